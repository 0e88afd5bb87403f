"""The room's boundary: the shortest way in is a way in, and no shorter one is."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.optimization.support.boundary import outside_share, way_in

Array = np.ndarray
seeds = st.integers(0, 10**6)
SQUARE = np.array([[-2.0, -1.5], [2.0, -1.5], [2.0, 1.5], [-2.0, 1.5]])
ELL = np.array([[-3.0, -2.0], [3.0, -2.0], [3.0, 1.0], [1.0, 1.0], [1.0, 2.0], [-3.0, 2.0]])
NOOK = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [2.6, 3.0], [2.6, 1.2], [1.8, 1.2], [1.8, 3.0], [0.0, 3.0]])
SLANTED = np.array([[0.0, 0.0], [5.0, -1.0], [4.0, 3.0], [2.0, 2.0], [0.5, 3.5]])
ROOMS = (SQUARE, ELL, NOOK, SLANTED)


def outline_of(rng: np.random.Generator, most: float = 0.6) -> Array:
    """A convex outline somewhere near a room, counterclockwise [m]."""
    points = rng.normal(size=(int(rng.integers(3, 12)), 2)) * rng.uniform(0.1, most, 2)
    hull = shapely.MultiPoint(points).convex_hull
    return np.array(hull.exterior.coords)[:-1] + rng.uniform([-4.0, -3.0], [6.0, 4.0])


def is_inside(outline: Array, ring: Array, tolerance: float = 0.0) -> bool:
    return bool(shapely.Polygon(ring).buffer(tolerance, join_style="mitre").covers(shapely.Polygon(outline)))


def fits(outline: Array, ring: Array, shifts: Array) -> Array:
    """Which of the shifts, shape (n, 2), bring an outline inside, shape (n,)."""
    room = shapely.Polygon(ring)
    shapely.prepare(room)
    return np.asarray(shapely.covers(room, shapely.polygons(outline[None] + shifts[:, None])))


@given(seeds, st.sampled_from(range(len(ROOMS))))
@settings(max_examples=80, deadline=None)
def test_the_way_in_leads_inside_and_none_is_shorter(seed: int, which: int) -> None:
    rng, ring = np.random.default_rng(seed), ROOMS[which]
    outline = outline_of(rng)
    way = way_in(outline, ring)
    low, high = ring.min(axis=0) - outline.min(axis=0), ring.max(axis=0) - outline.max(axis=0)
    if way is None:
        assert not fits(outline, ring, low + (high - low) * rng.random((2000, 2))).any()
        return
    length = float(np.hypot(*way))
    assert is_inside(outline + way, ring, 1e-7)
    assert (length == 0.0) == is_inside(outline, ring, 1e-9)
    # no point of the disk that it ends on the rim of is a way in, near its end or anywhere
    angles, reach = rng.uniform(-np.pi, np.pi, 2000), length * np.sqrt(rng.random(2000))
    shifts = reach[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    around = np.array(way) * (1.0 - 1e-6) + rng.normal(size=(500, 2)) * 0.01 * length
    shorter = np.concatenate([shifts, around])
    shorter = shorter[np.hypot(*shorter.T) < length - 1e-7]
    assert not fits(outline, ring, shorter).any()
    # and ways in that are found by chance are no shorter
    some = low + (high - low) * rng.random((2000, 2))
    assert (np.hypot(*some[fits(outline, ring, some)].T) >= length - 1e-7).all()


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_what_is_inside_stays_and_what_left_comes_back_no_farther_than_it_went(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for ring in ROOMS:
        outline = outline_of(rng, 0.2)
        way = way_in(outline, ring)
        if way is None:
            continue
        inside = outline + way
        assert np.hypot(*(way_in(inside, ring) or (1.0, 1.0))) < 1e-7
        shift = rng.uniform(-1.0, 1.0, 2)
        back = way_in(inside + shift, ring)
        assert back is not None
        assert np.hypot(*back) <= np.hypot(*shift) + 1e-6


def test_closed_forms() -> None:
    box = np.array([[-0.5, -0.25], [0.5, -0.25], [0.5, 0.25], [-0.5, 0.25]])
    assert way_in(box + np.array([1.9, 0.0]), SQUARE) == pytest.approx((-0.4, 0.0), abs=1e-8)
    assert way_in(box + np.array([1.9, -1.6]), SQUARE) == pytest.approx((-0.4, 0.35), abs=1e-8)
    assert way_in(box + np.array([0.3, 0.2]), SQUARE) == (0.0, 0.0)
    assert way_in(5.0 * box, SQUARE) is None
    # into the notch of an L: down below it, or to its left, whichever is nearer
    assert way_in(box + np.array([1.6, 0.95]), ELL) == pytest.approx((0.0, -0.2), abs=1e-8)
    assert way_in(box + np.array([0.6, 1.6]), ELL) == pytest.approx((-0.1, 0.0), abs=1e-8)
    # too wide for either arm of a U, though not for the room's box
    assert way_in(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.3], [0.0, 1.3]]), NOOK) is None
    assert way_in(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.1], [0.0, 1.1]]) + 0.5, NOOK) == pytest.approx((0.0, -0.4), abs=1e-8)


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_the_way_in_turns_and_moves_with_the_room(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outline, ring = outline_of(rng), ELL
    way = way_in(outline, ring)
    angle, shift = rng.uniform(-np.pi, np.pi), rng.uniform(-20, 20, 2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    other = way_in(outline @ turn.T + shift, ring @ turn.T + shift)
    assert (way is None) == (other is None)
    if way is not None and other is not None:  # two ways may be as short
        assert np.hypot(*other) == pytest.approx(np.hypot(*way), abs=1e-7)


@given(seeds, st.sampled_from(range(len(ROOMS))))
@settings(max_examples=30, deadline=None)
def test_the_share_outside_is_that_of_points(seed: int, which: int) -> None:
    rng, ring = np.random.default_rng(seed), ROOMS[which]
    outline = outline_of(rng)
    shape, floor = shapely.Polygon(outline), shapely.Polygon(ring)
    points = outline.min(axis=0) + np.ptp(outline, axis=0) * rng.random((4000, 2))
    points = points[shapely.contains_xy(shape, points)]
    outside = float((~shapely.contains_xy(floor, points)).mean())
    assert outside_share(outline, ring) == pytest.approx(outside, abs=5.0 * 0.5 / np.sqrt(len(points)) + 1e-9)
