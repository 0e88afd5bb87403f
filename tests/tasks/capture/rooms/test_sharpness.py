"""Walls gather on lines at the turn of their room: the compiled sum against histograms, and turns that are known."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.rooms.sharpness import LINE_M, sharpness


def by_histogram(plan: np.ndarray, sides: np.ndarray, weights: np.ndarray, turn: float) -> float:
    """The sum by shares of bins that are made one after another."""
    total = 0.0
    for direction in (np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])):
        bins: dict[int, float] = {}
        for point, side, weight in zip(plan, sides, weights, strict=True):
            if abs(side @ direction) > 0.8:
                place = point @ direction / LINE_M
                first = int(np.floor(place))
                bins[first] = bins.get(first, 0.0) + weight * (1 - (place - first))
                bins[first + 1] = bins.get(first + 1, 0.0) + weight * (place - first)
        total += sum(value**2 for value in bins.values())
    return total


@given(st.integers(0, 2**32 - 1), st.integers(0, 60))
def test_sums_are_those_of_histograms(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    plan, angles, weights = rng.normal(0, 2, (count, 2)), rng.uniform(0, 7, count), rng.uniform(0.1, 2, count)
    sides, turns = np.column_stack([np.cos(angles), np.sin(angles)]), rng.uniform(-1, 1, 3)
    np.testing.assert_allclose(sharpness(plan, sides, weights, turns), [by_histogram(plan, sides, weights, t) for t in turns], rtol=1e-9)


@given(st.floats(-0.7, 0.7), st.integers(0, 2**32 - 1))
def test_walls_are_sharpest_seen_along_themselves(turn: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    side, along = rng.integers(0, 4, 400), rng.uniform(-3, 3, 400)
    normals = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]], dtype=float)[side]
    plan = normals * np.where(side % 2, 2.0, 3.0)[:, None] + normals[:, ::-1] * along[:, None]
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turns = turn + np.deg2rad(np.arange(-6, 6.5, 0.5))
    found = turns[sharpness(plan @ rotation.T, normals @ rotation.T, np.ones(400), turns).argmax()]
    assert abs(found - turn) < 1e-9
