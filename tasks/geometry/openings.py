"""The openings of an asset: what the rays that colliders are measured by see as free, and how many of them a solid would stop."""

from __future__ import annotations

import dataclasses
import itertools
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.colliders import Sightlines
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST_LINES = 4_000
"""Lines along an axis that solids are held against; of more, so many are drawn, always the same."""

DEPTH_M = 0.1
"""An opening that is filled this deep counts twice: filling less of it is progress, too."""


FLAT_M = 1e-7
"""Corners this near to a plane lie in it: coordinates of meshes are rounded to a micrometre."""


def _unit_directions(most: int) -> Array:
    """Unit vectors along all steps of a grid up to `most` cells, one of each opposite pair, the axes first, shape (k, 3)."""
    steps = [np.array(step) for step in itertools.product(range(-most, most + 1), repeat=3) if step > (0, 0, 0)]
    primitive = sorted((step for step in steps if np.gcd.reduce(step) == 1), key=lambda step: (int(step @ step), *(-step).tolist()))
    return np.array([step / np.linalg.norm(step) for step in primitive])


DIRECTIONS = _unit_directions(2)
"""Normals of bounding polytopes, the axes first, shape (k, 3)."""


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
            total += lines.weight * _compiled()["_stopped"](
                lines.axis, lines.across, lines.low, lines.high, index, planes, box, self.far, self.origin, self.step, DEPTH_M, early
            )  # fmt: skip
            kept.append(index[early])
        return total, tuple(kept)

    def stopped_by_bounds(self, reaches: Array, among: tuple[Integers, ...] | None = None) -> Array:
        """As many rays as bounding polytopes stop early, shape (b,): no fewer than the solids inside them.

        reaches: as of `reach_of` [m], shape (b, 2, k). among: as for `stopped`.
        """
        total, costs = np.zeros(len(reaches)), np.empty(len(reaches))
        for lines in self.lines:
            index = np.arange(len(lines.across)) if among is None else among[lines.axis]
            _compiled()["_stopped_by_bounds"](
                lines.axis, lines.across, lines.low, lines.high, index, DIRECTIONS, reaches,
                self.far, self.origin, self.step, DEPTH_M, costs,
            )  # fmt: skip
            total += lines.weight * costs
        return total


def reach_of(points: Array) -> Array:
    """Least and greatest coordinates of points, shape (n, 3) [m], along each of `DIRECTIONS`, shape (2, k): a polytope around them."""
    along = _along_directions(points)
    return np.array([along.min(axis=0), along.max(axis=0)])


def _along_directions(points: Array) -> Array:
    """Coordinates of points, shape (n, 3) [m], along each of `DIRECTIONS`, shape (n, k): the same on any number of threads."""
    along = np.empty((len(points), len(DIRECTIONS)))
    _compiled()["_project"](points, DIRECTIONS, along)
    return along


def both_reaches(reach: Array, other: Array) -> Array:
    """The reach of two bodies together, shape (2, k) each."""
    return np.array([np.minimum(reach[0], other[0]), np.maximum(reach[1], other[1])])


class ReachesBeside:
    """Reaches of the two sides of planes through triangles, shape (m, 3, 3) [m], without cutting them."""

    def __init__(self, triangles: Array) -> None:
        self._along = _along_directions(triangles.reshape(-1, 3)).reshape(len(triangles), 3, -1)
        self._lowest, self._highest = self._along.min(axis=1), self._along.max(axis=1)

    def plane(self, axis: int, place: float) -> tuple[Integers, Array]:
        """Triangles below, above and in a plane across an axis at a coordinate [m]: numbers, shape (3,), and reaches, shape (3, 2, k)."""
        counts, reaches = np.zeros(3, dtype=np.int64), np.empty((3, 2, len(DIRECTIONS)))
        _compiled()["_reaches"](self._along, self._lowest, self._highest, axis, place, counts, reaches)
        return counts, reaches


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
def _compiled() -> Kernels:
    return compile_kernels(_is_far, _stopped, _stopped_by_bounds, _project, _widen, _reaches)


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


