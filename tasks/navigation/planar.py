"""Exact shortest paths for a disc: a visibility graph over the corners of its free polygon.

In a polygon with holes a shortest path is a polyline whose inner corners are reflex corners of the polygon,
met tangentially (de Berg et al., Computational Geometry, chapter 15). The graph holds those corners only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.navigation.points import FloorTriangles, rows
from tasks.navigation.protocol import NO_PATH, Path, PathFinder, PathFinderKind
from tasks.navigation.visibility import (
    ON_BOUNDARY,
    TANGENT,
    Boundary,
    Corners,
    boundary_of,
    clear,
    clear_lengths,
    contains,
    first_clear,
    joined,
    tangent_corners,
)
from tasks.settings import Config, NonNegative

if TYPE_CHECKING:
    import shapely
    from scipy.sparse import csr_matrix

    from schemas.capture import Shell
    from tasks.geometry.meshes import Surface
    from tasks.navigation.configuration import NavigationConfig
    from tasks.navigation.navmesh import NavmeshFile, Settings

Array = NDArray[np.float64]

_SAFETY = 1e-6
"""A blocked step ends this far before the obstacle [m], so that the next one starts inside."""

_JOINT_M = 1e-4
"""Islands of a navmesh that hang together at a point only grow by this [m]."""


@dataclasses.dataclass(frozen=True)
class PlanarConfig(Config):
    """Exact shortest paths in the free polygon of the floor. Needs nothing but Python packages."""

    kind: ClassVar[str] = "planar"
    smallest_island_m2: NonNegative = 0.0625  # the square of one step: on less floor no step can be made


class PlanarPathFinder(PathFinder):
    """Shortest paths for a point in a closed polygon with holes, world frame [m]. Exact up to rounding.

    Erode the floor by the agent's radius before (`obstacles.free_space`) and the point is the center of its disc.
    """

    name = PlanarConfig.kind

    def __init__(self, free: shapely.Geometry) -> None:
        import shapely

        parts = [part for part in shapely.get_parts(free) if part.geom_type == "Polygon" and part.area > 0]
        self._set_parts([shapely.MultiPolygon([part]) for part in sorted(parts, key=lambda part: (-part.area, part.bounds))])

    @classmethod
    def from_navmesh(cls, navmesh: NavmeshFile, floor_only: bool = False, file: str = "scene.navmesh") -> PlanarPathFinder:
        """Exact shortest paths on the walkable polygons of a .navmesh, in plan.

        An island is what the file's own links connect: parts that only touch, or lie above each other, stay apart. One
        that hangs together at a point only is widened by 0.1 mm, so that paths lead through there.
        Where islands lie above each other, a point belongs to the largest.

        Args:
            navmesh: A file of one tile.
            floor_only: Leave out what no agent on the floor can climb to.
            file: Name for messages.

        Raises:
            InputError: the file has several tiles, or for `floor_only` heights that cannot be.
        """
        import shapely

        from tasks.navigation.regions import walkable_region

        region = walkable_region(navmesh, floor_only, file)
        polygons = np.array([shapely.Polygon(ring) for ring in region.rings], dtype=object)
        made = cls(shapely.MultiPolygon())
        # Neighbors share corners to the last bit: on a grid, an edge could part from the one it lies on.
        united = [shapely.union_all(polygons[region.islands == island]) for island in range(len(region.areas))]
        floors = [shapely.MultiPolygon([p for p in shapely.get_parts(part) if p.geom_type == "Polygon"]) for part in united]
        whole = [shapely.buffer(floor, _JOINT_M, join_style="mitre") if len(floor.geoms) > 1 else floor for floor in floors]
        made._set_parts([shapely.MultiPolygon(list(shapely.get_parts(part))) for part in whole])
        return made

    def _set_parts(self, parts: list[shapely.MultiPolygon]) -> None:
        """Islands, largest first. The parts of one island touch at corners at most."""
        import shapely

        self._parts = parts
        # Sights are tested against the edges of one island: others may lie above it, or touch it.
        self._edges = [boundary_of(list(part.geoms)) for part in parts]
        self.boundary: Boundary = joined(self._edges)
        self.free: shapely.Geometry = shapely.MultiPolygon([polygon for part in parts for polygon in part.geoms])
        for part in (*parts, self.free):
            shapely.prepare(part)

    @cached_property
    def islands(self) -> tuple[float, ...]:
        """Area of every connected part [m2], largest first."""
        return tuple(float(part.area) for part in self._parts)

    def island_of(self, points: ArrayLike) -> NDArray[np.int64]:
        """Island of each point, shape (n, 2) to (n,); -1 where the agent cannot be."""
        p = rows(points)
        result = np.full(len(p), -1, dtype=np.int64)
        for number in reversed(range(len(self._parts))):
            result[contains(self._edges[number], p)] = number
        return result

    def snap(self, points: ArrayLike) -> Array:
        """The navigable point nearest to each point, shape (n, 2).

        Raises:
            ValueError: the free polygon is empty.
        """
        import shapely

        if not self._parts:
            raise ValueError("free: is empty, there is no point to snap to")
        p = rows(points).copy()
        outside = np.flatnonzero(~self.is_navigable(p))
        if len(outside):
            lines = shapely.shortest_line(self.free, shapely.points(p[outside]))
            p[outside] = shapely.get_coordinates(lines).reshape(-1, 2, 2)[:, 0]
        return p

    @cached_property
    def _triangles(self) -> FloorTriangles:
        """Triangles of the free polygon."""
        import shapely

        pieces = [shapely.get_parts(shapely.constrained_delaunay_triangles(part)) for part in self._parts]
        corners = np.concatenate([shapely.get_coordinates(p).reshape(-1, 4, 2)[:, :3] for p in pieces])
        areas = np.concatenate([shapely.area(p) for p in pieces])
        return FloorTriangles(corners, np.cumsum(areas), np.repeat(np.arange(len(pieces)), [len(p) for p in pieces]))

    def random_point(self, rng: np.random.Generator, island: int | None = None) -> Array:
        """A navigable point, uniform over the area of one island or of all, shape (2,)."""
        return self._triangles.random_point(rng, island)

    @cached_property
    def _nodes(self) -> NDArray[np.int64]:
        """Edges of the boundary whose start is a corner that paths bend around."""
        return np.flatnonzero(self.boundary.reflex)

    @cached_property
    def _graph(self) -> csr_matrix:
        """Symmetric graph of corners that see each other along a common tangent; weights are distances [m]."""
        from scipy.sparse import coo_matrix

        at = self.boundary.starts[self._nodes]
        island = self.boundary.island[self._nodes]
        count = len(at)
        if count == 0:
            return coo_matrix((0, 0)).tocsr()
        rows, columns = [], []
        for i in range(count):  # one row at a time keeps memory linear in the corners
            targets = np.arange(i + 1, count)
            targets = targets[island[targets] == island[i]]
            targets = targets[self._is_tangent(targets, at[i])]
            targets = targets[self._is_tangent(np.full(len(targets), i), at[targets])]
            rows.append(np.full(len(targets), i))
            columns.append(targets)
        a, b = np.concatenate(rows), np.concatenate(columns)
        seen = np.zeros(len(a), dtype=np.bool_)
        for number, edges in enumerate(self._edges):
            pairs = np.flatnonzero(island[a] == number)
            seen[pairs] = clear(edges, at[a[pairs]], at[b[pairs]])
        a, b = a[seen], b[seen]
        # Corners that coincide keep an edge: a weight of zero would read as no edge.
        weights = np.maximum(np.hypot(*(at[a] - at[b]).T), 1e-12)
        return coo_matrix((np.r_[weights, weights], (np.r_[a, b], np.r_[b, a])), shape=(count, count)).tocsr()

    def _is_tangent(self, nodes: NDArray[np.int64], points: Array) -> NDArray[np.bool_]:
        """Whether the line from each node to a point leaves both edges of the node's corner on one side, shape (n,)."""
        edges = self._nodes[nodes]
        offset = points - self.boundary.starts[edges]
        unit = offset / np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-300)[:, None]
        back, ahead = -self.boundary.arriving[edges], self.boundary.leaving[edges]
        left = unit[:, 0] * back[:, 1] - unit[:, 1] * back[:, 0]
        right = unit[:, 0] * ahead[:, 1] - unit[:, 1] * ahead[:, 0]
        return (np.minimum(left, right) >= -TANGENT) | (np.maximum(left, right) <= TANGENT)

    @cached_property
    def _corners(self) -> list[tuple[NDArray[np.int64], Corners]]:
        """For every island its nodes and what is there."""
        corners = []
        for island in range(len(self._parts)):
            nodes = np.flatnonzero(self.boundary.island[self._nodes] == island)
            edges = self._nodes[nodes]
            corners.append((nodes, Corners(self.boundary.starts[edges], -self.boundary.arriving[edges], self.boundary.leaving[edges])))
        return corners

    def _candidates(self, point: Array, island: int, beyond: Array | None = None, limit: float = np.inf) -> tuple[NDArray[np.int64], Array]:
        """Nodes that a shortest path from `point` could bend around first, nearest first, and the path's length over each."""
        nodes, corners = self._corners[island]
        chosen, total = tangent_corners(point, corners, np.zeros(len(nodes)) if beyond is None else beyond, limit)
        return nodes[chosen], total

    def field(self, goals: ArrayLike) -> PlanarField:
        """Distances and paths to the nearest of `goals`, shape (n, 2). Goals that are not navigable are never reached."""
        return PlanarField(self, rows(goals))

    def is_clear(self, start: ArrayLike, end: ArrayLike) -> bool:
        """Whether a straight move from a navigable point to anywhere, shape (2,) each, stays in the free polygon."""
        island = 0 if len(self._parts) == 1 else int(self.island_of(start)[0])
        if island < 0 or not clear(self._edges[island], rows(start), rows(end))[0]:
            return False
        # The next move starts there, and outside of the polygon nothing would stop it.
        return bool(contains(self._edges[island], rows(end))[0])

    def try_step(self, position: ArrayLike, offset: ArrayLike) -> Array:
        """Where a straight move of `offset` from a navigable point ends, shape (2,): short of the first obstacle; no sliding."""
        start = rows(position)[0]
        end = start + rows(offset)[0]
        return end if self.is_clear(start, end) else self.try_steps(position, offset)[0]

    def try_steps(self, positions: ArrayLike, offsets: ArrayLike) -> Array:
        """Where straight moves from navigable points, each by its own offset, shape (n, 2), end: as `try_step` has each, shape (n, 2)."""
        starts = rows(positions)
        ends = starts + rows(offsets)
        islands = np.zeros(len(starts), dtype=np.int64) if len(self._parts) == 1 else self.island_of(starts)
        for island in np.unique(islands):
            mine = np.flatnonzero(islands == island)
            ends[mine] = self._stops(int(island), starts[mine], ends[mine])
        return ends

    def _stops(self, island: int, starts: Array, ends: Array) -> Array:
        """Where moves on one island end, shape (n, 2)."""
        if island < 0:
            return starts
        edges = self._edges[island]
        # The next move starts at the end, and outside of the polygon nothing would stop it.
        blocked = np.flatnonzero(~(clear(edges, starts, ends) & contains(edges, ends)))
        if not len(blocked):
            return ends
        ends = ends.copy()
        # Only the rest asks whether it starts on this island: where there is one alone, nobody has looked.
        at, to, inside = starts[blocked], ends[blocked], contains(edges, starts[blocked])
        length = np.hypot(*(to - at).T)
        reach = np.maximum(0.0, np.minimum(clear_lengths(edges, at, to), length) - _SAFETY)
        stops = at + (to - at) * (reach / np.maximum(length, 1e-300))[:, None]
        free = inside & clear(edges, at, stops) & contains(edges, stops)
        ends[blocked] = np.where(free[:, None], stops, at)
        return ends

    def navmesh(self, settings: Settings) -> NavmeshFile:
        """The free polygon tiled by convex polygons, as habitat-sim stores it, glTF frame.

        Raises:
            ValueError: the free polygon is empty, or has more corners than the format can number.
        """
        from tasks.navigation.convex import convex_cover
        from tasks.navigation.navmesh import CORNERS, navmesh_from_polygons

        return navmesh_from_polygons(convex_cover(self.free, CORNERS), settings)


