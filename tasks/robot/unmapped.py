"""What a lidar sees that the map does not have, kept until it is seen to be gone."""

from __future__ import annotations

import math
from collections import Counter
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
"""So many scans have to see something at a doubtful place: chance does not strike one square of `PACE_M` so often, and a pose that is off
does not stay so."""

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
        self.points: Array = np.zeros((0, 2))
        self._doubted: Counter[tuple[int, int]] = Counter()

    def see(self, returns: ArrayLike, pose: ArrayLike) -> None:
        """Take in a scan: where its rays ended, shape (n, 2), and from where, shape (3,); world frame [m]."""
        seen, here = np.asarray(returns, dtype=np.float64).reshape(-1, 2), np.asarray(pose, dtype=np.float64)[:2]
        if not len(seen):
            return
        ranges = np.hypot(*(seen - here).T)
        kept = self.points[~self._seen_through(seen - here, ranges, self.points - here)]
        near = seen[ranges < LOOK_M]
        off = self._mapped.distances(near)
        seen_again = self._doubtful(near[(off > DOUBTFUL_M) & (off <= OFF_MAP_M)])
        self.points = _spaced(np.vstack([kept, near[off > OFF_MAP_M], seen_again]))

    def _doubtful(self, near: Array) -> Array:
        """Those of doubtful places, shape (n, 2), where so many scans saw something, shape (m, 2)."""
        squares = [(int(x), int(y)) for x, y in _squares(near)]
        self._doubted.update(set(squares))
        return near[np.array([self._doubted[square] >= TIMES for square in squares], dtype=bool)]

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
