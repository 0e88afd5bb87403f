"""Distances by the tree of boxes, against one implementation that looks at every triangle and another that has a tree of its own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.fidelity.box_trees import distances_within
from tasks.geometry.proximity import closest_points
from tests.tasks.geometry.slivers import slivers
from tests.tasks.geometry.test_proximity import brute


def soup(rng: np.random.Generator, count: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles anywhere within a metre: vertices [m], shape (3 count, 3), and faces."""
    corners = rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 60),
    flatness=st.sampled_from([1.0, 1e-3, 0.0]),
    offset=st.sampled_from([0.0, 50.0]),
    size=st.sampled_from([1.0, 0.05]),
    reach=st.sampled_from([0.05, 0.5, np.inf]),
)
def test_distances_are_those_of_brute_force_as_far_as_the_reach(
    seed: int, count: int, flatness: float, offset: float, size: float, reach: float
) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = soup(rng, count, size)
    vertices = vertices * [1, 1, flatness] + offset
    points = rng.uniform(-2, 2, (40, 3)) + offset
    slow = brute(vertices, faces, points)
    found = distances_within(vertices, faces, points, reach)
    within = slow < reach - 1e-9
    assert found[within] == pytest.approx(slow[within], abs=1e-9)
    assert np.isinf(found[slow > reach + 1e-9]).all()


@pytest.mark.parametrize("reach", [0.02, 0.1, np.inf])
def test_a_large_mesh_has_the_distances_of_libigl(reach: float) -> None:
    rng = np.random.default_rng(0)
    vertices, faces = soup(rng, 30_000, 0.02)
    points = rng.uniform(-1.2, 1.2, (5_000, 3))
    other = closest_points(vertices, faces, points).distance
    found = distances_within(vertices, faces, points, reach)
    assert np.array_equal(np.isfinite(found), other <= reach)
    assert found[other <= reach] == pytest.approx(other[other <= reach], abs=1e-12)


def test_neither_the_order_of_points_nor_that_of_faces_changes_a_byte() -> None:
    rng = np.random.default_rng(1)
    vertices, faces = soup(rng, 3_000, 0.05)
    points = rng.uniform(-1, 1, (2_000, 3))
    whole = distances_within(vertices, faces, points, 0.1)
    turn, shuffled = rng.permutation(len(points)), rng.permutation(len(faces))
    assert np.array_equal(whole[turn], distances_within(vertices, faces, points[turn], 0.1))
    assert np.array_equal(whole, distances_within(vertices, faces[shuffled], points, 0.1))


@pytest.mark.parametrize("height", [0.0, 1e-17, 1e-14, 1e-10, 1e-8, 1e-6, 1e-4])
@pytest.mark.parametrize("turn", [0, 1, 2])
def test_slivers_are_as_far_as_the_segment_that_they_all_but_are(height: float, turn: int) -> None:
    for corner, point, distance in zip(*slivers(height, turn), strict=True):
        assert distances_within(corner, [[0, 1, 2]], point[None], np.inf)[0] == pytest.approx(distance, abs=5 * height + 1e-8)


def test_triangles_without_area_are_the_segment_or_point_that_they_shrank_to() -> None:
    vertices = np.array([[0, 0, 0], [2, 0, 0], [1, 0, 0], [5, 5, 5]], dtype=float)
    faces = [[0, 1, 2], [0, 2, 1], [3, 3, 3]]
    points = np.array([[0.5, 3, 0], [-3, 0, 4], [5, 5, 7], [1, 0, 0]])
    assert distances_within(vertices, faces, points, np.inf).tolist() == [3, 5, 2, 0]
    assert distances_within(vertices, faces, points, 3.0).tolist() == [3, np.inf, 2, 0], "the reach itself is within it"


def test_many_equal_triangles_make_a_tree_too() -> None:
    found = distances_within(np.eye(3), np.tile([[0, 1, 2]], (5000, 1)), np.zeros((3, 3)), 1.0)
    assert found == pytest.approx(3**-0.5)


def test_nothing_is_near_no_triangle() -> None:
    assert distances_within(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), np.zeros((2, 3)), 1.0).tolist() == [np.inf, np.inf]
    assert distances_within(np.eye(3), [[0, 1, 2]], np.zeros((0, 3)), 1.0).shape == (0,)


@pytest.mark.parametrize(("vertices", "points"), [(np.full((3, 3), np.nan), np.zeros((1, 3))), (np.eye(3), [[np.inf, 0, 0]])])
def test_what_has_no_answer_is_refused(vertices: np.ndarray, points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="not finite"):
        distances_within(vertices, [[0, 1, 2]], points, 1.0)
