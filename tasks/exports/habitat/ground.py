"""The walkable area of a navmesh seen from above: what a replayed step may cross, and how far it is to walk.

Points are x and z of Habitat's frame [m], shape (n, 2), where nothing else is said. A point may lie `NEAR` beside a polygon
and still count as on it.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.exports.habitat.navmesh_file import NEAR, NavmeshPolygons

if TYPE_CHECKING:
    import shapely

    from tasks.navigation.planar import PlanarField, PlanarPathFinder

Array = NDArray[np.float64]

STRAY = 1e-3
"""A step that leaves the navmesh by less than this stays on it [m]: corners in the file are rounded to 32 bits."""

_LEVEL = 0.5  # a point this near in height [m] may stand on a polygon: voxels and steps, no storey
_GRID = 1e-6  # polygons are united on a grid of this size [m], so that rounded corners leave no slits between them
_JOIN = 1e-4  # and widened by this [m]: habitat-sim's bakes have polygons that are linked at a single point
_OVERLAP = 0.01  # share of the area that may be there twice; more of it means floors above one another
_MOST_CORNERS = 3000  # of one connected part; the visibility graph of more takes longer than a minute


class Ground:
    """The walkable polygons of one navmesh, by connected part."""

    def __init__(self, navmesh: NavmeshPolygons) -> None:
        self._navmesh = navmesh
        self._islands: dict[int, Island] = {}

    @cached_property
    def _tree(self) -> shapely.STRtree:
        import shapely

        return shapely.STRtree([shapely.Polygon(corners[:, [0, 2]]) for corners in self._navmesh.polygons])

    @cached_property
    def _heights(self) -> Array:
        """Mean height of every polygon [m], shape (n,)."""
        return np.array([corners[:, 1].mean() for corners in self._navmesh.polygons])

    def island_of(self, points: Array) -> NDArray[np.int64]:
        """Connected part of each point (x, y, z), shape (n, 3) to (n,); -1 where none is near.

        Of floors above one another it is that whose height is nearest; on one floor, the nearest part.
        """
        import shapely

        numbers = np.full(len(points), -1, dtype=np.int64)
        if len(points) and self._navmesh.polygons:
            which, polygon = self._tree.query(shapely.points(points[:, [0, 2]]), predicate="dwithin", distance=NEAR)
            above = np.abs(self._heights[polygon] - points[which, 1])
            above[above < _LEVEL] = 0.0
            beside = shapely.distance(shapely.points(points[which][:, [0, 2]]), self._tree.geometries[polygon])
            order = np.lexsort((beside, above, which))
            rows, first = np.unique(which[order], return_index=True)
            numbers[rows] = self._navmesh.islands[polygon[order[first]]]
        return numbers

    def island(self, number: int) -> Island:
        """One connected part."""
        if number not in self._islands:
            self._islands[number] = Island([self._tree.geometries[i] for i in np.flatnonzero(self._navmesh.islands == number)])
        return self._islands[number]


class Island:
    """A connected part of a navmesh."""

    def __init__(self, polygons: list[shapely.Polygon]) -> None:
        import shapely

        self._shape = shapely.union_all(shapely.make_valid(polygons), grid_size=_GRID)
        self._reach = shapely.buffer(self._shape, STRAY)
        shapely.prepare(self._reach)
        self._area = float(shapely.area(polygons).sum())
        self._fields: dict[bytes, PlanarField] = {}

    def contains_moves(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """Whether each straight move, shape (n, 2) each, stays on the part, shape (n,)."""
        import shapely

        return np.asarray(shapely.covers(self._reach, shapely.linestrings(np.stack([starts, ends], axis=1))), dtype=np.bool_)

    def geodesic(self, start: Array, goals: Array) -> tuple[float, float]:
        """Least and largest length [m] that the shortest path from a point, shape (2,), to the nearest goal, shape (n, 2), can have.

        Both are the length itself on a part that lies in one plane and can be searched; else it is only known to be no
        shorter than the straight line.
        """
        if self._finder is None:
            return float(np.hypot(*(goals - start).T).min()), np.inf
        key = goals.tobytes()
        if key not in self._fields:
            self._fields[key] = self._finder.field(self._finder.snap(goals))
        length = float(self._fields[key].distances(self._finder.snap(start[None]))[0])
        return length, length

    @cached_property
    def _finder(self) -> PlanarPathFinder | None:
        """Exact shortest paths; None where floors lie above one another, do not hang together in plan or have too many corners."""
        import shapely

        from tasks.navigation.planar import PlanarPathFinder

        joined = shapely.buffer(self._shape, _JOIN, join_style="mitre")
        is_one = joined.geom_type == "Polygon" and not joined.is_empty
        is_flat = self._area <= (1 + _OVERLAP) * self._shape.area
        return PlanarPathFinder(joined) if is_one and is_flat and shapely.get_num_coordinates(joined) <= _MOST_CORNERS else None
