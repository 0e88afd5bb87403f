"""Passages in outer walls that no door fills: gaps from the floor up, through which the scan shows floor behind the wall."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud
from tasks.capture.rooms.openings import WallLine, wall_lines

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CELL_M = 0.05
"""Step along a wall [m]: openings are found this exactly, and refined by the wall on both sides."""

MIN_WIDTH_M, MAX_WIDTH_M = 0.55, 3.0
"""Width of passages [m]: people go through, and wider ones join two parts of one room."""

MIN_TOP_M, ABOVE_FLOOR_M = 1.8, 0.15
"""A passage is free between these heights [m]: thresholds and skirting are lower, lintels higher."""

NEAR_M, FACING = 0.12, 0.7
"""Points this near to a wall's line [m], whose normals are turned along it by a cosine, are its surface."""

BAND_M = 0.2
"""Height of the bands in which wall is looked for [m]."""

MIN_WALL_BANDS = 2
"""Bands with wall in a column of cells that make it wall: fewer are stray points, or what stands before the opening."""

BEHIND_M = (0.15, 1.0)
"""Distances behind a wall's line [m] between which the floor of the next room is looked for: thick walls end within."""

FLOOR_M, LEVEL = 0.08, 0.8
"""Floor of the next room lies this near to z = 0 [m], and its normals are this far upright."""

MIN_FLOOR_SHARE = 0.5
"""Least share of a gap's width behind which floor was seen; reflections on a polished floor show less."""

MIN_GLIMPSE_M, MIN_SIDE_BANDS = 0.15, 6
"""Width of floor behind a gap [m] that suffices if the gap is framed: wall in so many bands on both sides and above, floor and nothing
else before it. Cameras that pass at a slant see no more."""

CLEAR_SIDE_BANDS, MIN_CLEAR_SHARE, MAX_CLEAR_WIDTH_M = 8, 0.9, 1.6
"""Without floor behind it, a gap is a passage if it has at least so many bands of wall on both sides, floor before this share of its width
and nothing else, and is no wider than a double door [m]: surface that cameras missed has no straight frame up to a lintel."""

BEFORE_M, MAX_HIDDEN_SHARE = 0.6, 0.2
"""Distance before a gap within which nothing may stand [m], and most of its width that may be hidden even so."""

MAX_STANDING_POINTS = 2
"""Points of a column in the gap that belong to objects: with more, something stands in it and the wall is hidden."""

MIN_SIDE_M = 0.1
"""Wall seen next to a gap [m], or a corner of the room: the scan may end otherwise."""


@dataclasses.dataclass(frozen=True)
class _Frame:
    """Cells along a wall, shape (n,) each: bands of height with wall, and True for cells with wall above passages, with floor behind the
    wall and before it, and with objects before it."""

    bands: NDArray[np.int64]
    has_lintel: Mask
    has_floor: Mask
    has_floor_before: Mask
    is_hidden: Mask

    def is_around(self, start: int, stop: int) -> bool:
        """True if a gap between two cells has an opening's frame, with a glimpse of floor behind it or a frame seen whole."""
        side, gap = round(MIN_SIDE_M / CELL_M), slice(start, stop)
        sides = (self.bands[max(start - side, 0) : start], self.bands[stop : stop + side])
        side_bands = min(int(cells.max(initial=0)) for cells in sides)
        shown, hidden = float(self.has_floor_before[gap].mean()), float(self.is_hidden[gap].mean())
        is_framed = side_bands >= MIN_SIDE_BANDS and self.has_lintel[gap].mean() >= MIN_FLOOR_SHARE
        is_clear = side_bands >= CLEAR_SIDE_BANDS and shown >= MIN_CLEAR_SHARE and hidden == 0.0
        is_clear = is_clear and (stop - start) * CELL_M <= MAX_CLEAR_WIDTH_M
        has_glimpse = self.has_floor[gap].sum() * CELL_M >= MIN_GLIMPSE_M
        is_free = shown >= MIN_FLOOR_SHARE and hidden <= MAX_HIDDEN_SHARE
        return bool(is_framed and (is_clear or (has_glimpse and is_free)))


def passages(cloud: Cloud, is_wall: Mask, polygon: Array, height: float) -> list[Array]:
    """Corners of each free passage in the outer walls [m], shape (4, 3).

    Args:
        cloud: points of the scan, world frame.
        is_wall: which of these points are wall, shape (n,).
        polygon: corners of the floor, counter-clockwise, shape (n, 2) [m].
        height: of the room [m].
    """
    corners = []
    for line in wall_lines(polygon, np.zeros((0, 6))):
        corners += _on_line(line, cloud, is_wall, height)
    return corners


