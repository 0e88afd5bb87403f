"""Replicas of dwellings, as the lake has them: rows, and surfaces that rays can be cast at."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.capture import Instance, Room, Scene, Shell
from schemas.fidelity import SceneFidelity
from schemas.optimization import Certificate, Optimization, Placement, Support
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import inverse, matrix
from tasks.replica import placed_parts
from tasks.shell import room_shell
from warehouse.lake import Lake

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class BenchReplica:
    """What the pipeline made of a scan. placements, supports, certificates (MuJoCo's), instances by instance id; assets by asset id.
    parts: (instance id, or the part of the shell, mesh in the world frame)."""

    scene: Scene
    room: Shell | None
    rooms: list[Room]
    instances: dict[str, Instance]
    placements: dict[str, Placement]
    supports: dict[str, Support]
    certificates: dict[str, Certificate]
    assets: dict[str, Asset]
    optimization: Optimization | None
    fidelity: SceneFidelity | None
    parts: list[tuple[str, trimesh.Trimesh]]

    def true_to_world(self, scan_to_true: Array) -> Array:
        """From the frame that the truth is in to the replica's world, 4x4: both know the scan's."""
        return np.asarray(matrix(self.scene.alignment) @ inverse(scan_to_true))


class FirstHits:
    """What rays meet first, by name."""

    def __init__(self, parts: list[tuple[str, trimesh.Trimesh]]) -> None:
        self._names = np.array([name for name, _ in parts], dtype=object)
        self._scene = RayScene([mesh for _, mesh in parts])

    def first(self, eye: Array, points: Array) -> list[str | None]:
        """What is met first on the way from an eye through points, shape (n, 3) [m], and beyond; None for nothing."""
        way = points - eye
        hits = self._scene.cast(np.column_stack([np.tile(eye, (len(points), 1)), way]).astype(np.float32))
        met = np.isfinite(hits["t_hit"])
        return [str(self._names[int(k)]) if ok else None for k, ok in zip(hits["geometry_ids"].astype(np.int64), met, strict=True)]

    def distances(self, eye: Array, points: Array) -> Array:
        """Distances from an eye to what is met first in the direction of points, shape (n, 3) [m]; infinite where nothing is met."""
        way = points - eye
        hits = self._scene.cast(np.column_stack([np.tile(eye, (len(points), 1)), way]).astype(np.float32))
        return np.asarray(hits["t_hit"], dtype=np.float64) * np.linalg.norm(way, axis=1)


def replica_of(lake: Lake, scene_id: str) -> BenchReplica:
    """What the newest snapshot of a lake has of a scene."""
    reader = lake.snapshot()
    shells, optimizations = reader.rows(Shell, scene_id), reader.rows(Optimization, scene_id)
    fidelities = reader.rows(SceneFidelity, scene_id)
    placements = {row.instance_id: row for row in reader.rows(Placement, scene_id)}
    assets = {row.asset_id: row for row in reader.rows_by_key(Asset, sorted({row.asset_id for row in placements.values()}))}
    parts: list[tuple[str, trimesh.Trimesh]] = list(room_shell(shells[0])) if shells else []
    for name, row in sorted(placements.items()):
        parts += [(name, part) for part in placed_parts(row, lake.blobs[assets[row.asset_id].mesh_blob])]
    return BenchReplica(
        scene=reader.rows(Scene, scene_id)[0],
        room=shells[0] if shells else None,
        rooms=reader.rows(Room, scene_id),
        instances={row.instance_id: row for row in reader.rows(Instance, scene_id)},
        placements=placements,
        supports={row.instance_id: row for row in reader.rows(Support, scene_id)},
        certificates={row.instance_id: row for row in reader.rows(Certificate, scene_id) if row.engine == "mujoco"},
        assets=assets,
        optimization=optimizations[0] if optimizations else None,
        fidelity=fidelities[0] if fidelities else None,
        parts=parts,
    )
