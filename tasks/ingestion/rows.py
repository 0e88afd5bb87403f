"""Rows of the lake's tables from a scene of a finished dataset, stage by stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from schemas.candidates import Asset, Candidate, TextureCharts
from schemas.captions import Caption
from schemas.capture import Instance, Scene
from schemas.optimization import Placement
from tasks.candidates.assets import MAX_FACES, MadeAsset, charted, decimated, make_asset
from tasks.captions.sentences import shape_word
from tasks.capture.instances.boxes import oriented_box
from tasks.capture.instances.rows import modelled_solid
from tasks.capture.reading import Group
from tasks.capture.rooms.rows import parted
from tasks.geometry.meshes import Surface, dump_glb, dump_points, surface_of, union_of
from tasks.geometry.transforms import flat, translation
from tasks.ingestion.ground import scene_shell
from tasks.ingestion.scene import FinishedObject, FinishedScene, ImportedModel, IngestionConfig, Source
from tasks.stage import Blobs, Context, Outcome

PROVIDER, VERSION = "imported", "1"
"""Who made the rows: nobody here; the dataset's own words and meshes."""


def scene_rows(scene: FinishedScene, source: Source, context: Context, config: IngestionConfig) -> dict[str, Outcome]:
    """Rows by stage, in the order of the data path; a stage of which the dataset knows nothing is not there.

    Selection stays empty: nobody here scored anything.
    """
    assets = _Assets(context.scene_id)
    surfaces = [_surface(instance) for instance in scene.objects]
    rows = {"capture": _capture(scene, source, surfaces, context, config)}
    captions = [
        _caption(context.scene_id, instance, surface) for instance, surface in zip(scene.objects, surfaces, strict=True) if instance.physics
    ]
    if captions:
        rows["captions"] = Outcome(captions=captions)
    placements = [row for instance in scene.objects if (row := assets.add(instance)) is not None]
    rows["candidates"] = Outcome(
        candidates=assets.candidates, assets=list(assets.rows.values()), texture_charts=list(assets.charts.values()), blobs=assets.files,
        degradations=assets.notes,
    )  # fmt: skip
    rows["optimization"] = Outcome(
        placements=placements, supports=[], contacts=[], optimization_steps=[], optimizations=[], certificates=[],
    )  # fmt: skip
    return rows


def _surface(instance: FinishedObject) -> Surface:
    """An object's surface in the world frame."""
    return surface_of(instance.model.parts).transformed(instance.pose, instance.scale)


def _capture(
    scene: FinishedScene, source: Source, surfaces: Sequence[Surface], context: Context, config: IngestionConfig
) -> Outcome:  # fmt: skip
    blobs, notes = Blobs(), list(scene.notes)
    instances = [
        _instance(context, instance, surface, blobs, config) for instance, surface in zip(scene.objects, surfaces, strict=True)
    ]  # fmt: skip
    shell, more = scene_shell(scene, surfaces, context)
    shell, rooms, instances = parted(shell, instances, scene.room_type)
    stage = [part for part, _ in scene.stage]
    merged = surface_of(stage) if stage else union_of(surfaces)
    if len(merged.faces) > config.max_faces:
        notes.append(f"mesh thinned from {len(merged.faces)} to about {config.max_faces} faces")
        merged = decimated(merged, config.max_faces)
        stage = []
    mesh = dump_glb(stage, [f"stage_{i:03d}" for i in range(len(stage))]) if stage else dump_glb([merged.to_trimesh()], ["scan"])
    row = Scene(
        scene_id=context.scene_id,
        room_id=source.room_id,
        dataset=context.scene_id.partition("/")[0],
        scan=context.scene_id.partition("/")[2],
        scan_format=source.kind,
        scan_path=str(source.root),
        alignment=flat(scene.alignment),
        alignment_source="identity" if np.array_equal(scene.alignment, np.eye(4)) else "format",
        to_original=flat(np.linalg.inv(scene.alignment)),
        floor_tilt_radians=None,
        mesh_blob=blobs.add(mesh, "glb"),
        vertex_count=len(merged.vertices),
        face_count=len(merged.faces),
        frame_count=0,
        instance_count=len(instances),
        segmentation="objects",
        license=scene.license,
    )
    return Outcome(
        scenes=[row], shells=[shell], rooms=rooms, surfaces=[], frames=[], instances=instances, masks=[], blobs=blobs,
        degradations=list(dict.fromkeys([*notes, *more])),
    )  # fmt: skip


def _instance(context: Context, instance: FinishedObject, surface: Surface, blobs: Blobs, config: IngestionConfig) -> Instance:
    """An instance: the box of its placed geometry, and points on it."""
    starts = np.concatenate([[0], np.cumsum([len(part.faces) for part in instance.model.parts])]).astype(np.int64)
    group = Group(instance.source_id, instance.raw_label, np.arange(len(surface.vertices)), np.arange(len(surface.faces)))
    rng = context.rng("surface", instance.instance_id)
    solid = modelled_solid(surface, group, instance.model.parts, starts, rng, config.max_points)
    pose, size = oriented_box(surface.vertices[np.unique(surface.faces)], is_noisy=False)
    return Instance(
        scene_id=context.scene_id,
        instance_id=instance.instance_id,
        source_id=instance.source_id,
        raw_label=instance.raw_label,
        category=instance.label.category,
        nyu40_id=instance.label.nyu40_id,
        nyu40_label=instance.label.nyu40_label,
        is_structure=instance.label.is_structure,
        found_by="objects",
        category_probability=None,
        room_index=None,
        box_pose=flat(pose),
        box_size=tuple(float(v) for v in size),
        box_volume_m3=float(np.prod(size)),
        hidden_m=None,
        point_count=len(solid.points),
        points_blob=blobs.add(dump_points(solid.points, solid.colors), "ply"),
        mesh_blob=None,  # the asset has the same triangles, once for all objects that show it
        view_blob=None,
        best_frames=(),
    )


