"""Rows of a drawn scene, of the stages from capture to selection, as if somebody had scanned it."""

from __future__ import annotations

import dataclasses
from collections import ChainMap
from collections.abc import Mapping, MutableMapping, Sequence
from typing import cast

import numpy as np

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import SYNTHESIS, Instance, Room, RoomSurface, Scene, Shell
from schemas.selection import Selection
from schemas.synthesis import Synthesis, SynthesisObject
from tasks import captions as captioning
from tasks.capture.labels import label_map
from tasks.geometry.meshes import Surface, asset_surface, dump_glb, dump_points, sample_surface, surface_of, union_of
from tasks.geometry.transforms import flat, inverse, yaw_pose
from tasks.geometry.triangles import surface_area
from tasks.optimization import OptimizationConfig
from tasks.shell import room_shell
from tasks.stage import Blobs, Context, Outcome
from tasks.synthesis.layout import Array
from tasks.synthesis.metrics.boxes import colliding, floating, off_edge
from tasks.synthesis.scenes.assets import PROVIDER, VERSION, StandIn, Style, stand_for
from tasks.synthesis.scenes.bases import Kept, kept_of
from tasks.synthesis.scenes.drawn import BaseScene, Drawn, small_ids
from tasks.synthesis.scenes.rooms import plain_room
from tasks.synthesis.scenes.verdicts import stable_as_drawn

LARGE_ID = "0000"
"""Of the large object in a room of its own."""

SAMPLES_PER_M2, LEAST_SAMPLES, MOST_SAMPLES = 4000, 200, 4000
"""Points on an object: as capture spreads them, and no more than captions need."""


@dataclasses.dataclass(frozen=True)
class _Placed:
    """An object where it was drawn. pose: Asset to world frame, 4x4 [m]. size: Extents of its box [m], shape (3,)."""

    instance_id: str
    stand: StandIn
    pose: Array
    size: tuple[float, ...]
    surface: Surface

    @property
    def box_pose(self) -> Array:
        """Its box to the world frame, origin at the middle, 4x4 [m]."""
        return np.asarray(self.pose @ yaw_pose(0.0, [0.0, 0.0, 0.5 * self.size[2]]))


def drawn_rows(
    drawn: Drawn, dataset: str, chosen: Sequence[Asset | None], base: BaseScene | None, context: Context, config: OptimizationConfig
) -> dict[str, Outcome]:
    """Rows by stage, in the order of the data path. Assets that are made are among the outcome of candidates.

    chosen: An asset of the lake for each box, the large object's first unless there is a base, None for those to be made. config: As the
    optimization has it: it says how objects are simulated where they were drawn.
    """
    frame, kept = np.eye(4), None
    if base is not None:
        kept = kept_of(base, drawn.scene_id)
        frame = kept.frame
    shell, rooms, surfaces = (kept.shell, kept.rooms, kept.surfaces) if kept is not None else _room_of(drawn)
    placed = _placed(drawn, chosen, base, frame, context)
    room_index = next((row.room_index for row in base.instances if row.instance_id == base.instance_id), None) if base is not None else 0
    blobs = Blobs()
    for item in placed:
        blobs.update(item.stand.files)
    instances = [_instance(drawn, item, room_index, blobs) for item in placed]
    known = dataclasses.replace(context, blobs=_with(blobs, context.blobs))
    captioned = captioning.run(instances=instances, frames=[], masks=[], context=known, config=captioning.CaptionsConfig())
    candidates = [_candidate(drawn, item) for item in placed]
    selections = [_selection(drawn, item) for item in placed]
    assets = {item.stand.asset.asset_id: item.stand.asset for item in placed}
    captions: list[Caption] = captioned.rows["captions"]
    if kept is not None:
        instances, captions = [*kept.instances, *instances], [*kept.captions, *captions]
        candidates, selections = [*kept.candidates, *candidates], [*kept.selections, *selections]
        assets |= {asset.asset_id: asset for asset in kept.assets}
    stable = stable_as_drawn(instances, captions, selections, shell, list(assets.values()), known, config)
    syntheses, objects = _syntheses(drawn, base, frame, placed, stable)
    scene = _scene(drawn, dataset, base, instances, shell, _whole(kept, assets, placed, known), blobs)
    return {
        "capture": Outcome(
            scenes=[scene], shells=[shell], rooms=rooms, surfaces=surfaces, frames=[], instances=instances, masks=[],
            syntheses=syntheses, synthesis_objects=objects, blobs=blobs,
        ),
        "captions": Outcome(captions=captions, degradations=captioned.degradations),
        "candidates": Outcome(
            candidates=candidates, assets=sorted(assets.values(), key=lambda row: row.asset_id), texture_charts=[], blobs=blobs
        ),
        "selection": Outcome(selections=selections),
    }  # fmt: skip


