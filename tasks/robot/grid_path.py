"""A way around what is in the way: the cheapest over the nodes of the floor, by A* (Hart, Nilsson and Raphael 1968)."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.robot.clearances import CELL_M, Clearances, clear_at, compiled

Array = NDArray[np.float64]

STRIDE = 2
"""Every second node is looked at: steps of 4 cm, a sixth of what a cart needs to pass."""

SHY_M = 0.1
"""Beside a thing a way costs twice as much as in the open, and this much farther away a quarter of that [m]."""

NEAR_M = 0.3
"""A start or goal without clearance leads to the nearest node with some, this far away at most [m]."""


def grid_path(clearances: Clearances, start: ArrayLike, goal: ArrayLike, radius: float, spacing: float) -> Array | None:
    """Places to go to one after the other, world frame [m], shape (n, 2), the goal the last; None where there is no way.

    Straight ways between them are at most `spacing` long and keep the radius free to 2 mm, but for the first steps where the start has
    less.

    Args:
        clearances: Of the floor as it is known.
        start: Where it begins, shape (2,).
        goal: Where it ends, shape (2,).
        radius: What has to be free around the way [m].
        spacing: Between places, at most [m].
    """
    clearances = clearances.flattened()
    first, last = np.asarray(start, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    cells = _kernels()["_cheapest"](
        clearances.nodes, clearances.origin, clearances.points, first[0], first[1], last[0], last[1], radius
    )  # fmt: skip
    if not len(cells):
        return None
    way = np.vstack([first, clearances.origin + STRIDE * CELL_M * cells, last])
    return _thinned(clearances, way, radius, spacing)


def _thinned(clearances: Clearances, way: Array, radius: float, spacing: float) -> Array:
    """The fewest of a way's places, greedily, so that straight ways between them stay free and short."""
    kept, at = [], 0
    while at < len(way) - 1:
        after = at + 1
        while after + 1 < len(way):
            if np.hypot(*(way[after + 1] - way[at])) > spacing or clearances.least_along(way[at], way[after + 1]) < radius:
                break
            after += 1
        kept.append(way[after])
        at = after
    return np.array(kept)


@cache
def _kernels() -> Kernels:
    return compile_kernels(_sift_down, _sift_up, _nearest_free, _cheapest, known=compiled())


def _sift_up(keys: Array, cells: NDArray[np.int64], at: int) -> None:
    """Let the last of a heap rise to its place."""
    while at > 0:
        above = (at - 1) // 2
        if keys[above] <= keys[at]:
            return
        keys[above], keys[at] = keys[at], keys[above]
        cells[above], cells[at] = cells[at], cells[above]
        at = above


def _sift_down(keys: Array, cells: NDArray[np.int64], size: int) -> None:
    """Let the first of a heap sink to its place."""
    at = 0
    while True:
        least = at
        for below in (2 * at + 1, 2 * at + 2):
            if below < size and keys[below] < keys[least]:
                least = below
        if least == at:
            return
        keys[least], keys[at] = keys[at], keys[least]
        cells[least], cells[at] = cells[at], cells[least]
        at = least


def _nearest_free(nodes: Array, origin: Array, points: Array, x: float, y: float, radius: float) -> int:
    """The nearest of the looked at nodes that has the radius free; -1 where none is near."""
    step = STRIDE * CELL_M
    columns, rows = nodes.shape[0] // STRIDE, nodes.shape[1] // STRIDE
    reach = int(np.ceil(NEAR_M / step))
    middle, level = round((x - origin[0]) / step), round((y - origin[1]) / step)
    best, nearest = NEAR_M, -1
    for column in range(max(middle - reach, 0), min(middle + reach + 1, columns)):
        for row in range(max(level - reach, 0), min(level + reach + 1, rows)):
            px, py = origin[0] + column * step, origin[1] + row * step
            away = math.hypot(px - x, py - y)
            if away < best and clear_at(nodes, origin, points, px, py) >= radius:
                best, nearest = away, column * rows + row
    return nearest


def _cheapest(nodes: Array, origin: Array, points: Array, x: float, y: float, gx: float, gy: float, radius: float) -> NDArray[np.int64]:
    """Nodes of the cheapest way, column and row in strides, shape (n, 2); none where there is none."""
    step = STRIDE * CELL_M
    columns, rows = nodes.shape[0] // STRIDE, nodes.shape[1] // STRIDE
    start = _nearest_free(nodes, origin, points, x, y, radius)
    goal = _nearest_free(nodes, origin, points, gx, gy, radius)
    if start < 0 or goal < 0:
        return np.empty((0, 2), dtype=np.int64)
    count = columns * rows
    costs, before = np.full(count, np.inf), np.full(count, -1)
    is_done = np.zeros(count, dtype=np.bool_)
    keys, cells = np.empty(8 * count + 1), np.empty(8 * count + 1, dtype=np.int64)
    keys[0], cells[0], size = 0.0, start, 1
    costs[start] = 0.0
    goal_column, goal_row = goal // rows, goal % rows
    while size > 0:
        cell = cells[0]
        size -= 1
        keys[0], cells[0] = keys[size], cells[size]
        _sift_down(keys, cells, size)
        if is_done[cell]:
            continue
        is_done[cell] = True
        if cell == goal:
            break
        column, row = cell // rows, cell % rows
        for right in range(-1, 2):
            for up in range(-1, 2):
                c, r = column + right, row + up
                if (right == 0 and up == 0) or c < 0 or r < 0 or c >= columns or r >= rows or is_done[c * rows + r]:
                    continue
                clear = clear_at(nodes, origin, points, origin[0] + c * step, origin[1] + r * step)
                if clear < radius:
                    continue
                shy = SHY_M / (SHY_M + clear - radius)
                cost = costs[cell] + step * math.hypot(right, up) * (1.0 + shy * shy)
                if cost < costs[c * rows + r]:
                    costs[c * rows + r], before[c * rows + r] = cost, cell
                    keys[size] = cost + step * math.hypot(c - goal_column, r - goal_row)
                    cells[size] = c * rows + r
                    size += 1
                    _sift_up(keys, cells, size - 1)
    if not is_done[goal]:
        return np.empty((0, 2), dtype=np.int64)
    length, cell = 0, goal
    while cell >= 0:
        length, cell = length + 1, before[cell]
    way, cell = np.empty((length, 2), dtype=np.int64), goal
    for k in range(length - 1, -1, -1):
        way[k, 0], way[k, 1] = cell // rows, cell % rows
        cell = before[cell]
    return way