def _caption(scene_id: str, instance: FinishedObject, surface: Surface) -> Caption:
    """What the dataset states of an object's body; nothing is told that it does not state."""
    if instance.physics is None:
        raise ValueError(f"{instance.instance_id}: the dataset states no body")
    size = np.ptp(surface.bounds, axis=0)
    shape = shape_word(size)
    return Caption(
        scene_id=scene_id, instance_id=instance.instance_id, provider=PROVIDER, provider_version=VERSION, is_fallback=False,
        sentence=instance.label.category, colors=(), color_shares=(), materials=(), shape=shape, body_type="rigid", density_kg_m3=None,
        solid_fraction=None, mass_kg=instance.physics.mass_kg, friction=instance.physics.friction, restitution=instance.physics.restitution,
        attribute_source=instance.physics.source, appearance_call_id=None, physics_call_id=None,
    )  # fmt: skip


class _Assets:
    """The assets of a scene, each made once, however many objects show it."""

    def __init__(self, scene_id: str) -> None:
        self._scene_id = scene_id
        self._made: dict[tuple[int, str], tuple[MadeAsset | None, str, np.ndarray[Any, Any]]] = {}
        self.rows: dict[str, Asset] = {}
        self.charts: dict[str, TextureCharts] = {}
        self.files: dict[str, bytes] = {}
        self.candidates: list[Candidate] = []
        self.notes: list[str] = []

    def add(self, instance: FinishedObject) -> Placement | None:
        """The candidate and the placement of an object; no placement where its mesh is no asset. Structures have neither."""
        if instance.label.is_structure:
            return None
        key = (id(instance.model), instance.label.category)
        if key not in self._made:
            self._made[key] = _made(instance.model, instance.label.category)
        made, problem, shift = self._made[key]
        asset_id = made.asset.asset_id if made is not None else None
        self.candidates.append(
            Candidate(
                scene_id=self._scene_id, instance_id=instance.instance_id, slot=1, provider=PROVIDER, provider_version=VERSION,
                is_fallback=False, outcome="filled" if made is not None else "failed", reason=problem or None, asset_id=asset_id,
                seed=None, call_id=None, library=None, library_file=None, library_score=None,
                twin_of=None, seen_share=None, seconds=None,
            )
        )  # fmt: skip
        if made is None:
            self.notes.append(f"{instance.instance_id}: {instance.model.name}: {problem}: no asset")
            return None
        self.rows[made.asset.asset_id] = made.asset
        if made.charts is not None:
            self.charts[made.asset.asset_id] = made.charts
        self.files.update(made.files)
        return _placement(self._scene_id, instance, made.asset.asset_id, shift)


def _made(model: ImportedModel, category: str) -> tuple[MadeAsset | None, str, np.ndarray[Any, Any]]:
    """The asset of a model, or why there is none; and what canonical coordinates are shifted by from the model's [m]."""
    parts, surface = list(model.parts), surface_of(model.parts)
    if len(surface.faces) > MAX_FACES:
        surface = decimated(surface, MAX_FACES)
        parts = [surface.to_trimesh()]
    bounds = surface.bounds
    shift = -np.array([bounds[:, 0].mean(), bounds[:, 1].mean(), bounds[0, 2]])
    try:
        made = make_asset(
            parts, provider=PROVIDER, name=model.name, category=category, source=model.source, license=model.license,
            author=model.author, pieces=model.pieces,
        )  # fmt: skip
    except ValueError as error:
        return None, " ".join(str(error).split()), shift
    return charted(made, parts), "", shift


def _placement(scene_id: str, instance: FinishedObject, asset_id: str, shift: np.ndarray[Any, Any]) -> Placement:
    back = translation(-instance.scale * shift)
    pose = instance.pose @ back
    proposed = pose if instance.proposed is None else instance.proposed @ back
    moved = pose[:3, 3] - proposed[:3, 3]
    is_moved = instance.proposed is not None
    return Placement(
        scene_id=scene_id,
        instance_id=instance.instance_id,
        asset_id=asset_id,
        origin="annotation" if instance.is_annotated else "imported",
        annotator=None,  # the dataset does not say who
        annotation_match=None,
        scale=tuple(float(v) for v in instance.scale),
        proposed_pose=flat(proposed),
        optimized_pose=flat(pose),
        settled_pose=None,
        displacement_m=float(np.hypot(moved[0], moved[1])) if is_moved else None,
        lift_m=float(moved[2]) + 0.0 if is_moved else None,
        method="imported",
        remains=instance.remains,
        collider_pieces=None,
        collider_faces=None,
        collider_early_share=None,
        collider_miss_share=None,
        collider_blob=None,
        collider_cut_share=None,
        collider_distance_m=None,
        fidelity_loss=None,
    )
