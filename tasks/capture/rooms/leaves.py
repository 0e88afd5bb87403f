"""Doors and windows of which a scan saw a part: as large as the hole in the wall that they fill.

Where wall is seen, no leaf or pane is. What was seen of one grows along its wall, up and down, until it meets wall, and as far as doors
and windows usually reach where nothing of the wall was seen.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.rooms.openings import WallLine, interval_on, wall_lines

Array = NDArray[np.float64]

NEAR_M = 0.15
"""Points of walls this near to a wall's faces are its own [m]."""

STEP_M = 0.05
"""By so much a rectangle grows at once [m]."""

RIM_M = 0.12
"""Width of the rim around a rectangle that is looked at for wall [m]: the spacing of a coarse mesh's vertices."""

CELL_M = 0.1
"""Cells of a rim [m]."""

WALL_SHARE = 0.34
"""Of a rim's cells with wall in them, from which on the rectangle ends there."""

DOOR_M, WINDOW_M = (0.88, 2.03), (1.2, 1.1)
"""Usual widths and heights [m]: as far nothing that was not seen ends them. Of windows as of one with two casements."""

WIDEST_DOOR_M, WIDEST_WINDOW_M = 1.0, 1.4
"""Wider than this neither gets [m], unless more of it was seen: what lies beyond is wall that was not seen."""

FARTHEST_M = 1.6
"""Wall is looked for so far beside what was seen [m]."""

NEAR_FLOOR_M = 0.3
"""Doors begin at the floor, whatever skirting or threshold was called wall below this [m]."""

DOOR_TOP_M, WINDOW_TOP_M = 2.2, 2.35
"""They end no higher [m]."""

USUAL_WINDOW_TOP_M = 2.1
"""Where windows end whose lintel was not seen [m]."""

SILL_M = 1.15
"""Windows begin no higher [m]; doors begin at the floor."""

LOW_SILL_M = 0.1
"""Windows that go down end so high above the floor [m]."""

LEAF_TOP_M, LEAF_M, LEAF_DEPTH_M = 1.7, 0.3, 0.15
"""The leaf of a door that is in no wall's line ends higher, is wider and taller than this where it was seen, and no thicker [m]."""

LEAST_LEAF_M, HINGE_M = 0.65, 0.25
"""Whatever height of it was seen, what is as wide, reaches down to the floor and hangs so near to the end of a wall is its door [m]."""

BAR = (0.02, 0.4)
"""Least width [m] and flatness of a bar between panes, all that was seen of a window."""

LEAST_POINTS = 10
"""Fewer have no direction."""

LEAST_GAIN_M = 0.08
"""What grows by less was seen whole [m]."""


def whole_leaves(
    polygon: Array, interior_walls: Array, height: float, leaves: Sequence[Array], is_door: Sequence[bool], wall_points: Array,
    of_house: Sequence[bool] | None = None,
) -> list[Array | None]:  # fmt: skip
    """Corners of the box of every door and window with what was not seen of it [m], shape (8, 3); None where it was seen whole, or
    fills no wall.

    polygon: floor's corners, counter-clockwise, shape (n, 2). interior_walls: rows x0, y0, x1, y1, thickness, height, shape (k, 6).
    height: of the room. leaves: points of each, shape (m, 3). wall_points: points that were seen of walls, shape (w, 3). [m]
    of_house: which doors may stand open, or between two walls, where they are in none; all, if None.
    """
    lines = wall_lines(polygon, interior_walls)
    made = []
    for index, (points, door) in enumerate(zip(leaves, is_door, strict=True)):
        # where another leaf or pane was seen, none of this one is
        taken = np.concatenate([wall_points, *(other for k, other in enumerate(leaves) if k != index)])
        is_alone = door and (of_house is None or of_house[index])
        made.append(_whole(points, door, is_alone, lines, height, taken))
    return made


