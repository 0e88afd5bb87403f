"""How far space around a surface is from it, on a coarse grid, and how well a partial scan lies on a model.

A scan shows a part of an object, and nothing of what is behind it. So it is laid on a model, turned by quarters and moved within the
model's box, and what counts is first how near the model's surface is to every scanned point, then how much of the model was seen.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

CELLS = 16
"""Grid points along each side of a field: 4 kB a model; between them distances are interpolated, which are smooth."""

SAMPLES = 256
"""Points of a surface that are laid on another: more change the fit by less than noise does."""

MARGIN = 0.15
"""Of the box's sides that a field reaches beyond it, and `MARGIN_M`; farther away, the way to the field is added."""

MARGIN_M = 0.02

REACH = 0.3
"""Of a box's diagonal, the largest distance that is kept; none so far away lies on a surface."""

NOISE_M, NOISE_SHARE = 0.012, 0.02
"""How far a scanned point lies from its surface [m], and more in proportion to the diagonal: drift, and a grid that is coarser."""


@dataclasses.dataclass(frozen=True)
class SurfaceField:
    """Distances to a surface, the origin at the bottom center of its box, +Z up.

    values: In 1/255 of the reach, shape (16, 16, 16) uint8. low, high: First and last point of the grid [m], shape (3,). samples: Points
    of the surface [m], shape (256, 3). size: Of the box [m], shape (3,).
    """

    values: NDArray[np.uint8]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    samples: NDArray[np.float32]
    size: NDArray[np.float32]

    @property
    def reach(self) -> float:
        """The largest distance that is kept [m]."""
        return REACH * float(np.linalg.norm(self.size))


