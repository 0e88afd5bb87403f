"""How well a plan of cells falls into convex parts when it is cut along a line: the compiled inner loop of the pieces."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels


def hull_area(plan: NDArray[np.bool_], axis: int = 0, position: int = 0) -> float:
    """Sum of the areas of the convex hulls of the connected bodies of cells in plan, shape (n, m), in cells.

    The plan is cut before row (axis 0) or column (axis 1) `position`; 0 cuts nothing. Cells touch along edges.
    """
    return float(_compiled()["_area"](np.ascontiguousarray(plan), axis, position))


def best_cut(plan: NDArray[np.bool_], rows: Sequence[int], columns: Sequence[int]) -> tuple[float, int, int]:
    """The least area that a cut before one of some rows or columns leaves, its axis and its position; of equal ones the first."""
    tried = np.array([*((0, row) for row in rows), *((1, column) for column in columns)], dtype=np.int64)
    area, best = _compiled()["_best"](np.ascontiguousarray(plan), tried)
    return float(area), int(tried[best, 0]), int(tried[best, 1])


@cache
def _compiled() -> Kernels:
    return compile_kernels(_area, _best)


def _best(plan: NDArray[np.bool_], tried: NDArray[np.int64]) -> tuple[float, int]:
    least, best = np.inf, 0
    for n in range(len(tried)):
        area = _area(plan, tried[n, 0], tried[n, 1])
        if area < least:
            least, best = area, n
    return least, best


def _area(plan: NDArray[np.bool_], axis: int, position: int) -> float:
    """The loop: flood fill per body, keeping its extremes per row, then Andrew's monotone chain over their corners."""
    rows, columns = plan.shape
    left = plan.copy()
    stack = np.empty(rows * columns, dtype=np.int64)
    first, last = np.empty(rows, dtype=np.int64), np.empty(rows, dtype=np.int64)
    total = 0.0
    for start in range(rows * columns):
        if not left[start // columns, start % columns]:
            continue
        first[:], last[:] = columns, -1
        stack[0], depth = start, 1
        left[start // columns, start % columns] = False
        while depth > 0:
            depth -= 1
            i, j = stack[depth] // columns, stack[depth] % columns
            first[i], last[i] = min(first[i], j), max(last[i], j)
            for direction in range(4):
                di, dj = (direction < 2) * (2 * direction - 1), (direction >= 2) * (2 * direction - 5)
                a, b = i + di, j + dj
                if a < 0 or b < 0 or a >= rows or b >= columns or not left[a, b]:
                    continue
                if axis == 0 and (a < position) != (i < position):
                    continue
                if axis == 1 and (b < position) != (j < position):
                    continue
                left[a, b] = False
                stack[depth] = a * columns + b
                depth += 1
        # Chains of the low and the high column over the rows' upper and lower edges.
        chain = np.empty((2 * rows + 2, 2), dtype=np.float64)
        for side in range(2):
            size = 0
            for i in range(rows):
                if last[i] < 0:
                    continue
                y = -float(first[i]) if side == 0 else float(last[i] + 1)
                for edge in range(2):
                    x = float(i + edge)
                    while size > 1:
                        ux, uy = chain[size - 1, 0] - chain[size - 2, 0], chain[size - 1, 1] - chain[size - 2, 1]
                        if ux * (y - chain[size - 2, 1]) - uy * (x - chain[size - 2, 0]) < 0:
                            break
                        size -= 1
                    if size == 1 and chain[0, 0] == x:
                        chain[0, 1] = max(chain[0, 1], y)
                        continue
                    chain[size, 0], chain[size, 1] = x, y
                    size += 1
            for k in range(size - 1):
                total += 0.5 * (chain[k + 1, 0] - chain[k, 0]) * (chain[k + 1, 1] + chain[k, 1])
    return total
