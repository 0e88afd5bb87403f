"""How sharply upright surface gathers on lines along two axes, compiled: by this the turn of a room is told."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

LINE_M = 0.02
"""Width of a bin across a wall: the noise of its fused surface."""

_FACING = 0.8
"""Cosine between a normal and the axis that its point counts for."""


def sharpness(plan: Array, sides: Array, weights: Array, turns: Array) -> Array:
    """Sums of squares of the histograms of places along both axes of a frame, for each of some turns of it [rad], shape (t,).

    plan: Positions on the floor [m], shape (n, 2). sides: Unit normals in plan, shape (n, 2); a point counts for the axis it faces, by its
    weight, shape (n,), which is shared between two neighboring bins, so that nothing jumps where a wall crosses a border.
    """
    kernel = _compiled()["_sharpness"]
    return np.asarray(kernel(*(np.ascontiguousarray(values, dtype=np.float64) for values in (plan, sides, weights, turns))))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_sharpness)


def _sharpness(plan: Array, sides: Array, weights: Array, turns: Array) -> Array:
    sums, places = np.zeros(len(turns)), np.empty(len(plan))
    for t in range(len(turns)):
        for quarter in range(2):
            x, y = np.cos(turns[t] + quarter * np.pi / 2), np.sin(turns[t] + quarter * np.pi / 2)
            low, high = np.inf, -np.inf
            for i in range(len(plan)):
                if abs(sides[i, 0] * x + sides[i, 1] * y) > _FACING:
                    places[i] = (plan[i, 0] * x + plan[i, 1] * y) / LINE_M
                    low, high = min(low, places[i]), max(high, places[i])
                else:
                    places[i] = np.nan
            if low > high:
                continue
            low = np.floor(low)
            mass = np.zeros(int(high - low) + 2)
            for i in range(len(plan)):
                if places[i] == places[i]:
                    place = int(places[i] - low)
                    share = places[i] - low - place
                    mass[place] += weights[i] * (1 - share)
                    mass[place + 1] += weights[i] * share
            for each in mass:
                sums[t] += each * each
    return sums