def _whole(points: Array, is_door: bool, is_alone: bool, lines: Sequence[WallLine], height: float, wall_points: Array) -> Array | None:
    fits = [(fit, i) for i, line in enumerate(lines) if (fit := interval_on(line, points, height)) is not None]
    if not fits and is_alone:
        lines = _own_line(points, np.array([line.start + s * line.along for line in lines if line.reach for s in (0.0, line.length)]))
        fits = [(fit, i) for i, line in enumerate(lines) if (fit := interval_on(line, points, height)) is not None]
    elif not fits and not is_door:
        fits = [(fit, i) for i, line in enumerate(lines) if (fit := interval_on(line, points, height, *BAR)) is not None]
    if not fits:
        return None
    fit, which = min(fits)
    line, seen = lines[which], np.array([fit.low, fit.high, fit.bottom, fit.top])
    wall = np.column_stack([(wall_points[:, :2] - line.start) @ line.along, wall_points[:, 2]])
    wall = wall[np.abs((wall_points[:, :2] - line.start) @ line.inward) < line.reach + NEAR_M]
    grown = _grown(seen, is_door, line.length, height, wall)
    if np.abs(grown - seen).max() < LEAST_GAIN_M:
        return None
    (front, back), (low, high, bottom, top) = (fit.front, fit.back), grown
    return np.array(
        [[*(line.start + s * line.along - d * line.inward), z] for s in (low, high) for d in (front, back) for z in (bottom, top)]
    )


def _own_line(points: Array, wall_ends: Array) -> list[WallLine]:
    """The line that a leaf stands on which is in no wall: in a doorway between two, or open; none for what is no leaf of a door.
    wall_ends: of walls inside the room, shape (k, 2) [m]."""
    if len(points) < LEAST_POINTS:
        return []
    low, high = np.percentile(points, [1, 99], axis=0)
    middle = np.median(points[:, :2], axis=0)
    values, vectors = np.linalg.eigh(np.cov((points[:, :2] - middle).T))
    along = vectors[:, int(np.argmax(values))]
    inward = np.array([-along[1], along[0]])
    deep, wide = (float(np.ptp(np.percentile((points[:, :2] - middle) @ way, [1, 99]))) for way in (inward, along))
    if high[2] - low[2] < LEAF_M or wide < LEAF_M or deep > LEAF_DEPTH_M:
        return []
    sides = middle + np.percentile((points[:, :2] - middle) @ along, [1, 99])[:, None] * along
    hangs = bool(len(wall_ends)) and float(np.linalg.norm(sides[:, None] - wall_ends, axis=2).min()) < HINGE_M
    if high[2] < LEAF_TOP_M and not (hangs and wide > LEAST_LEAF_M and low[2] < NEAR_FLOOR_M):
        return []
    # long enough for what was not seen of it
    return [WallLine(middle - 2.0 * along, along, inward, 4.0, 0.0)]


def _grown(seen: Array, is_door: bool, length: float, height: float, wall: Array) -> Array:
    """A rectangle low, high along a wall, bottom, top [m], grown until it meets points of the wall (along, height), shape (w, 2) [m]."""
    most = np.array([max(seen[0] - FARTHEST_M, 0.0), min(seen[1] + FARTHEST_M, length), 0.0, DOOR_TOP_M if is_door else WINDOW_TOP_M])
    most[3] = min(most[3], height - 0.05)
    hole, left, ends = seen.copy(), [0, 1, 2, 3], [False] * 4
    while left:
        for side in tuple(left):
            step = STEP_M if side % 2 else -STEP_M
            ends[side] = _is_wall(_rim(_beside(hole, seen, side), side), wall) or _is_wall(_rim(_within(hole, side), side), wall)
            if ends[side] or (most[side] - hole[side]) * step <= 0.0:
                left.remove(side)
            else:
                hole[side] += step
    for side in (side for side in range(4) if ends[side]):
        hole[side] = _met(hole, side, wall)
    return _bounded(seen, hole, ends, is_door, wall, float(most[3]))


def _beside(hole: Array, seen: Array, side: int) -> Array:
    """The part of a hole beside what was seen of its filling, from which a side of it is looked at: there nothing but wall ends it."""
    part = hole.copy()
    across = [2, 3] if side < 2 else [0, 1]
    part[across] = seen[across]
    return _within(part, side)


