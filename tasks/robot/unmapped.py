"""What a lidar sees that the map does not have, kept until it is seen to be gone."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from tasks.robot.floor_map import Floor

Array = NDArray[np.float64]

OFF_MAP_M = 0.08
"""Returns farther than this from all that the map's plane shows are of things that it does not have [m]: eight times the lidar's noise."""

DOUBTFUL_M = 0.04
"""Returns farther off than this [m] may be of a thing that was moved a little: four times the lidar's noise, of which a turn of a hundred
rays has one by chance."""

TIMES = 5
"""So many more scans have to see something at a doubtful place than look there and see nothing, as `MISSED` counts these: chance does not
strike one square of `PACE_M` so often, and a pose that is off does not stay so."""

MISSED = 0.2
"""What a scan that looks at a doubtful place and sees nothing there takes off: of a thing that is there, noise moves every other return
into a square beside it."""

MOST = 2.0 * TIMES
"""Up to this is counted: a thing that was there for an hour is forgotten as soon as one that was there for a second."""

BEHIND_M = 0.06
"""A place is empty when rays beside it end so much farther away [m]."""

PACE_M = 0.03
"""Places nearer to each other than this are one."""

RAYS = 180
"""Sectors in which is looked whether rays pass: of two degrees, so that a leg of a chair does not slip between."""

LOOK_M = 3.0
"""Only places this near are judged and kept [m]: farther away a small error of the heading makes walls of nothing."""


class UnmappedPlaces:
    """Places where something is that the map does not have. floor: The map."""

    def __init__(self, floor: Floor) -> None:
        self._mapped = floor.plane_distances
        self._sure: Array = np.zeros((0, 2))
        self._squares: NDArray[np.int64] = np.zeros((0, 2), dtype=np.int64)
        self._counts: Array = np.zeros(0)

    @property
    def points(self) -> Array:
        """The places, world frame [m], shape (n, 2)."""
        return np.vstack([self._sure, PACE_M * self._squares[self._counts >= TIMES]])

    def see(self, returns: ArrayLike, pose: ArrayLike) -> None:
        """Take in a scan: where its rays ended, shape (n, 2), and from where, shape (3,); world frame [m]."""
        seen, here = np.asarray(returns, dtype=np.float64).reshape(-1, 2), np.asarray(pose, dtype=np.float64)[:2]
        if not len(seen):
            return
        ranges = np.hypot(*(seen - here).T)
        kept = self._sure[~self._seen_through(seen - here, ranges, self._sure - here)]
        near = seen[ranges < LOOK_M]
        off = self._mapped.distances(near)
        self._sure = _spaced(np.vstack([kept, near[off > OFF_MAP_M]]))
        self._doubt(seen - here, ranges, near[(off > DOUBTFUL_M) & (off <= OFF_MAP_M)], here)

    def _doubt(self, returns: Array, ranges: Array, doubtful: Array, here: Array) -> None:
        """Count doubtful returns, shape (n, 2), by their squares, and take off where a scan, as `_seen_through` has it, saw nothing."""
        squares, places = np.unique(np.vstack([self._squares, _squares(doubtful)]), axis=0, return_inverse=True)
        known, hit = places[: len(self._squares)], places[len(self._squares) :]
        counts = np.zeros(len(squares))
        counts[known] = self._counts
        is_hit = np.zeros(len(squares), dtype=bool)
        is_hit[hit] = True
        counts[is_hit] = np.minimum(counts[is_hit] + 1.0, MOST)
        counts[~is_hit & self._looked_at(returns, ranges, PACE_M * squares - here)] -= MISSED
        stays = counts > 0.0
        self._squares, self._counts = squares[stays], counts[stays]

    @staticmethod
    def _looked_at(returns: Array, ranges: Array, places: Array) -> NDArray[np.bool_]:
        """Whether a ray reaches as far as places, or past them; both are given from where the scan was taken."""
        farthest = np.zeros(RAYS)
        np.maximum.at(farthest, _sector(returns), ranges)
        away = np.hypot(*places.T)
        looked: NDArray[np.bool_] = (away < LOOK_M) & (farthest[_sector(places)] > away - PACE_M)
        return looked

    @staticmethod
    def _seen_through(returns: Array, ranges: Array, places: Array) -> NDArray[np.bool_]:
        """Whether rays pass on all sides of places; both are given from where the scan was taken."""
        sectors = np.full(RAYS, 0.0)
        nearest = np.full(RAYS, np.inf)
        which = _sector(returns)
        np.minimum.at(nearest, which, ranges)
        sectors[np.isfinite(nearest)] = nearest[np.isfinite(nearest)]
        around = np.minimum(sectors, np.minimum(np.roll(sectors, 1), np.roll(sectors, -1)))
        away = np.hypot(*places.T)
        passed: NDArray[np.bool_] = (away < LOOK_M) & (around[_sector(places)] > away + BEHIND_M)
        return passed


def _sector(directions: Array) -> NDArray[np.int64]:
    """The sector that each direction, shape (n, 2), lies in."""
    turns = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * math.pi)
    sectors: NDArray[np.int64] = np.floor(turns * RAYS).astype(np.int64) % RAYS
    return sectors


def _spaced(points: Array) -> Array:
    """Points, shape (n, 2), of which no two lie in one square of `PACE_M`; the first of each stays."""
    if not len(points):
        return points
    _, first = np.unique(_squares(points), axis=0, return_index=True)
    return points[np.sort(first)]


def _squares(points: Array) -> NDArray[np.int64]:
    """The square of `PACE_M` that each point, shape (n, 2), lies in."""
    squares: NDArray[np.int64] = np.round(points / PACE_M).astype(np.int64)
    return squares
