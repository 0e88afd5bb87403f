"""The loop of Algorithm 1, compiled. `tasks.optimization.search.collisions` says what it does; arrays are as in its `Crowd`.

A move costs only what is near: every object has a list of the objects that it could overlap while all stay within `REACH`
steps of their anchors, the places where they were listed. An object that is about to go farther is listed anew. The loss
is kept up to date by the differences of the listed pairs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import compile_kernels

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Lists = NDArray[np.int32]

TOUCH_M = 1e-6
"""Sides that overlap by less [m] only touch: a micrometre is rounding."""

ROUNDING_M3 = 1e-12
"""A loss has fallen when it fell by more than this [m3]: the rounding of a sum of some hundred volumes."""

ROUNDING_M2 = 1e-9
"""An outline has left the room when more of it than this [m2] is outside that was not: the rounding of clipped areas."""

REACH = 3
"""Steps that an object may be from its anchor: more make longer lists, fewer make lists more often."""

KEPT, REVERTED, LEFT_ROOM, LEFT_SUPPORT = 1, 2, 3, 4


@cache
def compiled_descent() -> Callable[..., Any]:
    """The loop as machine code, with what it calls."""
    called = (_area, _outside, _is_clear, _volume, _add, _place, _slot, _widened, _link_all, _find, _list_anew, _leaves)
    return compile_kernels(*called, _descend)["_descend"]


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
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for v in range(corners):
        x0, x1 = min(x0, outline[v, 0] + dx), max(x1, outline[v, 0] + dx)
        y0, y1 = min(y0, outline[v, 1] + dy), max(y1, outline[v, 1] + dy)
    for t in range(room.shape[0]):
        if max(room[t, 0, 0], room[t, 1, 0], room[t, 2, 0]) < x0 or min(room[t, 0, 0], room[t, 1, 0], room[t, 2, 0]) > x1:
            continue
        if max(room[t, 0, 1], room[t, 1, 1], room[t, 2, 1]) < y0 or min(room[t, 0, 1], room[t, 1, 1], room[t, 2, 1]) > y1:
            continue
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


def _is_clear(x0: float, y0: float, x1: float, y1: float, borders: Array) -> bool:
    """Whether a rectangle lies inside the room and meets none of its borders, shape (e, 2, 2): nothing of it is outside."""
    cx, cy = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    inside = False
    for e in range(borders.shape[0]):
        ax, ay, bx, by = borders[e, 0, 0], borders[e, 0, 1], borders[e, 1, 0], borders[e, 1, 1]
        if max(ax, bx) >= x0 and min(ax, bx) <= x1 and max(ay, by) >= y0 and min(ay, by) <= y1:
            side = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            if abs(side) <= 0.5 * (abs(bx - ax) * (y1 - y0) + abs(by - ay) * (x1 - x0)) * (1.0 + 1e-9):
                return False
        if (ay > cy) != (by > cy) and cx < ax + (cy - ay) / (by - ay) * (bx - ax):
            inside = not inside
    return inside


def _volume(boxes: Array, i: int, j: int) -> float:
    """Volume in which two boxes overlap [m3]. boxes: low and high corners where they are now, shape (n, 6)."""
    x = min(boxes[i, 3], boxes[j, 3]) - max(boxes[i, 0], boxes[j, 0])
    y = min(boxes[i, 4], boxes[j, 4]) - max(boxes[i, 1], boxes[j, 1])
    z = min(boxes[i, 5], boxes[j, 5]) - max(boxes[i, 2], boxes[j, 2])
    return x * y * z if x > TOUCH_M and y > TOUCH_M and z > TOUCH_M else 0.0


def _add(total: float, rest: float, value: float) -> tuple[float, float]:
    """A sum and its rounding error with one more value in them (Neumaier 1974)."""
    result = total + value
    if abs(total) >= abs(value):
        return result, rest + ((total - result) + value)
    return result, rest + ((value - result) + total)


def _place(boxes: Array, low: Array, high: Array, moved: Integers, step: float, i: int) -> None:
    """The box of object i where its moves have brought it: computed from its first place, so that no rounding adds up."""
    for k in range(2):
        boxes[i, k], boxes[i, k + 3] = low[i, k] + moved[i, k] * step, high[i, k] + moved[i, k] * step


def _slot(near: Lists, degree: Integers, i: int, j: int) -> int:
    """Where object j stands in object i's list; -1: nowhere."""
    for s in range(degree[i]):
        if near[i, s] == j:
            return s
    return -1


