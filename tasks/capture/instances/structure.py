"""The room itself in a mesh that names nothing: floor, ceiling, walls and slopes, as planes that are too large for furniture."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.boxes import clumps

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

FLOOR_BAND_M = 0.05
"""Height up to which level surface counts as floor: fused floors are some two centimetres thick, rugs one more."""

SLIVER_M = 0.07
"""What rises no higher than this is floor whose surface is too rough, or lies too low or high, to count as level."""

MIN_FLOOR_M2 = 0.1
"""Less level surface at z = 0, or such that looks down, is the bottom of a thing, whose scan shows no floor."""

ROOM_M = 3.0
"""No smaller mesh is a room [m], that may be inside out: bottoms of furniture look down, too."""

SUNKEN_M2 = 1.0
"""As much level surface below the floor, and no less, is a lower floor; the rest of what lies there was seen in a mirror, or is noise."""

LEVEL, STEEP = 0.8, 0.35
"""Vertical part of a unit normal from which surface is level, and up to which it is upright: noise turns normals by 20 degrees."""

CEILING_M, MIN_CEILING_M2 = 1.9, 0.5
"""Surface that looks down from above this, and so much of it, is a ceiling: below tables and shelves there is less."""

WALL_BAND_M = 0.06
"""Half the thickness of a wall's surface, by drift and noise."""

WALL_M2, WALL_SPAN_M, WALL_TOP_M = 1.2, 1.2, 2.2
"""A wall's surface, its height, and how high it reaches: furniture ends below."""

UNDER_CEILING_M = 0.3
"""Where the scan ends lower than a wall, what reaches so near to its top does."""

OUTER_SHARE, OUTER_SPAN_M, BEHIND_M = 0.04, 1.0, 0.15
"""Or, where nobody scanned that high: no more than this share of the surface lies farther behind it, as behind a cupboard's front."""

SLOPE_M2, SLOPE_TOP_M = 1.5, 1.8
"""A slope's surface below a roof, and how high it reaches: less that leans is a lampshade, or a curtain."""

TURN, APART, NARROW = np.deg2rad(20), np.deg2rad(12), np.deg2rad(4)
"""A surface's normals may be so far off its plane's [rad]; directions of walls are so far from one another; and what is so near to one is
what it is measured by."""

MOST_DIRECTIONS = 12
"""Of walls; more are no walls."""

_ROUND = 2 * np.pi

_AREA_DECIMALS = 9
"""Of areas that are held against each other [m2]: bins next to each other hold the same surface, in whatever order it was added."""

CELL_M = 0.12
"""Surface in one plane belongs together across gaps of this width [m]: a door frame's."""


@dataclasses.dataclass(frozen=True)
class RoomPlane:
    """A part of the room. category: `floor`, `ceiling` or `wall`. members: its vertices, sorted, shape (n,)."""

    category: str
    members: Indices


def structure_of(points: Array, normals: Array, areas: Array) -> list[RoomPlane]:
    """Floor, ceiling, walls and slopes among vertices of an aligned mesh (floor at z = 0), none of them twice; what is none is left.

    points: World frame [m], shape (n, 3). normals: Unit, outward from matter, shape (n, 3). areas: Of each vertex [m2], shape (n,).
    """
    free = np.ones(len(points), dtype=bool)
    planes: list[RoomPlane] = []

    def take(category: str, members: Indices) -> None:
        members = members[free[members]]
        if len(members):
            free[members] = False
            planes.append(RoomPlane(category, members))

    z, up = points[:, 2], normals[:, 2]
    floor = _floor(points, normals, areas)
    if len(floor):
        take("floor", floor)
    ceiling = np.flatnonzero(free & (up < -LEVEL + 0.1) & (z > CEILING_M))
    if areas[ceiling].sum() >= MIN_CEILING_M2:
        take("ceiling", ceiling)
    if not len(floor):
        return planes  # a thing of its own, or a part of a room: what is upright may be a side of furniture
    top = float(np.percentile(z, 99))
    walls = _walls(points, normals, areas, free, min(WALL_TOP_M, top - UNDER_CEILING_M))
    has_ceiling = any(plane.category == "ceiling" for plane in planes)
    if walls and not has_ceiling and not _enclose(walls, points, normals, areas):
        return planes  # sides of what stands on the floor: a figure, a booth
    for wall in walls:
        take("wall", wall)
    for slope in _slopes(points, normals, areas, free, min(SLOPE_TOP_M, top - UNDER_CEILING_M)):
        take("wall", slope)
    return planes


