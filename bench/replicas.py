"""Generated rooms as replicas: optimized, certified, with a navmesh and episodes; rows up to the exports stage."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.rooms import BenchScene
from schemas.capture import Scene
from schemas.optimization import Placement
from tasks import navigation, optimization
from tasks.geometry.transforms import flat
from tasks.navigation import NavigationConfig
from tasks.optimization import OptimizationConfig
from tasks.stage import Blobs, Caches, Context


def as_replica(
    scene: BenchScene, seed: int, caches: Caches, config: NavigationConfig | None = None
) -> tuple[dict[str, list[Any]], Mapping[str, bytes], dict[str, float]]:
    """Rows by table, the blobs that they name, and seconds by stage.

    What the stages read of a scene and a generated room does not have is filled in as a scan without frames would have it.
    """
    blobs = Blobs()
    blobs.update(scene.blobs)
    rows: dict[str, list[Any]] = {**scene.rows, "scenes": [_scene_row(scene, blobs)]}
    seconds: dict[str, float] = {}
    for stage, settings in ((optimization.STAGE, OptimizationConfig()), (navigation.STAGE, config or NavigationConfig())):
        clock = time.perf_counter()
        context = Context(scene.scene_id, stage.name, seed, blobs, caches)
        outcome = stage.run(
            **{table: rows[table] for table in dict.fromkeys((*stage.reads, *stage.history))}, context=context, config=settings
        )
        seconds[stage.name] = time.perf_counter() - clock
        rows |= outcome.rows
        blobs.update(outcome.blobs)
    return rows, blobs, seconds


def as_drawn(scene: BenchScene) -> tuple[dict[str, list[Any]], Mapping[str, bytes]]:
    """Rows up to the navigation stage of a generated room with everything where the generator put it, and the blobs that they name."""
    blobs = Blobs()
    blobs.update(scene.blobs)
    placements = [
        Placement(
            scene_id=row.scene_id, instance_id=row.instance_id, asset_id=row.asset_id, origin="selection", annotator=None,
            annotation_match=None, scale=row.scale, proposed_pose=row.pose, optimized_pose=flat((scene.drawn_poses or {})[row.instance_id]),
            displacement_m=0.0, lift_m=0.0, method="default", settled_pose=None, remains=None,
            collider_pieces=None, collider_faces=None, collider_early_share=None, collider_miss_share=None,
            collider_blob=None, collider_cut_share=None, collider_distance_m=None, fidelity_loss=None,
        )
        for row in scene.rows["selections"]
    ]  # fmt: skip
    return {**scene.rows, "scenes": [_scene_row(scene, blobs)], "placements": placements}, blobs


def _scene_row(scene: BenchScene, blobs: Blobs) -> Scene:
    dataset, scan = scene.scene_id.split("/", 1)
    return Scene(
        scene_id=scene.scene_id, room_id=scene.scene_id, dataset=dataset, scan=scan, scan_format="glb", scan_path="-",
        alignment=flat(np.eye(4)), alignment_source="identity", to_original=flat(np.eye(4)),
        floor_tilt_radians=0.0, mesh_blob=blobs.add(b"none", "glb"),
        vertex_count=3, face_count=1, frame_count=0, instance_count=len(scene.rows["instances"]), segmentation="file",
        license="Apache-2.0",
    )  # fmt: skip
