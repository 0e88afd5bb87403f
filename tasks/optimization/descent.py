"""The loop of Algorithm 1, compiled. `tasks.optimization.collisions` says what it does; arrays are as in its `Crowd`."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

TOUCH_M = 1e-6
"""Sides that overlap by less [m] only touch: a micrometre is rounding."""

ROUNDING_M3 = 1e-12
"""A loss has fallen when it fell by more than this [m3]: the rounding of a sum of some hundred volumes."""

ROUNDING_M2 = 1e-9
"""An outline has left the room when more of it than this [m2] is outside that was not: the rounding of clipped areas."""

KEPT, REVERTED, LEFT_ROOM, LEFT_SUPPORT = 1, 2, 3, 4


@cache
def compiled_descent() -> Callable[..., Any]:
    """The loop as machine code. Compiled code calls only compiled code, so what it calls is compiled in place first."""
    import numba

    compiled = numba.njit(cache=True, nogil=True, error_model="numpy")
    for function in (_area, _outside, _fill, _leaves, _shift, _descend):
        globals()[function.__name__] = compiled(function)
    loop: Callable[..., Any] = globals()["_descend"]
    return loop


def _area(ring: Array, count: int) -> float:
    """Area of a ring's first `count` corners."""
    area = 0.0
    for v in range(count):
        u = v - 1 if v > 0 else count - 1
        area += ring[u, 0] * ring[v, 1] - ring[v, 0] * ring[u, 1]
    return 0.5 * area


def _outside(outline: Array, corners: int, dx: float, dy: float, room: Array, ring: Array, other: Array) -> float:
    """Area of a convex outline, moved, outside the room: what clipping by the room's triangles leaves [m2].

    Computed around the outline's first corner, so that a room far from the origin costs no digits. `ring`, `other`:
    space for corners, shape (corners + 3, 2) or more.
    """
    ox, oy = outline[0, 0], outline[0, 1]
    for v in range(corners):
        ring[v, 0], ring[v, 1] = outline[v, 0] - ox, outline[v, 1] - oy
    left = _area(ring, corners)
    for t in range(room.shape[0]):
        count = corners
        for v in range(corners):
            ring[v, 0], ring[v, 1] = outline[v, 0] - ox, outline[v, 1] - oy
        for e in range(3):
            ax, ay = room[t, e, 0] - ox - dx, room[t, e, 1] - oy - dy
            bx, by = room[t, (e + 1) % 3, 0] - ox - dx, room[t, (e + 1) % 3, 1] - oy - dy
            kept = 0
            for v in range(count):
                u = v - 1 if v > 0 else count - 1
                before = (bx - ax) * (ring[u, 1] - ay) - (by - ay) * (ring[u, 0] - ax)
                here = (bx - ax) * (ring[v, 1] - ay) - (by - ay) * (ring[v, 0] - ax)
                if (before >= 0) != (here >= 0):
                    s = before / (before - here)
                    other[kept, 0] = ring[u, 0] + s * (ring[v, 0] - ring[u, 0])
                    other[kept, 1] = ring[u, 1] + s * (ring[v, 1] - ring[u, 1])
                    kept += 1
                if here >= 0:
                    other[kept, 0], other[kept, 1] = ring[v, 0], ring[v, 1]
                    kept += 1
            count = kept
            ring, other = other, ring
        left -= _area(ring, count)
    return left


def _fill(volume: Array, group: Booleans, low: Array, high: Array, counted: Booleans, moved: Integers, step: float) -> float:
    """Overlaps of the things in `group` with all others brought up to date; the sum over all pairs [m3]."""
    n = low.shape[0]
    for i in range(n):
        if not group[i]:
            continue
        for j in range(n):
            if not counted[i, j] or i == j:
                continue
            product = 1.0
            for k in range(3):
                a, b = low[i, k], low[j, k]
                c, d = high[i, k], high[j, k]
                if k < 2:
                    a, c = a + moved[i, k] * step, c + moved[i, k] * step
                    b, d = b + moved[j, k] * step, d + moved[j, k] * step
                side = min(c, d) - max(a, b)
                product = product * side if side > TOUCH_M else 0.0
            volume[i, j] = product
            volume[j, i] = product
    total = 0.0
    for i in range(n):
        for j in range(i + 1, n):
            total += volume[i, j]
    return total


def _leaves(thing: int, carrier: Integers, shifts: Booleans, moved: Integers) -> bool:
    """Whether a thing stands where its carrier does not carry it."""
    if carrier[thing] < 0:
        return False
    reach = (shifts.shape[1] - 1) // 2
    sx = moved[thing, 0] - moved[carrier[thing], 0] + reach
    sy = moved[thing, 1] - moved[carrier[thing], 1] + reach
    return bool(sx < 0 or sy < 0 or sx > 2 * reach or sy > 2 * reach or not shifts[thing, sx, sy])


def _shift(moved: Integers, group: Booleans, move: Integers, sign: int) -> None:
    """Move the things in `group`, or take the move back."""
    for i in range(moved.shape[0]):
        if group[i]:
            moved[i, 0] += sign * move[0]
            moved[i, 1] += sign * move[1]


def _descend(
    low: Array, high: Array, counted: Booleans, movable_count: int, carries: Booleans, outlines: Array, corners: Integers, room: Array,
    carrier: Integers, shifts: Booleans, table: Integers, step: float, things: Integers, directions: Integers, loss: Array,
    smallest: Array, outcome: Integers, moved: Integers,
) -> tuple[int, float, bool]:  # fmt: skip
    """Fills loss, smallest, outcome and moved. Returns the steps done, the first loss, and whether no move can lower it."""
    n, most = low.shape[0], outlines.shape[1] + 8
    ring, other = np.empty((most, 2)), np.empty((most, 2))
    volume, outside, trial = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    tried = np.zeros((n, 4), dtype=np.bool_)
    tried_count, done = 0, 0
    if room.shape[0] > 0:
        for i in range(n):
            outside[i] = _outside(outlines[i], corners[i], 0.0, 0.0, room, ring, other)
    start = _fill(volume, np.ones(n, dtype=np.bool_), low, high, counted, moved, step)
    best = start
    while done < things.shape[0] and best > 0.0 and tried_count < 4 * movable_count:
        thing, move = things[done], table[directions[done]]
        group = carries[thing]
        _shift(moved, group, move, 1)
        code, total = KEPT, best
        if room.shape[0] > 0:
            for i in range(n):
                if group[i]:
                    trial[i] = _outside(outlines[i], corners[i], moved[i, 0] * step, moved[i, 1] * step, room, ring, other)
                    if trial[i] > outside[i] + ROUNDING_M2:
                        code = LEFT_ROOM
        if code == KEPT and _leaves(thing, carrier, shifts, moved):
            code = LEFT_SUPPORT
        if code == KEPT:
            total = _fill(volume, group, low, high, counted, moved, step)
            if total >= best - ROUNDING_M3:
                code = REVERTED
        loss[done] = total
        if code == KEPT:
            best, tried_count = total, 0
            tried[:] = False
            for i in range(n):
                if group[i]:
                    outside[i] = trial[i]
        else:
            _shift(moved, group, move, -1)
            if code == REVERTED:
                _fill(volume, group, low, high, counted, moved, step)
            if not tried[thing, directions[done]]:
                tried[thing, directions[done]] = True
                tried_count += 1
        smallest[done], outcome[done] = best, code
        done += 1
    return done, start, best > 0.0 and tried_count >= 4 * movable_count
