"""Slanted walls below a roof: from a knee's height at an outer wall up to the ceiling, told by surfaces that lean into the room."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud
from tasks.capture.rooms.openings import WallLine, wall_lines

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_M2, LEAST_LENGTH_M = 0.8, 0.8
"""Less that leans is a lamp's shade, a curtain or the rounded corner of a coarse mesh."""

STEEPNESS = (0.27, 3.8)
"""Height over reach: flatter is a ceiling, steeper a wall (15 to 75 degrees)."""

KNEE_M, TOP_M = 0.2, 0.25
"""A slope begins so high at least, and so far below the ceiling."""

REACH_M = (0.3, 3.5)
"""So far into a room it reaches at least and at most: less is a molding."""

FLAT_M = 0.06
"""Points of a slope lie this near to its plane: noise and drift."""

CELL_M, FILLED_SHARE = 0.2, 0.35
"""Of the cells of a slope, that much is seen at least: furniture stands below it, not before it."""

NEAR_M = 0.3
"""A slope that ends this near to a wall reaches it."""

_LEANING = (-0.97, -0.2)
"""Vertical part of a normal that leans into the room."""


OUTSIDE_M = 0.15
"""As far as a slope may reach beyond the floor [m]: its thickness, and the error of a wall's place."""


@dataclasses.dataclass(frozen=True)
class Slope:
    """A slanted wall over a stretch of an outer wall's inner face, shape (2,) each: its height there, and how far into the room it
    reaches at the ceiling [m]."""

    start: Array
    end: Array
    knee: float
    reach: float

    @property
    def row(self) -> tuple[float, ...]:
        """x0, y0, x1, y1, height at the wall, reach at the ceiling [m]."""
        return (*map(float, (*self.start, *self.end)), self.knee, self.reach)


def slanted_walls(cloud: Cloud, is_structure: Mask, polygon: Array, interior_walls: Array, height: float) -> list[Slope]:
    """Slopes over the walls of a floor polygon, in the order of its edges.

    is_structure: which points of the scan are wall or ceiling, shape (n,). polygon: corners, counter-clockwise, shape (n, 2).
    interior_walls: rows x0, y0, x1, y1, thickness, height, shape (k, 6). height: of the room. [m]
    """
    leans = is_structure & (cloud.normals[:, 2] > _LEANING[0]) & (cloud.normals[:, 2] < _LEANING[1])
    leans &= (cloud.points[:, 2] > KNEE_M) & (cloud.points[:, 2] < height + FLAT_M)
    if cloud.areas[leans].sum() < LEAST_M2:
        return []
    ends = np.concatenate([polygon, interior_walls[:, :2], interior_walls[:, 2:4]])
    lines = wall_lines(polygon, np.zeros((0, 6)))
    slopes = [(line, _slope(line, cloud, leans, height, ends)) for line in lines]
    return [slope for line, slope in slopes if slope is not None and _is_inside(slope, line.inward, polygon)]


def _is_inside(slope: Slope, inward: Array, polygon: Array) -> bool:
    """Whether what lies below a slope is floor: one that reaches through the wall across the room was measured wrong."""
    import shapely

    way = slope.reach * inward
    plan = shapely.Polygon([slope.start, slope.end, slope.end + way, slope.start + way])
    return bool(shapely.Polygon(polygon).buffer(OUTSIDE_M).covers(plan))