def _within(hole: Array, side: int) -> Array:
    """A hole without its rows next to the sill and the lintel, from which its sides are looked at, or without its columns next to those:
    wall that runs on below a window is none beside it."""
    part = hole.copy()
    across = [2, 3] if side < 2 else [0, 1]
    low, high = hole[across]
    margin = min(CELL_M, 0.25 * float(high - low))
    part[across] = low + margin, high - margin
    return part


def _bounded(seen: Array, hole: Array, ends: Sequence[bool], is_door: bool, wall: Array, highest: float) -> Array:
    """The hole in the wall where it ends at wall that was seen (ends: low, high, bottom, top); where none was, no more of it than is
    usual around what was seen, and none above `highest` [m]."""
    usual, widest = (DOOR_M, WIDEST_DOOR_M) if is_door else (WINDOW_M, WIDEST_WINDOW_M)
    low, high, bottom, top = hole.tolist()
    width = max(widest if all(ends[:2]) else usual[0], float(seen[1] - seen[0]))
    if high - low > width:
        # wall that was seen farther from it than a door or window is wide says nothing of where it ends
        at_low = ends[0] and not ends[1] and seen[1] - low <= width
        at_high = ends[1] and not ends[0] and high - seen[0] <= width
        middle = float(np.clip(0.5 * (seen[0] + seen[1]), low + 0.5 * width, high - 0.5 * width))
        low, high = (low, low + width) if at_low else (high - width, high) if at_high else (middle - 0.5 * width, middle + 0.5 * width)
    if not ends[3]:
        top = min(usual[1] if is_door else min(top, USUAL_WINDOW_TOP_M), highest)
    if is_door and (not ends[2] or bottom < NEAR_FLOOR_M):
        bottom = 0.0
    elif not ends[2]:
        sill = max(bottom, min(SILL_M, top - usual[1]))
        bottom = LOW_SILL_M if bottom < LOW_SILL_M and _goes_down(hole, ends, sill, wall) else sill
    return np.array([min(low, seen[0]), max(high, seen[1]), min(bottom, seen[2]), max(top, seen[3])])


def _goes_down(hole: Array, ends: Sequence[bool], sill: float, wall: Array) -> bool:
    """Whether the wall beside a hole in it is seen below the usual height of a sill [m], so that the hole is one down there, too."""
    below = np.array([hole[0], hole[1], LOW_SILL_M, sill])
    return any(ends[side] and _is_wall(_rim(below, side), wall) for side in (0, 1))


def _met(hole: Array, side: int, wall: Array) -> float:
    """Where the wall begins, beyond a side of a hole that has grown up to it [m]."""
    low, high, bottom, top = _rim(hole, side)
    inside = wall[(wall[:, 0] >= low) & (wall[:, 0] <= high) & (wall[:, 1] >= bottom) & (wall[:, 1] <= top)]
    return float(np.percentile(inside[:, side // 2], 10 if side % 2 else 90))


def _rim(rectangle: Array, side: int) -> Array:
    """The strip along a side of a rectangle (low, high, bottom, top), outside of it [m]."""
    low, high, bottom, top = rectangle
    return np.array([
        [low - RIM_M, low, bottom, top], [high, high + RIM_M, bottom, top],
        [low, high, bottom - RIM_M, bottom], [low, high, top, top + RIM_M],
    ][side])  # fmt: skip


def _is_wall(rim: Array, wall: Array) -> bool:
    """Whether wall, points (along, height) of shape (w, 2) [m], is in enough cells of a strip."""
    low, high, bottom, top = rim
    inside = wall[(wall[:, 0] >= low) & (wall[:, 0] <= high) & (wall[:, 1] >= bottom) & (wall[:, 1] <= top)]
    is_upright = high - low < top - bottom
    along = inside[:, 1] - bottom if is_upright else inside[:, 0] - low
    cells = max(int(np.ceil(max(high - low, top - bottom) / CELL_M)), 1)
    return len(np.unique(np.minimum(along / CELL_M, cells - 1).astype(np.int64))) >= WALL_SHARE * cells
