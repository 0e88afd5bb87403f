"""Directions of walls other than a room's own two, and the slanted walls along them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]

MAX_PASSAGE_M = 2.6
"""Widest opening through which floor of a neighboring room is seen; wider ones join two parts of a room."""

_OBLIQUE_M2 = 1.0
"""A direction other than the room's own needs this much wall: it could be noise otherwise."""

_MIN_SLANT, _UPRIGHT = np.sin(np.deg2rad(12)), 0.4
"""Least sine of the angle between a slanted wall and the axes: noise turns normals by ten degrees. Most vertical part of its normal."""

_BIN_DEGREES, _PLANE_M = 5, 0.06
"""Width of a direction, and half the thickness of a wall's surface by noise and drift."""

_MIN_SLANTED_M2, _MIN_SLANTED_M, _MIN_TALL_M = 0.4, 0.25, 1.0
"""Least surface, length and height of a slanted wall: less is a side of furniture, or a rounded corner."""

_SPARSE_M2, _SPARSE_SLANT = 0.2, np.sin(np.deg2rad(25))
"""A wall of which less than `_MIN_SLANTED_M2` was seen has at least this surface and this sine of its angle to the axes: noise at the
ends of straight walls leans less."""

_GAP_M = 0.3
"""Gap in a slanted wall that furniture leaves [m]."""

_END_M = 0.12
"""Walls nearer to the end of a slanted one meet it [m]: its last points are lost in the corner."""

_BACK_M = 0.4
"""The other face of a partition lies within this distance [m]."""


@dataclasses.dataclass(frozen=True)
class SlantedWall:
    """A wall that runs along no axis: ends seen from above [m], and the unit normal that looks into the room, shapes (2,).

    seen_m: length of the wall without its openings [m]. has_back: its other face was seen, too. is_sparse: less than `_MIN_SLANTED_M2`
    of its surface was seen.
    """

    start: Array
    end: Array
    normal: Array
    seen_m: float
    has_back: bool = False
    is_sparse: bool = False

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(np.linalg.norm(self.end - self.start))


def oblique_direction(cloud: Cloud, free: Mask, tried: list[float]) -> float | None:
    """The angle of normals [rad], off the axes and off those tried, that most of the points in `free`, shape (n,), have; None if few do."""
    if cloud.areas[free].sum() < _OBLIQUE_M2:
        return None
    normals, areas = cloud.normals[free, :2], cloud.areas[free]
    angles = np.arctan2(normals[:, 1], normals[:, 0]) % np.pi
    weights = np.bincount((angles / np.deg2rad(5)).astype(np.int64) % 36, weights=areas, minlength=36)
    near = weights + np.roll(weights, 1) + np.roll(weights, -1)
    for known in (0.0, np.pi / 2, *tried):  # nothing is left there but noise
        near[(np.arange(-1, 2) + round(known / np.deg2rad(5) - 0.5)) % 36] = 0
        near[round(known / np.deg2rad(5)) % 36] = 0
    if near.max() < _OBLIQUE_M2:
        return None
    middle = np.deg2rad(5 * (int(np.argmax(near)) + 0.5))
    close = np.abs((angles - middle + np.pi / 2) % np.pi - np.pi / 2) < np.deg2rad(10)
    return _sharpest(cloud.points[free][close, :2], areas[close], middle)


def _sharpest(points: Array, areas: Array, middle: float) -> float:
    """The angle within 8 degrees of `middle` [rad] along which points lie in the thinnest planes."""
    angles = middle + np.deg2rad(np.arange(-8, 8.1, 0.25))
    center = points.mean(axis=0)

    def sharpness(angle: float) -> float:
        offset = (points - center) @ [np.cos(angle), np.sin(angle)]
        histogram = np.bincount(((offset - offset.min()) / 0.02).astype(np.int64), weights=areas)
        return float((histogram**2).sum())

    return float(angles[int(np.argmax([sharpness(float(angle)) for angle in angles]))])


def slanted_walls_of(cloud: Cloud, is_wall: Mask) -> list[SlantedWall]:
    """Walls that run along no axis, the largest first. is_wall: which points of the cloud are wall, shape (n,)."""
    plan = cloud.normals[:, :2]
    is_slanted = is_wall & (np.abs(cloud.normals[:, 2]) < _UPRIGHT) & (np.abs(plan).min(axis=1) > _MIN_SLANT)
    points, areas = cloud.points[is_slanted], cloud.areas[is_slanted]
    angles = np.arctan2(plan[is_slanted, 1], plan[is_slanted, 0]) % (2 * np.pi)
    is_free = np.ones(len(points), dtype=bool)
    walls: list[tuple[float, SlantedWall]] = []
    count = 360 // _BIN_DEGREES
    while True:
        bins = (angles[is_free] / (2 * np.pi) * count).astype(np.int64) % count
        weights = np.bincount(bins, weights=areas[is_free], minlength=count)
        near = weights + np.roll(weights, 1) + np.roll(weights, -1)
        if near.max() < _SPARSE_M2:
            break
        middle = (int(np.argmax(near)) + 0.5) * 2 * np.pi / count
        off = (angles - middle + np.pi) % (2 * np.pi) - np.pi
        facing = is_free & (np.abs(off) < np.deg2rad(1.5 * _BIN_DEGREES))
        yaw = middle + float(np.average(off[facing], weights=areas[facing] + 1e-12))
        facing = is_free & (np.abs((angles - yaw + np.pi) % (2 * np.pi) - np.pi) < np.deg2rad(2.5 * _BIN_DEGREES))
        walls += _walls_facing(yaw, points[facing], areas[facing])
        is_free &= ~facing
    ordered = [wall for _, wall in sorted(walls, key=lambda entry: -entry[0])]
    return [dataclasses.replace(wall, has_back=any(_is_back(wall, other) for other in ordered)) for wall in ordered]