def _widened(near: Lists, volume: Array) -> tuple[Lists, Array]:
    """The lists, shape (n, k), with space for twice as many."""
    n, space = near.shape
    wider, volumes = np.empty((n, 2 * space), dtype=near.dtype), np.empty((n, 2 * space))
    for i in range(n):
        for k in range(space):
            wider[i, k], volumes[i, k] = near[i, k], volume[i, k]
    return wider, volumes


def _link_all(hit: NDArray[np.uint8], near: Lists, volume: Array, degree: Integers, i: int) -> None:
    """Put the objects that are hit, none of which overlaps i, into i's list, and i into theirs."""
    for j in range(hit.shape[0]):
        if hit[j]:
            for first, other in ((i, j), (j, i)):
                near[first, degree[first]], volume[first, degree[first]] = other, 0.0
                degree[first] += 1


def _find(homes: Array, hit: NDArray[np.uint8], x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> None:
    """Mark the boxes, low and high corners of shape (6, n), that overlap a box."""
    a, b, c, d, e, f = homes[0], homes[1], homes[2], homes[3], homes[4], homes[5]
    for j in range(hit.shape[0]):  # bytes and no branches: several boxes at a time
        plan = np.uint8(a[j] < x1) & np.uint8(d[j] > x0) & np.uint8(b[j] < y1) & np.uint8(e[j] > y0)
        hit[j] = plan & np.uint8(c[j] < z1) & np.uint8(f[j] > z0)


def _list_anew(
    i: int, low: Array, high: Array, step: float, moved: Integers, anchor: Integers, homes: Array, hit: NDArray[np.uint8], apart: Integers,
    apart_first: Integers, near: Lists, volume: Array, degree: Integers, mark: Integers, stamp: int,
) -> tuple[Lists, Array]:  # fmt: skip
    """Anchor object i where it is, and list it with all that could overlap it while both stay within reach of their anchors.

    Overlaps are untouched: who is dropped from a list or comes into it cannot overlap object i where it is now. homes:
    boxes at their anchors, low and high corners, shape (6, n), so that all can be looked through at once. mark, stamp:
    i's partners that do not count, and those listed already, are marked with the stamp.
    """
    for k in range(2):
        anchor[i, k] = moved[i, k]
        homes[k, i], homes[k + 3, i] = low[i, k] + moved[i, k] * step, high[i, k] + moved[i, k] * step
    reach = (2 * REACH + 1e-6) * step
    x0, x1, y0, y1 = homes[0, i] - reach, homes[3, i] + reach, homes[1, i] - reach, homes[4, i] + reach
    z0, z1 = homes[2, i] + 0.5 * TOUCH_M, homes[5, i] - 0.5 * TOUCH_M  # too long a list does no harm
    _find(homes, hit, x0, x1, y0, y1, z0, z1)
    mark[i] = stamp
    for k in range(apart_first[i], apart_first[i + 1]):
        mark[apart[k]] = stamp
    kept = 0
    for s in range(degree[i]):
        j = near[i, s]
        if hit[j]:
            near[i, kept], volume[i, kept] = j, volume[i, s]
            mark[j] = stamp
            kept += 1
        else:
            t, last = _slot(near, degree, j, i), degree[j] - 1
            near[j, t], volume[j, t] = near[j, last], volume[j, last]
            degree[j] = last
    degree[i] = kept
    added, longest = 0, 0
    for j in range(hit.shape[0]):
        if hit[j] and mark[j] == stamp:
            hit[j] = 0
        elif hit[j]:
            added += 1
            longest = max(longest, degree[j] + 1)
    while max(kept + added, longest) > near.shape[1]:
        near, volume = _widened(near, volume)
    _link_all(hit, near, volume, degree, i)
    return near, volume


def _leaves(obj: int, carrier: Integers, shifts: Booleans, moved: Integers) -> bool:
    """Whether an object stands where its carrier does not carry it."""
    if carrier[obj] < 0:
        return False
    reach = (shifts.shape[1] - 1) // 2
    sx = moved[obj, 0] - moved[carrier[obj], 0] + reach
    sy = moved[obj, 1] - moved[carrier[obj], 1] + reach
    return bool(sx < 0 or sy < 0 or sx > 2 * reach or sy > 2 * reach or not shifts[obj, sx, sy])


def _descend(
    low: Array, high: Array, apart: Integers, apart_first: Integers, movable_count: int, carried: Integers, carried_first: Integers,
    outlines: Array, corners: Integers, room: Array, borders: Array, carrier: Integers, shifts: Booleans, table: Integers, step: float,
    objects: Integers, directions: Integers, loss: Array, smallest: Array, outcome: Integers, moved: Integers,
) -> tuple[int, float, bool]:  # fmt: skip
    """Fills loss, smallest, outcome and moved. Returns the steps done, the first loss, and whether no move can lower it.

    apart: the partners that do not count in the loss with each object, carried: the objects that each moves along; of object
    i from `first[i]` to `first[i + 1]`. borders: what bounds the room, shape (e, 2, 2).
    """
    n, most = low.shape[0], outlines.shape[1] + 8
    ring, other = np.empty((most, 2)), np.empty((most, 2))
    outside, trial, plan, is_clear = np.zeros(n), np.zeros(n), np.empty((n, 4)), np.ones(n, dtype=np.bool_)
    boxes, homes, hit = np.empty((n, 6)), np.empty((6, n)), np.empty(n, dtype=np.uint8)
    anchor, mark = np.zeros((n, 2), dtype=np.int64), np.full(n, -1, dtype=np.int64)
    for i in range(n):
        for k in range(3):
            boxes[i, k], boxes[i, k + 3] = low[i, k], high[i, k]
        for k in range(6):
            homes[k, i] = boxes[i, k]
    near: Lists = np.empty((n, 16), dtype=np.int32)
    volume: Array = np.empty((n, 16))
    degree = np.zeros(n, dtype=np.int64)
    margin, stamp = REACH * step, 0
    for i in range(n):
        plan[i, 0], plan[i, 1], plan[i, 2], plan[i, 3] = np.inf, np.inf, -np.inf, -np.inf
        for v in range(corners[i]):
            plan[i, 0], plan[i, 1] = min(plan[i, 0], outlines[i, v, 0]), min(plan[i, 1], outlines[i, v, 1])
            plan[i, 2], plan[i, 3] = max(plan[i, 2], outlines[i, v, 0]), max(plan[i, 3], outlines[i, v, 1])
        if room.shape[0] > 0:
            is_clear[i] = _is_clear(plan[i, 0] - margin, plan[i, 1] - margin, plan[i, 2] + margin, plan[i, 3] + margin, borders)
            outside[i] = 0.0 if is_clear[i] else _outside(outlines[i], corners[i], 0.0, 0.0, room, ring, other)
    sum_high, sum_low, overlapping = 0.0, 0.0, 0
    for i in range(n):
        near, volume = _list_anew(
            i, low, high, step, moved, anchor, homes, hit, apart, apart_first, near, volume, degree, mark, stamp
        )  # fmt: skip
        stamp += 1
    for i in range(n):
        for s in range(degree[i]):
            volume[i, s] = _volume(boxes, i, near[i, s])
            if near[i, s] > i and volume[i, s] > 0.0:
                sum_high, sum_low = _add(sum_high, sum_low, volume[i, s])
                overlapping += 1
    start = best = sum_high + sum_low
    tried, since, tried_count, done = np.full((n, 4), -1, dtype=np.int64), 0, 0, 0
    while done < objects.shape[0] and best > 0.0 and tried_count < 4 * movable_count:
        obj, dx, dy = objects[done], table[directions[done], 0], table[directions[done], 1]
        begin, end = carried_first[obj], carried_first[obj + 1]
        for e in range(begin, end):
            i = carried[e]
            if abs(moved[i, 0] + dx - anchor[i, 0]) > REACH or abs(moved[i, 1] + dy - anchor[i, 1]) > REACH:
                near, volume = _list_anew(
                    i, low, high, step, moved, anchor, homes, hit, apart, apart_first, near, volume, degree, mark, stamp
                )  # fmt: skip
                stamp += 1
                if room.shape[0] > 0:
                    x, y = moved[i, 0] * step, moved[i, 1] * step
                    x0, y0, x1, y1 = plan[i, 0] + x, plan[i, 1] + y, plan[i, 2] + x, plan[i, 3] + y
                    is_clear[i] = _is_clear(x0 - margin, y0 - margin, x1 + margin, y1 + margin, borders)
        code, total = KEPT, best
        for e in range(begin, end):
            i = carried[e]
            mark[i] = stamp
            moved[i, 0] += dx
            moved[i, 1] += dy
            trial[i] = 0.0
            if not is_clear[i]:
                x, y = moved[i, 0] * step, moved[i, 1] * step
                if not _is_clear(plan[i, 0] + x, plan[i, 1] + y, plan[i, 2] + x, plan[i, 3] + y, borders):
                    trial[i] = _outside(outlines[i], corners[i], x, y, room, ring, other)
                if trial[i] > outside[i] + ROUNDING_M2:
                    code = LEFT_ROOM
        if code == KEPT and _leaves(obj, carrier, shifts, moved):
            code = LEFT_SUPPORT
        if code == KEPT:
            new_high, new_low, new_overlapping = sum_high, sum_low, overlapping
            for e in range(begin, end):
                _place(boxes, low, high, moved, step, carried[e])
            for e in range(begin, end):
                i = carried[e]
                for s in range(degree[i]):
                    j = near[i, s]
                    if j < i and mark[j] == stamp:  # both move: the pair is met once
                        continue
                    now, was = _volume(boxes, i, j), volume[i, s]
                    if now != was:
                        new_high, new_low = _add(new_high, new_low, now)
                        new_high, new_low = _add(new_high, new_low, -was)
                        new_overlapping += (now > 0.0) - (was > 0.0)
            total = new_high + new_low if new_overlapping > 0 else 0.0
            if total >= best - ROUNDING_M3:
                code = REVERTED
        loss[done] = total
        if code == KEPT:
            best, tried_count = total, 0
            since += 1
            sum_high, sum_low, overlapping = new_high, new_low, new_overlapping
            for e in range(begin, end):
                i = carried[e]
                outside[i] = trial[i]
                for s in range(degree[i]):
                    j = near[i, s]
                    volume[i, s] = _volume(boxes, i, j)
                    volume[j, _slot(near, degree, j, i)] = volume[i, s]
        else:
            for e in range(begin, end):
                moved[carried[e], 0] -= dx
                moved[carried[e], 1] -= dy
                if code == REVERTED:
                    _place(boxes, low, high, moved, step, carried[e])
            if tried[obj, directions[done]] != since:
                tried[obj, directions[done]] = since
                tried_count += 1
        stamp += 1
        smallest[done], outcome[done] = best, code
        done += 1
    return done, start, best > 0.0 and tried_count >= 4 * movable_count
