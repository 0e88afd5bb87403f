"""The floor of a replica as a cart meets it: what it runs into, and what its lidar sees of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.robot.configuration import Cart, Lidar

if TYPE_CHECKING:
    import shapely
    import trimesh

    from tasks.exports.bodies import Replica

Array = NDArray[np.float64]

DETAIL_M = 0.002
"""Outlines are told to this [m]: scanned surfaces have thousands of edges, and a lidar errs by five times as much."""

EDGE = "edge of the floor"
"""What bounds the floor, as an obstacle."""


@dataclasses.dataclass(frozen=True)
class Floor:
    """Where a cart can be, world frame [m].

    polygon: The floor. obstacles: By name, what lies between what the cart climbs and its top, seen from above. plane: By name, what the
    lidar's plane cuts out of it: segments, x and y of both ends, shape (n, 4). Names are instances and parts of the shell. carriers: By
    instance, the instance that carries it. standing: Instances that stand on the floor.
    """

    polygon: shapely.Polygon
    obstacles: Mapping[str, shapely.Geometry]
    plane: Mapping[str, Array]
    carriers: Mapping[str, str]
    standing: frozenset[str]

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
    """The floor of a replica; doors are open. carriers: By instance, the instance that carries it, None for what floor or walls do."""
    import shapely

    from tasks.exports.nav2 import is_door
    from tasks.geometry.meshes import surface_of
    from tasks.navigation.obstacles import footprint
    from tasks.shell import floor_ring

    named = {body.instance_id: body.shape.parts for body in replica.bodies if not is_door(body.category)}
    poses = {body.instance_id: body.pose for body in replica.bodies}
    obstacles, plane = {}, {}
    for name, parts in named.items():
        surface = surface_of(parts).transformed(poses[name])
        obstacles[name] = footprint(surface, cart.climb_m, cart.height_m)
        plane[name] = cut(surface.to_trimesh(), lidar.height_m)
    for name, part in replica.shell:
        if name == "floor":
            continue
        obstacles[name] = footprint(surface_of([part]), cart.climb_m, cart.height_m)
        plane[name] = cut(part, lidar.height_m)
    kept = {name: shapely.simplify(shape, DETAIL_M) for name, shape in obstacles.items() if not shape.is_empty}
    standing = frozenset(name for name in named if carriers.get(name) is None and poses[name][2, 3] < cart.height_m)
    known = {name: carrier for name, carrier in carriers.items() if carrier is not None and name in named}
    floor = shapely.Polygon(floor_ring(replica.room))
    return Floor(floor, kept, {name: segments for name, segments in plane.items() if len(segments)}, known, standing)


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
