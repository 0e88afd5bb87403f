"""The floor of a replica as a cart meets it: what it runs into, and what its lidar sees of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tasks.robot.clearances import Clearances
from tasks.robot.configuration import Cart, Lidar

if TYPE_CHECKING:
    import shapely
    import trimesh

    from tasks.exports.bodies import Replica
    from tasks.geometry.meshes import Surface

Array = NDArray[np.float64]

DETAIL_M = 0.002
"""Outlines are told to this [m]: scanned surfaces have thousands of edges, and a lidar errs by five times as much."""

EDGE = "edge of the floor"
"""What bounds the floor, as an obstacle."""


class Envelope(NamedTuple):
    """The room that a thing takes, at most. plan: Convex hull seen from above, world frame [m]. low, high: Its bottom and its top [m]."""

    plan: shapely.Geometry
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Floor:
    """Where a cart can be, world frame [m].

    polygon: The floor. obstacles: By name, what lies between what the cart climbs and its top, seen from above. plane: By name, what the
    lidar's plane cuts out of it: segments, x and y of both ends, shape (n, 4). Names are instances and parts of the shell. carriers: By
    instance, the instance that carries it. standing: Instances that stand on the floor, or on a rug, fastened to nothing. envelopes: By
    name, the room that each takes at all heights, climbed or passed under or not.
    """

    polygon: shapely.Polygon
    obstacles: Mapping[str, shapely.Geometry]
    plane: Mapping[str, Array]
    carriers: Mapping[str, str]
    standing: frozenset[str]
    envelopes: Mapping[str, Envelope] = dataclasses.field(default_factory=dict)

    @cached_property
    def segments(self) -> Array:
        """All that the lidar sees, shape (n, 4)."""
        return np.concatenate([np.zeros((0, 4)), *(self.plane[name] for name in sorted(self.plane))])

    @cached_property
    def edges(self) -> Array:
        """All that the cart runs into, as segments, shape (n, 4)."""
        return np.concatenate([edges for _, edges in self._named_edges])

    @cached_property
    def edge_names(self) -> list[str]:
        """Whose each of the edges is."""
        return [name for name, edges in self._named_edges for _ in edges]

    @cached_property
    def _named_edges(self) -> list[tuple[str, Array]]:
        return [(EDGE, outline(self.polygon)), *((name, outline(self.obstacles[name])) for name in sorted(self.obstacles))]

    @cached_property
    def clearances(self) -> Clearances:
        """How far it is to what the cart runs into."""
        return Clearances.of(self)

    @cached_property
    def plane_distances(self) -> Clearances:
        """How far it is to what the lidar sees."""
        return Clearances.around(self.segments, self.polygon.bounds[:2], self.polygon.bounds[2:])

    def free(self, radius: float) -> shapely.MultiPolygon:
        """Where the middle of a disc of this radius [m] can be."""
        import shapely

        from tasks.navigation.obstacles import free_space

        ring = shapely.get_coordinates(self.polygon.exterior)[:-1]
        return free_space(ring, [self.obstacles[name] for name in sorted(self.obstacles)], radius)

    def covers(self, points: Array) -> NDArray[np.bool_]:
        """Whether points, shape (n, 2), are on the floor and in no obstacle, shape (n,)."""
        import shapely

        open_floor = shapely.difference(self.polygon, shapely.union_all([self.obstacles[name] for name in sorted(self.obstacles)]))
        shapely.prepare(open_floor)
        inside: NDArray[np.bool_] = shapely.contains_xy(open_floor, points[:, 0], points[:, 1])
        return inside


def floor_of(replica: Replica, cart: Cart, lidar: Lidar, carriers: Mapping[str, str | None]) -> Floor:
    """The floor of a replica; doors are open, and the lidar sees no brackets.

    carriers: By instance, the instance that carries it, None for what floor or walls do.
    """
    import shapely

    from tasks.exports.nav2 import is_door
    from tasks.geometry.meshes import surface_of
    from tasks.navigation.obstacles import footprint
    from tasks.shell import floor_ring

    bodies = {body.instance_id: body for body in replica.bodies if not is_door(body.category)}
    surfaces = {name: surface_of(body.shape.parts).transformed(body.pose) for name, body in bodies.items()}
    surfaces |= {name: surface_of([part]) for name, part in (*replica.shell, *replica.brackets) if name != "floor"}
    unseen = {name for name, _ in replica.brackets}
    climbed = {name: climbed_m(bodies[name].category, cart) if name in bodies else cart.climb_m for name in surfaces}
    obstacles = {name: footprint(surface, climbed[name], cart.height_m) for name, surface in surfaces.items()}
    plane = {name: cut(surface.to_trimesh(), lidar.height_m) for name, surface in surfaces.items() if name not in unseen}
    envelopes = {name: _envelope(surface) for name, surface in surfaces.items()}
    known = {name: carrier for name, carrier in carriers.items() if carrier is not None and name in bodies}
    flat = {name for name in bodies if envelopes[name].high <= climbed[name]}
    standing = frozenset(
        name
        for name, body in bodies.items()
        if not body.is_fixed and name not in flat and envelopes[name].low < cart.height_m and (name not in known or known[name] in flat)
    )
    return Floor(
        shapely.Polygon(floor_ring(replica.room)),
        {name: shapely.simplify(shape, DETAIL_M) for name, shape in obstacles.items() if not shape.is_empty},
        {name: segments for name, segments in plane.items() if len(segments)},
        known,
        standing,
        envelopes,
    )


def climbed_m(category: str, cart: Cart) -> float:
    """How much of an object of a category a cart drives over [m]."""
    from tasks.mounting import mounting

    return max(cart.climb_m, cart.covering_m) if mounting(category).kind == "covering" else cart.climb_m


def _envelope(surface: Surface) -> Envelope:
    import shapely

    low, high = (float(value) for value in surface.bounds[:, 2])
    return Envelope(shapely.MultiPoint(surface.vertices[:, :2]).convex_hull, low, high)


def outline(shape: shapely.Geometry) -> Array:
    """The boundary of polygons as segments, shape (n, 4)."""
    import shapely

    rings = [
        ring
        for part in shapely.get_parts(shape)
        if part.geom_type == "Polygon" and not part.is_empty
        for ring in (part.exterior, *part.interiors)
    ]
    return np.concatenate([np.zeros((0, 4)), *(_chain(shapely.get_coordinates(ring)) for ring in rings)])


def cut(mesh: trimesh.Trimesh, height: float) -> Array:
    """What a level plane cuts out of a surface, as segments, shape (n, 4) [m], to `DETAIL_M`."""
    import shapely
    import trimesh

    low, high = mesh.bounds[:, 2]
    if not low < height < high:
        return np.zeros((0, 4))
    pairs = trimesh.intersections.mesh_plane(mesh, [0.0, 0.0, 1.0], [0.0, 0.0, height])[:, :, :2]
    pairs = pairs[np.hypot(*(pairs[:, 1] - pairs[:, 0]).T) > 1e-9]
    if not len(pairs):
        return np.zeros((0, 4))
    joined = shapely.line_merge(shapely.union_all(shapely.linestrings(pairs), grid_size=1e-6))
    lines = [shapely.get_coordinates(line) for line in shapely.get_parts(shapely.simplify(joined, DETAIL_M))]
    return np.concatenate([np.zeros((0, 4)), *(_chain(line) for line in lines if len(line) > 1)])


def _chain(corners: Array) -> Array:
    """Segments between corners that follow each other, shape (n, 2) to (n - 1, 4)."""
    return np.concatenate([corners[:-1], corners[1:]], axis=1)
