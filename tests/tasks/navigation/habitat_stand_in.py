"""What the adapter to habitat-sim uses of its Python package, on the project's own library, which golden data shows to agree with it."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import trimesh

from tasks.navigation import recast
from tasks.navigation.navmesh import Settings


class NavMeshSettings:
    """habitat-sim's names; anything else is refused, as its compiled class does."""

    __slots__ = (
        "agent_height", "agent_max_climb", "agent_max_slope", "agent_radius", "cell_height", "cell_size", "detail_sample_dist",
        "detail_sample_max_error", "edge_max_error", "edge_max_len", "filter_ledge_spans", "filter_low_hanging_obstacles",
        "filter_walkable_low_height_spans", "include_static_objects", "region_merge_size", "region_min_size", "verts_per_poly",
    )  # fmt: skip

    def set_defaults(self) -> None:
        self.cell_size, self.cell_height, self.agent_height, self.agent_radius, self.agent_max_climb = 0.05, 0.2, 1.5, 0.1, 0.2
        self.agent_max_slope, self.region_min_size, self.region_merge_size, self.edge_max_len = 45.0, 20.0, 20.0, 12.0
        self.edge_max_error, self.verts_per_poly, self.detail_sample_dist, self.detail_sample_max_error = 1.3, 6.0, 6.0, 1.0
        self.filter_low_hanging_obstacles = self.filter_ledge_spans = self.filter_walkable_low_height_spans = True
        self.include_static_objects = False


class ShortestPath:
    def __init__(self) -> None:
        self.requested_start = self.requested_end = np.zeros(3, dtype=np.float32)
        self.points: list[np.ndarray] = []
        self.geodesic_distance = float("inf")


class PathFinder:
    def __init__(self) -> None:
        self._mesh: recast.RecastMesh | None = None

    @property
    def is_loaded(self) -> bool:
        return self._mesh is not None

    def load_nav_mesh(self, path: str) -> bool:
        self._mesh = recast.RecastMesh.load(Path(path).read_bytes())
        return True

    def save_nav_mesh(self, path: str) -> bool:
        Path(path).write_bytes(self._mesh.save())
        return True

    def snap_point(self, point: np.ndarray) -> np.ndarray:
        return self._mesh.snap(point)[0][0].astype(np.float32)

    def find_path(self, path: ShortestPath) -> bool:
        path.geodesic_distance, corners = self._mesh.path(path.requested_start, path.requested_end)
        path.points = list(corners)
        return bool(np.isfinite(path.geodesic_distance))

    def try_step_no_sliding(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        a, b = start.astype(np.float64), end.astype(np.float64)
        share = self._mesh.clear_share(a[[0, 2]] * (1, -1), b[[0, 2]] * (1, -1))
        return (a + share * (b - a)).astype(np.float32)


class Simulator:
    """Loads a stage by its config and bakes it. It wants what the real one wants: an upright stage and no window."""

    def __init__(self, configuration: SimpleNamespace) -> None:
        backend = configuration.backend
        assert backend.create_renderer is False
        config = Path(backend.scene_id)
        assert config.name.endswith(".stage_config.json")
        stage = json.loads(config.read_text())
        assert stage["up"] == [0, 1, 0]
        mesh = trimesh.load(config.parent / stage["render_asset"], force="mesh", process=False)
        self._vertices, self._faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        self.pathfinder, self._open = PathFinder(), True

    def recompute_navmesh(self, pathfinder: PathFinder, settings: NavMeshSettings) -> bool:
        assert self._open
        data = recast.bake(
            self._vertices,
            self._faces,
            Settings(
                settings.cell_size, settings.cell_height, settings.agent_height, settings.agent_radius, settings.agent_max_climb,
                settings.agent_max_slope, settings.region_min_size, settings.region_merge_size, settings.edge_max_len,
                settings.edge_max_error, settings.verts_per_poly, settings.detail_sample_dist, settings.detail_sample_max_error,
                settings.filter_low_hanging_obstacles, settings.filter_ledge_spans, settings.filter_walkable_low_height_spans,
                settings.include_static_objects,
            ),
        )  # fmt: skip
        pathfinder._mesh = recast.RecastMesh.load(data) if data else None
        return bool(data)

    def close(self) -> None:
        self._open = False


def SimulatorConfiguration() -> SimpleNamespace:
    return SimpleNamespace(scene_id="", create_renderer=True, enable_physics=False)


def AgentConfiguration() -> SimpleNamespace:
    return SimpleNamespace(sensor_specifications=["rgb"])


def Configuration(backend: SimpleNamespace, agents: list[SimpleNamespace]) -> SimpleNamespace:
    return SimpleNamespace(backend=backend, agents=agents)
