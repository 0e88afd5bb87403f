"""Guidance of layouts by physics (PhyScene on a table): out of each other, onto the support, down to its level, out of the large object.

The cost of a layout is half the sum of squares of lengths [m]: how deep footprints of objects at the same height are in each other, how
far they reach over the edge, how far bottoms are from the nearest support level, how deep they are below the large object's top. Depth is
that of turned boxes along the axis of least overlap; the volume of the overlap would be as zero where the depth is, but its slope hangs
on the sizes of both, so that no one step suits mugs and monitors. Steps go down the gradient of middles and yaws; sizes and categories
stay.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.synthesis.layout import Array, Large, Layout
from tasks.synthesis.metrics.boxes import WITHOUT_LEVEL, colliding, floating, off_edge
from tasks.synthesis.model.encoding import Encoding

Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

MARGIN_M = 0.002
"""Left of where objects begin to carry one another: what is just apart is apart in single precision too."""

CONTACT_M = 0.003
"""Objects that share less height than this are on one another, not beside."""

SUNK_M = 0.01
"""So deep may a thing be below the large object's top: it rests on it, not quite exactly."""

CAPTURE_M = 0.02
"""In a large object whose levels nobody knows, a thing belongs onto another one only where it nearly stands on it."""

BLOCKED = 4.0
"""What an axis counts more for each length that two objects cannot part along it, as the edge is in the way."""

STILL_M = 1e-5
"""What moves less in a descent has settled."""

TURNED = 0.5
"""Share of a step's turn that is made: turns part boxes only where these are long."""


