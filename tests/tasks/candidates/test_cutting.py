"""Crops of a scan as convex pieces: few of them, which make up the surface."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.candidates.closing import solid_field
from tasks.candidates.cutting import best_cut, hull_area
from tasks.candidates.scan_crop import closed_crop, pieces_of_crop
from tasks.furniture import generate
from tasks.geometry.meshes import sample_surface
from tests.tasks.candidates.crops import (
    OPEN_BOTTOM,
    crop_of_parts,
    signed_distance,
)


@pytest.mark.whole
@pytest.mark.parametrize("category", ["chair", "table", "bookshelf", "bed"])
def test_pieces_are_convex_few_and_make_up_the_surface(category: str) -> None:
    model = generate(category, None, np.random.default_rng(2))
    crop = crop_of_parts(model.parts, hidden=(OPEN_BOTTOM,))
    field = solid_field(crop)
    surface, pieces = pieces_of_crop(crop, field)
    assert 1 <= len(pieces) <= 40
    assert surface.is_watertight
    for piece in pieces:
        assert piece.is_volume
        assert piece.convex_hull.volume == pytest.approx(piece.volume, rel=1e-4)
    corners = np.concatenate([piece.vertices for piece in pieces])
    assert np.allclose([corners.min(axis=0), corners.max(axis=0)], surface.bounds, atol=1e-6)
    # The union is no smaller than the solid and does not fill its box.
    closed = closed_crop(crop, field)
    assert surface.volume > 0.6 * closed.volume
    points, _, _ = sample_surface(crop, 1000, np.random.default_rng(0))
    distance = np.abs(signed_distance(surface, points))
    assert np.percentile(distance, 90) < 2.5 * field.step


def test_a_corner_sofa_is_cut_not_filled() -> None:
    parts = [trimesh.creation.box(bounds=[[-1, -1, 0], [1, -0.2, 0.6]]), trimesh.creation.box(bounds=[[-1, -0.2, 0], [-0.2, 1, 0.6]])]
    crop = crop_of_parts(parts, hidden=(OPEN_BOTTOM,))
    surface, pieces = pieces_of_crop(crop, solid_field(crop))
    assert len(pieces) >= 2
    assert surface.volume < 0.75 * 2 * 2 * 0.6
    assert signed_distance(surface, np.array([[0.6, 0.6, 0.3]]))[0] > 0.3


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 7), st.integers(0, 1), st.integers(0, 6))
def test_hulls_of_cells_have_the_area_that_shapely_says(seed: int, rows: int, columns: int, axis: int, position: int) -> None:
    import shapely
    from scipy.ndimage import label

    plan = np.random.default_rng(seed).random((rows, columns)) < 0.6
    side = np.zeros(plan.shape, dtype=bool)
    np.moveaxis(side, axis, 0)[:position] = True
    expected = 0.0
    for half in (plan & side, plan & ~side):
        bodies, count = label(half)
        for index in range(1, count + 1):
            expected += shapely.union_all([shapely.box(i, j, i + 1, j + 1) for i, j in np.argwhere(bodies == index)]).convex_hull.area
    assert hull_area(plan, axis, position) == pytest.approx(expected)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 7), min_size=1), st.lists(st.integers(0, 7), min_size=1))
def test_the_best_cut_is_the_first_that_leaves_least(seed: int, rows: list[int], columns: list[int]) -> None:
    plan = np.random.default_rng(seed).random((7, 7)) < 0.6
    areas = {(axis, at): hull_area(plan, axis, at) for axis, places in ((0, rows), (1, columns)) for at in places}
    area, axis, at = best_cut(plan, rows, columns)
    assert area == min(areas.values())
    assert (axis, at) == next(cut for cut, left in areas.items() if left == area)