class PlanarField:
    """Geodesic distance to the nearest of a set of goals in the free polygon of a `PlanarPathFinder`."""

    def __init__(self, finder: PlanarPathFinder, goals: Array) -> None:
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import dijkstra

        self._finder, self._goals = finder, goals
        self._goal_islands = finder.island_of(goals)
        graph = finder._graph
        self._at = finder.boundary.starts[finder._nodes]
        count = len(self._at)
        nearest = np.full(count, np.inf)
        self._node_goal = np.full(count, -1, dtype=np.int64)
        for number, (goal, island) in enumerate(zip(goals, self._goal_islands, strict=True)):
            if island < 0:
                continue
            nodes, _ = finder._candidates(goal, int(island))
            nodes = nodes[clear(finder._edges[island], np.broadcast_to(goal, (len(nodes), 2)), self._at[nodes])]
            distance = np.maximum(np.hypot(*(self._at[nodes] - goal).T), 1e-12)
            closer = distance < nearest[nodes]
            nearest[nodes[closer]] = distance[closer]
            self._node_goal[nodes[closer]] = number
        first = np.flatnonzero(np.isfinite(nearest))
        # One more row, whose edges lead from all goals at once to the corners that see one of them.
        joined = csr_matrix(
            (
                np.r_[graph.data, nearest[first]],
                np.r_[graph.indices, first],
                np.r_[graph.indptr, graph.nnz + len(first)],
            ),
            shape=(count + 1, count + 1),
        )
        distance, previous = dijkstra(joined, indices=count, return_predecessors=True)
        self._previous = previous[:count]
        self._beyond = [distance[:count][nodes] for nodes, _ in finder._corners]
        self._goals_of = [np.flatnonzero(self._goal_islands == island) for island in range(len(finder.islands))]

    def distances(self, points: ArrayLike) -> Array:
        """Geodesic distances from points, shape (n, 2), to the nearest goal [m], shape (n,); infinite without a path."""
        p = rows(points)
        islands = self._finder.island_of(p)
        return np.array([self._search(point, int(island))[0] for point, island in zip(p, islands, strict=True)], dtype=np.float64)

    def path(self, start: ArrayLike) -> Path:
        """Shortest path from `start`, shape (2,), to the nearest goal."""
        point = rows(start)[0]
        length, node, goal = self._search(point, int(self._finder.island_of(point)[0]))
        if not np.isfinite(length):
            return NO_PATH
        corners = [point]
        while node >= 0 and node < len(self._at):
            corners.append(self._at[node])
            goal, node = int(self._node_goal[node]), int(self._previous[node])
        corners.append(self._goals[goal])
        line = np.array(corners)
        # A start or goal on a corner would appear twice.
        moved = np.r_[True, np.hypot(*np.diff(line, axis=0).T) > ON_BOUNDARY]
        return Path(length, line[moved], goal)

    def _search(self, point: Array, island: int) -> tuple[float, int, int]:
        """Distance of a point, the corner it goes to first or -1, and the goal when it goes there straight."""
        finder = self._finder
        best, straight = np.inf, -1
        if island < 0:
            return best, -1, -1
        goals = self._goals_of[island]
        if not len(goals):
            return best, -1, -1
        direct = np.hypot(*(self._goals[goals] - point).T)
        order = np.argsort(direct, kind="stable")
        seen = first_clear(finder._edges[island], point, self._goals[goals[order]])
        if seen >= 0:
            best, straight = float(direct[order[seen]]), int(goals[order[seen]])
        nodes, total = finder._candidates(point, island, self._beyond[island], best)
        seen = first_clear(finder._edges[island], point, self._at[nodes])
        return (best, -1, straight) if seen < 0 else (float(total[seen]), int(nodes[seen]), -1)


def _build(room: Shell, surfaces: Sequence[Surface], walls: Sequence[shapely.Geometry], config: NavigationConfig) -> PlanarPathFinder:
    from tasks.navigation.obstacles import footprint, free_space

    agent, settings = config.agent, config.path_finder
    assert isinstance(settings, PlanarConfig)
    prints = [footprint(surface, agent.max_climb_m, agent.height_m) for surface in surfaces]
    return PlanarPathFinder(free_space(room.floor_polygon, [*prints, *walls], agent.radius_m, settings.smallest_island_m2))


PLANAR = PathFinderKind(name="planar", config=PlanarConfig, build=_build, is_exact=True)
