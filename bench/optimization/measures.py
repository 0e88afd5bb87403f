"""Measures of placed objects by other means than the optimization's: what is below each by rays, and what is out of the room.

Shared with it are the convex pieces that objects are, as in every simulator, the rays' library, and the table of what hangs,
stands and covers. Not shared are its search for carriers, its gaps, its depths and its outlines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import inverse
from tasks.mounting import mounting
from tasks.optimization.solids import ConvexParts

Array = NDArray[np.float64]

FLOOR = "floor"

TOUCH_M = 0.01
"""A gap below this is contact: a simulator closes it without anything to be seen."""

SUNK_M = 0.03
"""How deep an object may be in what carries it and still count as carried by it [m]."""

BASE_M = 0.02
"""What of an object lies within this of its lowest point is what it stands on [m]."""

SAMPLES_PER_M2 = 4000.0
"""Rays per area of surface: one for every 1.6 cm square."""

OUTSIDE_M = 0.01
"""What reaches less far over the floor's edge is rounding and baseboards [m]."""

OFF_WALL_M = 0.05
"""A back nearer to the wall than this hangs on it: mirrors and cabinets have brackets [m]."""


class Measures:
    """A scene's solids in their own frames [m], ready to be measured at any poses. categories: by name."""

    def __init__(self, solids: Sequence[ConvexParts], categories: Mapping[str, str], polygon: Array, height: float) -> None:
        import shapely
        import trimesh

        self.names = [solid.name for solid in solids]
        self.floor, self.height = shapely.Polygon(polygon) if len(polygon) > 2 else None, height
        shapely.prepare(self.floor)
        self.points: dict[str, Array] = {}
        self.casts: dict[str, RayScene] = {}
        self.coverings = {name for name in self.names if mounting(categories.get(name, "")).kind == "covering"}
        for solid in solids:
            meshes = [trimesh.Trimesh(hull.vertices, hull.faces, process=False) for hull in solid.hulls]
            self.casts[solid.name] = RayScene(meshes)
            self.points[solid.name] = np.concatenate([_scattered(mesh) for mesh in meshes])

    def at(self, poses: Mapping[str, Array]) -> Posed:
        """The solids at poses, to the world, 4x4 by name [m]."""
        return Posed(self, poses)


class Posed:
    """The solids of a scene at some poses."""

    def __init__(self, measures: Measures, poses: Mapping[str, Array]) -> None:
        self._of, self._poses = measures, poses
        self._world = {name: measures.points[name] @ poses[name][:3, :3].T + poses[name][:3, 3] for name in measures.names}
        self._low = np.array([self._world[name].min(axis=0) for name in measures.names]).reshape(-1, 3)
        self._high = np.array([self._world[name].max(axis=0) for name in measures.names]).reshape(-1, 3)

    def gaps(self, name: str) -> dict[str, float]:
        """Height of an object's base above each object below it, and above the floor [m]; negative where it sinks in.

        The least over its base. Only what lies at most `SUNK_M` above the base counts.
        """
        world = self._world[name]
        base = world[world[:, 2] <= world[:, 2].min() + BASE_M]
        gaps = {FLOOR: float(base[:, 2].min())}
        low, high = base.min(axis=0), base.max(axis=0)
        above = (self._high[:, :2] >= low[:2]).all(axis=1) & (self._low[:, :2] <= high[:2]).all(axis=1)
        near = above & (self._low[:, 2] <= high[2] + SUNK_M)
        origins = base + np.array([0.0, 0.0, SUNK_M])
        for index in np.flatnonzero(near):
            other = self._of.names[index]
            if other == name:
                continue
            into = inverse(self._poses[other])
            start, way = origins @ into[:3, :3].T + into[:3, 3], into[:3, :3] @ [0.0, 0.0, -1.0]
            hits = self._of.casts[other].cast(np.column_stack([start, np.tile(way, (len(start), 1))]).astype(np.float32))
            upward = hits["primitive_normals"] @ -way > 0.05
            gap = hits["t_hit"][upward & np.isfinite(hits["t_hit"])]
            if len(gap):
                gaps[other] = float(gap.min()) - SUNK_M
        return gaps

    def carriers(self, name: str) -> tuple[set[str], float]:
        """What an object touches with its base, and the gap to the nearest object below it [m]. A rug counts as the floor."""
        gaps = self.gaps(name)
        touched = {other for other, gap in gaps.items() if gap <= TOUCH_M}
        if touched & self._of.coverings:
            touched.add(FLOOR)
        return touched, min(gaps.values())

    def reach_outside(self, name: str) -> float:
        """How far an object reaches over the floor's edge [m]; 0 inside and where no floor is known."""
        import shapely

        if self._of.floor is None:
            return 0.0
        plan = self._world[name][:, :2]
        beyond = plan[~shapely.contains_xy(self._of.floor, plan)]
        return float(shapely.distance(shapely.points(beyond), self._of.floor).max(initial=0.0))

    def off_wall(self, name: str) -> float:
        """Distance of an object from the nearest wall of the room [m]."""
        import shapely

        if self._of.floor is None:
            return 0.0
        return float(shapely.distance(shapely.points(self._world[name][:, :2]), self._of.floor.boundary).min())

    def below_ceiling(self, name: str) -> float:
        """Distance of an object's top from the ceiling [m]."""
        return abs(self._of.height - float(self._world[name][:, 2].max()))


def _scattered(mesh: object) -> Array:
    """Corners of a convex piece, and points spread over its surface, drawn by one fixed rule; shape (n, 3) [m]."""
    import trimesh

    assert isinstance(mesh, trimesh.Trimesh)
    vertices, count = np.asarray(mesh.vertices), int(np.ceil(SAMPLES_PER_M2 * float(mesh.area)))
    rng = np.random.default_rng(0)
    areas = np.asarray(mesh.area_faces)
    corners = vertices[np.asarray(mesh.faces)[rng.choice(len(areas), count, p=areas / areas.sum())]]
    u, v = rng.random((2, count, 1))
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    return np.concatenate([vertices, corners[:, 0] + u * (corners[:, 1] - corners[:, 0]) + v * (corners[:, 2] - corners[:, 0])])
