"""Scenes of which one large object is furnished anew: what stays of them, as rows of the new scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Room, RoomSurface, Shell
from schemas.errors import InputError
from schemas.optimization import Placement
from schemas.selection import Selection
from tasks.geometry.boxes import oriented_iou
from tasks.geometry.transforms import matrix
from tasks.micro_scenes.boxes import StandingBox, standing_box
from tasks.synthesis.layout import Array
from tasks.synthesis.scenes.assets import PROVIDER, VERSION
from tasks.synthesis.scenes.drawn import BaseScene


@dataclasses.dataclass(frozen=True)
class Kept:
    """Rows that stay, of the new scene. frame: Of the large object to the world frame, 4x4 [m]. poses: Asset, pose to the world frame, 4x4
    [m], and scale of everything that stands there."""

    frame: Array
    shell: Shell
    rooms: list[Room]
    surfaces: list[RoomSurface]
    instances: list[Instance]
    captions: list[Caption]
    candidates: list[Candidate]
    selections: list[Selection]
    assets: list[Asset]
    poses: list[tuple[str, Array, tuple[float, ...]]]


def large_box(base: BaseScene) -> StandingBox:
    """The box of the large object, at its optimized pose; its pose is the frame of the micro-scene.

    Raises:
        InputError: nothing was placed for it.
    """
    row = next((row for row in base.placements if row.instance_id == base.instance_id), None)
    asset = next((asset for asset in base.assets if row is not None and asset.asset_id == row.asset_id), None)
    if row is None or asset is None:
        raise InputError(
            base.scene.scene_id, base.instance_id, "has no asset that stands for it", "run the optimization of its scene first"
        )
    return standing_box(base.instance_id, asset.extents, row.scale, matrix(row.optimized_pose))


def kept_of(base: BaseScene, scene_id: str) -> Kept:
    """What stays: all but the small objects of the large one, at their optimized poses."""
    frame = large_box(base).pose
    instances = [
        dataclasses.replace(row, scene_id=scene_id, view_blob=None, best_frames=())
        for row in base.instances
        if row.instance_id not in base.belonging
    ]
    names = {row.instance_id for row in instances}
    placements = [row for row in base.placements if row.instance_id in names]
    offered = {(row.instance_id, row.asset_id): row for row in base.candidates}
    scored = {(row.instance_id, row.asset_id): row for row in sorted(base.selections, key=lambda row: -row.rank)}
    assets = {asset.asset_id: asset for asset in base.assets}
    candidates, selections = [], []
    for row in placements:
        key = row.instance_id, row.asset_id
        candidate = offered.get(key)
        made = Candidate(
            scene_id=scene_id, instance_id=row.instance_id, slot=1, provider=assets[row.asset_id].provider, provider_version=VERSION,
            is_fallback=False, outcome="filled", reason=None, asset_id=row.asset_id, seed=None, call_id=None,
            library=None, library_file=None, library_score=None,
            twin_of=None, seen_share=None, seconds=None,
        )  # fmt: skip
        candidates.append(made if candidate is None else dataclasses.replace(candidate, scene_id=scene_id))
        selections.append(_selection(row, candidates[-1].slot, scored.get(key), assets[row.asset_id], base.instances, scene_id))
    return Kept(
        frame=frame,
        shell=dataclasses.replace(base.shell, scene_id=scene_id),
        rooms=[dataclasses.replace(room, scene_id=scene_id) for room in base.rooms],
        surfaces=[dataclasses.replace(surface, scene_id=scene_id) for surface in base.surfaces],
        instances=instances,
        captions=[dataclasses.replace(row, scene_id=scene_id) for row in base.captions if row.instance_id in names],
        candidates=candidates,
        selections=selections,
        assets=[assets[asset_id] for asset_id in sorted({row.asset_id for row in placements})],
        poses=[(row.asset_id, matrix(row.optimized_pose), row.scale) for row in placements],
    )


def _selection(
    row: Placement, slot: int, scored: Selection | None, asset: Asset, instances: Sequence[Instance], scene_id: str
) -> Selection:
    """The asset where the optimization left it; scored as it was, else by its box alone, where people or a dataset brought it."""
    if scored is not None:
        return dataclasses.replace(
            scored, scene_id=scene_id, rank=1, slot=slot, pose=row.optimized_pose, scale=row.scale, look=None
        )  # fmt: skip
    box = standing_box(row.instance_id, asset.extents, row.scale, matrix(row.optimized_pose))
    own = next(instance for instance in instances if instance.instance_id == row.instance_id)
    middle = box.pose.copy()
    middle[:3, 3] = box.center
    share = oriented_iou(middle, box.size, own.box_pose, own.box_size)
    apart = float(np.linalg.norm(box.center - matrix(own.box_pose)[:3, 3]))
    return Selection(
        scene_id=scene_id, instance_id=row.instance_id, rank=1, slot=slot, asset_id=row.asset_id, score=share, chamfer_m=apart,
        coverage=share, box_iou=share, foreign_share=None, color_similarity=0.0, pose=row.optimized_pose, scale=row.scale, look=None,
        provider=PROVIDER, provider_version=VERSION,
    )  # fmt: skip


def with_origins(placements: Sequence[Placement], drawn: frozenset[str], base: Sequence[Placement], origin: str) -> list[Placement]:
    """Placements of a synthesized scene: drawn objects have `origin`, those of the base what they had there."""
    before = {row.instance_id: row for row in base}
    made = []
    for row in placements:
        was = before.get(row.instance_id)
        if row.instance_id in drawn:
            row = dataclasses.replace(row, origin=origin)
        elif was is not None:
            row = dataclasses.replace(row, origin=was.origin, annotator=was.annotator, annotation_match=was.annotation_match)
        made.append(row)
    return made
