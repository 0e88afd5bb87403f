"""What boxes of layouts do that things cannot: go into each other, reach over the edge, stand on nothing."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.synthesis.layout import Layout

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

TOLERANCE_M = 0.005
"""Deeper than this is a collision; farther over the edge is off it."""

LEVEL_M = 0.01
"""Nearer to a support level than this is on it."""

WITHOUT_LEVEL = ("bathtub", "bed", "chair", "shelf", "sink", "sofa", "toilet")
"""Large objects on which things lie lower than the top of the box: compartments, mattresses, seats, basins."""


@dataclasses.dataclass(frozen=True)
class BoxFigures:
    """Shares. layouts, objects: How many the shares are of; without any, they are NaN. collides, off_edge, floats, off_support: Of the
    objects; off_support are those that are off the edge or float. layouts_collide, layouts_off_support: Of the layouts, those with at
    least one such object."""

    layouts: int
    objects: int
    collides: float
    off_edge: float
    floats: float
    off_support: float
    layouts_collide: float
    layouts_off_support: float


@dataclasses.dataclass(frozen=True)
class _Pairs:
    """Objects of all layouts one after another, and the ordered pairs of different ones of the same layout.

    layout: Of each object, shape (n,). centers, sizes: [m], shape (n, 3). yaws: [rad], shape (n,). first, second: Objects, shape (p,).
    """

    layout: Indices
    centers: Array
    sizes: Array
    yaws: Array
    first: Indices
    second: Indices


def colliding(layouts: Sequence[Layout]) -> list[Flags]:
    """Which objects go deeper than 5 mm into another of their layout, shape (n,) per layout; what merely rests on another does not."""
    pairs = _pairs_of(layouts)
    deep = _depths(pairs, pairs.first, pairs.second) > TOLERANCE_M
    flags = np.zeros(len(pairs.layout), dtype=bool)
    flags[pairs.first[deep]] = True
    return _split(flags, layouts)


def depths(layout: Layout) -> Array:
    """How deep every two objects of a layout are in each other [m], shape (n, n): the shortest move that parts their boxes, negative for
    gaps along the axis that parts them most; zero on the diagonal."""
    pairs, values = _pairs_of([layout]), np.zeros((len(layout), len(layout)))
    values[pairs.first, pairs.second] = _depths(pairs, pairs.first, pairs.second)
    return values


def off_edge(layouts: Sequence[Layout]) -> list[Flags]:
    """Which objects reach over the edge of the large object's box by more than 5 mm, seen from above, shape (n,) per layout."""
    return [np.asarray((overhangs(layout) > TOLERANCE_M).any(axis=1)) for layout in layouts]


def overhangs(layout: Layout) -> Array:
    """How far footprints reach over the edge of the large object's box along its x and y axes [m], negative inside, shape (n, 2)."""
    cos, sin = np.abs(np.cos(layout.yaws)), np.abs(np.sin(layout.yaws))
    half = 0.5 * np.column_stack([cos * layout.sizes[:, 0] + sin * layout.sizes[:, 1], sin * layout.sizes[:, 0] + cos * layout.sizes[:, 1]])
    return np.asarray(np.abs(layout.centers[:, :2]) + half - 0.5 * np.asarray(layout.large.size[:2]))


def floating(layouts: Sequence[Layout]) -> list[Flags]:
    """Which objects have their bottom farther than 1 cm from the top of the large object and of everything below them, shape (n,) per
    layout. Nothing floats on a large object of `WITHOUT_LEVEL`, whose levels its box does not tell."""
    pairs = _pairs_of(layouts)
    top = np.array([layout.large.size[2] for layout in layouts])
    unknown = np.array([layout.large.category in WITHOUT_LEVEL for layout in layouts], dtype=bool)
    bottoms = pairs.centers[:, 2] - 0.5 * pairs.sizes[:, 2]
    supported = unknown[pairs.layout] | (np.abs(bottoms - top[pairs.layout]) <= LEVEL_M)
    tops = pairs.centers[:, 2] + 0.5 * pairs.sizes[:, 2]
    near = np.abs(bottoms[pairs.first] - tops[pairs.second]) <= LEVEL_M
    above = near & (_plane_depths(pairs, pairs.first, pairs.second) > TOLERANCE_M)
    supported[pairs.first[above]] = True
    return _split(~supported, layouts)


def box_figures(layouts: Sequence[Layout]) -> BoxFigures:
    """Shares of objects and layouts that collide, and that are off their support."""
    flags = colliding(layouts), off_edge(layouts), floating(layouts)
    collides, over, floats = (np.concatenate([np.zeros(0, dtype=bool), *part]) for part in flags)
    off = [a | b for a, b in zip(flags[1], flags[2], strict=True)]
    return BoxFigures(
        layouts=len(layouts), objects=len(collides), collides=_share(collides), off_edge=_share(over), floats=_share(floats),
        off_support=_share(over | floats), layouts_collide=_share([bool(part.any()) for part in flags[0]]),
        layouts_off_support=_share([bool(part.any()) for part in off]),
    )  # fmt: skip


def _share(flags: Sequence[bool] | Flags) -> float:
    return float(np.mean(flags)) if len(flags) else math.nan


def _split(flags: Flags, layouts: Sequence[Layout]) -> list[Flags]:
    return np.split(flags, np.cumsum([len(layout) for layout in layouts])[:-1]) if layouts else []


def _pairs_of(layouts: Sequence[Layout]) -> _Pairs:
    first, second, start = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)], 0
    for layout in layouts:
        i, j = np.nonzero(~np.eye(len(layout), dtype=bool))
        first.append(start + i)
        second.append(start + j)
        start += len(layout)
    return _Pairs(
        layout=np.repeat(np.arange(len(layouts)), [len(layout) for layout in layouts]),
        centers=np.concatenate([np.zeros((0, 3)), *(layout.centers for layout in layouts)]),
        sizes=np.concatenate([np.zeros((0, 3)), *(layout.sizes for layout in layouts)]),
        yaws=np.concatenate([np.zeros(0), *(layout.yaws for layout in layouts)]),
        first=np.concatenate(first),
        second=np.concatenate(second),
    )


def _depths(pairs: _Pairs, a: Indices, b: Indices) -> Array:
    """Depth of pairs of boxes [m], shape (p,): the least overlap along height and the four sides of their footprints."""
    half = 0.5 * pairs.sizes[:, 2]
    height = half[a] + half[b] - np.abs(pairs.centers[a, 2] - pairs.centers[b, 2])
    return np.minimum(height, _plane_depths(pairs, a, b))


def _plane_depths(pairs: _Pairs, a: Indices, b: Indices) -> Array:
    """Depth of pairs of footprints [m], shape (p,): the least overlap along the sides of both (separating axes)."""
    between = pairs.centers[b, :2] - pairs.centers[a, :2]
    half = 0.5 * pairs.sizes[:, :2]
    least = np.full(len(a), np.inf)
    for box in (a, b):
        for turn in (0.0, 0.5 * math.pi):
            angle = pairs.yaws[box] + turn
            axis = np.column_stack([np.cos(angle), np.sin(angle)])
            reach = sum(
                half[other, 0] * np.abs(np.cos(angle - pairs.yaws[other])) + half[other, 1] * np.abs(np.sin(angle - pairs.yaws[other]))
                for other in (a, b)
            )
            least = np.minimum(least, reach - np.abs((between * axis).sum(axis=1)))
    return least