def outward(points: Array, normals: Array, areas: Array) -> Array:
    """Normals that look away from matter, shape (n, 3): all of them turned where the floor of a room looks down."""
    extents = np.ptp(points, axis=0)
    near = (np.abs(points[:, 2]) < FLOOR_BAND_M) & (np.abs(normals[:, 2]) > LEVEL)
    is_room = float(extents[:2].max()) > ROOM_M and float(extents[2]) > CEILING_M
    return -normals if is_room and float(areas[near] @ normals[near, 2]) < 0.0 else normals


def _floor(points: Array, normals: Array, areas: Array) -> Indices:
    """Vertices of the floor, of sunken ones, and of what lies flat on them; none where there is no floor."""
    z, level = points[:, 2], np.abs(normals[:, 2]) > LEVEL
    floor = (np.abs(z) < FLOOR_BAND_M) & level
    if areas[floor].sum() < MIN_FLOOR_M2 or areas[floor] @ normals[floor, 2] < 0.0:
        return np.zeros(0, dtype=np.int64)
    floor |= (np.abs(z) < FLOOR_BAND_M / 2) & (np.abs(normals[:, 2]) > STEEP)
    below = np.flatnonzero((z < -FLOOR_BAND_M) & level)
    for members, _ in _patches(points[below], areas[below], SUNKEN_M2):
        floor[below[members]] = True
    return np.flatnonzero(floor)


def _walls(points: Array, normals: Array, areas: Array, free: Mask, reach: float) -> list[Indices]:
    """Vertices of each wall: what lies in an upright plane and reaches high, or has nothing behind it; with all that is flat on it."""
    free = free.copy()
    upright = np.abs(normals[:, 2]) < STEEP
    angle = np.arctan2(normals[:, 1], normals[:, 0]) % _ROUND
    total, walls = float(areas.sum()), []
    for yaw in _directions(angle[free & upright], areas[free & upright]):
        facing = upright & (np.abs((angle - yaw + np.pi) % _ROUND - np.pi) < TURN)  # the two sides of a wall may be nearer than its band
        across, along = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        offset = points[:, :2] @ across
        in_plane = np.column_stack([points[:, :2] @ along, points[:, 2], np.zeros(len(points))])
        for place in _offsets(offset[free & facing], areas[free & facing], WALL_M2):
            members = np.flatnonzero(free & facing & (np.abs(offset - place) < WALL_BAND_M))
            if not len(members):
                continue
            place = float(np.average(offset[members], weights=areas[members] + 1e-12))
            members = np.flatnonzero(free & facing & (np.abs(offset - place) < WALL_BAND_M))
            behind = min(areas[offset > place + BEHIND_M].sum(), areas[offset < place - BEHIND_M].sum()) / total
            for patch, cells in _patches(in_plane[members], areas[members], WALL_M2):
                low, high = np.percentile(points[members[patch], 2], [2, 98])
                is_high = high - low > WALL_SPAN_M and high > reach
                if not is_high and not (high - low > OUTER_SPAN_M and behind < OUTER_SHARE):
                    continue
                # Door and picture frames, skirting: whatever lies flat on the wall is part of it here.
                flat = np.flatnonzero(free & (np.abs(offset - place) < 0.6 * WALL_BAND_M))
                flat = flat[np.isin(_cells(in_plane[flat]), cells)]
                walls.append(np.union1d(members[patch], flat))
                free[walls[-1]] = False
    return walls


def _enclose(walls: Sequence[Indices], points: Array, normals: Array, areas: Array) -> bool:
    """True if walls are around what was scanned: one has hardly anything behind it, or most of their surface looks to the middle."""
    middle = np.average(points[:, :2], axis=0, weights=areas)
    total, inward, outward_m2 = float(areas.sum()), 0.0, 0.0
    for members in walls:
        normal = areas[members] @ normals[members, :2]
        normal /= max(float(np.linalg.norm(normal)), 1e-12)
        place = float(np.average(points[members, :2] @ normal, weights=areas[members] + 1e-12))
        if areas[points[:, :2] @ normal < place - BEHIND_M].sum() < OUTER_SHARE * total:
            return True
        inward += float(areas[members].sum()) * float(middle @ normal > place)
        outward_m2 += float(areas[members].sum()) * float(middle @ normal <= place)
    return inward > outward_m2


