"""Algorithm 1, compiled and incremental, against the same in plain Python with the whole loss summed at every move."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.optimization.plain import compare, compiled_seconds, crowd_of, descend_plainly
from tasks.geometry.boxes import aabb_overlaps
from tasks.optimization.search.collisions import Crowd, Trace, descend, listed, room_borders, room_triangles
from tasks.optimization.search.descent import REACH, TOUCH_M, compiled_descent
from tests.tasks.optimization.search.test_collisions import collision_loss

seeds = st.integers(0, 10**6)
L_SHAPE = np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 0.0], [0.0, 0.0], [0.0, 2.0], [-2.0, 2.0]])
WALL = np.array([[-1.0, -1.1], [1.0, -1.1], [1.0, -1.0], [-1.0, -1.0]])


def both(crowd: Crowd, step: float, max_steps: int, seed: int) -> Trace:
    """What the compiled loop does, once it is the same as what the plain one does."""
    one = descend(crowd, step, max_steps, np.random.default_rng(seed))
    other = descend_plainly(crowd, step, max_steps, np.random.default_rng(seed))
    assert np.array_equal(one.objects, other.objects)
    assert np.array_equal(one.moves, other.moves)
    assert np.array_equal(one.outcome, other.outcome)
    assert np.array_equal(one.moved, other.moved)
    assert one.exhausted == other.exhausted
    assert one.start == pytest.approx(other.start, abs=1e-9)
    assert np.abs(one.loss - other.loss).max(initial=0.0) < 1e-9
    assert np.abs(one.smallest - other.smallest).max(initial=0.0) < 1e-9
    assert (one.final == 0.0) == (other.final == 0.0)
    return one


@pytest.mark.whole
def test_furnished_rooms_have_the_same_moves_outcomes_and_losses() -> None:
    met: set[int] = set()
    for seed in range(6):
        crowd = crowd_of(30, np.random.default_rng(seed))
        trace = both(crowd, 0.05, 1200, seed)
        assert len(trace.loss) > 200
        assert trace.final < trace.start
        met |= set(trace.outcome.tolist())
    assert met == {1, 2, 3, 4}  # kept, reverted, out of the room, off the support


@given(seed=seeds, count=st.integers(1, 14), step=st.sampled_from([0.013, 0.05, 0.2]), closeness=st.floats(0.1, 1.0))
@settings(max_examples=60, deadline=None)
def test_any_crowd_has_the_same_moves_outcomes_and_losses(seed: int, count: int, step: float, closeness: float) -> None:
    """Objects carried by carried objects, pairs that do not count, objects that are not moved, with a room and without."""
    rng = np.random.default_rng(seed)
    crowd = crowd_of(count, rng)
    center = crowd.low[:, :2].mean(axis=0)
    shift = (center - crowd.low[:, :2]) * (1.0 - closeness)
    wide = np.column_stack([shift, np.zeros(count)])
    carries, counted = crowd.carries.copy(), crowd.counted.copy()
    for i, j in zip(*np.nonzero(rng.random((count, count)) < 0.1), strict=True):
        carries[i] |= carries[j]
        counted[i, j] = counted[j, i] = False
    crowd = dataclasses.replace(
        crowd,
        low=crowd.low + wide,
        high=crowd.high + wide,
        outlines=crowd.outlines + shift[:, None],
        carries=carries,
        counted=counted,
        movable=rng.random(count) < 0.9,
        room=crowd.room if rng.random() < 0.7 else np.zeros((0, 3, 2)),
    )
    both(crowd, step, 300, seed)


def boxes_crowd(low: np.ndarray, high: np.ndarray) -> Crowd:
    """Boxes that all count, all move, and stand in no room."""
    n = len(low)
    rings = np.stack([low[:, :2], np.column_stack([high[:, 0], low[:, 1]]), high[:, :2], np.column_stack([low[:, 0], high[:, 1]])], axis=1)
    return Crowd(
        low=low, high=high, counted=~np.eye(n, dtype=bool), movable=np.ones(n, dtype=bool), carries=np.eye(n, dtype=bool), outlines=rings,
        corners=np.full(n, 4), room=np.zeros((0, 3, 2)), carrier=np.full(n, -1), shifts=np.ones((n, 1, 1), dtype=bool),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_the_lists_are_right_when_objects_go_far(seed: int) -> None:
    """A pile of boxes in one place, which have to go far past each other, among others that they first meet on the way."""
    rng = np.random.default_rng(seed)
    pile, around = rng.normal(0.0, 0.1, (24, 3)), rng.uniform(-2.0, 2.0, (20, 3))
    center = np.concatenate([pile, around[np.abs(around[:, :2]).max(axis=1) > 0.9]])
    size = rng.uniform(0.1, 0.5, center.shape)
    center[:, 2] = size[:, 2] / 2
    crowd = boxes_crowd(center - size / 2, center + size / 2)
    crowd.carries[0, 30], crowd.carries[0, 31] = True, True  # carried along without being near
    trace = both(crowd, 0.05, 1800, seed)
    assert np.abs(trace.moved).max() > 3 * REACH
    assert (trace.outcome == 1).sum() > 100


def test_two_boxes_that_were_far_apart_meet() -> None:
    """Object 0 is in object 1 and can only leave it towards object 2, which is far from it at first; the loss sees all three."""
    low = np.array([[0.0, 0.0, 0.0], [-1.0, -5.0, 0.0], [2.0, -5.0, 0.0]])
    high = np.array([[2.9, 1.0, 1.0], [1.0, 5.0, 1.0], [2.2, 5.0, 1.0]])
    low[0, 0] = 0.9
    high[0, 0] = 1.9  # a tenth in object 1, a tenth away from object 2
    crowd = dataclasses.replace(boxes_crowd(low, high), movable=np.array([True, False, False]))
    trace = both(crowd, 0.05, 400, 0)
    assert trace.final == 0.0
    assert trace.moved[0, 0] == 2
    far = dataclasses.replace(crowd, low=low - [[0.9, 0, 0], [0, 0, 0], [0, 0, 0]], high=high - [[0.9, 0, 0], [0, 0, 0], [0, 0, 0]])
    trace = both(far, 0.05, 400, 1)
    assert trace.final == 0.0
    assert trace.moved[0, 0] > 3 * REACH


@given(seed=seeds, count=st.integers(2, 12))
@settings(max_examples=40, deadline=None)
def test_the_loss_is_zero_exactly_when_no_two_boxes_overlap(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    center, size = rng.uniform(-0.8, 0.8, (count, 3)), rng.uniform(0.1, 0.4, (count, 3))
    center[:, 2] = 0.0
    crowd = boxes_crowd(center - size / 2, center + size / 2)
    trace = descend(crowd, 0.05, 20_000, rng)
    offset = np.column_stack([trace.moved * 0.05, np.zeros(count)])
    left = collision_loss(crowd.low + offset, crowd.high + offset, crowd.counted)
    assert trace.final == pytest.approx(left, abs=1e-12)
    assert (trace.final == 0.0) == (left == 0.0)
    assert (trace.loss[:-1] > 0.0).all()


@given(seed=seeds, count=st.integers(0, 12))
@settings(max_examples=30, deadline=None)
def test_both_losses_are_one_and_do_not_depend_on_place_or_order(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-1, 1, (count, 3))
    high = low + rng.uniform(0.1, 1.0, (count, 3))
    counted = np.triu(rng.random((count, count)) < 0.8, 1)
    counted |= counted.T
    loss = collision_loss(low, high, counted)
    overlaps = aabb_overlaps(low, high)
    sides = np.minimum(high[:, None], high[None]) - np.maximum(low[:, None], low[None])
    volumes = np.where((sides > TOUCH_M).all(axis=2) & counted, overlaps, 0.0)
    assert float(np.triu(volumes, 1).sum()) == pytest.approx(loss, abs=1e-12)
    order, shift = rng.permutation(count), rng.uniform(-5, 5, 3)
    assert collision_loss(low[order] + shift, high[order] + shift, counted[np.ix_(order, order)]) == pytest.approx(loss, abs=1e-12)


@given(
    at=st.tuples(st.floats(-2.5, 2.5), st.floats(-2.5, 2.5)), size=st.tuples(st.floats(0.01, 2.0), st.floats(0.01, 2.0)), wall=st.booleans()
)
@settings(max_examples=200, deadline=None)
def test_a_clear_rectangle_has_nothing_outside_the_room(at: tuple[float, float], size: tuple[float, float], wall: bool) -> None:
    from shapely import Polygon, box

    compiled_descent()
    from tasks.optimization.search import descent

    room = room_triangles(L_SHAPE, [WALL] if wall else [])
    free = Polygon(L_SHAPE).difference(Polygon(WALL)) if wall else Polygon(L_SHAPE)
    borders = room_borders(room)
    assert np.linalg.norm(borders[:, 1] - borders[:, 0], axis=1).sum() == pytest.approx(free.length, abs=1e-9)
    corners = (at[0] - size[0] / 2, at[1] - size[1] / 2, at[0] + size[0] / 2, at[1] + size[1] / 2)
    clear = descent._is_clear(*corners, borders)
    outside = box(*corners).difference(free).area
    assert not clear or outside == pytest.approx(0.0, abs=1e-12)
    if free.exterior.distance(box(*corners)) > 1e-6 and free.contains(box(*corners)):
        assert clear or free.boundary.distance(box(*corners)) < 1e-6  # the quick way is taken where it can be
    ring = np.array([[corners[0], corners[1]], [corners[2], corners[1]], [corners[2], corners[3]], [corners[0], corners[3]]])
    clipped = descent._outside(ring, 4, 0.0, 0.0, room, np.empty((12, 2)), np.empty((12, 2)))
    assert clipped == pytest.approx(outside, abs=1e-9)


@given(seeds, st.integers(0, 9))
@settings(max_examples=30, deadline=None)
def test_lists_say_what_was_chosen(seed: int, n: int) -> None:
    chosen = np.random.default_rng(seed).random((n, n)) < 0.4
    columns, first = listed(chosen)
    again = np.zeros_like(chosen)
    for i in range(n):
        assert (np.diff(columns[first[i] : first[i + 1]]) > 0).all()
        again[i, columns[first[i] : first[i + 1]]] = True
    assert np.array_equal(again, chosen)


@pytest.mark.whole
def test_the_plain_loop_is_left_far_behind() -> None:
    """Bounds for a machine that does other work; quiet, the first is above 1,500 and the second about 1."""
    found = compare(39, 0, 600)
    assert found["is_same"]
    assert found["largest_difference_m3"] < 1e-9
    assert found["speedup"] > 200
    assert compiled_seconds(1000, 0, 30) < 8 * compiled_seconds(39, 0, 60)  # 26 times as many objects