def _stopped_by_bounds(
    axis: int, across: Any, low: Any, high: Any, index: Any, directions: Any, reaches: Any,
    far: Any, origin: Any, step: Any, deep: float, costs: Any,
) -> None:  # fmt: skip
    """As `_stopped`, for bodies between planes across all directions: `costs` of each."""
    first, second = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
    for body in range(len(reaches)):
        least, most, total = reaches[body, 0], reaches[body, 1], 0.0
        for n in range(len(index)):
            line = index[n]
            u, v = across[line, 0], across[line, 1]
            if u <= least[first] or u >= most[first] or v <= least[second] or v >= most[second]:
                continue
            if low[line] <= least[axis] and high[line] >= most[axis]:
                continue
            start, end = least[axis], most[axis]
            for k in range(3, len(directions)):
                at = directions[k, first] * u + directions[k, second] * v
                along = directions[k, axis]
                if along > 1e-9:
                    start, end = max(start, (least[k] - at) / along), min(end, (most[k] - at) / along)
                elif along < -1e-9:
                    start, end = max(start, (most[k] - at) / along), min(end, (least[k] - at) / along)
                elif at < least[k] or at > most[k]:
                    end = -np.inf
                if end <= start:
                    break
            if end <= start:
                continue
            for side in range(2):
                depth = min(end, low[line]) - start if side == 0 else end - max(start, high[line])
                is_wide = np.isinf(low[line])
                if depth > 1e-6 and not (is_wide and not _is_far(axis, across[line], start if side == 0 else end, far, origin, step)):
                    total += 1.0 + min(depth / deep, 1.0)
        costs[body] = total


def _project(points: Any, directions: Any, along: Any) -> None:
    """Coordinates of points, shape (n, 3), along directions, shape (k, 3), into `along`, shape (n, k)."""
    for n in range(len(points)):
        for k in range(len(directions)):
            along[n, k] = points[n, 0] * directions[k, 0] + points[n, 1] * directions[k, 1] + points[n, 2] * directions[k, 2]


def _widen(reach: Any, low: Any, high: Any) -> None:
    """Take coordinates between two points along all directions into a reach."""
    for k in range(len(low)):
        reach[0, k] = min(reach[0, k], low[k])
        reach[1, k] = max(reach[1, k], high[k])


def _reaches(along: Any, lowest: Any, highest: Any, axis: int, place: float, counts: Any, reach: Any) -> None:
    """Reaches of triangles below, above and in a plane across an axis, shape (3, 2, k), and how many of them there are, shape (3,).

    along: coordinates of their corners along `DIRECTIONS`, shape (m, 3, k). lowest, highest: of all corners, shape (m, k).
    """
    reach[:, 0, :], reach[:, 1, :] = np.inf, -np.inf
    heights, meeting = np.empty(3), np.empty(along.shape[2])
    for m in range(len(along)):
        under, over = 0, 0
        for i in range(3):
            heights[i] = along[m, i, axis] - place
            if abs(heights[i]) < FLAT_M:
                heights[i] = 0.0
            under += heights[i] < 0.0
            over += heights[i] > 0.0
        if not (under and over):
            side = 0 if under else 1 if over else 2
            counts[side] += 1
            _widen(reach[side], lowest[m], highest[m])
            continue
        counts[0] += 1
        counts[1] += 1
        for i in range(3):
            j = (i + 1) % 3
            if heights[i] <= 0.0:
                _widen(reach[0], along[m, i], along[m, i])
            if heights[i] >= 0.0:
                _widen(reach[1], along[m, i], along[m, i])
            if heights[i] * heights[j] < 0.0:
                share = heights[i] / (heights[i] - heights[j])
                for k in range(len(meeting)):
                    meeting[k] = along[m, i, k] + share * (along[m, j, k] - along[m, i, k])
                _widen(reach[0], meeting, meeting)
                _widen(reach[1], meeting, meeting)