def _slopes(points: Array, normals: Array, areas: Array, free: Mask, reach: float) -> list[Indices]:
    """Vertices of each slanted wall below a roof: planes that lean into the room and reach high."""
    free = free.copy()
    leans = (normals[:, 2] < -0.2) & (normals[:, 2] > -0.97)
    azimuth = np.arctan2(normals[:, 1], normals[:, 0]) % _ROUND
    slopes = []
    for yaw in _directions(azimuth[free & leans], areas[free & leans]):
        facing = leans & (np.abs((azimuth - yaw + np.pi) % _ROUND - np.pi) < TURN)
        here = free & facing
        if areas[here].sum() < SLOPE_M2:
            continue
        normal = np.average(normals[here], axis=0, weights=areas[here])
        normal /= np.linalg.norm(normal)
        offset = points @ normal
        for place in _offsets(offset[here], areas[here], SLOPE_M2):
            members = np.flatnonzero(free & facing & (np.abs(offset - place) < 1.5 * WALL_BAND_M))
            for patch, _ in _patches(points[members], areas[members], SLOPE_M2):
                if np.percentile(points[members[patch], 2], 98) > reach:
                    slopes.append(members[patch])
                    free[slopes[-1]] = False
    return slopes


def _patches(points: Array, areas: Array, least: float) -> list[tuple[Indices, Array]]:
    """Points that hang together and stand for `least` area [m2], the largest patch first, each with the cells that it fills."""
    if not len(points):
        return []
    labels, _ = clumps(points, CELL_M)
    surface = np.bincount(labels, weights=areas)
    chosen = [int(k) for k in np.argsort(-surface, kind="stable") if surface[k] >= least]
    return [(members, np.unique(_cells(points[members]))) for members in (np.flatnonzero(labels == k) for k in chosen)]


def _cells(points: Array) -> Indices:
    """Cell of each point, one number for all three places, shape (n,)."""
    cell = np.floor(points / CELL_M).astype(np.int64) + (1 << 20)
    return np.asarray((cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2])


def _directions(angle: Array, areas: Array) -> list[float]:
    """Directions [rad] that surfaces face most, strongest first, apart from one another."""
    bins = 180
    histogram = np.bincount((angle / _ROUND * bins).astype(np.int64) % bins, weights=areas, minlength=bins)
    smooth = histogram + np.roll(histogram, 1) + np.roll(histogram, -1)
    chosen: list[float] = []
    for peak in np.argsort(-np.round(smooth, _AREA_DECIMALS), kind="stable"):
        yaw = (int(peak) + 0.5) / bins * _ROUND
        if smooth[peak] < WALL_M2 or len(chosen) == MOST_DIRECTIONS:
            break
        if all(abs((yaw - other + np.pi) % _ROUND - np.pi) > APART for other in chosen):
            off = (angle - yaw + np.pi) % _ROUND - np.pi
            near = np.abs(off) < NARROW  # a bin's center is a degree off, which is 14 cm along a wall of eight metres
            chosen.append(float(yaw + areas[near] @ off[near] / max(float(areas[near].sum()), 1e-12)))
    return chosen


def _offsets(offset: Array, areas: Array, least: float) -> list[float]:
    """Offsets [m] at which much surface lies, that of most first."""
    if not len(offset):
        return []
    start = float(offset.min()) - 0.1
    bins = np.floor((offset - start) / 0.02).astype(np.int64)
    smooth = np.convolve(np.bincount(bins, weights=areas, minlength=int(bins.max()) + 6), np.ones(5), mode="same")
    chosen: list[float] = []
    for peak in np.argsort(-np.round(smooth, _AREA_DECIMALS), kind="stable"):
        if smooth[peak] < least:
            break
        place = start + (int(peak) + 0.5) * 0.02
        if all(abs(place - other) > 2 * WALL_BAND_M for other in chosen):
            chosen.append(place)
    return chosen
