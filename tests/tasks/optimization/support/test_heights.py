"""Plan views, undersides and cells of things, seen from above and below."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.ndimage
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.meshes import Surface, surface_of
from tasks.optimization.support.heights import face_blocks, occupancy, plan_view, underside
from tests.tasks.optimization.support.furnishings import (
    SHELF,
    TABLE,
    block,
)


@pytest.mark.whole
@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.3, 0.3), ceiling=st.floats(-0.1, 2.0))
@settings(max_examples=40, deadline=None)
def test_a_plan_view_equals_rays_from_above(x: float, y: float, ceiling: float) -> None:
    """The highest surface below the ceiling, board by board."""
    surface = surface_of(SHELF)
    view = plan_view(surface, [x - 0.02, y - 0.02], [x + 0.02, y + 0.02], ceiling, 0.01)
    cells = np.argwhere(np.ones(view.heights.shape)) + np.array(view.first)
    for cell, height in zip(cells, view.at(cells), strict=True):
        cx, cy = (cell + 0.5) * 0.01
        on_board, on_side = abs(cx) < 0.15 and abs(cy) < 0.4, abs(cx) < 0.15 and abs(abs(cy) - 0.41) < 0.01
        if min(abs(abs(cx) - 0.15), abs(abs(cy) - 0.4), abs(abs(cy) - 0.42)) < 1e-6:
            continue
        levels = [z for b in (0.02, 0.5, 1.0, 1.48) for z in (b, b + 0.02)] if on_board else [0.0, 1.5] if on_side else []
        assert (
            height == pytest.approx(max([z for z in levels if z <= ceiling], default=-np.inf), abs=1e-9)
            or min(abs(z - ceiling) for z in levels) < 1e-6
        )


def test_the_underside_of_a_table_is_its_feet_and_its_top() -> None:
    _, heights = underside(surface_of(TABLE), 0.01)
    assert (heights < 0.01).sum() == pytest.approx(4 * 36, abs=30)
    assert (np.abs(heights - 0.71) < 0.01).sum() == pytest.approx(120 * 80 - 4 * 36, rel=0.03)
    assert len(underside(surface_of(block(0.001, 0.001, 0.001)), 0.01)[0]) == 1


@pytest.mark.whole
@given(seed=st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_occupied_cells_are_those_that_points_of_the_slice_lie_in(seed: int) -> None:
    """Random triangles: every sampled point between the heights lies in a marked cell or beside one."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.5, 0.5, (6, 3, 3))
    surface = Surface(corners.reshape(-1, 3), np.arange(18).reshape(6, 3), np.zeros((18, 3), dtype=np.uint8))
    bottom, top = np.sort(rng.uniform(-0.5, 0.5, 2))
    view = occupancy(surface, [-0.3, -0.3], [0.4, 0.4], bottom, top, 0.02)
    weights = rng.dirichlet([1.0, 1.0, 1.0], (6, 3000))
    points = np.einsum("tnk,tkd->tnd", weights, corners).reshape(-1, 3)
    points = points[(points[:, 2] > bottom) & (points[:, 2] < top)]
    cells = np.unique(np.floor(points[:, :2] / 0.02).astype(np.int64), axis=0)
    inside = cells[((cells >= view.first) & (cells < np.array(view.first) + view.heights.shape)).all(axis=1)]
    # a triangle may pass through a corner of a cell that is not its center: one cell beside is near enough
    marked = np.isfinite(view.heights)
    beside = scipy.ndimage.binary_dilation(marked, np.ones((3, 3)))
    assert all(beside[tuple(cell - view.first)] for cell in inside)
    # and nothing is marked outside of the triangles' own plan
    hulls = shapely.union_all([shapely.Polygon(corner[:, :2]) for corner in corners]).buffer(0.03)
    centers = (np.argwhere(marked) + np.array(view.first) + 0.5) * 0.02
    assert all(hulls.contains(shapely.Point(center)) for center in centers)
    assert not marked.any() or (corners[..., 2].min() <= top and corners[..., 2].max() >= bottom)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_faces_left_out_in_blocks_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    surface = surface_of([ball])
    blocks = face_blocks(surface)
    assert len(blocks) == -(-len(surface.faces) // 64)
    low = rng.uniform(-0.6, 0.3, 2)
    high = low + rng.uniform(0.01, 0.4, 2)
    every = np.tile([-np.inf] * 3 + [np.inf] * 3, (len(blocks), 1))
    ceiling = float(rng.uniform(-0.5, 0.6))
    assert np.array_equal(
        plan_view(surface, low, high, ceiling, 0.01, blocks=blocks).heights,
        plan_view(surface, low, high, ceiling, 0.01, blocks=every).heights,
    )
    assert np.array_equal(
        occupancy(surface, low, high, ceiling - 0.1, ceiling, 0.01, blocks).heights,
        occupancy(surface, low, high, ceiling - 0.1, ceiling, 0.01, every).heights,
    )
