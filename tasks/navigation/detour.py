"""What the path finders over Detour's navmeshes share: the file, its islands, and points on them."""

from __future__ import annotations

import abc
import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.navigation.navmesh import NavmeshFile, Settings, read_navmesh
from tasks.navigation.points import FloorTriangles, rows
from tasks.navigation.protocol import DistanceField, PathFinder
from tasks.navigation.regions import Region, closed_but_for, walkable_region

Array = NDArray[np.float64]

ON_MESH_M = 1e-4
"""Points nearer than this to a polygon lie on it [m]: a hundred times what single precision rounds in a room."""

SNAP_M = 2.0
"""How far aside habitat-sim looks for a polygon [m]: of what is farther it may find one, but not the nearest."""

_SAME = 1e-5
"""habitat-sim's tolerance when it compares the settings of navmeshes."""


class DetourPathFinder(PathFinder):
    """A navmesh file and what can be said of it without a search, world frame [m], for an agent that stands on the floor (z = 0).

    Parts of the navmesh that nobody on the floor can climb to, as tops of cupboards, stay in the file but are left out here.
    """

    def __init__(self, data: bytes) -> None:
        """`data`: Bytes of a .navmesh file of one tile; none when nothing is walkable."""
        self.file: NavmeshFile | None = read_navmesh(data) if data else None
        nothing = Region(np.zeros(0, dtype=np.int64), (), np.zeros(0, dtype=np.int64), ())
        self.region = walkable_region(self.file, floor_only=True) if self.file else nothing
        self.floor = closed_but_for(self.file, self.region) if self.file and self.region.rings else None
        """The file with everything closed but the floor: what is searched."""

    @property
    def islands(self) -> tuple[float, ...]:
        """Area of every connected part [m2], largest first."""
        return self.region.areas

    def island_of(self, points: ArrayLike) -> NDArray[np.int64]:
        """Island of each point, shape (n, 2) to (n,); -1 where the agent cannot be."""
        p = rows(points)
        places, polygons = self._places(p)
        with np.errstate(invalid="ignore"):
            there = (polygons >= 0) & (np.hypot(*(places - p).T) <= ON_MESH_M)
        return np.where(there, self._island_of_polygon[polygons], -1)

    def snap(self, points: ArrayLike) -> Array:
        """The navigable point nearest to each point, shape (n, 2).

        Raises:
            ValueError: nothing is walkable.
        """
        if self.floor is None:
            raise ValueError("navmesh: is empty, there is no point to snap to")
        p = rows(points)
        places, polygons = self._places(p)
        with np.errstate(invalid="ignore"):
            sure = (polygons >= 0) & (np.hypot(*(places - p).T) <= SNAP_M)
        for index in np.flatnonzero(~sure):
            places[index] = self._nearest(p[index])
        there = np.hypot(*(places - p).T) <= ON_MESH_M
        return np.where(there[:, None], p, places)

    def random_point(self, rng: np.random.Generator, island: int | None = None) -> Array:
        """A navigable point, uniform over the area of one island or of all, shape (2,)."""
        return self._triangles.random_point(rng, island)

    @abc.abstractmethod
    def field(self, goals: ArrayLike) -> DistanceField:
        """Distances and paths to the nearest of `goals`, shape (n, 2). Goals that are not navigable are never reached."""

    def navmesh(self, settings: Settings) -> NavmeshFile:
        """The file as it was baked, tops of furniture and all, glTF frame.

        Raises:
            ValueError: nothing is walkable, or the navmesh was baked with other settings.
        """
        if self.file is None:
            raise ValueError("navmesh: is empty")
        made = self.file.settings or Settings()
        if not np.allclose(dataclasses.astuple(made), dataclasses.astuple(settings), rtol=0, atol=_SAME):
            raise ValueError(f"navmesh: was baked with {made}, asked for is {settings}")
        return self.file

    @abc.abstractmethod
    def _places(self, points: Array) -> tuple[Array, NDArray[np.int64]]:
        """For points, shape (n, 2), the nearest place on the floor's navmesh, same shape, and its polygon, -1 for none in reach."""

    @cached_property
    def _island_of_polygon(self) -> NDArray[np.int64]:
        """Island of every polygon of the file; one more entry, so that polygon -1 has none."""
        count = len(self.file.tiles[0].polygons) if self.file else 0
        islands = np.full(count + 1, -1, dtype=np.int64)
        islands[self.region.numbers] = self.region.islands
        return islands

    @cached_property
    def _triangles(self) -> FloorTriangles:
        """Fans of the floor's polygons."""
        fans = [ring[[0, k, k + 1]] for ring in self.region.rings for k in range(1, len(ring) - 1)]
        islands = np.repeat(self.region.islands, [len(ring) - 2 for ring in self.region.rings])
        corners = np.array(fans).reshape(-1, 3, 2)
        u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        return FloorTriangles(corners, np.cumsum(0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])), islands)

    def _nearest(self, point: Array) -> Array:
        """The point of the floor's navmesh nearest to one outside, shape (2,)."""
        starts = np.concatenate(self.region.rings)
        along = np.concatenate([np.roll(ring, -1, axis=0) for ring in self.region.rings]) - starts
        share = np.clip(((point - starts) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-18), 0.0, 1.0)
        on_edge = starts + share[:, None] * along
        return np.asarray(on_edge[np.hypot(*(on_edge - point).T).argmin()])


def space(points: Array) -> Array:
    """Points on the floor, world frame, shape (n, 2), in the glTF frame, shape (n, 3)."""
    p = points.reshape(-1, 2)
    result = np.zeros((len(p), 3))
    result[:, 0], result[:, 2] = p[:, 0], -p[:, 1]
    return result


def from_above(points: Array) -> Array:
    """Points of the glTF frame, shape (n, 3), seen from above in the world frame, shape (n, 2)."""
    result = np.empty((len(points), 2))
    result[:, 0], result[:, 1] = points[:, 0], -points[:, 2]
    return result
