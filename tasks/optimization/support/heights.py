"""Plan views: the height of a placed surface over a grid of cells, which says what can stand on it and where."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.meshes import Surface
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

BLOCK = 64
"""Faces that are left out together."""


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


def face_blocks(surface: Surface) -> Array:
    """Boxes around every 64 consecutive faces [m], shape (n, 6), lowest corner first: neighbors in a mesh's order are
    mostly neighbors in space, so that a window needs to look at few of a scan's 50,000 faces."""
    count = -(-len(surface.faces) // BLOCK)
    blocks = np.empty((count, 6))
    _compiled()["_bound"](*_triangles(surface), blocks)
    return blocks


def plan_view(
    surface: Surface, low: ArrayLike, high: ArrayLike, ceiling: float, cell: float, upward: bool = False, blocks: Array | None = None
) -> PlanView:
    """The highest point of a surface at or below `ceiling` in every cell of a window [m]; `low`, `high`: shape (2,).
    `blocks`: the surface's `face_blocks`, where they are known.

    `upward`: only faces that look up count, which closed surfaces allow: an object sunk into a block does not find the
    block's underside below it.
    """
    blocks = face_blocks(surface) if blocks is None else blocks
    first, heights = _window(low, high, cell)
    _compiled()["_raster"](*_triangles(surface), blocks, first.astype(np.float64), float(cell), float(ceiling), bool(upward), heights)
    return PlanView(heights, (int(first[0]), int(first[1])), cell)


def occupancy(
    surface: Surface, low: ArrayLike, high: ArrayLike, bottom: float, top: float, cell: float, blocks: Array | None = None
) -> PlanView:
    """Where a surface, upright faces too, passes between two heights [m]: 1 in such cells of a window, else minus infinity.
    `blocks`: the surface's `face_blocks`, where they are known."""
    blocks = face_blocks(surface) if blocks is None else blocks
    first, heights = _window(low, high, cell)
    _compiled()["_mark"](*_triangles(surface), blocks, first.astype(np.float64), float(cell), float(bottom), float(top), heights)
    return PlanView(heights, (int(first[0]), int(first[1])), cell)


def underside(surface: Surface, cell: float) -> tuple[NDArray[np.int64], Array]:
    """Cells that a surface covers in plan, shape (n, 2), and its lowest height in each [m], shape (n,).

    An object smaller than a cell covers the cell of its center.
    """
    low, high = surface.bounds
    first, heights = _window(low, high, cell)
    vertices, faces = _triangles(surface)
    everywhere = np.tile([-np.inf] * 3 + [np.inf] * 3, (-(-len(faces) // BLOCK), 1))
    mirrored = vertices * np.array([1.0, 1.0, -1.0])
    _compiled()["_raster"](mirrored, faces, everywhere, first.astype(np.float64), float(cell), np.inf, False, heights)
    cells = np.argwhere(np.isfinite(heights))
    if not len(cells):
        return np.floor(0.5 * (low + high)[None, :2] / cell).astype(np.int64), np.array([low[2]])
    return cells + first, -heights[cells[:, 0], cells[:, 1]]


def _triangles(surface: Surface) -> tuple[Array, NDArray[np.int64]]:
    return np.ascontiguousarray(surface.vertices, dtype=np.float64), np.ascontiguousarray(surface.faces, dtype=np.int64)


def _window(low: ArrayLike, high: ArrayLike, cell: float) -> tuple[NDArray[np.int64], Array]:
    """First cell of a window, and its empty heights."""
    a, b = np.asarray(low, dtype=np.float64)[:2], np.asarray(high, dtype=np.float64)[:2]
    first = np.floor(a / cell).astype(np.int64)
    shape = np.maximum(np.floor(b / cell).astype(np.int64) - first + 1, 1)
    return first, np.full((int(shape[0]), int(shape[1])), -np.inf)


@cache
def _compiled() -> Kernels:
    return compile_kernels(_raster, _mark, _bound)


def _bound(vertices: Array, faces: NDArray[np.int64], blocks: Array) -> None:
    """Box of every block of faces."""
    for b in range(blocks.shape[0]):
        for k in range(3):
            least, most = np.inf, -np.inf
            for t in range(b * BLOCK, min((b + 1) * BLOCK, faces.shape[0])):
                for e in range(3):
                    value = vertices[faces[t, e], k]
                    least, most = min(least, value), max(most, value)
            blocks[b, k], blocks[b, 3 + k] = least, most


def _mark(
    vertices: Array, faces: NDArray[np.int64], blocks: Array, first: Array, cell: float, bottom: float, top: float, heights: Array
) -> None:
    """Mark the cells that triangles pass through between two heights: cells whose centers their slices cover, and cells
    along the slices' edges, which are all that upright faces have in plan."""
    nx, ny = heights.shape
    x0, y0 = first[0] * cell, first[1] * cell
    x1, y1 = x0 + nx * cell, y0 + ny * cell
    ring, cut = np.empty((8, 3)), np.empty((8, 3))
    for block in range(blocks.shape[0]):
        if (
            blocks[block, 0] > x1
            or blocks[block, 3] < x0
            or blocks[block, 1] > y1
            or blocks[block, 4] < y0
            or blocks[block, 2] > top
            or blocks[block, 5] < bottom
        ):
            continue
        for t in range(block * BLOCK, min((block + 1) * BLOCK, faces.shape[0])):
            a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
            if min(vertices[a, 2], vertices[b, 2], vertices[c, 2]) > top or max(vertices[a, 2], vertices[b, 2], vertices[c, 2]) < bottom:
                continue
            if min(vertices[a, 0], vertices[b, 0], vertices[c, 0]) > x1 or max(vertices[a, 0], vertices[b, 0], vertices[c, 0]) < x0:
                continue
            if min(vertices[a, 1], vertices[b, 1], vertices[c, 1]) > y1 or max(vertices[a, 1], vertices[b, 1], vertices[c, 1]) < y0:
                continue
            for k in range(3):
                ring[0, k], ring[1, k], ring[2, k] = vertices[a, k], vertices[b, k], vertices[c, k]
            n = 3
            for side in range(2):  # cut off what lies below the bottom, then what lies above the top
                m = 0
                for e in range(n):
                    f = (e + 1) % n
                    inside = ring[e, 2] - bottom if side == 0 else top - ring[e, 2]
                    other = ring[f, 2] - bottom if side == 0 else top - ring[f, 2]
                    if inside >= 0:
                        for k in range(3):
                            cut[m, k] = ring[e, k]
                        m += 1
                    if (inside > 0 and other < 0) or (inside < 0 and other > 0):
                        for k in range(3):
                            cut[m, k] = ring[e, k] + inside / (inside - other) * (ring[f, k] - ring[e, k])
                        m += 1
                n = m
                for e in range(n):
                    for k in range(3):
                        ring[e, k] = cut[e, k]
            for e in range(n):
                f = (e + 1) % n
                dx, dy = ring[f, 0] - ring[e, 0], ring[f, 1] - ring[e, 1]
                parts = max(int(np.ceil(2 * np.sqrt(dx * dx + dy * dy) / cell)), 1)
                for p in range(parts + 1):
                    i = int(np.floor((ring[e, 0] + dx * p / parts) / cell) - first[0])
                    j = int(np.floor((ring[e, 1] + dy * p / parts) / cell) - first[1])
                    if 0 <= i < nx and 0 <= j < ny:
                        heights[i, j] = 1.0
            for e in range(1, n - 1):
                ax, ay, bx, by = ring[0, 0], ring[0, 1], ring[e, 0], ring[e, 1]
                cx, cy = ring[e + 1, 0], ring[e + 1, 1]
                area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
                if abs(area) < 1e-14:
                    continue
                i0 = max(int(np.ceil(min(ax, bx, cx) / cell - 0.5 - first[0])), 0)
                i1 = min(int(np.floor(max(ax, bx, cx) / cell - 0.5 - first[0])), nx - 1)
                j0 = max(int(np.ceil(min(ay, by, cy) / cell - 0.5 - first[1])), 0)
                j1 = min(int(np.floor(max(ay, by, cy) / cell - 0.5 - first[1])), ny - 1)
                for i in range(i0, i1 + 1):
                    x = (first[0] + i + 0.5) * cell
                    for j in range(j0, j1 + 1):
                        y = (first[1] + j + 0.5) * cell
                        v = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
                        w = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
                        if v >= -1e-9 and w >= -1e-9 and v + w <= 1 + 1e-9:
                            heights[i, j] = 1.0


def _raster(
    vertices: Array, faces: NDArray[np.int64], blocks: Array, first: Array, cell: float, ceiling: float, upward: bool, heights: Array
) -> None:
    """Raise `heights` to every triangle at the centers of the cells that it covers."""
    nx, ny = heights.shape
    x0, y0 = first[0] * cell, first[1] * cell
    x1, y1 = x0 + nx * cell, y0 + ny * cell
    for block in range(blocks.shape[0]):
        if blocks[block, 0] > x1 or blocks[block, 3] < x0 or blocks[block, 1] > y1 or blocks[block, 4] < y0 or blocks[block, 2] > ceiling:
            continue
        for t in range(block * BLOCK, min((block + 1) * BLOCK, faces.shape[0])):
            a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
            ax, bx, cx = vertices[a, 0], vertices[b, 0], vertices[c, 0]
            if min(ax, bx, cx) > x1 or max(ax, bx, cx) < x0:
                continue
            ay, by, cy = vertices[a, 1], vertices[b, 1], vertices[c, 1]
            if min(ay, by, cy) > y1 or max(ay, by, cy) < y0:
                continue
            az, bz, cz = vertices[a, 2], vertices[b, 2], vertices[c, 2]
            if min(az, bz, cz) > ceiling:
                continue
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
