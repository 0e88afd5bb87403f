"""Height of the floor: the lowest level of a surface that is large enough, or the one that frames show."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BAND_M = 0.04
"""Depth noise of a floor that was fused in a room: vertices this near to the plane count as floor. Of nearer things less is enough."""

MIN_FLOOR_M2 = 0.25
"""Less than the free floor between a desk and a wall cannot be told from a low shelf."""

_BELOW_SHARE = 0.03
"""Share of the surface that may lie below the floor: reflections and stray depth, not a lower storey."""

_STOREY_M = 0.16
"""Levels farther apart are a table and the floor, not a table and a thing on it; the reach of `floor_height` among levels."""

_MIN_STEP_M = 0.04
"""Levels nearer to each other than this are one: depth noise and drift of poses spread a floor as far."""

_MIN_LOWER_SHARE, _MIN_LEVEL_SHARE = 0.5, 0.08
"""Least area of a floor a step below the level that frames show, as a share of that level: drift doubles a smaller part. And
least area of that level, as a share of the floor above it: a reflection or a stairwell has less."""


@dataclasses.dataclass(frozen=True)
class Facets:
    """Faces as planes, in the frame of their surface: centers [m] (m, 3), unit normals (m, 3), areas [m2] (m,), corners [m] (m, 3, 3)."""

    centers: Array
    normals: Array
    areas: Array
    corners: Array

    def turned(self, rotation: Array) -> Facets:
        """The faces turned by a 3x3 rotation."""
        return Facets(self.centers @ rotation.T, self.normals @ rotation.T, self.areas, self.corners @ rotation.T)

    def chosen(self, where: NDArray[np.bool_]) -> Facets:
        """The faces where `where`, shape (m,), is set."""
        return Facets(self.centers[where], self.normals[where], self.areas[where], self.corners[where])


@dataclasses.dataclass(frozen=True)
class SeenLevel:
    """The horizontal and the lowest level that the frames of a fused scan show.

    up: in the scan frame, unit, shape (3,). points: on the lowest level, scan frame [m], shape (n, 3); empty if the frames
    show none. band_m: depth noise of the fused surface [m].
    """

    up: Array
    points: Array
    band_m: float = BAND_M

    def height_along(self, up: Array) -> float | None:
        """Height of the level along a direction, unit, shape (3,), in the scan frame [m]; None if the frames show none."""
        return float(np.median(self.points @ up)) if len(self.points) else None

    @property
    def facets(self) -> Facets:
        """The points as faces without extent, in the scan frame."""
        count = len(self.points)
        return Facets(self.points, np.tile(self.up, (count, 1)), np.ones(count), np.repeat(self.points[:, None], 3, axis=1))


def facets(corners: Array, weight: float = 1.0) -> Facets:
    """Faces by their three corners [m], shape (m, 3, 3), as planes, each standing for `weight` faces; those without area are left out."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    solid = length > 1e-12
    corners, cross, length = corners[solid], cross[solid], length[solid]
    return Facets(corners.mean(axis=1), cross / length[:, None], 0.5 * weight * length, corners)


def level_height(turned: Facets, floor: Facets | None, level: SeenLevel | None, up: Array) -> float | None:
    """Height of the floor along `up` [m]: the frames' own level, unless the surface has another floor or the scan names floors.

    Frames tell a table from the tops of boxes on it, which have more area in the fused surface than the visible table.

    Args:
        turned, floor: faces of the scan, and those that it names floor, in a frame whose z axis is `up`.
        level: the level that frames show, None for a scan with a mesh of its own.
        up: in the scan frame, unit, shape (3,).
    """
    seen = None if level is None or floor is not None else level.height_along(up)
    if level is None or seen is None:
        return floor_height(turned, floor, BAND_M if level is None else level.band_m)
    other = other_floor(turned, seen, level.band_m)
    return seen if other is None else other


