"""Openings of walls: where doors and windows are let in, from the points that were scanned of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BEFORE_M = 0.1
"""A closed door begins at its wall's face or behind it; noise and its frame are this much before it."""

_BEHIND_M = 0.35
"""The reveal of a window in an outer wall is hardly deeper."""

_LEAST_M = 0.25
"""Hatches and panes are larger; what is smaller was seen in part only."""

_FLATNESS = 1.5
"""What fills an opening is this much wider than it is deep; a leaf that stands open is no opening."""

_IN_WALL_SHARE = 0.7
"""Of its width that must lie along the wall."""

_TO_FLOOR_M = 0.12
"""Doors end this high at most: sills of windows are higher."""

_FREE_M = 0.01
"""An opening is this much larger on every side than what was seen of its filling."""

_LINTEL_M = 0.03
"""Wall over an opening that is lower than this is none."""


@dataclasses.dataclass(frozen=True)
class WallLine:
    """A wall's line [m] that openings are stated on. reach: from the line to the wall's faces; 0 for the inner face itself."""

    start: Array
    along: Array
    inward: Array
    length: float
    reach: float


@dataclasses.dataclass(frozen=True, order=True)
class Interval:
    """Where what fills an opening lies on a wall's line: how far off, from where to where along it, from front to back behind its face,
    and between which heights [m]."""

    off: float
    low: float
    high: float
    front: float
    back: float
    bottom: float
    top: float


def wall_lines(polygon: Array, interior_walls: Array) -> list[WallLine]:
    """Lines of the outer walls, then of those inside the room. polygon, interior_walls: as for `wall_openings`."""
    ends = [(a, b, 0.0) for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True)]
    ends += [(wall[:2], wall[2:4], 0.5 * float(wall[4])) for wall in interior_walls]
    return [_line(a, b, reach) for a, b, reach in ends if np.hypot(*(b - a)) > _LEAST_M]


def wall_openings(
    polygon: Array, interior_walls: Array, height: float, fillings: Sequence[Array], passages: Sequence[Array] = ()
) -> tuple[tuple[float, ...], ...]:
    """Openings as rows x0, y0, x1, y1, bottom, top, depth [m] in the world frame, in the order of walls.

    polygon: Floor's corners, counter-clockwise, shape (n, 2). interior_walls: Rows x0, y0, x1, y1, thickness, height, shape (k, 6).
    fillings: Points of every door and window, shape (m, 3) each. passages: Corners of openings that nothing fills, shape (m, 3) each.
    Depth is how far a filling reaches behind the inner face of an outer wall, and 0 where the opening goes through: for passages and
    interior walls. Openings that overlap are one, with the filling that one of them has.
    """
    lines = wall_lines(polygon, interior_walls)
    rectangles: list[list[list[float]]] = [[] for _ in lines]
    for points, is_filled in [*((points, True) for points in fillings), *((points, False) for points in passages)]:
        fits = [(fit, i) for i, line in enumerate(lines) if (fit := _fit(line, points, height)) is not None]
        if fits:
            (_, rectangle), which = min(fits)
            rectangles[which].append(rectangle if is_filled else [*rectangle[:4], 0.0])
    rows = []
    for line, own in zip(lines, rectangles, strict=True):
        for low, high, bottom, top, depth in _merged(own):
            start, end = line.start + low * line.along, line.start + high * line.along
            rows.append((*map(float, start), *map(float, end), bottom, top, depth))
    return tuple(rows)


def open_sides(polygon: Array, height: float) -> tuple[tuple[float, ...], ...]:
    """Openings, as `wall_openings` has them, that leave nothing of the outer walls: of a floor that no walls are around."""
    ends = zip(polygon.tolist(), np.roll(polygon, -1, axis=0).tolist(), strict=True)
    return tuple((*start, *end, 0.0, height, 0.0) for start, end in ends)


def _line(a: Array, b: Array, reach: float) -> WallLine:
    length = float(np.hypot(*(b - a)))
    along = (b - a) / length
    return WallLine(np.asarray(a), along, np.array([-along[1], along[0]]), length, reach)


def interval_on(line: WallLine, points: Array, height: float, least: float = 0.05, flatness: float = _FLATNESS) -> Interval | None:
    """Where points, shape (m, 3) [m], that fill an opening lie on a wall's line; None where they are of something else, of less than
    `least` [m], or less than `flatness` times as wide as deep. height: of the room."""
    plan = points[:, :2] - line.start
    (low, front, bottom), (high, back, top) = np.percentile(
        np.column_stack([plan @ line.along, -(plan @ line.inward), points[:, 2]]), [1, 99], axis=0
    )
    width = high - low
    if width < least or top - bottom < least or width < flatness * (back - front):
        return None
    if line.reach and (front < -line.reach - _BEFORE_M or back > line.reach + _BEFORE_M):
        return None
    if not line.reach and (front > _BEHIND_M or back < -_BEFORE_M or back > _BEHIND_M + _BEFORE_M or back - front > _BEHIND_M):
        return None
    if min(high, line.length) - max(low, 0.0) < _IN_WALL_SHARE * width:
        return None
    if bottom > height:  # of the room that it was found to have
        return None
    return Interval(abs(0.5 * float(front + back)), *map(float, (low, high, front, back, bottom, top)))


def _fit(line: WallLine, points: Array, height: float) -> tuple[float, list[float]] | None:
    """How far points lie from a wall's line, and of the opening that they fill the interval along the line, bottom, top and depth [m];
    None where they fill none."""
    seen = interval_on(line, points, height, _LEAST_M)
    if seen is None:
        return None
    low, high, bottom, top = max(seen.low - _FREE_M, 0.0), min(seen.high + _FREE_M, line.length), seen.bottom, seen.top
    bottom = 0.0 if bottom < _TO_FLOOR_M else bottom - _FREE_M
    top = height if top + _FREE_M > height - _LINTEL_M else top + _FREE_M
    if top - bottom < _LEAST_M:  # over the height that the room was found to have
        return None
    depth = 0.0 if line.reach else max(seen.back, 0.0) + _FREE_M
    return seen.off, [float(value) for value in (low, high, bottom, top, depth)]


def _merged(rectangles: list[list[float]]) -> list[list[float]]:
    """Rectangles along a wall, those that overlap as the one around them, from its start on."""
    left = sorted(rectangles)
    merged: list[list[float]] = []
    while left:
        first = left.pop(0)
        over = [r for r in left if r[0] <= first[1] and first[0] <= r[1] and r[2] <= first[3] and first[2] <= r[3]]
        if not over:
            merged.append(first)
            continue
        together = np.array([first, *over])
        around = [*together[:, [0, 2]].min(axis=0), *together[:, [1, 3, 4]].max(axis=0)]
        left = sorted([*(r for r in left if r not in over), [float(around[i]) for i in (0, 2, 1, 3, 4)]])
    return sorted(merged)