def with_ends_on(wall: SlantedWall, lines: Sequence[Array]) -> SlantedWall:
    """A slanted wall whose ends are moved along it onto walls that run along an axis, where these are near.

    Args:
        wall: to be moved.
        lines: positions of walls across x and across y [m].
    """
    along = (wall.end - wall.start) / max(wall.length, 1e-9)
    ends = []
    for place in (wall.start, wall.end):
        steps = [
            (position - place[axis]) / along[axis]
            for axis in (0, 1)
            for position in lines[axis].tolist()
            if abs(along[axis]) > _MIN_SLANT and abs(position - place[axis]) < _END_M
        ]
        step = min(steps, key=abs, default=0.0)
        ends.append(place + (step if abs(step) < 2 * _END_M else 0.0) * along)
    has_length = float((ends[1] - ends[0]) @ along) > 0.5 * wall.length
    return dataclasses.replace(wall, start=ends[0], end=ends[1]) if has_length else wall


def _is_back(wall: SlantedWall, other: SlantedWall) -> bool:
    """True if another wall is the other face of a wall."""
    away = 0.5 * (other.start + other.end - wall.start - wall.end)
    is_near = abs(float(away @ wall.normal)) < _BACK_M and float(np.linalg.norm(away)) < 0.5 * (wall.length + other.length)
    return is_near and float(wall.normal @ other.normal) < -np.cos(np.deg2rad(15))


def _walls_facing(yaw: float, points: Array, areas: Array) -> list[tuple[float, SlantedWall]]:
    """Walls among points, shape (n, 3) [m], whose normals have an angle [rad], each with its surface [m2]."""
    normal, along = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    offset, place = points[:, :2] @ normal, points[:, :2] @ along
    is_free = np.ones(len(points), dtype=bool)
    walls = []
    while areas[is_free].sum() >= _SPARSE_M2:
        start = float(offset[is_free].min())
        bins = np.floor((offset[is_free] - start) / 0.02).astype(np.int64)
        smooth = np.convolve(np.bincount(bins, weights=areas[is_free], minlength=5), np.ones(5), mode="same")
        if smooth.max() < _SPARSE_M2:
            break
        middle = start + (int(np.argmax(smooth)) + 0.5) * 0.02
        members = np.flatnonzero(is_free & (np.abs(offset - middle) < _PLANE_M))
        is_free[members] = False
        order = members[np.argsort(place[members], kind="stable")]
        for whole_stretch in np.split(order, np.flatnonzero(np.diff(place[order]) > MAX_PASSAGE_M) + 1):
            stretch = _without_scraps(whole_stretch, place, areas)
            wall = _fitted_wall(points[stretch], normal)
            area, tall = float(areas[stretch].sum()), float(np.ptp(np.percentile(points[stretch, 2], [2, 98])))
            is_sparse = area < _MIN_SLANTED_M2
            if area < _SPARSE_M2 or wall.seen_m < _MIN_SLANTED_M or tall < _MIN_TALL_M:
                continue
            if not is_sparse or np.abs(wall.normal).min() >= _SPARSE_SLANT:
                walls.append((area, dataclasses.replace(wall, is_sparse=is_sparse)))
    return walls


def _without_scraps(stretch: Indices, place: Array, areas: Array) -> Indices:
    """A wall's points without pieces at its ends that a gap parts from the rest and that are too small to be wall by themselves.

    Args:
        stretch: numbers of the points in the order of their places, shape (k,).
        place: of all points along the wall [m], shape (n,).
        areas: of all points [m2], shape (n,).
    """
    pieces = np.split(stretch, np.flatnonzero(np.diff(place[stretch]) > _GAP_M) + 1)
    is_wall = [np.ptp(place[piece]) >= _MIN_SLANTED_M and areas[piece].sum() >= 0.5 * _SPARSE_M2 for piece in pieces]
    if not any(is_wall):
        return stretch
    first, last = is_wall.index(True), len(pieces) - is_wall[::-1].index(True)
    return np.concatenate(pieces[first:last])


def _fitted_wall(points: Array, toward: Array) -> SlantedWall:
    """The straight wall through points, shape (n, 3) [m]. toward: a direction near its normal, shape (2,)."""
    center = points[:, :2].mean(axis=0)
    # Normals of fused depth are off by degrees, places along a wall by a centimeter.
    spread = points[:, :2] - center
    normal = np.linalg.eigh(spread.T @ spread)[1][:, 0]
    normal = normal if normal @ toward > 0 else -normal
    normal = normal if normal @ toward > np.cos(np.deg2rad(3 * _BIN_DEGREES)) else toward
    along = np.array([-normal[1], normal[0]])
    places = np.sort(spread @ along)
    low, high = np.percentile(places, [1, 99])
    gaps = np.diff(places[(places >= low) & (places <= high)])
    return SlantedWall(center + low * along, center + high * along, normal, float(high - low - gaps[gaps > _GAP_M].sum()))
