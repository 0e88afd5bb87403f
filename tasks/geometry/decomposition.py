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
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.colliders import GRID_M
from tasks.geometry.openings import Openings

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST_ATOMS = 250
"""Parts after cutting: joining them takes a few seconds."""

LEAST_M = 0.006
"""Parts are not cut across axes along which they are shorter than this."""

CUT_SHARE, LEAST_SHARE = 0.008, 2e-5
"""Cutting ends when all hulls together stop less than this share of the rays early; a part that stops less than the second is left."""

NEAR_M = 0.02
"""Parts whose boxes are nearer than this are neighbors."""


@dataclasses.dataclass(frozen=True)
class _Solid:
    """A convex solid. vertices: [m], shape (n, 3). box: its bounds, shape (2, 3). cost, lines: of the rays that it stops early."""

    vertices: Array
    box: Array
    volume: float
    cost: float
    lines: tuple[Integers, ...]

    @staticmethod
    def around(points: Array, free: Openings, among: tuple[Integers, ...] | None = None) -> _Solid:
        """The hull of points that do not lie in a plane. among: the lines of a solid around it."""
        from scipy.spatial import ConvexHull

        convex = ConvexHull(points, qhull_options="QJ Pp" if len(points) < 5 else "Qt Pp")
        vertices = points[np.sort(convex.vertices)]
        box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
        return _Solid(vertices, box, float(convex.volume), *free.stopped(np.ascontiguousarray(convex.equations), box, among))


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
) -> list[Array]:
    """Corners of hulls around parts of a mesh, shape (n, 3) each: the fewest of its chain of joins that hold, `most` where none do.

    triangles: shape (m, 3, 3) [m]. body: gives flat points a body. holds: whether hulls hold the measure. likely: the same, quick and
    lenient.
    """
    chain = {len(clouds): clouds for clouds in joins(cut(triangles, free, body), free)}
    counts = sorted(count for count in chain if count <= most) or [min(chain)]
    at, step = 0, 1
    while at < len(counts) - 1 and not likely(chain[counts[at]]):
        at, step = min(at + step, len(counts) - 1), max(1, at // 4)
    while at > 0 and likely(chain[counts[at - 1]]):
        at -= 1
    while at < len(counts) - 1 and not holds(chain[counts[at]]):
        at = min(at + max(1, at // 12), len(counts) - 1)
    return chain[counts[at]]


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
        for axis, place in _places(worst, free):
            below, above, within = split(worst.triangles, axis, place)
            # A wall in the plane belongs to the side whose material it bounds, which only the cost tells.
            ways = (
                [(below, above)]
                if not len(within)
                else [(np.concatenate([below, within]), above), (below, np.concatenate([above, within]))]
            )
            for sides in ways:
                if not all(len(side) for side in sides):
                    continue
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
    heights = np.where(np.abs(heights) < 1e-7, 0.0, heights)
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


def joins(atoms: Sequence[Part], free: Openings) -> Iterator[list[Array]]:
    """Vertices of the hulls of the atoms, then after every join of two neighbors, the cheapest first."""
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
    yield [solid.vertices for solid in solids.values()]
    number = len(atoms)
    while heap:
        _, _, i, j, both = heapq.heappop(heap)
        if i not in solids or j not in solids:
            continue
        del solids[i], solids[j]
        rest = list(solids)
        solids[number] = both
        offer(number, rest)
        number += 1
        yield [solid.vertices for solid in solids.values()]