def _with(files: Mapping[str, bytes], blobs: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """Files beside blobs; nothing is copied but the names of the files."""
    return ChainMap(dict(files), cast("MutableMapping[str, bytes]", blobs))  # only the first one is ever written to


def _room_of(drawn: Drawn) -> tuple[Shell, list[Room], list[RoomSurface]]:
    shell, room = plain_room(drawn)
    return shell, [room], []


def _placed(drawn: Drawn, chosen: Sequence[Asset | None], base: BaseScene | None, frame: Array, context: Context) -> list[_Placed]:
    """What stands for the boxes of a layout, the large object's first unless a base has it."""
    layout, style, cache = drawn.layout, Style.drawn(drawn.rng("style")), context.caches["tasks.geometry.meshes"]
    names = small_ids(len(layout), () if base is None else [row.instance_id for row in base.instances])
    wanted: list[tuple[str, str, tuple[float, ...], Array, str]] = []
    if base is None:
        wanted.append((LARGE_ID, layout.large.category, layout.large.size, np.eye(4), drawn.word))
    for name, category, center, size, yaw in zip(names, layout.categories, layout.centers, layout.sizes, layout.yaws, strict=True):
        pose = frame @ yaw_pose(float(yaw), center - [0.0, 0.0, 0.5 * size[2]])
        wanted.append((name, category, tuple(float(value) for value in size), pose, ""))
    placed = []
    for (name, category, size, pose, word), asset in zip(wanted, chosen, strict=True):
        stand = stand_for(category, size, asset, style, drawn.rng("asset", name), word)
        files = _with(stand.files, context.blobs)
        surface = asset_surface(stand.asset.mesh_blob, files, f"{stand.asset.name}.glb", cache).transformed(pose, stand.scale)
        placed.append(_Placed(name, stand, pose, size, surface))
    return placed


def _instance(drawn: Drawn, item: _Placed, room_index: int | None, blobs: Blobs) -> Instance:
    area = surface_area(item.surface.vertices, item.surface.faces)
    count = int(np.clip(area * SAMPLES_PER_M2, LEAST_SAMPLES, MOST_SAMPLES))
    points, colors, _ = sample_surface(item.surface, count, drawn.rng("points", item.instance_id))
    label = label_map()[item.stand.word]
    return Instance(
        scene_id=drawn.scene_id, instance_id=item.instance_id, source_id=item.instance_id, raw_label=item.stand.word,
        category=item.stand.word,
        nyu40_id=label.nyu40_id, nyu40_label=label.nyu40_label, is_structure=False, found_by=SYNTHESIS,
        category_probability=None, room_index=room_index, box_pose=flat(item.box_pose), box_size=item.size,
        box_volume_m3=float(np.prod(item.size)), hidden_m=None, point_count=count,
        points_blob=blobs.add(dump_points(points, colors), "ply"), mesh_blob=None, view_blob=None, best_frames=(),
    )  # fmt: skip


def _candidate(drawn: Drawn, item: _Placed) -> Candidate:
    return Candidate(
        scene_id=drawn.scene_id, instance_id=item.instance_id, slot=1, provider=item.stand.asset.provider, provider_version=VERSION,
        is_fallback=False, outcome="filled", reason=None, asset_id=item.stand.asset.asset_id, seed=None, call_id=None,
        library=None, library_file=None, library_score=None,
        twin_of=None, seen_share=None, seconds=None,
    )  # fmt: skip


def _selection(drawn: Drawn, item: _Placed) -> Selection:
    """The asset is the truth here: its points are the instance's, and its box is the one that was drawn."""
    return Selection(
        scene_id=drawn.scene_id, instance_id=item.instance_id, rank=1, slot=1, asset_id=item.stand.asset.asset_id, score=1.0, chamfer_m=0.0,
        coverage=1.0, box_iou=1.0, foreign_share=None, color_similarity=1.0, pose=flat(item.pose), scale=item.stand.scale, look=None,
        provider=PROVIDER, provider_version=f"{VERSION}:{drawn.model_id[:12]}",
    )  # fmt: skip


def _syntheses(
    drawn: Drawn, base: BaseScene | None, frame: Array, placed: Sequence[_Placed], stable: Mapping[str, bool | None]
) -> tuple[list[Synthesis], list[SynthesisObject]]:
    layout, back = drawn.layout, inverse(frame)
    (deep,), (over,), (loose,) = colliding([layout]), off_edge([layout]), floating([layout])
    smalls = placed if base is not None else placed[1:]
    objects = [
        SynthesisObject(
            scene_id=drawn.scene_id, instance_id=item.instance_id, category=category,
            box_center=tuple(float(value) + 0.0 for value in (back @ item.box_pose)[:3, 3]), box_size=item.size,
            yaw_radians=float(yaw) + 0.0, is_colliding=bool(meets), is_off_support=bool(off), is_stable=stable.get(item.instance_id),
        )
        for item, category, yaw, meets, off in zip(smalls, layout.categories, layout.yaws, deep, over | loose, strict=True)
    ]  # fmt: skip
    x, y, z = (float(value) for value in layout.large.size)
    row = Synthesis(
        scene_id=drawn.scene_id, model_id=drawn.model_id, model_kind=drawn.model_kind,
        instance_id=LARGE_ID if base is None else base.instance_id, category=layout.large.category, box_size=(x, y, z),
        frame_pose=flat(frame), room_type=layout.large.room_type, seed=drawn.seed, number=drawn.number,
        based_on=None if base is None else base.scene.scene_id, based_on_instance=None if base is None else base.instance_id,
        object_count=len(objects), colliding_count=sum(item.is_colliding for item in objects),
        off_support_count=sum(item.is_off_support for item in objects),
        stable_share=sum(item.is_stable is True for item in objects) / len(objects) if objects else None, seconds=drawn.seconds,
    )  # fmt: skip
    return [row], objects


def _whole(kept: Kept | None, assets: Mapping[str, Asset], placed: Sequence[_Placed], context: Context) -> Surface:
    """Everything that stands there, as drawn, in the world frame."""
    cache, surfaces = context.caches["tasks.geometry.meshes"], [item.surface for item in placed]
    for asset_id, pose, scale in kept.poses if kept is not None else ():
        asset = assets[asset_id]
        surfaces.append(asset_surface(asset.mesh_blob, context.blobs, f"{asset.name}.glb", cache).transformed(pose, scale))
    return union_of(surfaces)


def _scene(
    drawn: Drawn, dataset: str, base: BaseScene | None, instances: Sequence[Instance], shell: Shell, surface: Surface, blobs: Blobs
) -> Scene:
    mesh = union_of([surface_of([part for _, part in room_shell(shell)]), surface])
    return Scene(
        scene_id=drawn.scene_id, room_id=drawn.scene_id if base is None else base.scene.room_id, dataset=dataset,
        scan=drawn.scene_id.partition("/")[2], scan_format=SYNTHESIS, scan_path="", alignment=flat(np.eye(4)), alignment_source="identity",
        to_original=flat(np.eye(4)),
        floor_tilt_radians=None, mesh_blob=blobs.add(dump_glb([mesh.to_trimesh()], ["scan"]), "glb"), vertex_count=len(mesh.vertices),
        face_count=len(mesh.faces), frame_count=0, instance_count=len(instances), segmentation="objects", license=drawn.license,
    )  # fmt: skip
