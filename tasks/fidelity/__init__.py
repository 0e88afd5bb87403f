"""Fidelity: what a replica keeps of its scan, what it loses, and what it adds.

All that is needed lies in the lake. Capture leaves the whole scan mesh (`scenes.mesh_blob`), the faces of every instance
(`instances.mesh_blob`) and the poses of the frames (`frames`), all in the world frame; what of the mesh lies beside every
instance's faces is unlabeled. So the stage reads rows alone: it computes again when they change, not when the scan's folder
moves, and on a machine that has no scans.

Only what the scan's cameras could see of the replica counts (`tasks.fidelity.visibility`): of a cupboard's back nobody knows
anything. Space that the scan saw empty is carved by the same rays, point by point in place of a grid's cells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.candidates import Asset
from schemas.capture import Frame, Instance, RoomSurface, Scene, Shell
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.fidelity.cameras import frame_cameras, virtual_cameras
from tasks.fidelity.configuration import FidelityConfig
from tasks.fidelity.marked_points import dump_marked
from tasks.fidelity.measures import agreement, sample_scan
from tasks.fidelity.pictures import likeness
from tasks.fidelity.replicas import ReplicaRays, replica_surface
from tasks.fidelity.rows import object_row, scene_row
from tasks.fidelity.scans import scanned_surface
from tasks.geometry.rendering import RayScene
from tasks.shell import ShellConfig
from tasks.stage import Blobs, Context, Outcome, Stage

__all__ = ["STAGE", "FidelityConfig", "run"]


def run(
    *,
    scenes: Sequence[Scene],
    shells: Sequence[Shell],
    frames: Sequence[Frame],
    instances: Sequence[Instance],
    placements: Sequence[Placement],
    assets: Sequence[Asset],
    context: Context,
    config: FidelityConfig,
    surfaces: Sequence[RoomSurface] = (),
) -> Outcome:
    """A row for every object, one for the scene, and the scan's points with their distance to the replica.

    Raises:
        InputError: the scene has no row, a mesh cannot be read, or a placement names an asset that is not there.
    """
    if not scenes:
        raise InputError(context.scene_id, "scenes", "has no row for this scene", "run the capture stage again")
    objects = {i.instance_id for i in instances if not i.is_structure}
    scan = scanned_surface(scenes[0], instances, context.blobs)
    room = shells[0] if shells else None
    placed = [p for p in placements if p.instance_id in objects]
    replica = replica_surface(room, placed, assets, context.blobs, surfaces, ShellConfig(ceiling=config.ceiling))
    samples = sample_scan(scan, config, context.rng)
    cameras, source = frame_cameras(frames, config.max_cameras, config.picture_width), "frames"
    notes = [f"{name}: it has no faces, its points stand in for them" for name in scan.bare]
    if not cameras:
        cameras, source = virtual_cameras(room, samples.points, config.picture_width), "virtual"
        notes.append("no frame has a pose: what could be seen was decided by virtual cameras in the scan's free space")
    scan_rays, replica_rays = RayScene(scan.parts), ReplicaRays(replica)
    measured = agreement(scan, replica, samples, scan_rays, replica_rays, cameras, config, context.rng)
    shown = [cameras[i] for i in np.linspace(0, len(cameras) - 1, min(config.max_pictures, len(cameras))).round().astype(int)]
    alike = likeness(scan_rays, replica_rays, replica.owners, shown)
    blobs = Blobs()
    points = blobs.add(dump_marked(measured.marked), "ply")
    return Outcome(
        fidelity=[object_row(context.scene_id, name, row, alike) for name, row in measured.objects.items()],
        scene_fidelity=[scene_row(context.scene_id, scan, measured, alike, source, len(cameras), points)],
        blobs=blobs,
        degradations=notes,
    )


STAGE = Stage(
    name="fidelity",
    reads=("scenes", "shells", "surfaces", "frames", "instances", "placements", "assets"),
    writes=("fidelity", "scene_fidelity"),
    config=FidelityConfig,
    run=run,
)
