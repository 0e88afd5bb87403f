"""Collisions: Algorithm 1 never makes it worse, stays in the room and ends; outlines are hulls."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.optimization.plain import loss_of
from tasks.optimization.search.collisions import MOVES, Crowd, descend, plan_ring, room_triangles, stacked

L_SHAPE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 0.0), (0.0, 0.0), (0.0, 2.0), (-2.0, 2.0))


def crowd_of(rng: np.random.Generator, n: int, polygon: tuple[tuple[float, float], ...] = (), spread: float = 1.8) -> Crowd:
    center, size = rng.uniform(-spread, spread, (n, 3)), rng.uniform(0.2, 1.0, (n, 3))
    center[:, 2] = size[:, 2] / 2
    low, high = center - size / 2, center + size / 2
    rings = [np.array([[a[0], a[1]], [b[0], a[1]], [b[0], b[1]], [a[0], b[1]]]) for a, b in zip(low, high, strict=True)]
    outlines, corners = stacked(rings)
    room = room_triangles(np.array(polygon)) if polygon else np.zeros((0, 3, 2))
    return Crowd(
        low=low, high=high, counted=~np.eye(n, dtype=bool), movable=np.ones(n, dtype=bool), carries=np.eye(n, dtype=bool),
        outlines=outlines, corners=corners, room=room, carrier=np.full(n, -1), shifts=np.ones((n, 1, 1), dtype=bool),
    )  # fmt: skip


def collision_loss(low: np.ndarray, high: np.ndarray, counted: np.ndarray) -> float:
    """The loss of boxes [m3], corners of shape (n, 3), as equation A1 has it."""
    return loss_of(list(zip(low.tolist(), high.tolist(), strict=True)), counted.tolist())


@given(seed=st.integers(0, 10**6), n=st.integers(2, 15))
@settings(max_examples=40, deadline=None)
def test_the_loss_falls_and_is_that_of_the_poses(seed: int, n: int) -> None:
    crowd = crowd_of(np.random.default_rng(seed), n, L_SHAPE, spread=1.0)
    trace = descend(crowd, 0.05, 3000, np.random.default_rng(seed))
    levels = np.concatenate([[trace.start], trace.smallest])
    assert (np.diff(levels) <= 0).all()
    assert (np.diff(levels)[trace.outcome == 1] < 0).all()
    assert (np.diff(levels)[trace.outcome != 1] == 0).all()
    offset = np.column_stack([trace.moved * 0.05, np.zeros(n)])
    assert collision_loss(crowd.low + offset, crowd.high + offset, crowd.counted) == pytest.approx(trace.final, abs=1e-9)
    assert trace.final == 0 or trace.exhausted or len(trace.loss) == 3000
    if trace.exhausted:
        for i in range(n):
            for move in MOVES:
                tried = offset.copy()
                tried[i, :2] += move * 0.05
                low, high = crowd.low + tried, crowd.high + tried
                inside = _outside(low[i], high[i]) <= _outside(crowd.low[i] + offset[i], crowd.high[i] + offset[i]) + 1e-9
                assert not inside or collision_loss(low, high, crowd.counted) >= trace.final - 1e-9


def _outside(low: np.ndarray, high: np.ndarray) -> float:
    from shapely import Polygon, box

    return float(box(*low[:2], *high[:2]).difference(Polygon(L_SHAPE)).area)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_nothing_gets_farther_out_of_the_room(seed: int) -> None:
    crowd = crowd_of(np.random.default_rng(seed), 8, L_SHAPE)
    trace = descend(crowd, 0.05, 3000, np.random.default_rng(seed))
    for i, shift in enumerate(trace.moved * 0.05):
        before, after = _outside(crowd.low[i], crowd.high[i]), _outside(crowd.low[i] + [*shift, 0], crowd.high[i] + [*shift, 0])
        assert after <= before + 1e-8


def test_it_stops_at_zero_and_does_not_start_there() -> None:
    two = crowd_of(np.random.default_rng(0), 2)
    apart = dataclasses.replace(two, low=np.array([[0.0, 0, 0], [1, 0, 0]]), high=np.array([[1.0, 1, 1], [2, 1, 1]]))
    assert len(descend(apart, 0.05, 100, np.random.default_rng(0)).loss) == 0  # they only touch
    close = dataclasses.replace(apart, low=np.array([[0.0, 0, 0], [0.93, 0, 0]]))
    trace = descend(close, 0.05, 1000, np.random.default_rng(0))
    assert trace.loss[-1] == 0.0
    assert trace.final == 0.0
    assert (trace.loss[:-1] > 0).all()
    assert (trace.outcome == 1).sum() >= 2


@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=3, max_size=60))
@settings(max_examples=40, deadline=None)
def test_outlines_are_hulls(points: list[tuple[float, float]]) -> None:
    from shapely import MultiPoint, Polygon

    ring = plan_ring(np.array(points))
    hull = MultiPoint(points).convex_hull
    assert 3 <= len(ring) <= 32
    if hull.area > 1e-3:
        assert Polygon(ring).area == pytest.approx(hull.area, rel=0.02)
        assert Polygon(ring).exterior.is_ccw
    assert sum(np.linalg.det([t[1] - t[0], t[2] - t[0]]) / 2 for t in room_triangles(np.array(L_SHAPE))) == pytest.approx(12.0)


def test_a_full_room_is_descended_to_a_fraction_of_its_loss() -> None:
    crowd = crowd_of(np.random.default_rng(3), 39, L_SHAPE, spread=2.5)
    trace = descend(crowd, 0.05, 10_000, np.random.default_rng(0))
    assert len(trace.loss) > 1000
    assert trace.loss[-1] < 0.5 * trace.loss[0]
