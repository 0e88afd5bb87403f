"""A mesh as a few convex pieces that keep its openings open: cut where hulls stop rays early, then joined again.

Only what rays meet (`tasks.geometry.colliders`) decides. Surfaces may be open, doubled, self-intersecting or without volume.

* Cutting: the part whose hull stops most rays early is cut by a plane across an axis, through the surface itself: at a board or
  wall beside the opening, or in the middle; until hulls stop nearly none.
* Joining: of all neighbors, the two whose common hull stops fewest more become one part, again and again. A frame, which no
  single cut improves, falls apart into bars this way.
* The fewest parts are taken whose hulls hold the measure.

A mixture of the cutting of Wei et al., "Approximate convex decomposition for 3D meshes with collision-aware concavity"
(SIGGRAPH 2022), and the joining of Mamou and Ghorbel, "A simple and efficient approach for 3D mesh approximate convex
decomposition" (ICIP 2009), with visible space in place of their concavities.
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.colliders import GRID_M
from tasks.geometry.openings import Openings
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST_ATOMS = 400
"""Parts after cutting: joining them takes a few seconds."""

LEAST_M = 0.006
"""Parts are not cut across axes along which they are shorter than this."""

CUT_SHARE, LEAST_SHARE = 0.008, 2e-5
"""Cutting ends when all hulls together stop less than this share of the rays early; a part that stops less than the second is left."""

FLAT_M = 1e-7
"""Corners this near to a plane lie in it: coordinates of meshes are rounded to a micrometre."""

MAX_HULL_TRIES = 3
"""Planes whose halves get hulls: those that cut best by bounding polytopes, a tenth of the time each. The third is hardly ever the best."""

GUESS_EXCESS, MAX_EXCESS = 1.5, 6.0
"""Hulls are expected to hold the measure when they cost so many times what it allows, and never beyond the second: costs count deep rays
twice, and rays that two hulls stop."""

NEAR_M = 0.02
"""Parts whose boxes are nearer than this are neighbors."""


def _unit_directions(most: int) -> Array:
    """Unit vectors along all steps of a grid up to `most` cells, one of each opposite pair, the axes first, shape (k, 3)."""
    steps = [np.array(step) for step in itertools.product(range(-most, most + 1), repeat=3) if step > (0, 0, 0)]
    primitive = sorted((step for step in steps if np.gcd.reduce(step) == 1), key=lambda step: (int(step @ step), *(-step).tolist()))
    return np.array([step / np.linalg.norm(step) for step in primitive])


DIRECTIONS = _unit_directions(2)
"""Normals of bounding polytopes, the axes first, shape (k, 3)."""


@dataclasses.dataclass(frozen=True)
class _Solid:
    """A convex solid. vertices: [m], shape (n, 3). box: its bounds, shape (2, 3). reach: least and greatest coordinate along each of
    `DIRECTIONS` [m], shape (2, k). cost, lines: of the rays that it stops early."""

    vertices: Array
    box: Array
    reach: Array
    volume: float
    cost: float
    lines: tuple[Integers, ...]

    @staticmethod
    def around(points: Array, free: Openings, among: tuple[Integers, ...] | None = None) -> _Solid:
        """The hull of points that do not lie in a plane. among: the lines of a solid around it."""
        from scipy.spatial import ConvexHull

        convex = ConvexHull(points, qhull_options="QJ Pp" if len(points) < 5 else "Qt Pp")
        vertices = points[np.sort(convex.vertices)]
        along = vertices @ DIRECTIONS.T
        reach = np.array([along.min(axis=0), along.max(axis=0)])
        box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
        return _Solid(vertices, box, reach, float(convex.volume), *free.stopped(np.ascontiguousarray(convex.equations), box, among))


def _bounding_cost(reach: Array, free: Openings, among: tuple[Integers, ...] | None = None) -> float:
    """Rays that a bounding polytope stops early: no fewer than the hull inside it. reach: as of a solid. among: as for `Openings.stopped`."""
    normals = np.concatenate([DIRECTIONS, -DIRECTIONS])
    planes = np.column_stack([normals, np.concatenate([-reach[1], reach[0]])])
    return free.stopped(planes, np.ascontiguousarray(reach[:, :3]), among)[0]


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of a mesh: the triangles that lie in it, shape (m, 3, 3), and the hull around them."""

    triangles: Array
    solid: _Solid