def field_of(points: ArrayLike, extents: ArrayLike | None = None) -> SurfaceField:
    """The field of surface points, shape (n, 3) [m], +Z up, which are to be many; moved so that their box stands on the origin.

    extents: Of the box [m], shape (3,), where it is known to be larger than that of the points; the points lie at its top, in the middle.
    """
    from scipy.spatial import cKDTree

    p = np.asarray(points, dtype=np.float64)
    low, high = p.min(axis=0), p.max(axis=0)
    size = high - low if extents is None else np.maximum(np.asarray(extents, dtype=np.float64), high - low)
    p = p - np.array([*(0.5 * (low + high))[:2], high[2] - size[2]])
    pad = MARGIN * size + MARGIN_M
    first, last = np.array([*(-0.5 * size[:2]), 0.0]) - pad, np.array([*(0.5 * size[:2]), size[2]]) + pad
    axes = [np.linspace(a, b, CELLS) for a, b in zip(first, last, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    reach = REACH * float(np.linalg.norm(size))
    distance = np.minimum(cKDTree(p).query(grid, distance_upper_bound=reach)[0], reach)
    values = np.round(255.0 * distance / max(reach, 1e-9)).astype(np.uint8).reshape(CELLS, CELLS, CELLS)
    chosen = p[np.linspace(0, len(p) - 1, SAMPLES).astype(np.int64)]
    return SurfaceField(values, first.astype(np.float32), last.astype(np.float32), chosen.astype(np.float32), size.astype(np.float32))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_at, _nearness, _best)


def fits(
    query: SurfaceField, values: NDArray[np.uint8], low: NDArray[np.float32], high: NDArray[np.float32], samples: NDArray[np.float32],
    sizes: NDArray[np.float32], rows: NDArray[np.int64],
) -> Array:  # fmt: skip
    """How well a scan lies on models: for each of `rows`, the share of scanned points near the model, and the share of the model near
    scanned points, at the best place. Shape (k, 2), in 0..1. The other arrays are those of `SurfaceField`, one row per model."""
    out = np.zeros((len(rows), 2))
    sigma = NOISE_M + NOISE_SHARE * float(np.linalg.norm(query.size))
    _compiled()["_best"](
        query.values,
        query.low,
        query.high,
        query.samples,
        query.size,
        query.reach,
        values,
        low,
        high,
        samples,
        sizes,
        rows,
        sigma,
        out,
    )
    return out


def _at(values: Any, low: Any, high: Any, reach: float, x: float, y: float, z: float) -> float:
    """Distance at a point, interpolated; outside of the grid, with the way to it."""
    cells = values.shape[0]
    away = 0.0
    place = np.empty(3)
    for k in range(3):
        v = x if k == 0 else (y if k == 1 else z)
        inside = min(max(v, low[k]), high[k])
        away += (v - inside) ** 2
        place[k] = (inside - low[k]) / (high[k] - low[k]) * (cells - 1)
    i, j, k = min(int(place[0]), cells - 2), min(int(place[1]), cells - 2), min(int(place[2]), cells - 2)
    a, b, c = place[0] - i, place[1] - j, place[2] - k
    near = (1 - b) * ((1 - a) * values[i, j, k] + a * values[i + 1, j, k]) + b * (
        (1 - a) * values[i, j + 1, k] + a * values[i + 1, j + 1, k]
    )
    k += 1
    far = (1 - b) * ((1 - a) * values[i, j, k] + a * values[i + 1, j, k]) + b * (
        (1 - a) * values[i, j + 1, k] + a * values[i + 1, j + 1, k]
    )
    return ((1 - c) * near + c * far) * reach / 255.0 + np.sqrt(away)


def _nearness(values: Any, low: Any, high: Any, reach: float, points: Any, step: int, turn: int, back: bool, t: Any, sigma: float) -> float:
    """Mean of 1 / (1 + (d / sigma)^2) over every `step`-th point, turned by quarters and moved by t; or, `back`, the other way."""
    total, count = 0.0, 0
    cos, sin = (1.0, 0.0) if turn == 0 else ((0.0, 1.0) if turn == 1 else ((-1.0, 0.0) if turn == 2 else (0.0, -1.0)))
    for p in range(0, points.shape[0], step):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        if back:
            x, y, z = x - t[0], y - t[1], z - t[2]
            x, y = cos * x + sin * y, cos * y - sin * x
        else:
            x, y = cos * x - sin * y + t[0], sin * x + cos * y + t[1]
            z += t[2]
        d = _at(values, low, high, reach, x, y, z) / sigma
        total += 1.0 / (1.0 + d * d)
        count += 1
    return total / count


def _best(
    q_values: Any, q_low: Any, q_high: Any, q_samples: Any, q_size: Any, q_reach: float, values: Any, low: Any, high: Any, samples: Any,
    sizes: Any, rows: Any, sigma: float, out: Any,
) -> None:  # fmt: skip
    """Fill in both shares for every row at the best of four turns and of places within the box, one axis after the other."""
    t, best_t = np.zeros(3), np.zeros(3)
    for n in range(len(rows)):
        r = rows[n]
        size = sizes[r]
        reach = REACH * np.sqrt(size[0] ** 2 + size[1] ** 2 + size[2] ** 2)
        best = -1.0
        for turn in range(4):
            t[:] = 0.0
            now = _nearness(values[r], low[r], high[r], reach, q_samples, 4, turn, True, t, sigma)
            for axis in (2, 0, 1):
                along = size[2] if axis == 2 else (size[axis] if turn % 2 == 0 else size[1 - axis])
                slack = along - q_size[axis]
                kept = t[axis]
                for side in (-1.0, -0.5, 0.5, 1.0):
                    if axis < 2:
                        t[axis] = 0.5 * slack * side
                    else:  # scans lack what is below, not what is above
                        t[axis] = slack * side if side < 0.0 else sigma * (1.5 - 2.0 * side)
                    other = _nearness(values[r], low[r], high[r], reach, q_samples, 4, turn, True, t, sigma)
                    if other > now:
                        now, kept = other, t[axis]
                t[axis] = kept
            if now > best:
                best = now
                best_t[:] = t
                best_turn = turn
        out[n, 0] = _nearness(values[r], low[r], high[r], reach, q_samples, 1, best_turn, True, best_t, sigma)
        # The model moves onto the scan by the inverse: turned by the quarters, then moved.
        out[n, 1] = _nearness(q_values, q_low, q_high, q_reach, samples[r], 1, best_turn, False, best_t, sigma)
