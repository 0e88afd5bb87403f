"""The path finder `habitat`: habitat-sim's own navmesh and paths, where it is installed.

A scene is handed over as one stage, furniture and all; searches go through habitat-sim's `PathFinder`.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.errors import InputError
from schemas.machine.scratch import temporary_folder
from tasks.navigation.detour import ON_MESH_M, DetourPathFinder, from_above, space
from tasks.navigation.navmesh import Settings, dump_navmesh
from tasks.navigation.points import rows
from tasks.navigation.protocol import NO_PATH, Path, PathFinderKind
from tasks.navigation.triangles import scene_triangles
from tasks.navigation.voxels import Voxels

if TYPE_CHECKING:
    import shapely

    from schemas.capture import Shell
    from tasks.geometry.meshes import Surface
    from tasks.navigation.configuration import NavigationConfig

Array = NDArray[np.float64]

_SETTINGS = {
    "edge_max_length": "edge_max_len", "vertices_per_polygon": "verts_per_poly", "detail_sample_distance": "detail_sample_dist",
}  # fmt: skip
"""Settings that habitat-sim calls otherwise."""

_LOOK_M = 0.01
"""A move is looked at in steps of this [m]: habitat-sim's own step may round a thin corner."""


def bake_stage(vertices: ArrayLike, faces: ArrayLike, settings: Settings) -> bytes:
    """The .navmesh that habitat-sim bakes for a triangle soup; no bytes when nothing is walkable.

    Args:
        vertices: Corners in the glTF frame [m], shape (n, 3).
        faces: Triangles, outward counter-clockwise, shape (m, 3).
        settings: Of voxels and agent; they become the file's header.

    Raises:
        InputError: habitat-sim is not installed.
    """
    import trimesh

    sim = habitat_sim()
    asked = sim.NavMeshSettings()
    asked.set_defaults()
    for name, value in dataclasses.asdict(settings).items():
        setattr(asked, _SETTINGS.get(name, name), value)
    with temporary_folder() as folder:
        stage, config, out = (folder / name for name in ("scene.glb", "scene.stage_config.json", "scene.navmesh"))
        trimesh.Trimesh(np.asarray(vertices), np.asarray(faces), process=False).export(stage)
        # a stage without a config is taken as one with +Z up
        config.write_text(json.dumps({"render_asset": stage.name, "collision_asset": stage.name, "up": [0, 1, 0], "front": [0, 0, -1]}))
        backend = sim.SimulatorConfiguration()
        backend.scene_id, backend.create_renderer, backend.enable_physics = str(config), False, False
        agent = sim.AgentConfiguration()
        agent.sensor_specifications = []
        simulator = sim.Simulator(sim.Configuration(backend, [agent]))
        try:
            if not simulator.recompute_navmesh(simulator.pathfinder, asked):
                return b""
            simulator.pathfinder.save_nav_mesh(str(out))
        finally:
            simulator.close()
        return out.read_bytes()


@dataclasses.dataclass(frozen=True)
class HabitatConfig(Voxels):
    """Navmesh and paths by habitat-sim itself, where it is installed: the paper's path finder."""

    kind: ClassVar[str] = "habitat"