def other_floor(turned: Facets, level: float, band: float) -> float | None:
    """Height of the floor of a fused surface [m] if the level that frames show is not that floor; None if it is.

    Args:
        turned: faces of the surface in a frame whose z axis is up.
        level: height of the level that frames show in that frame [m].
        band: depth noise of the surface [m].
    """
    is_level = np.abs(turned.normals[:, 2]) > np.cos(np.deg2rad(20))
    heights, areas = turned.centers[is_level, 2], turned.areas[is_level]
    below = level - _MIN_STEP_M

    def area_around(height: float) -> float:
        same_side = (heights < below) == (height < below)
        return float(areas[same_side & (np.abs(heights - height) < _MIN_STEP_M)].sum())

    lower = floor_height(turned, None, band, below)
    if lower is not None and (lower < level - _STOREY_M or area_around(lower) >= _MIN_LOWER_SHARE * area_around(level)):
        return lower
    own = floor_height(turned, None, band)
    is_stray = own is not None and own > level + _STOREY_M and area_around(level) < _MIN_LEVEL_SHARE * area_around(own)
    return own if is_stray else None


def floor_height(faces: Facets, floor: Facets | None, band: float = BAND_M, below: float = np.inf) -> float | None:
    """Height of the floor [m] in a frame whose z axis is up; None when nothing level and low enough is seen.

    The lowest level of at least `MIN_FLOOR_M2` that is not dwarfed by a level above it and has hardly anything below.

    Args:
        faces, floor: faces of the scan, and those that it names floor, in that frame.
        band: depth noise of the surface [m].
        below: height [m] above which levels count only as larger ones.
    """
    source = floor if floor is not None else faces
    level = np.abs(source.normals[:, 2]) > np.cos(np.deg2rad(20))
    heights, areas = source.centers[level, 2], source.areas[level]
    if not len(heights) or areas.sum() < MIN_FLOOR_M2:
        return _weighted_median(source.centers[:, 2], source.areas) if floor is not None else None
    if floor is not None:
        # Of a slab, the upper side; of a scan whose faces are turned the wrong way round, whatever there is.
        upward = source.normals[level, 2] > 0
        return _weighted_median(heights[upward], areas[upward]) if upward.mean() > 0.1 else _weighted_median(heights, areas)
    order = np.argsort(faces.centers[:, 2])
    share = np.cumsum(faces.areas[order]) / faces.areas.sum()
    ceiling_of_noise = float(faces.centers[order, 2][np.searchsorted(share, _BELOW_SHARE)])
    start = heights.min()
    bins = np.floor((heights - start) / 0.02).astype(np.int64)
    if bins.max() > 100_000:
        return None
    largest = np.convolve(np.bincount(bins, weights=areas, minlength=5), np.ones(5), mode="same").max()
    is_low = heights <= below
    heights, areas = heights[is_low], areas[is_low]
    by_bin = np.bincount(bins[is_low], weights=areas, minlength=5)
    filled = np.convolve(by_bin, np.ones(5), mode="same")
    centers = start + (np.arange(len(filled)) + 0.5) * 0.02
    reach = centers <= ceiling_of_noise + 0.35
    enough = (filled >= max(MIN_FLOOR_M2, 0.08 * largest)) & reach
    if not enough.any():
        return None
    first = int(np.argmax(enough))
    stop = min(first + round(_STOREY_M / 0.02), len(filled))
    peak = first + int(np.argmax(filled[first:stop]))
    # All bins around a thin floor are as full; a platform a little above it must not draw its height up.
    window = slice(max(peak - 2, 0), peak + 3)
    three = np.convolve(by_bin, np.ones(3), mode="same")
    crests = (three >= np.append(three[1:], 0.0)) & (three >= np.append(0.0, three[:-1])) & (three >= 0.5 * three[window].max())
    peak = window.start + int(np.argmax(crests[window])) if crests[window].any() else peak
    near = np.abs(heights - centers[peak]) < band
    return _weighted_median(heights[near], areas[near])


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][min(int(np.searchsorted(total, 0.5 * total[-1])), len(values) - 1)])
