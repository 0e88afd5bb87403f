"""How far a model of upright blocks and an instance's points are from each other, compiled: thousands of models a second.

A block is x0, x1, y0, y1, z0, z1 [m]; blocks of a model touch and do not overlap. Frame: the instance's box, +Z up, x and y zero in its
middle, z zero at its bottom.
"""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

TRUNCATION_M = 0.15
"""Farther is wrong, however far: points of pillows and neighbors do not pull at a model."""

LEVEL_WEIGHT, SIDE_WEIGHT = 1.0, 0.35
"""What model surface counts that should have points: tops are seen from everywhere, of the sides half or less, undersides never."""

PITCH_M = 0.07
"""Samples on a model's surface lie about this far apart: half of an arm rest."""

CELL_SHARE, CELL_M = 1 / 80, (0.01, 0.04)
"""Cell of the field of distances to points: a share of the box's diagonal, and its bounds [m]."""

LARGE_SHARE = 1 / 200
"""Cells, and half of the pitch, are no smaller share of the diagonal: a merged instance of a hall's size costs no more than a sofa."""

MARGIN_CELLS = 2
"""Cells of the field beyond the box: surfaces that lie on its sides are looked up within."""


@dataclasses.dataclass(frozen=True)
class FitTarget:
    """An instance to be fitted. points: [m], shape (n, 3), thinned evenly. size: of the box [m]. unseen: which sides of the box, -x, +x,
    -y, +y, -z, +z, the scan could not see. near: distance within which a point counts as covered [m]. field: distance of cells from the
    nearest point [m]; origin: center of its first cell; cell: its step [m]. slack: what the field's grain and gaps between points make of
    nothing [m]."""

    points: Array
    size: Array
    unseen: NDArray[np.bool_]
    near: float
    field: NDArray[np.float32]
    origin: Array
    cell: float
    slack: float


def fit_target(points: Array, size: Array, unseen: NDArray[np.bool_], near: float, most: int) -> FitTarget:
    """A target from an instance's points [m], shape (n, 3), at most `most` of which are kept, spread evenly."""
    from scipy.ndimage import distance_transform_edt

    diagonal = float(np.linalg.norm(size))
    cell = max(float(np.clip(CELL_SHARE * diagonal, *CELL_M)), LARGE_SHARE * diagonal)
    thinned = _thinned(points, cell, most)
    origin = np.array([-0.5 * size[0], -0.5 * size[1], 0.0]) - MARGIN_CELLS * cell
    shape = np.ceil(size / cell).astype(int) + 2 * MARGIN_CELLS + 1
    at = np.rint((points - origin) / cell).astype(np.int64)
    at = at[((at >= 0) & (at < shape)).all(axis=1)]
    free = np.ones(shape, dtype=bool)
    free[tuple(at.T)] = False
    field = distance_transform_edt(free, sampling=cell) if len(at) else np.full(shape, TRUNCATION_M)
    return FitTarget(thinned, size, unseen, near, np.ascontiguousarray(field, dtype=np.float32), origin, cell, 1.5 * cell)


def _thinned(points: Array, cell: float, most: int) -> Array:
    """One point of each cell, of ever larger ones until they are few enough."""
    from_corner = points - points.min(axis=0)
    while True:
        _, first = np.unique(np.floor(from_corner / cell).astype(np.int64), axis=0, return_index=True)
        if len(first) <= most:
            return np.ascontiguousarray(points[np.sort(first)])
        cell *= max(1.05, 0.9 * (len(first) / most) ** 0.5)


def misfits(target: FitTarget, blocks: Array, counts: NDArray[np.int64]) -> Array:
    """What several models miss, shape (h, 4): mean distance of the points from the surface and of the surface from points, each
    truncated [m], the share of points that are covered, and the share of the surface that has no points though it should.

    blocks: shape (h, b, 6), of which the first `counts` (h) are of the model.
    """
    pitch = max(PITCH_M, 2 * LARGE_SHARE * float(np.linalg.norm(target.size)))
    return np.asarray(
        _compiled()["_misfits"](
            target.points, np.ascontiguousarray(blocks), counts, target.field, target.origin, target.cell, target.slack, target.size,
            target.unseen, target.near, TRUNCATION_M, LEVEL_WEIGHT, SIDE_WEIGHT, pitch,
        )
    )  # fmt: skip


