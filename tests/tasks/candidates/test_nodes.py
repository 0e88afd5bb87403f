"""Nodes of a grid around a surface: their distances to it, and which of them rays tell to be inside."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.candidates.nodes import FRONT_SHARE, INSIDE_SHARE, INSIDE_SHARE_ABOVE, NodeGrid, distances, enclosed
from tasks.furniture import generate
from tasks.geometry.meshes import Surface
from tasks.geometry.proximity import closest_points
from tasks.geometry.rendering import RayScene
from tests.tasks.candidates.crops import crop_of_parts

DIRECTIONS = np.array(
    [[0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]
    + [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-0.6, 0.6)],
    dtype=np.float32,
)  # fmt: skip


def grid_around(surface: Surface, cells: int, seed: int) -> NodeGrid:
    """A grid whose lines meet no edge of the surface: where they do, nobody can say which side is met."""
    low, high = surface.bounds
    step = float(max(high - low) / cells)
    shape = np.ceil((high - low) / step).astype(int) + 6
    origin = low - step * (2 + np.random.default_rng(seed).uniform(0.1, 0.9, 3))
    return NodeGrid(origin, step, (int(shape[0]), int(shape[1]), int(shape[2])))


def nodes_of(grid: NodeGrid) -> np.ndarray:
    """All nodes in order, in single precision, shape (n, 3)."""
    return np.stack(np.meshgrid(*grid.axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)


@pytest.mark.parametrize("category", ["sofa", "bookshelf", "chair", "vase"])
def test_what_is_enclosed_is_what_single_rays_tell(category: str) -> None:
    """The reference casts every ray of every node by itself."""
    crop = crop_of_parts(generate(category, None, np.random.default_rng(3)).parts)
    grid = grid_around(crop, 15, 1)
    nodes, scene = nodes_of(grid), RayScene([crop.to_trimesh()])
    backs, above, fronts = np.zeros((3, len(nodes)))
    for direction in DIRECTIONS:
        hits = scene.cast(np.concatenate([nodes, np.tile(direction, (len(nodes), 1))], axis=1))
        met, leaving = np.isfinite(hits["t_hit"]), hits["primitive_normals"] @ direction > 0
        backs += met & leaving
        above += met & leaving & (direction[2] >= 0)
        fronts += met & ~leaving
    upward = (DIRECTIONS[:, 2] >= 0).sum()
    closed_in = (backs >= INSIDE_SHARE * 14) | (above >= INSIDE_SHARE_ABOVE * upward)
    expected = (closed_in & (fronts <= FRONT_SHARE * 14)).reshape(grid.shape)
    away = distances(crop.vertices, crop.faces, grid, 1e-3 * grid.step) > 0.9e-3 * grid.step  # what touches is on no side
    asked = away & (np.random.default_rng(0).random(grid.shape) < 0.9)
    assert np.array_equal(enclosed(crop.vertices, crop.faces, grid, asked), expected & asked)
    assert 0.005 < expected.mean() < 0.9


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 30), decimals=st.integers(0, 6), far=st.floats(0.2, 3.0))
@settings(max_examples=60, deadline=None)
def test_distances_are_those_of_an_exact_query(seed: int, count: int, decimals: int, far: float) -> None:
    """With large and small triangles, and some that are lines or points."""
    rng = np.random.default_rng(seed)
    vertices = np.round(rng.normal(size=(3 * count, 3)) * rng.choice([0.05, 1.0], size=(3 * count, 1)), decimals)
    surface = Surface(vertices, rng.integers(0, 3 * count, (count, 3)), np.zeros((3 * count, 3), dtype=np.uint8))
    grid = NodeGrid(np.array([-1.5, -1.0, -0.7]), 0.31, (9, 7, 6))
    expected = np.minimum(closest_points(vertices, surface.faces, nodes_of(grid)).distance, far * grid.step)
    found = distances(vertices, surface.faces, grid, far * grid.step)
    assert np.allclose(found.ravel(), expected, atol=1e-7)
