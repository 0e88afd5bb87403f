"""Level surfaces: closed, manifold, outward, and where the function is zero."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.isosurfaces import _cases, dense_surface, level_surface


def bordered(values: np.ndarray) -> np.ndarray:
    return np.pad(values, 1, constant_values=1.0).astype(np.float32)


def directed_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(edges, axis=0, return_counts=True)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), shape=st.tuples(*[st.integers(1, 9)] * 3), share=st.floats(0.02, 0.98))
def test_whatever_the_values_the_surface_is_a_closed_manifold(seed: int, shape: tuple[int, int, int], share: float) -> None:
    rng = np.random.default_rng(seed)
    values = bordered(rng.uniform(0, 1, shape) - share)
    vertices, faces = dense_surface(values)
    edges, times = directed_edges(faces)
    assert (times == 1).all(), "an edge has two faces of the same direction, or more than two faces"
    assert {tuple(e) for e in edges.tolist()} == {tuple(e[::-1]) for e in edges.tolist()}, "the surface is open"
    assert set(np.unique(faces)) == set(range(len(vertices)))
    # one vertex per crossed edge of the grid
    assert len(vertices) == sum(int((np.diff((values < 0).astype(np.int8), axis=a) != 0).sum()) for a in range(3))


def test_the_cases_are_consistent_under_taking_the_opposite() -> None:
    table, count = _cases()
    assert count[0] == count[255] == 0
    for corner in range(8):
        assert count[1 << corner] == count[255 ^ 1 << corner] == 1
    crossed = [{e for e in table[case].ravel().tolist() if e >= 0} for case in range(256)]
    assert all(crossed[case] == crossed[255 ^ case] for case in range(256))


def test_a_sphere_is_where_it_should_be_and_faces_outward() -> None:
    n, radius, center = 40, 14.3, np.array([19.2, 20.1, 19.7])
    grid = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1)
    vertices, faces = dense_surface((np.linalg.norm(grid - center, axis=-1) - radius).astype(np.float32))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.005)
    assert np.abs(np.linalg.norm(vertices - center, axis=1) - radius).max() < 0.02


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), unknown=st.sampled_from([0.0, 0.02, 0.1]))
def test_bricks_give_the_surface_of_the_whole(seed: int, unknown: float) -> None:
    rng = np.random.default_rng(seed)
    size, many = 3, (2, 3, 2)
    shape = tuple(size * m for m in many)
    values = rng.normal(size=shape).astype(np.float32)
    known = rng.random(shape) >= unknown
    colors = rng.uniform(0, 255, (*shape, 3)).astype(np.float32)
    alone = np.array([[0] + [-1] * 7])
    whole = level_surface(values[None], known[None], colors[None], np.zeros((1, 3), dtype=np.int64), alone)
    places = np.stack(np.meshgrid(*[np.arange(m) for m in many], indexing="ij"), axis=-1).reshape(-1, 3)
    index = {tuple(p): i for i, p in enumerate(places.tolist())}
    following = np.array([[index.get((x + (c & 1), y + (c >> 1 & 1), z + (c >> 2)), -1) for c in range(8)] for x, y, z in places.tolist()])
    cut = [tuple(slice(size * v, size * v + size) for v in p) for p in places.tolist()]
    parts = level_surface(
        np.stack([values[c] for c in cut]), np.stack([known[c] for c in cut]), np.stack([colors[c] for c in cut]), size * places, following
    )
    assert sorted_triangles(*whole) == sorted_triangles(*parts)


def sorted_triangles(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray) -> list[list[float]]:
    return sorted(np.concatenate([vertices[faces], colors[faces]], axis=2).reshape(len(faces), 18).round(5).tolist())
