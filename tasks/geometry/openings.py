"""The openings of an asset: what the rays that colliders are measured by see as free, and how many of them a solid would stop."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.colliders import Sightlines
from tasks.kernels import compile_kernels

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST_LINES = 4_000
"""Lines along an axis that solids are held against; of more, so many are drawn, always the same."""

DEPTH_M = 0.1
"""An opening that is filled this deep counts twice: filling less of it is progress, too."""


@dataclasses.dataclass(frozen=True)
class Lines:
    """Lines along an axis through an asset. across: the two other coordinates [m], shape (n, 2). low, high: coordinates along the
    axis up to which, and from which on, rays from below and above are free [m], inf and -inf where nothing is met, shape (n,).
    weight: rays that a ray stands for.
    """

    axis: int
    across: Array
    low: Array
    high: Array
    weight: float


@dataclasses.dataclass(frozen=True)
class Openings:
    """What rays see as free around an asset. lines: along x, y, z. far: cells of a grid that lie farther than `early_m` [m] from what is
    seen. origin, step: of the grid [m], shape (3,). rays: that meet the asset."""

    lines: tuple[Lines, Lines, Lines]
    far: NDArray[np.bool_]
    origin: Array
    step: Array
    early_m: float
    rays: int

    def stopped(self, planes: Array, box: Array, among: tuple[Integers, ...] | None = None) -> tuple[float, tuple[Integers, ...]]:
        """How many rays a convex solid stops early, deep ones counting more, and which lines they are on, indices per axis.

        planes: outward unit normals and negative offsets, shape (k, 4). box: its bounds [m], shape (2, 3). among: the lines to look at.
        """
        total, kept = 0.0, []
        for lines in self.lines:
            index = np.arange(len(lines.across)) if among is None else among[lines.axis]
            early = np.empty(len(index), dtype=np.bool_)
            total += lines.weight * _compiled()(
                lines.axis, lines.across, lines.low, lines.high, index, planes, box, self.far, self.origin, self.step, DEPTH_M, early
            )  # fmt: skip
            kept.append(index[early])
        return total, tuple(kept)


def openings(sight: Sightlines) -> Openings:
    """What the rays of an asset see as free."""
    from scipy.ndimage import distance_transform_edt

    low, high, counts = sight.vertices.min(axis=0), sight.vertices.max(axis=0), sight.counts
    step = (high - low) / counts
    surface = np.zeros(counts, dtype=bool)
    at, lines = 0, []
    for axis in range(3):
        plane = [i for i in range(3) if i != axis]
        size = int(np.prod(counts[plane]))
        up, down = slice(at, at + size), slice(at + size, at + 2 * size)
        at += 2 * size
        ends = []
        for rays, sign in ((up, 1.0), (down, -1.0)):
            hits = sight.rays[rays, :3].astype(np.float64)
            hits[:, axis] += sign * sight.seen[rays]
            ends.append(hits[:, axis])
            i, j, k = np.clip(((hits[np.isfinite(sight.seen[rays])] - low) / np.maximum(step, 1e-12)).astype(int), 0, counts - 1).T
            surface[i, j, k] = True
        drawn = np.arange(size)
        if size > MOST_LINES:
            drawn = np.sort(np.random.default_rng(axis).permutation(size)[:MOST_LINES])
        across = sight.rays[up, :3][:, plane].astype(np.float64)[drawn]
        lines.append(Lines(axis, across, ends[0][drawn] - sight.early_m, ends[1][drawn] + sight.early_m, size / len(drawn)))
    far = distance_transform_edt(~surface, sampling=np.maximum(step, 1e-9)) > sight.early_m + 0.5 * float(step.max())
    return Openings((lines[0], lines[1], lines[2]), far, low, step, sight.early_m, int(np.isfinite(sight.seen).sum()))


@cache
def _compiled() -> Callable[..., Any]:
    return compile_kernels(_is_far, _stopped)["_stopped"]


def _is_far(axis: int, across: Any, along: float, far: Any, origin: Any, step: Any) -> bool:
    """Whether a place on a line lies in a cell that is far from all that is seen."""
    at = np.empty(3, dtype=np.int64)
    side = 0
    for i in range(3):
        if i == axis:
            place = along
        else:
            place = across[side]
            side += 1
        at[i] = min(max(int((place - origin[i]) / max(step[i], 1e-12)), 0), far.shape[i] - 1)
    return bool(far[at[0], at[1], at[2]])


def _stopped(
    axis: int, across: Any, low: Any, high: Any, index: Any, planes: Any, box: Any,
    far: Any, origin: Any, step: Any, deep: float, early: Any,
) -> float:  # fmt: skip
    """The rays along one axis that a solid stops early, weighed; `early` says for which lines."""
    first, second = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
    total = 0.0
    for n in range(len(index)):
        line = index[n]
        early[n] = False
        u, v = across[line, 0], across[line, 1]
        if u <= box[0, first] or u >= box[1, first] or v <= box[0, second] or v >= box[1, second]:
            continue
        if low[line] <= box[0, axis] and high[line] >= box[1, axis]:
            continue
        start, end = -np.inf, np.inf
        for k in range(len(planes)):
            room = -planes[k, 3] - planes[k, first] * u - planes[k, second] * v
            along = planes[k, axis]
            if along > 1e-9:
                end = min(end, room / along)
            elif along < -1e-9:
                start = max(start, room / along)
            elif room < 0:
                end = -np.inf
            if end <= start:
                break
        if end <= start:
            continue
        for side in range(2):
            depth = min(end, low[line]) - start if side == 0 else end - max(start, high[line])
            if depth <= 1e-6 or (np.isinf(low[line]) and not _is_far(axis, across[line], start if side == 0 else end, far, origin, step)):
                continue
            early[n] = True
            total += 1.0 + min(depth / deep, 1.0)
    return total