@dataclasses.dataclass(frozen=True)
class Guidance:
    """How much layouts are guided. share: Of the steps of sampling, the last ones. inner: Descents in each of them. limit_m: The most
    that a middle moves along an axis in a descent [m]. settling: Descents of the drawn layout, at most. free_m: What an object keeps free
    around itself, drawn evenly between these for each [m]; two neighbors keep both, and an edge counts as one's like. tries: How often a
    layout is drawn until nothing in it collides or is off its support, at most."""

    share: float = 0.2
    inner: int = 3
    limit_m: float = 0.05
    settling: int = 400
    free_m: tuple[float, float] = (0.004, 0.01)
    tries: int = 4

    def free(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """What objects keep free around them [m]; what `rng` draws afterwards does not hang on it."""
        return rng.spawn(1)[0].uniform(*self.free_m, size=shape)


@dataclasses.dataclass(frozen=True)
class Boxes:
    """Objects of several layouts one after another.

    layout: Of each object, shape (n,). centers: [m], shape (n, 3). halves: Half extents [m], shape (n, 3). yaws: [rad], shape (n,).
    free: What they keep free around them [m], shape (n,). larges: Extents of the layouts' large objects [m], shape (b, 3). has_level:
    Whether these carry things on their top, shape (b,).
    """

    layout: Indices
    centers: Array
    halves: Array
    yaws: Array
    free: Array
    larges: Array
    has_level: Flags

    def at(self, centers: Array, yaws: Array) -> Boxes:
        """The same objects elsewhere."""
        return dataclasses.replace(self, centers=centers, yaws=yaws)

    def of(self, chosen: Flags) -> Boxes:
        """Some of the objects."""
        return dataclasses.replace(
            self, layout=self.layout[chosen], centers=self.centers[chosen], halves=self.halves[chosen], yaws=self.yaws[chosen],
            free=self.free[chosen],
        )  # fmt: skip

    def between(self, first: Indices, second: Indices) -> Array:
        """What pairs keep free between them [m], shape (p,)."""
        return self.free[first] + self.free[second]


@dataclasses.dataclass(frozen=True)
class Contacts:
    """What of boxes touches what. first, second: Objects at the same height in one layout, shape (p,). sides: Along which of four axes
    they part, those of the first's sides and those of the second's, shape (p,). levels: Where bottoms belong [m]; NaN where nobody
    knows, shape (n,)."""

    first: Indices
    second: Indices
    sides: Indices
    levels: Array


def boxes_of(layouts: Sequence[Layout], free: Sequence[Array] | None = None) -> Boxes:
    """Objects of layouts. free: What they keep free around them [m], shape (n,) per layout; half of `MARGIN_M` without."""
    kept = [np.full(len(layout), 0.5 * MARGIN_M) for layout in layouts] if free is None else free
    return Boxes(
        layout=np.repeat(np.arange(len(layouts)), [len(layout) for layout in layouts]),
        centers=np.concatenate([np.zeros((0, 3)), *(layout.centers for layout in layouts)]),
        halves=0.5 * np.concatenate([np.zeros((0, 3)), *(layout.sizes for layout in layouts)]),
        yaws=np.concatenate([np.zeros(0), *(layout.yaws for layout in layouts)]),
        free=np.concatenate([np.zeros(0), *kept]),
        larges=np.array([layout.large.size for layout in layouts]).reshape(-1, 3),
        has_level=has_level([layout.large.category for layout in layouts]),
    )


def has_level(categories: Sequence[str]) -> Flags:
    """Whether large objects of categories carry things on the top of their box, shape (b,)."""
    return np.array([name not in WITHOUT_LEVEL for name in categories], dtype=bool)


def contacts_of(boxes: Boxes) -> Contacts:
    """What touches what. An object belongs to the level that is nearest to its bottom: the large object's top, or the top of an object
    with a lower middle whose footprint overlaps its own. What belongs onto an object does not collide with it. Others part along the axis
    of least overlap, but for those along which an edge of the large object is in the way."""
    first, second = _near(boxes, *_pairs(boxes.layout))
    bottoms, tops = boxes.centers[:, 2] - boxes.halves[:, 2], boxes.centers[:, 2] + boxes.halves[:, 2]
    overlaps, axes, _ = _sides(boxes, first, second)
    flat = overlaps.min(axis=0)
    levels = np.where(boxes.has_level[boxes.layout], boxes.larges[boxes.layout, 2], np.nan)
    carriers = np.full(len(levels), -1)
    upper = np.concatenate([first, second])
    lower = np.concatenate([second, first])
    can_carry = (np.concatenate([flat, flat]) > MARGIN_M) & (boxes.centers[lower, 2] < boxes.centers[upper, 2])
    can_carry &= boxes.has_level[boxes.layout[upper]] | (np.abs(bottoms[upper] - tops[lower]) < CAPTURE_M)
    upper, lower = upper[can_carry], lower[can_carry]
    gaps = np.abs(bottoms[upper] - tops[lower])
    order = np.lexsort((lower, gaps, upper))
    nearest = order[np.unique(upper[order], return_index=True)[1]]
    nearer = ~(gaps[nearest] >= np.abs(bottoms - levels)[upper[nearest]])
    on, under = upper[nearest[nearer]], lower[nearest[nearer]]
    levels[on], carriers[on] = tops[under], under
    apart = np.minimum(tops[first], tops[second]) - np.maximum(bottoms[first], bottoms[second]) > CONTACT_M
    apart &= (carriers[first] != second) & (carriers[second] != first) & (flat > -boxes.between(first, second))
    first, second, overlaps, axes = first[apart], second[apart], overlaps[:, apart], axes[:, apart]
    lacking = overlaps + boxes.between(first, second) - _room(boxes, first, -axes) - _room(boxes, second, axes)
    sides = np.argmin(overlaps + BLOCKED * np.maximum(lacking, 0.0), axis=0)
    return Contacts(first, second, sides, levels)


def cost(boxes: Boxes, contacts: Contacts) -> Array:
    """Cost of each layout [m^2], shape (b,)."""
    count = len(boxes.larges)
    deep = np.maximum(_depths(boxes, contacts)[0] + boxes.between(contacts.first, contacts.second), 0.0)
    over = np.maximum(_overhangs(boxes)[0] + 2.0 * boxes.free[:, None], 0.0)
    off, sunk = _heights(boxes, contacts)
    single = np.square(over).sum(axis=1) + np.square(off) + np.square(sunk)
    squares = np.bincount(boxes.layout, single, count) + np.bincount(boxes.layout[contacts.first], np.square(deep), count)
    return np.asarray(0.5 * squares)


def gradient(boxes: Boxes, contacts: Contacts) -> tuple[Array, Array]:
    """Slope of the cost by middles [m], shape (n, 3), and by yaws [m^2 / rad], shape (n,); the contacts stay."""
    count = len(boxes.layout)
    by_center, by_yaw = np.zeros((count, 3)), np.zeros(count)
    depth, axis, turned_first, turned_second = _depths(boxes, contacts)
    deep = np.maximum(depth + boxes.between(contacts.first, contacts.second), 0.0)
    for column in range(2):
        push = deep * axis[:, column]
        by_center[:, column] = np.bincount(contacts.first, push, count) - np.bincount(contacts.second, push, count)
    by_yaw += np.bincount(contacts.first, deep * turned_first, count) + np.bincount(contacts.second, deep * turned_second, count)
    overhang, turned = _overhangs(boxes)
    over = np.maximum(overhang + 2.0 * boxes.free[:, None], 0.0)
    by_center[:, :2] += over * np.sign(boxes.centers[:, :2])
    by_yaw += (over * turned).sum(axis=1)
    off, sunk = _heights(boxes, contacts)
    by_center[:, 2] = off - sunk
    return by_center, by_yaw


def descended(boxes: Boxes, limit_m: float) -> tuple[Boxes, Flags]:
    """Boxes a step down the gradient, and which of them moved, shape (n,). A middle moves by its slope, as two boxes are in each other by
    half after it, and turns by a lever of the footprint's half diagonal; neither moves by more than the limit."""
    contacts = contacts_of(boxes)
    by_center, by_yaw = gradient(boxes, contacts)
    step = np.clip(-by_center * (0.5, 0.5, 1.0), -limit_m, limit_m)
    radius = np.maximum(np.hypot(boxes.halves[:, 0], boxes.halves[:, 1]), MARGIN_M)
    turn = np.clip(-TURNED * by_yaw / radius, -limit_m, limit_m) / radius
    return boxes.at(boxes.centers + step, boxes.yaws + turn), (np.abs(step) > STILL_M).any(axis=1) | (np.abs(turn) * radius > STILL_M)


def guided(
    clean: NDArray[np.float32], larges: Mapping[int, Large], encoding: Encoding, guidance: Guidance, free: Array
) -> NDArray[np.float32]:
    """What a denoiser takes layouts for, some descents further, shape (b, slots, d). larges: Large objects of those rows that are
    layouts. free: What slots but the first keep free around them [m], shape (b, slots - 1). Middles and turns move; slots that show no
    object stay."""
    rows = np.array(sorted(larges))
    layout, slot = np.nonzero(encoding.categories(clean[rows, 1:]) != encoding.empty)
    at = rows[layout], slot + 1
    vectors = clean[at].astype(np.float64)
    sizes, levels = np.array([larges[row].size for row in rows]), has_level([larges[row].category for row in rows])
    tops = sizes[layout, 2]
    middles, halves = encoding.boxes(vectors[:, :6], tops)
    before = Boxes(layout, middles, halves, np.arctan2(vectors[:, 7], vectors[:, 6]), free[rows[layout], slot], sizes, levels)
    after = before
    for _ in range(guidance.inner):
        after, _ = descended(after, guidance.limit_m)
    turn = after.yaws - before.yaws
    cos, sin = np.cos(turn), np.sin(turn)
    vectors[:, :3] = np.clip(encoding.scaled(after.centers, halves, tops)[:, :3], -1.0, 1.0)
    vectors[:, 6], vectors[:, 7] = cos * vectors[:, 6] - sin * vectors[:, 7], sin * vectors[:, 6] + cos * vectors[:, 7]
    made = clean.copy()
    made[at] = vectors
    return made


def settled(layouts: Sequence[Layout], guidance: Guidance, free: Sequence[Array] | None = None) -> list[Layout]:
    """Drawn layouts after descents until nothing in them moves any more: the last part of guided sampling, without noise. What becomes of
    a layout does not depend on the others. free: What their objects keep free around them [m], shape (n,) per layout."""
    boxes = boxes_of(layouts, free)
    centers, yaws, active = boxes.centers.copy(), boxes.yaws.copy(), np.arange(len(boxes.layout))
    for _ in range(guidance.settling):
        boxes, moved = descended(boxes, guidance.limit_m)
        centers[active], yaws[active] = boxes.centers, boxes.yaws
        restless = np.bincount(boxes.layout, moved, len(layouts))[boxes.layout] > 0
        if not restless.any():
            break
        boxes, active = boxes.of(restless), active[restless]
    ends = np.cumsum([len(layout) for layout in layouts])[:-1]
    yaws = np.where(np.abs(yaws) > math.pi, (yaws + math.pi) % (2.0 * math.pi) - math.pi, yaws)
    parts = zip(layouts, np.split(centers, ends), np.split(yaws, ends), strict=True) if layouts else ()
    return [Layout(layout.large, layout.categories, middles, layout.sizes, turns) for layout, middles, turns in parts]


def sound(layouts: Sequence[Layout]) -> list[bool]:
    """Whether nothing in a layout collides or is off its support, of each."""
    flags = zip(colliding(layouts), off_edge(layouts), floating(layouts), strict=True)
    return [not any(bool(part.any()) for part in parts) for parts in flags]


def _pairs(layout: Indices) -> tuple[Indices, Indices]:
    """Every two objects of the same layout, each once, shape (p,). layout: Ascending."""
    ends = np.searchsorted(layout, layout, side="right")
    later = ends - np.arange(len(layout)) - 1
    first = np.repeat(np.arange(len(layout)), later)
    within = np.arange(len(first)) - np.repeat(np.cumsum(later) - later, later)
    return first, first + 1 + within


def _near(boxes: Boxes, first: Indices, second: Indices) -> tuple[Indices, Indices]:
    """Those of pairs whose footprints may come nearer than the margin, shape (p,)."""
    radii = np.hypot(boxes.halves[:, 0], boxes.halves[:, 1])
    between = boxes.centers[second, :2] - boxes.centers[first, :2]
    near = np.hypot(between[:, 0], between[:, 1]) < radii[first] + radii[second] + MARGIN_M + boxes.between(first, second)
    return first[near], second[near]


def _depths(boxes: Boxes, contacts: Contacts) -> tuple[Array, Array, Array, Array]:
    """Overlap of footprints along the axis by which they part [m], shape (p,), and its slopes: by the middle of the first, shape (p, 2),
    negative by that of the second; by the yaws of the first and of the second [m / rad], shape (p,)."""
    overlaps, axes, turns = _sides(boxes, contacts.first, contacts.second)
    every = np.arange(len(contacts.first))
    by_turns = turns[contacts.sides, :, every]
    return overlaps[contacts.sides, every], axes[contacts.sides, every], by_turns[:, 0], by_turns[:, 1]


def _room(boxes: Boxes, objects: Indices, ways: Array) -> Array:
    """How far objects can go along directions until they reach an edge [m], shape (4, p). ways: Unit vectors, shape (4, p, 2)."""
    left = np.maximum(-_overhangs(boxes)[0][objects] + np.abs(boxes.centers[objects, :2]), 0.0)
    left = left - boxes.centers[objects, :2] * np.sign(ways)
    return np.asarray((np.maximum(left, 0.0) / np.maximum(np.abs(ways), 1e-9)).min(axis=-1))


def _sides(boxes: Boxes, first: Indices, second: Indices) -> tuple[Array, Array, Array]:
    """Overlaps of footprints along the two axes of the first's sides and the two of the second's [m], shape (4, p), and their slopes: by
    the middle of the first, shape (4, p, 2), and by the yaws of both [m / rad], shape (4, 2, p)."""
    between = boxes.centers[second, :2] - boxes.centers[first, :2]
    difference = boxes.yaws[second] - boxes.yaws[first]
    cos, sin = np.cos(difference), np.sin(difference)
    overlaps, axes, turns = [], [], []
    for own, other, turned in ((first, second, sin), (second, first, -sin)):
        depth, width = boxes.halves[other, 0], boxes.halves[other, 1]
        along = np.column_stack([np.cos(boxes.yaws[own]), np.sin(boxes.yaws[own])])
        across = np.column_stack([-along[:, 1], along[:, 0]])
        # how far the other reaches along the own axes, and how that changes as the own box turns
        reaches = depth * np.abs(cos) + width * np.abs(sin), depth * np.abs(sin) + width * np.abs(cos)
        by_cos, by_sin = np.sign(cos) * turned, -np.sign(sin) * cos * (1.0 if own is first else -1.0)
        slopes = depth * by_cos + width * by_sin, depth * by_sin + width * by_cos
        places = (between * along).sum(axis=1), (between * across).sum(axis=1)
        for side, (axis, place, beside) in enumerate(((along, places[0], places[1]), (across, places[1], -places[0]))):
            sign = np.where(place < 0.0, -1.0, 1.0)
            overlaps.append(boxes.halves[own, side] + reaches[side] - np.abs(place))
            axes.append(axis * sign[:, None])
            turns.append((slopes[side] - sign * beside, -slopes[side])[:: 1 if own is first else -1])
    return np.array(overlaps), np.array(axes), np.array(turns)


def _overhangs(boxes: Boxes) -> tuple[Array, Array]:
    """How far footprints reach over the edges [m], shape (n, 2), and its slope by the yaw [m / rad], shape (n, 2).

    What is in a compartment is in the footprint too, so that objects in shelves are no exception.
    """
    cos, sin = np.cos(boxes.yaws), np.sin(boxes.yaws)
    depth, width = boxes.halves[:, 0], boxes.halves[:, 1]
    reach = np.column_stack([depth * np.abs(cos) + width * np.abs(sin), depth * np.abs(sin) + width * np.abs(cos)])
    by_cos, by_sin = -np.sign(cos) * sin, np.sign(sin) * cos
    slope = np.column_stack([depth * by_cos + width * by_sin, depth * by_sin + width * by_cos])
    return np.abs(boxes.centers[:, :2]) + reach - 0.5 * boxes.larges[boxes.layout, :2], slope


def _heights(boxes: Boxes, contacts: Contacts) -> tuple[Array, Array]:
    """How far bottoms are above their level, and how far below the large object's top by more than `SUNK_M` [m], shape (n,)."""
    bottoms = boxes.centers[:, 2] - boxes.halves[:, 2]
    off = np.where(np.isnan(contacts.levels), 0.0, bottoms - contacts.levels)
    deep = np.where(boxes.has_level[boxes.layout], boxes.larges[boxes.layout, 2] - SUNK_M - bottoms, 0.0)
    return off, np.maximum(deep, 0.0)