def _on_line(line: WallLine, cloud: Cloud, is_wall: Mask, height: float) -> list[Array]:
    """Passages in one wall."""
    count = int(line.length / CELL_M)
    if count * CELL_M < MIN_WIDTH_M:
        return []
    plan = cloud.points[:, :2] - line.start
    along, inward, z = plan @ line.along, plan @ line.inward, cloud.points[:, 2]
    cell = np.floor(along / line.length * count).astype(np.int64)
    is_here = (cell >= 0) & (cell < count) & (z < height)
    is_face = is_here & is_wall & (np.abs(inward) < NEAR_M) & (np.abs(cloud.normals[:, :2] @ line.inward) > FACING)
    is_free_height = (z > ABOVE_FLOOR_M) & (z < min(MIN_TOP_M, height))
    bands = _bands(cell, z, is_face & is_free_height, count)
    standing = np.bincount(cell[is_here & ~is_wall & (np.abs(inward) < NEAR_M) & is_free_height], minlength=count)
    is_level = np.abs(cloud.normals[:, 2]) > LEVEL
    is_behind = is_here & is_level & (np.abs(z) < FLOOR_M) & (inward < -BEHIND_M[0]) & (inward > -BEHIND_M[1])
    has_floor = np.bincount(cell[is_behind], minlength=count) > 0
    is_before = is_here & (inward > NEAR_M) & (inward < BEFORE_M)
    frame = _Frame(
        bands=bands,
        has_lintel=np.bincount(cell[is_face & (z >= min(MIN_TOP_M, height))], minlength=count) > 0,
        has_floor=has_floor,
        has_floor_before=np.bincount(cell[is_before & is_level & (np.abs(z) < FLOOR_M)], minlength=count) > 0,
        is_hidden=np.bincount(cell[is_before & ~is_wall & is_free_height], minlength=count) > MAX_STANDING_POINTS,
    )
    is_gap = (bands < MIN_WALL_BANDS) & (standing <= MAX_STANDING_POINTS)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_gap.astype(np.int8), [0]]))).reshape(-1, 2)
    step, face_places = line.length / count, along[is_face & is_free_height]
    corners = []
    for start, stop in edges.tolist():
        # A slanted view through the opening shows floor behind a part of its width.
        shows_floor = has_floor[start:stop].mean() >= MIN_FLOOR_SHARE or frame.is_around(start, stop)
        if not shows_floor or not _has_sides(is_gap, start, stop):
            continue
        low, high = _end(face_places, start * step, -1.0), _end(face_places, stop * step, 1.0)
        low, high = max(low, 0.0), min(high, line.length)
        if MIN_WIDTH_M <= high - low <= MAX_WIDTH_M:
            is_above = is_face & (cell >= start) & (cell < stop) & (z >= min(MIN_TOP_M, height))
            top = _lintel(cell[is_above] - start, z[is_above], stop - start, height)
            ends = line.start + np.array([[low], [high]]) * line.along
            corners.append(np.array([[*point, level] for point in ends for level in (0.0, top)]))
    return corners


def _bands(cell: NDArray[np.int64], z: Array, where: Mask, count: int) -> NDArray[np.int64]:
    """Number of bands of height with points, for each cell along a wall, shape (count,)."""
    pairs = np.unique(cell[where] * 64 + np.floor(z[where] / BAND_M).astype(np.int64))
    return np.bincount(pairs // 64, minlength=count)


def _has_sides(is_gap: Mask, start: int, stop: int) -> bool:
    """True if wall goes on next to a gap, on one side at least; on the other one a corner of the room may be."""
    side = round(MIN_SIDE_M / CELL_M)
    before, after = is_gap[max(start - side, 0) : start], is_gap[stop : stop + side]
    return bool((len(before) or len(after)) and not before.any() and not after.any())


def _end(places: Array, edge: float, direction: float) -> float:
    """Where the wall next to a gap ends along its line [m]. edge: of the gap's cells. direction: from the gap to the wall."""
    away = direction * (places - edge)
    near = away[(away > -CELL_M) & (away < MIN_SIDE_M)]
    return edge + direction * float(near.min()) if len(near) else edge


def _lintel(cell: NDArray[np.int64], z: Array, count: int, height: float) -> float:
    """Height at which the wall above a gap begins [m]; the room's height if most of the gap has no wall above."""
    lowest = np.full(count, np.inf)
    np.minimum.at(lowest, cell, z)
    is_seen = np.isfinite(lowest)
    return float(np.median(lowest[is_seen])) if is_seen.mean() >= MIN_FLOOR_SHARE else height
