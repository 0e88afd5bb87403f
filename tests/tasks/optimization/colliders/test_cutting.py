"""Convex pieces cut back from one another: nothing is left in the other, and what lies beside it stays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.geometry.hulls import LIMITS, Hull, is_within
from tasks.optimization.colliders.cutting import LEAST_M, MOST_PARTS, beyond, solid_hull, without
from tests.tasks.optimization.scenes import penetration_depth


def cuboid(size: tuple[float, float, float], center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Hull:
    """A box [m]."""
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    hull = solid_hull(corners * size + center)
    assert hull is not None
    return hull


SIZES = st.tuples(*[st.floats(0.05, 1.0)] * 3)
PLACES = st.tuples(*[st.floats(-0.7, 0.7)] * 3)
POINTS = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).uniform(-0.5, 0.5, (12, 3)))


@given(POINTS, st.integers(0, 2**32 - 1), st.floats(-0.4, 0.4))
def test_a_plane_divides_a_hull_into_two_that_together_are_as_large(points: np.ndarray, seed: int, offset: float) -> None:
    hull = solid_hull(points)
    assert hull is not None
    normal = np.random.default_rng(seed).normal(size=3)
    normal /= np.linalg.norm(normal)
    sides = [beyond(hull, normal, offset), beyond(hull, -normal, -offset)]
    for side, sign in zip(sides, (1.0, -1.0), strict=True):
        if side is not None:
            assert (sign * (side.vertices @ normal - offset)).min() >= -1e-9
            assert side.volume > 0.0
    most = LEAST_M * 3.0  # a sliver that is nothing has no more than its thickness by the largest section, sqrt(3) squared
    assert sum(side.volume for side in sides if side is not None) == pytest.approx(hull.volume, abs=most)


@given(SIZES, PLACES, POINTS)
def test_what_is_left_beside_another_hull_is_out_of_it_and_within_what_it_was(
    size: tuple[float, float, float], place: tuple[float, float, float], points: np.ndarray
) -> None:
    hull, other = solid_hull(points), cuboid(size, place)
    assert hull is not None
    parts = without(hull, other, 0.001)
    assert len(parts) <= MOST_PARTS
    assert sum(part.volume for part in parts) <= hull.volume + 1e-9, "parts do not overlap"
    for part in parts:
        assert is_within(part, LIMITS)
        if part is not hull:
            assert penetration_depth(part.vertices, other.vertices) == pytest.approx(0.0, abs=1e-9)
    for a, first in enumerate(parts):
        for second in parts[a + 1 :]:
            assert penetration_depth(first.vertices, second.vertices) < 1e-9


@given(SIZES, SIZES, PLACES)
def test_boxes_that_are_apart_stay_whole(first: tuple[float, ...], second: tuple[float, ...], place: tuple[float, ...]) -> None:
    away = (0.5 * (first[0] + second[0]) + 0.01, place[1], place[2])
    hull = cuboid(first)  # type: ignore[arg-type]
    assert without(hull, cuboid(second, away), 0.005) == [hull]  # type: ignore[arg-type]


def test_a_corner_that_is_taken_costs_no_more_than_itself() -> None:
    hull, other = cuboid((1.0, 1.0, 1.0)), cuboid((1.0, 1.0, 1.0), (0.6, 0.6, 0.6))
    parts = without(hull, other)
    assert sum(part.volume for part in parts) == pytest.approx(1.0 - 0.4**3, rel=1e-9)


def test_what_lies_within_another_hull_is_gone() -> None:
    assert without(cuboid((0.2, 0.2, 0.2)), cuboid((1.0, 1.0, 1.0))) == []


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.eye(3), np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.001]])])
def test_what_is_flat_is_no_solid(points: np.ndarray) -> None:
    assert solid_hull(points) is None