def _slope(line: WallLine, cloud: Cloud, leans: Mask, height: float, ends: Array) -> Slope | None:
    """The slope over a wall; None without one. ends: of all walls, shape (k, 2) [m]: it begins and ends there."""
    normals = cloud.normals[leans]
    inward = normals[:, :2] @ line.inward
    plan = cloud.points[leans, :2] - line.start
    s, off, z = plan @ line.along, plan @ line.inward, cloud.points[leans, 2]
    own = (inward > 0.2) & (np.abs(normals[:, :2] @ line.along) < 0.3) & (off > 0.05) & (off < REACH_M[1]) & (s > 0.0) & (s < line.length)
    s, off, z, steep, area = s[own], off[own], z[own], inward[own] / -normals[own, 2], cloud.areas[leans][own]
    plane = _plane(off, z, np.arctan(steep), area)
    if plane is None:
        return None
    slant, knee = plane
    near = np.abs(z - knee - slant * off) / np.hypot(1.0, slant) < FLAT_M
    reach = (height - knee) / slant
    if area[near].sum() < LEAST_M2 or not KNEE_M <= knee <= height - TOP_M or not REACH_M[0] <= reach <= REACH_M[1]:
        return None
    first, last = np.percentile(s[near], [1, 99])
    low, high = _reaching(float(first), float(last), line, ends)
    if high - low < LEAST_LENGTH_M or _filled(s[near], off[near], (low, high), reach) < FILLED_SHARE:
        return None
    return Slope(line.start + low * line.along, line.start + high * line.along, float(knee), float(reach))


def _plane(off: Array, z: Array, angles: Array, area: Array) -> tuple[float, float] | None:
    """Steepness of the plane that most of some points lie in, and its height at the wall [m]; None where too few do.

    off, z: places before the wall and heights [m]; angles: of the normals from straight down [rad]; area [m2]; all of shape (m,).
    """
    if area.sum() < LEAST_M2:
        return None
    width = np.deg2rad(5.0)
    bins = (angles / width).astype(np.int64)
    counts = np.convolve(np.bincount(bins, weights=area, minlength=int(np.pi / 2 / width) + 2), np.ones(3), mode="same")
    angle = (int(np.argmax(counts)) + 0.5) * width
    near = np.abs(angles - angle) < 2.0 * width
    if area[near].sum() < LEAST_M2:
        return None
    slant = float(np.tan(np.average(angles[near], weights=area[near])))
    heights = z[near] - slant * off[near]
    place = np.floor((heights - heights.min()) / 0.1).astype(np.int64)
    weights = np.convolve(np.bincount(place, weights=area[near], minlength=3), np.ones(3), mode="same")
    knee = float(heights.min() + (int(np.argmax(weights)) + 0.5) * 0.1)
    for most in (0.2, 0.1, FLAT_M):
        close = np.abs(z - knee - slant * off) / np.hypot(1.0, slant) < most
        if close.sum() < 10 or np.ptp(off[close]) < 0.1:
            return None
        slant, knee = (float(v) for v in np.polyfit(off[close], z[close], 1, w=np.sqrt(area[close])))
        if not STEEPNESS[0] < slant < STEEPNESS[1]:
            return None
    return slant, knee


def _reaching(low: float, high: float, line: WallLine, ends: Array) -> tuple[float, float]:
    """A stretch of a wall, drawn out to walls that begin or end at it no farther than `NEAR_M` from its ends [m]."""
    at = (ends - line.start) @ line.along
    stops = np.array([0.0, line.length, *at[np.abs((ends - line.start) @ line.inward) < NEAR_M]])
    first, last = stops[np.abs(stops - low) < NEAR_M], stops[np.abs(stops - high) < NEAR_M]
    low = float(first.min()) if len(first) else low
    high = float(last.max()) if len(last) else high
    return max(low, 0.0), min(high, line.length)


def _filled(s: Array, off: Array, span: tuple[float, float], reach: float) -> float:
    """Share of a slope's cells, seen from above, with points in them (along, before the wall) [m]."""
    columns, rows = max(round((span[1] - span[0]) / CELL_M), 1), max(round(reach / CELL_M), 1)
    i = np.floor((s - span[0]) / (span[1] - span[0]) * columns).astype(np.int64)
    j = np.floor(off / reach * rows).astype(np.int64)
    ok = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
    return len(np.unique(i[ok] * rows + j[ok])) / (columns * rows)