class HabitatPathFinder(DetourPathFinder):
    """habitat-sim's shortest paths on the polygons of a .navmesh, from the floor (z = 0), world frame [m]."""

    name = HabitatConfig.kind

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._sim = habitat_sim()
        self._finder = self._sim.PathFinder()
        if self.floor is not None:
            with temporary_folder() as folder:
                file = folder / "floor.navmesh"
                file.write_bytes(dump_navmesh(self.floor))
                if not self._finder.load_nav_mesh(str(file)):
                    raise InputError(
                        "scene.navmesh", "content", "habitat-sim does not load it", "bake it again with the habitat-sim in use"
                    )

    def _places(self, points: Array) -> tuple[Array, NDArray[np.int64]]:
        places = np.full((len(points), 2), np.nan)
        if self.floor is not None:
            for index, point in enumerate(space(points)):
                places[index] = from_above(np.array([self._finder.snap_point(point.astype(np.float32))], dtype=np.float64))[0]
        return places, self._polygons(places)

    def _polygons(self, places: Array) -> NDArray[np.int64]:
        """The polygon of the floor that each place, shape (n, 2), lies in or next to; -1 for NaN, shape (n,)."""
        result = np.full(len(places), -1, dtype=np.int64)
        if self.floor is None:
            return result
        starts, ends = self._edges
        along = ends - starts
        length = np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-12)
        for index in np.flatnonzero(np.isfinite(places).all(axis=1)):
            to = places[index] - starts
            outside = (along[..., 1] * to[..., 0] - along[..., 0] * to[..., 1]) / length
            result[index] = self.region.numbers[int(outside.max(axis=1).argmin())]
        return result

    @cached_property
    def _edges(self) -> tuple[Array, Array]:
        """Edges of the floor's polygons, shape (n, 6, 2) twice; polygons of fewer corners repeat one."""
        most = max(len(ring) for ring in self.region.rings)
        starts = np.array([ring[np.minimum(np.arange(most), len(ring) - 1)] for ring in self.region.rings])
        ends = np.array([ring[np.minimum(np.arange(1, most + 1), len(ring)) % len(ring)] for ring in self.region.rings])
        return starts, ends

    def field(self, goals: ArrayLike) -> HabitatField:
        """Distances and paths to the nearest of `goals`, shape (n, 2). Goals that are not navigable are never reached."""
        return HabitatField(self, rows(goals))

    def is_clear(self, start: ArrayLike, end: ArrayLike) -> bool:
        """Whether a straight move from a navigable point to anywhere, shape (2,) each, meets no edge of the navmesh."""
        a, b = rows(start)[0], rows(end)[0]
        if self.floor is None or math.dist(self._stepped(a, b), b) > ON_MESH_M:
            return False
        steps = max(1, math.ceil(math.dist(a, b) / _LOOK_M))
        return bool(self.is_navigable(a + np.arange(steps + 1)[:, None] / steps * (b - a)).all())

    def try_step(self, position: ArrayLike, offset: ArrayLike) -> Array:
        """Where a straight move of `offset` from a navigable point ends, shape (2,): at the first edge; no sliding."""
        start = rows(position)[0]
        end = start + rows(offset)[0]
        if self.is_clear(start, end):
            return np.asarray(end)
        stop = self._stepped(start, end)
        return stop if self.is_clear(start, stop) else start

    def _stepped(self, start: Array, end: Array) -> Array:
        """Where habitat-sim's step between points, shape (2,) each, ends."""
        a, b = space(np.array([start, end])).astype(np.float32)
        return from_above(np.array([self._finder.try_step_no_sliding(a, b)], dtype=np.float64))[0]

    def searched(self, start: Array, goal: Array) -> Array:
        """Corners of habitat-sim's path between navigable points, shape (2,) each, with exact ends; shape (0, 2) without one."""
        path = self._sim.ShortestPath()
        path.requested_start, path.requested_end = space(np.array([start, goal])).astype(np.float32)
        if not self._finder.find_path(path):
            return np.zeros((0, 2))
        corners = from_above(np.array(path.points, dtype=np.float64))
        corners[0], corners[-1] = start, goal
        return corners


class HabitatField:
    """Geodesic distance to the nearest of a set of goals by habitat-sim, measured on the floor."""

    def __init__(self, finder: HabitatPathFinder, goals: Array) -> None:
        self._finder, self._goals, self._islands = finder, goals, finder.island_of(goals)

    def distances(self, points: ArrayLike) -> Array:
        """Geodesic distances from points, shape (n, 2), to the nearest goal [m], shape (n,); infinite without a path."""
        return np.array([self.path(point).length for point in rows(points)], dtype=np.float64)

    def path(self, start: ArrayLike) -> Path:
        """Shortest path from `start`, shape (2,), to the nearest goal. A goal is tried only while its straight distance leaves hope."""
        point, best = rows(start)[0], NO_PATH
        island = int(self._finder.island_of(point)[0])
        if island < 0:
            return best
        straight = np.hypot(*(self._goals - point).T)
        for goal in np.argsort(straight, kind="stable"):
            if self._islands[goal] != island:
                continue
            if straight[goal] >= best.length:
                break
            corners = self._finder.searched(point, self._goals[goal])
            length = float(np.hypot(*np.diff(corners, axis=0).T).sum()) if len(corners) else math.inf
            if length < best.length:
                best = Path(length, corners, int(goal))
        return best


def habitat_sim(needed_by: str = "path_finder", instead: str = "set navigation.path_finder to recast or planar") -> Any:
    """habitat-sim's Python package, for what needs it, with what can be done without it.

    Raises:
        InputError: it is not installed, or does not import.
    """
    try:
        return importlib.import_module("habitat_sim")
    except ImportError as error:
        raise InputError("habitat_sim", needed_by, f"habitat needs this package: {error}", f"install habitat-sim, or {instead}") from error


def _build(room: Shell, surfaces: Sequence[Surface], walls: Sequence[shapely.Geometry], config: NavigationConfig) -> HabitatPathFinder:
    return HabitatPathFinder(bake_stage(*scene_triangles(room, surfaces, config.settings), config.settings))


HABITAT = PathFinderKind(name="habitat", config=HabitatConfig, build=_build)