@cache
def _compiled() -> Kernels:
    return compile_kernels(_point_distance, _is_covered, _misfits)


def _point_distance(x, y, z, blocks, count):  # type: ignore[no-untyped-def]
    """Distance of a point from the surface of blocks: from the nearest when outside, to the nearest side of its block when inside."""
    best, depth = np.inf, -1.0
    for b in range(count):
        dx = max(blocks[b, 0] - x, x - blocks[b, 1])
        dy = max(blocks[b, 2] - y, y - blocks[b, 3])
        dz = max(blocks[b, 4] - z, z - blocks[b, 5])
        inside = max(dx, dy, dz)
        if inside <= 0.0:
            depth = max(depth, -inside)
        else:
            a, c, d = max(dx, 0.0), max(dy, 0.0), max(dz, 0.0)
            best = min(best, a * a + c * c + d * d)
    return depth if depth >= 0.0 else np.sqrt(best)


def _is_covered(x, y, z, blocks, count, own):  # type: ignore[no-untyped-def]
    """Whether a point lies in another block than its own."""
    for b in range(count):
        if b != own and blocks[b, 0] < x < blocks[b, 1] and blocks[b, 2] < y < blocks[b, 3] and blocks[b, 4] < z < blocks[b, 5]:
            return True
    return False


def _misfits(points, blocks, counts, field, origin, cell, slack, size, unseen, near, limit, level, side, pitch):  # type: ignore[no-untyped-def]
    models, n = blocks.shape[0], points.shape[0]
    result = np.zeros((models, 4))
    at = np.zeros(3)
    for h in range(models):
        count = counts[h]
        for i in range(n):
            d = _point_distance(points[i, 0], points[i, 1], points[i, 2], blocks[h], count)
            result[h, 0] += min(d, limit) / n
            if d <= near:
                result[h, 2] += 1.0 / n
        total = 1e-9
        for b in range(count):
            for face in range(6):
                if face == 4:  # undersides
                    continue
                axis, high = face // 2, face % 2
                edge = blocks[h, b, face]
                border = (0.0 if high == 0 else size[2]) if axis == 2 else (-0.5 if high == 0 else 0.5) * size[axis]
                if unseen[face] and abs(edge - border) < 0.5 * cell:
                    continue
                u, v = (axis + 1) % 3, (axis + 2) % 3
                long, wide = blocks[h, b, 2 * u + 1] - blocks[h, b, 2 * u], blocks[h, b, 2 * v + 1] - blocks[h, b, 2 * v]
                rows, columns = max(int(np.ceil(long / pitch)), 1), max(int(np.ceil(wide / pitch)), 1)
                weight = (level if axis == 2 else side) * long * wide / (rows * columns)
                at[axis] = edge + (1e-4 if high == 1 else -1e-4)
                for r in range(rows):
                    at[u] = blocks[h, b, 2 * u] + (r + 0.5) * long / rows
                    for c in range(columns):
                        at[v] = blocks[h, b, 2 * v] + (c + 0.5) * wide / columns
                        if _is_covered(at[0], at[1], at[2], blocks[h], count, b):
                            continue
                        i = min(max(int(np.rint((at[0] - origin[0]) / cell)), 0), field.shape[0] - 1)
                        j = min(max(int(np.rint((at[1] - origin[1]) / cell)), 0), field.shape[1] - 1)
                        k = min(max(int(np.rint((at[2] - origin[2]) / cell)), 0), field.shape[2] - 1)
                        d = max(field[i, j, k] - slack, 0.0)
                        total += weight
                        result[h, 1] += weight * min(d, limit)
                        if d > near:
                            result[h, 3] += weight
        result[h, 1] /= total
        result[h, 3] /= total
    return result
