"""Plan views: the height of a placed surface over a grid of cells, which says what can stand on it and where."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.meshes import Surface

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class PlanView:
    """Heights at the centers of square cells [m], shape (nx, ny); minus infinity where nothing is.

    Cell (i, j) has its center at ((first[0] + i + 0.5) * cell, (first[1] + j + 0.5) * cell) in the world frame, so
    views with one cell size share one grid.
    """

    heights: Array
    first: tuple[int, int]
    cell: float

    def at(self, cells: NDArray[np.int64]) -> Array:
        """Heights at grid cells, shape (n, 2) to (n,); minus infinity outside the view."""
        local = cells - np.array(self.first)
        inside = ((local >= 0) & (local < np.array(self.heights.shape))).all(axis=1)
        result = np.full(len(cells), -np.inf)
        result[inside] = self.heights[local[inside, 0], local[inside, 1]]
        return result


def plan_view(surface: Surface, low: ArrayLike, high: ArrayLike, ceiling: float, cell: float, upward: bool = False) -> PlanView:
    """The highest point of a surface at or below `ceiling` in every cell of a window [m]; `low`, `high`: shape (2,).

    `upward`: only faces that look up count, which closed surfaces allow: a thing sunk into a block does not find the
    block's underside below it.
    """
    corners, first, heights = _window(surface, low, high, -np.inf, ceiling, cell)
    _compiled()["raster"](corners, first.astype(np.float64), float(cell), float(ceiling), bool(upward), heights)
    return PlanView(heights, (int(first[0]), int(first[1])), cell)


def occupancy(surface: Surface, low: ArrayLike, high: ArrayLike, bottom: float, top: float, cell: float) -> PlanView:
    """Where a surface, upright faces too, passes between two heights [m]: 1 in such cells of a window, else minus infinity."""
    corners, first, heights = _window(surface, low, high, bottom, top, cell)
    _compiled()["mark"](corners, first.astype(np.float64), float(cell), float(bottom), float(top), heights)
    return PlanView(heights, (int(first[0]), int(first[1])), cell)


def underside(surface: Surface, cell: float) -> tuple[NDArray[np.int64], Array]:
    """Cells that a surface covers in plan, shape (n, 2), and its lowest height in each [m], shape (n,).

    A thing smaller than a cell covers the cell of its center.
    """
    low, high = surface.bounds
    mirrored = dataclasses.replace(surface, vertices=surface.vertices * np.array([1.0, 1.0, -1.0]))
    view = plan_view(mirrored, low, high, np.inf, cell)
    cells = np.argwhere(np.isfinite(view.heights))
    if not len(cells):
        return np.floor(0.5 * (low + high)[None, :2] / cell).astype(np.int64), np.array([low[2]])
    return cells + np.array(view.first), -view.heights[cells[:, 0], cells[:, 1]]


def _window(
    surface: Surface, low: ArrayLike, high: ArrayLike, bottom: float, top: float, cell: float
) -> tuple[Array, NDArray[np.int64], Array]:
    """Triangles, shape (m, 3, 3), that may be seen in a window between two heights, its first cell, and empty heights."""
    a, b = np.asarray(low, dtype=np.float64)[:2], np.asarray(high, dtype=np.float64)[:2]
    first = np.floor(a / cell).astype(np.int64)
    shape = np.maximum(np.floor(b / cell).astype(np.int64) - first + 1, 1)
    corners = surface.vertices[surface.faces]
    least, most = corners.min(axis=1), corners.max(axis=1)
    near = (least[:, :2] <= b + cell).all(axis=1) & (most[:, :2] >= a - cell).all(axis=1) & (least[:, 2] <= top) & (most[:, 2] >= bottom)
    return np.ascontiguousarray(corners[near]), first, np.full((int(shape[0]), int(shape[1])), -np.inf)


@cache
def _compiled() -> dict[str, Callable[..., Any]]:
    import numba

    return {f.__name__.strip("_"): numba.njit(cache=True, nogil=True, error_model="numpy")(f) for f in (_raster, _mark)}


def _mark(corners: Array, first: Array, cell: float, bottom: float, top: float, heights: Array) -> None:
    """Mark the cells that triangles, shape (n, 3, 3), pass through between two heights: points on them, half a cell apart."""
    nx, ny = heights.shape
    for t in range(corners.shape[0]):
        longest = 0.0
        for e in range(3):
            square = 0.0
            for k in range(3):
                square += (corners[t, e, k] - corners[t, (e + 1) % 3, k]) ** 2
            longest = max(longest, square)
        parts = max(int(np.ceil(2 * np.sqrt(longest) / cell)), 1)
        for p in range(parts + 1):
            for q in range(parts + 1 - p):
                u, v = p / parts, q / parts
                z = corners[t, 0, 2] + u * (corners[t, 1, 2] - corners[t, 0, 2]) + v * (corners[t, 2, 2] - corners[t, 0, 2])
                if z < bottom or z > top:
                    continue
                x = corners[t, 0, 0] + u * (corners[t, 1, 0] - corners[t, 0, 0]) + v * (corners[t, 2, 0] - corners[t, 0, 0])
                y = corners[t, 0, 1] + u * (corners[t, 1, 1] - corners[t, 0, 1]) + v * (corners[t, 2, 1] - corners[t, 0, 1])
                i, j = int(np.floor(x / cell) - first[0]), int(np.floor(y / cell) - first[1])
                if 0 <= i < nx and 0 <= j < ny:
                    heights[i, j] = 1.0


def _raster(corners: Array, first: Array, cell: float, ceiling: float, upward: bool, heights: Array) -> None:
    """Raise `heights` to every triangle, shape (n, 3, 3), at the centers of the cells that it covers."""
    nx, ny = heights.shape
    for t in range(corners.shape[0]):
        ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
        bx, by, bz = corners[t, 1, 0], corners[t, 1, 1], corners[t, 1, 2]
        cx, cy, cz = corners[t, 2, 0], corners[t, 2, 1], corners[t, 2, 2]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-14 or (upward and area < 0):  # upright faces are seen edge-on from above
            continue
        i0 = max(int(np.ceil(min(ax, bx, cx) / cell - 0.5 - first[0] - 1e-9)), 0)
        i1 = min(int(np.floor(max(ax, bx, cx) / cell - 0.5 - first[0] + 1e-9)), nx - 1)
        j0 = max(int(np.ceil(min(ay, by, cy) / cell - 0.5 - first[1] - 1e-9)), 0)
        j1 = min(int(np.floor(max(ay, by, cy) / cell - 0.5 - first[1] + 1e-9)), ny - 1)
        for i in range(i0, i1 + 1):
            x = (first[0] + i + 0.5) * cell
            for j in range(j0, j1 + 1):
                y = (first[1] + j + 0.5) * cell
                v = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
                w = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
                if v < -1e-9 or w < -1e-9 or v + w > 1 + 1e-9:
                    continue
                z = az + v * (bz - az) + w * (cz - az)
                if z <= ceiling and z > heights[i, j]:
                    heights[i, j] = z
