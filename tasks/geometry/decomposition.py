"""A mesh as a few convex pieces that keep its openings open: cut where hulls stop rays early, then joined again.

Only what rays meet (`tasks.geometry.colliders`) decides. Surfaces may be open, doubled, self-intersecting or without volume.

* Cutting: the part whose hull stops most rays early is cut by a plane across an axis, through the surface itself: at a board or
  wall beside the opening, or in the middle; until hulls stop nearly none. Polytopes around the halves, which cost a tenth of hulls,
  say which plane that is.
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
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.colliders import GRID_M
from tasks.geometry.hulls import Hull, balanced, deviation, hull_of, reduced, with_body
from tasks.geometry.openings import FLAT_M, Openings, ReachesBeside, both_reaches, reach_of

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST_ATOMS = 450
"""Parts after cutting: joining them takes a second. More than three times as many as pieces are wanted: joins choose among them."""

LEAST_M = 0.006
"""Parts are not cut across axes along which they are shorter than this."""

CUT_SHARE, LEAST_SHARE = 0.008, 2e-5
"""Cutting ends when all hulls together stop less than this share of the rays early; a part that stops less than the second is left."""

MAX_HALVINGS = 3
"""A rounded piece is halved so often at most: eight hulls stand for it as well as engines take."""

MAX_HULL_OFFERS = 2
"""Joins of a solid that get hulls at once: a join that costs little is among the cheapest by bounding polytopes, too."""

GUESS_EXCESS, MAX_EXCESS = 1.5, 6.0
"""Hulls are expected to hold the measure when they cost so many times what it allows, and never beyond the second: costs count deep rays
twice, and rays that two hulls stop."""

NEAR_M = 0.02
"""Parts whose boxes are nearer than this are neighbors."""


@dataclasses.dataclass(frozen=True)
class _Solid:
    """A convex solid. vertices: [m], shape (n, 3). box: its bounds, shape (2, 3). reach: as of `reach_of` [m], shape (2, k). cost,
    lines: of the rays that it stops early."""

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
        reach = reach_of(vertices)
        box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
        return _Solid(vertices, box, reach, float(convex.volume), *free.stopped(np.ascontiguousarray(convex.equations), box, among))


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
    chain: list[JoinedHulls] = []
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
        plane = _most_promising(worst, free)
        if plane is None:
            done.append(worst)
            continue
        axis, place, way = plane
        below, above, within = split(worst.triangles, axis, place)
        sides = (np.concatenate([below, within]), above) if way == 0 else (below, np.concatenate([above, within]))
        halves = [part(side, worst.solid.lines) for side in sides]
        total += sum(half.solid.cost for half in halves) - worst.solid.cost
        for half in halves:
            heapq.heappush(heap, (-half.solid.cost, number, half))
            number += 1
    return done + [entry[2] for entry in sorted(heap, key=lambda entry: entry[1])]


def _most_promising(part: Part, free: Openings) -> tuple[int, float, int] | None:
    """The plane whose halves stop fewest rays by bounding polytopes, if any cuts the part: axis, coordinate [m], and the side, 0 below and
    1 above, of walls in the plane: they belong to the side whose material they bound, which only the cost tells."""
    planes: list[tuple[int, float, int]] = []
    sides: list[Array] = []
    beside = ReachesBeside(part.triangles)
    for axis, place in _places(part, free):
        counts, (below, above, within) = beside.plane(axis, place)
        for way in (0, 1) if counts[2] else (0,):
            if counts[1 - way] and counts[way] + counts[2]:
                planes.append((axis, place, way))
                sides += [both_reaches(below, within), above] if way == 0 else [below, both_reaches(above, within)]
    if not planes:
        return None
    costs = free.stopped_by_bounds(np.array(sides), part.solid.lines).reshape(-1, 2).sum(axis=1)
    return planes[int(costs.argmin())]


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
            bin_of = ((walls - low[axis]) * (bins / reach)).astype(np.int64)
            most = int(np.bincount(bin_of).argmax())
            tried.append(float(np.median(walls[bin_of == most])))
        # Where they end across it.
        across = [lines.across[part.solid.lines[lines.axis], axis - (axis > lines.axis)] for lines in free.lines if lines.axis != axis]
        ends = np.concatenate(across)
        ends = ends[(ends >= low[axis]) & (ends < high[axis])]
        profile = np.bincount(((ends - low[axis]) * (bins / reach)).astype(np.int64), minlength=bins)[:bins]
        jumps = np.abs(np.diff(profile))
        jump = int(jumps.argmax())
        tried += [float(low[axis] + (jump + 1) * reach / bins)] if jumps[jump] > 0 else []
        coordinates = np.round(points[:, axis], 5)
        places = [0.5 * (low[axis] + high[axis])]
        for place in tried:
            near = coordinates[np.abs(coordinates - place) <= free.early_m + reach / bins]
            # Both sides of a board are near: each is tried.
            places += [float(near.min()), float(near.max())] if len(near) else [place]
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
class JoinedHulls:
    """Hulls after some joins. clouds: their corners, shape (n, 3) each [m]. cost: of all the rays that they stop early."""

    clouds: list[Array]
    cost: float


def joins(atoms: Sequence[Part], free: Openings) -> Iterator[JoinedHulls]:
    """The hulls of the atoms, then after every join of two neighbors, the cheapest first.

    Of a solid's joins the most promising get hulls at once. The others wait by the costs of bounding polytopes, and get a hull when they
    come first.
    """
    solids = {i: atom.solid for i, atom in enumerate(atoms)}
    bounding = dict(zip(solids, free.stopped_by_bounds(np.array([solid.reach for solid in solids.values()])).tolist(), strict=True))
    heap: list[tuple[float, float, int, int, _Solid | None]] = []

    def offer_hull(i: int, j: int) -> None:
        a, b = solids[i], solids[j]
        both = _Solid.around(np.concatenate([a.vertices, b.vertices]), free)
        heapq.heappush(heap, (both.cost - a.cost - b.cost, both.volume - a.volume - b.volume, i, j, both))

    def offer(i: int, among: Sequence[int]) -> None:
        a, boxes = solids[i], np.array([solids[j].box for j in among]).reshape(-1, 2, 3)
        is_near = ((boxes[:, 0] <= a.box[1] + NEAR_M) & (boxes[:, 1] >= a.box[0] - NEAR_M)).all(axis=1)
        near = [among[k] for k in np.flatnonzero(is_near).tolist()]
        if len(near) > MAX_HULL_OFFERS:
            reaches = np.array([both_reaches(a.reach, solids[j].reach) for j in near])
            costs = free.stopped_by_bounds(reaches) - bounding[i] - np.array([bounding[j] for j in near])
            order = np.argsort(costs, kind="stable").tolist()
            for k in order[MAX_HULL_OFFERS:]:
                heapq.heappush(heap, (float(costs[k]), -np.inf, i, near[k], None))
            near = [near[k] for k in order[:MAX_HULL_OFFERS]]
        for j in near:
            offer_hull(i, j)

    for i in range(1, len(atoms)):
        offer(i, range(i))
    total = sum(solid.cost for solid in solids.values())
    yield JoinedHulls([solid.vertices for solid in solids.values()], total)
    number = len(atoms)
    while heap:
        _, _, i, j, both = heapq.heappop(heap)
        if i not in solids or j not in solids:
            continue
        if both is None:
            offer_hull(i, j)
            continue
        total += both.cost - solids[i].cost - solids[j].cost
        del solids[i], solids[j]
        rest = list(solids)
        solids[number], bounding[number] = both, float(free.stopped_by_bounds(both.reach[None])[0])
        offer(number, rest)
        number += 1
        yield JoinedHulls([solid.vertices for solid in solids.values()], total)


class Halving:
    """The hull of a point cloud that engines take, and those of its halves, made when they are asked for.

    points: shape (n, 3) [m]; flat ones get a body of `thickness_m`. hull: within the limits of engines. away_m: how far that lies off the
    hull of all points [m].
    """

    def __init__(self, points: Array, thickness_m: float, depth: int = MAX_HALVINGS) -> None:
        self._thickness_m, self._depth = thickness_m, depth
        self._whole = hull_of(with_body(points, thickness_m))
        self.hull, self.away_m = reduced(self._whole), 0.0
        if self.hull is not self._whole:
            self.hull = balanced(self.hull, self._whole)
            self.away_m = max(deviation(self.hull, self._whole.vertices), deviation(self._whole, self.hull.vertices))

    @cached_property
    def halves(self) -> list[Halving]:
        """The two halves along the longest side."""
        low, high = self._whole.vertices.min(axis=0), self._whole.vertices.max(axis=0)
        axis = int((high - low).argmax())
        sides = split(self._whole.vertices[self._whole.faces], axis, 0.5 * float(low[axis] + high[axis]))
        return [Halving(np.unique(side.reshape(-1, 3), axis=0), self._thickness_m, self._depth - 1) for side in sides[:2]]

    def hulls(self, deviation_m: float) -> list[Hull]:
        """Hulls that together stand for the points: halved again and again while they lie farther off than a deviation [m]."""
        if self.away_m <= deviation_m or not self._depth:
            return [self.hull]
        return [hull for half in self.halves for hull in half.hulls(deviation_m)]