def parts_of(
    triangles: Array,
    free: Openings,
    body: Callable[[Array], Array],
    likely: Callable[[list[Array]], bool],
    holds: Callable[[list[Array]], bool],
    most: int,
    share: float,
) -> list[Array]:
    """Corners of hulls around parts of a mesh, shape (n, 3) each: the fewest of its chain of joins that hold, `most` where none do.

    triangles: shape (m, 3, 3) [m]. body: gives flat points a body. holds: whether hulls hold the measure. likely: the same, quick and
    lenient. share: of the rays, that hulls may stop early by that measure: what stops several times as many is not asked for.
    """
    chain: list[Joined] = []
    for joined in joins(cut(triangles, free, body), free):
        if len(joined.clouds) <= most:
            chain.append(joined)
            if joined.cost > MAX_EXCESS * share * free.rays:
                break
        last = joined
    chain = chain[::-1] or [last]  # the fewest first
    # The costs say about where hulls begin to hold.
    guess = next((i for i, joined in enumerate(chain) if joined.cost <= GUESS_EXCESS * share * free.rays), len(chain) - 1)
    at = _first(len(chain), guess, lambda i: likely(chain[i].clouds))
    while at < len(chain) - 1 and not holds(chain[at].clouds):
        at = min(at + max(1, at // 12), len(chain) - 1)
    return chain[at].clouds


def _first(count: int, guess: int, is_good: Callable[[int], bool]) -> int:
    """The first of `count` numbers that is good, if all after it are; the last if no other is. The search starts at a guess."""
    low, high, at, step = -1, count - 1, guess, 1
    while high - low > 1:
        at = min(max(at, low + 1), high - 1)
        if is_good(at):
            high, at = at, at - step
        else:
            low, at = at, at + step
        step *= 2
        if low >= 0 and high < count - 1:
            at = (low + high) // 2
    return high


def cut(triangles: Array, free: Openings, body: Callable[[Array], Array]) -> list[Part]:
    """Parts whose hulls stop nearly no ray early."""

    def part(inside: Array, among: tuple[Integers, ...] | None) -> Part:
        return Part(inside, _Solid.around(body(inside.reshape(-1, 3)), free, among))

    whole = part(triangles, None)
    heap, done, number, total = [(-whole.solid.cost, 0, whole)], list[Part](), 1, whole.solid.cost
    while heap and len(heap) + len(done) < MOST_ATOMS and total > CUT_SHARE * free.rays:
        _, _, worst = heapq.heappop(heap)
        if worst.solid.cost <= LEAST_SHARE * free.rays:
            done.append(worst)
            break
        best: tuple[float, list[Part]] | None = None
        for axis, place, way in _promising(worst, free)[:MAX_HULL_TRIES]:
            below, above, within = split(worst.triangles, axis, place)
            sides = (np.concatenate([below, within]), above) if way == 0 else (below, np.concatenate([above, within]))
            halves = [part(side, worst.solid.lines) for side in sides]
            cost = sum(half.solid.cost for half in halves)
            if best is None or cost < best[0]:
                best = cost, halves
        if best is None:
            done.append(worst)
            continue
        total += best[0] - worst.solid.cost
        for half in best[1]:
            heapq.heappush(heap, (-half.solid.cost, number, half))
            number += 1
    return done + [entry[2] for entry in sorted(heap, key=lambda entry: entry[1])]


def _promising(part: Part, free: Openings) -> list[tuple[int, float, int]]:
    """Planes, the most promising by bounding polytopes first: axis, coordinate [m], and the side, 0 below and 1 above, of walls in the
    plane: they belong to the side whose material they bound, which only the cost tells."""
    along = part.triangles @ DIRECTIONS.T
    lowest, highest = along.min(axis=1), along.max(axis=1)
    ranked = []
    for axis, place in _places(part, free):
        counts, reach = np.zeros(3, dtype=np.int64), np.empty((3, 2, len(DIRECTIONS)))
        _compiled()["_reaches"](along, lowest, highest, axis, place, counts, reach)
        below, above, within = reach
        for way in (0, 1) if counts[2] else (0,):
            first, second = (_both(below, within), above) if way == 0 else (below, _both(above, within))
            if not counts[1 - way] or not counts[way] + counts[2]:
                continue
            cost = sum(_bounding_cost(side, free, part.solid.lines) for side in (first, second))
            ranked.append((cost, len(ranked), axis, place, way))
    return [(axis, place, way) for _, _, axis, place, way in sorted(ranked)]


def _both(reach: Array, other: Array) -> Array:
    """Least and greatest coordinates of two bodies together, shape (2, k)."""
    return np.array([np.minimum(reach[0], other[0]), np.maximum(reach[1], other[1])])


@cache
def _compiled() -> Kernels:
    return compile_kernels(_widen, _reaches)


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


def _places(part: Part, free: Openings) -> Iterator[tuple[int, float]]:
    """Planes that are worth a try: axis and coordinate [m]."""
    points = part.triangles.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    for axis in range(3):
        reach = high[axis] - low[axis]
        if reach < LEAST_M:
            continue
        bins = int(np.clip(reach / GRID_M, 4, 96))
        tried = []
        # Where openings end along the axis: a back panel, a shelf.
        along, index = free.lines[axis], part.solid.lines[axis]
        walls = np.concatenate([along.low[index] + free.early_m, along.high[index] - free.early_m])
        walls = walls[np.isfinite(walls) & (walls > low[axis]) & (walls < high[axis])]
        if len(walls):
            count, edges = np.histogram(walls, bins=bins, range=(low[axis], high[axis]))
            most = int(count.argmax())
            tried.append(float(np.median(walls[(walls >= edges[most]) & (walls <= edges[most + 1])])))
        # Where they end across it.
        across = [lines.across[part.solid.lines[lines.axis], axis - (axis > lines.axis)] for lines in free.lines if lines.axis != axis]
        profile, edges = np.histogram(np.concatenate(across), bins=bins, range=(low[axis], high[axis]))
        jumps = np.abs(np.diff(profile))
        tried += [float(edges[1 + int(i)]) for i in np.argsort(-jumps, kind="stable")[:1] if jumps[i] > 0]
        coordinates = np.unique(np.round(points[:, axis], 5))
        places = [0.5 * (low[axis] + high[axis])]
        for place in tried:
            near = coordinates[np.abs(coordinates - place) <= free.early_m + reach / bins]
            # Both sides of a board are near: each is tried.
            places += [float(near[0]), float(near[-1])] if len(near) else [place]
        for place in dict.fromkeys(places):
            if low[axis] + 1e-4 < place < high[axis] - 1e-4:
                yield axis, place


def split(triangles: Array, axis: int, place: float) -> tuple[Array, Array, Array]:
    """Triangles below and above a plane across an axis, cut where they cross it, and those in the plane, shape (m, 3, 3) each."""
    heights = triangles[:, :, axis] - place
    heights = np.where(np.abs(heights) < FLAT_M, 0.0, heights)
    lowest, highest = heights.min(axis=1), heights.max(axis=1)
    within = (lowest == 0) & (highest == 0)
    below, above = (highest <= 0) & ~within, (lowest >= 0) & ~within
    crossing = (lowest < 0) & (highest > 0)
    cut, h = triangles[crossing], heights[crossing]
    parts: tuple[list[Array], list[Array]] = ([triangles[below]], [triangles[above]])
    if len(cut):
        # Turn each so that the corner that is alone on its side (or the one on the plane) comes first.
        alone = np.where((h > 0).sum(axis=1) == 1, (h > 0).argmax(axis=1), (h < 0).argmax(axis=1))
        index = (alone[:, None] + np.arange(3)) % 3
        rows = np.arange(len(cut))[:, None]
        corner, height = cut[rows, index], h[rows, index]
        first = _meeting(corner[:, 0], corner[:, 1], height[:, 0], height[:, 1])
        last = _meeting(corner[:, 0], corner[:, 2], height[:, 0], height[:, 2])
        tip = np.stack([corner[:, 0], first, last], axis=1)
        rest = [np.stack([first, corner[:, 1], corner[:, 2]], axis=1), np.stack([first, corner[:, 2], last], axis=1)]
        up = height[:, 0] > 0
        for side, tips in ((1, up), (0, ~up)):
            parts[side].append(tip[tips])
            parts[1 - side].extend(piece[tips] for piece in rest)
    return np.concatenate(parts[0]), np.concatenate(parts[1]), triangles[within]


def _meeting(a: Array, b: Array, height_a: Array, height_b: Array) -> Array:
    """Where edges from a to b, shape (n, 3), meet height 0, given their ends' heights, shape (n,)."""
    share = height_a / (height_a - height_b)
    return np.asarray(a + share[:, None] * (b - a))


@dataclasses.dataclass(frozen=True)
class Joined:
    """Hulls after some joins. clouds: their corners, shape (n, 3) each [m]. cost: of all the rays that they stop early."""

    clouds: list[Array]
    cost: float


def joins(atoms: Sequence[Part], free: Openings) -> Iterator[Joined]:
    """The hulls of the atoms, then after every join of two neighbors, the cheapest first."""
    solids = {i: atom.solid for i, atom in enumerate(atoms)}
    heap: list[tuple[float, float, int, int, _Solid]] = []

    def offer(i: int, among: Sequence[int]) -> None:
        a, boxes = solids[i], np.array([solids[j].box for j in among]).reshape(-1, 2, 3)
        near = ((boxes[:, 0] <= a.box[1] + NEAR_M) & (boxes[:, 1] >= a.box[0] - NEAR_M)).all(axis=1)
        for j in (among[k] for k in np.flatnonzero(near).tolist()):
            b = solids[j]
            both = _Solid.around(np.concatenate([a.vertices, b.vertices]), free)
            heapq.heappush(heap, (both.cost - a.cost - b.cost, both.volume - a.volume - b.volume, i, j, both))

    for i in range(1, len(atoms)):
        offer(i, range(i))
    total = sum(solid.cost for solid in solids.values())
    yield Joined([solid.vertices for solid in solids.values()], total)
    number = len(atoms)
    while heap:
        _, _, i, j, both = heapq.heappop(heap)
        if i not in solids or j not in solids:
            continue
        total += both.cost - solids[i].cost - solids[j].cost
        del solids[i], solids[j]
        rest = list(solids)
        solids[number] = both
        offer(number, rest)
        number += 1
        yield Joined([solid.vertices for solid in solids.values()], total)
