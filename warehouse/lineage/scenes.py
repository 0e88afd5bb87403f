"""The walk from a scene: its stages from exports back to the scan, what each wrote, and whether all ids in its rows lead somewhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask, Room, Scene, Shell
from schemas.exports import ExportFile
from schemas.fidelity import SceneFidelity
from schemas.navigation import Episode, Navmesh, UnreachableTarget
from schemas.optimization import Certificate, Optimization, OptimizationStep, Placement, Support
from schemas.record import table_of
from schemas.selection import Selection
from schemas.tables import TABLES
from warehouse.lineage.nodes import exported_places, follow_scan, verdict
from warehouse.lineage.walk import Walk, lost, picked

STAGES = tuple(dict.fromkeys(table.stage for table in TABLES.values() if table.stage and table.grain == "scene"))
"""Stages that work on scenes, in the order of the data path."""


def walk_scene(walk: Walk, scene: Scene) -> str:
    """Walk a scene; the id of its node."""
    scene_id = scene.scene_id
    facts = picked(scene, "room_id", "instance_count", "frame_count", "vertex_count", "face_count", "segmentation", "mesh_blob")
    root = walk.node("scene", scene_id, facts | {"alignment_source": scene.alignment_source}, walk.run(scene_id, "capture"))
    walk.check_blobs(root, (scene.mesh_blob,))
    walk.line(0, "", root)
    there = [stage for stage in STAGES if walk.state(scene_id, stage) is not None]
    runs = [walk.facts_of_run(scene_id, stage) for stage in there]
    read = {stage for run in runs if run is not None for stage in run.upstream}
    for stage in reversed(there):
        node = _stage_node(walk, scene_id, stage)
        if stage not in read:  # the others are reached from these
            walk.edge(root, node, "came to")
        walk.line(1, "", node)
        for other in there:
            run = walk.facts_of_run(scene_id, stage)
            if run is not None and other in run.upstream:
                walk.edge(node, f"stage:{scene_id}/{other}", "read")
        if stage == "exports":
            _formats(walk, scene_id, node)
        if stage == "optimization":
            _batches(walk, scene_id, node)
        if stage == "capture":
            follow_scan(walk, node, scene_id, 2, "read")
    _follow(walk, scene_id, root)
    return root


def _stage_node(walk: Walk, scene_id: str, stage: str) -> str:
    state = walk.state(scene_id, stage)
    run = walk.run(scene_id, stage)
    facts: dict[str, Any] = {"stage": stage, "outcome": state.last.outcome if state is not None else None}
    if state is not None and state.last.error is not None:
        facts["error"] = state.last.error
    if run is not None:
        facts |= _SUMMARIES[stage](walk, scene_id) if stage in _SUMMARIES else {}
    return walk.node("stage", f"{scene_id}/{stage}", facts, run)


def _formats(walk: Walk, scene_id: str, stage: str) -> None:
    """What was exported, by format."""
    by_format: dict[str, list[ExportFile]] = {}
    for row in walk.rows(ExportFile, scene_id):
        by_format.setdefault(row.format, []).append(row)
    placed = {row.instance_id: row for row in walk.rows(Placement, scene_id)}
    for name, files in by_format.items():
        scenes = [row for row in files if row.role == "scene"]
        facts = {
            "format": name, "files": len(files), "size_bytes": sum(row.size_bytes for row in files),
            "scene_files": [f"{name}/{row.path}" for row in scenes], **verdict(walk, files[0]),
        }  # fmt: skip
        node = walk.node("export_format", f"{scene_id}/{name}", facts, walk.run(scene_id, "exports"))
        walk.edge(node, stage, "written by")
        walk.line(2, "wrote", node)
        for file in scenes:
            for place in exported_places(walk, file):
                if place.instance_id not in placed:
                    walk.missing(node, "placement", f"{scene_id}/{place.instance_id}", "shows")
                elif place.asset_id not in (None, placed[place.instance_id].asset_id):
                    text = f"{name}/{file.path} says asset {place.asset_id} of {place.name}, and the placement says another"
                    walk.problem("differs", node, text)


def _batches(walk: Walk, scene_id: str, stage: str) -> None:
    """Annotation batches with answers for the scene."""
    batches: dict[str, list[Annotation]] = {}
    for row in walk.rows(Annotation, scene_id):
        batches.setdefault(row.batch_id, []).append(row)
    for batch, rows in batches.items():
        facts = {
            "answers": len(rows), "annotators": sorted({row.annotator for row in rows}),
            "first": min(row.answered_at for row in rows), "last": max(row.answered_at for row in rows),
        }  # fmt: skip
        node = walk.node("batch", batch, facts, walk.run(batch, "annotation"))
        walk.leads(2, stage, node, "answers from")
        choices = {row.choice for row in rows if row.choice is not None}
        there_are = {row.asset_id for row in walk.reader.rows_by_key(Asset, choices)}
        for asset in lost(choices, there_are):
            walk.missing(node, "asset", asset, "chose")


def _follow(walk: Walk, scene_id: str, root: str) -> None:
    """Follow the ids in all rows of a scene."""
    instances = {row.instance_id for row in walk.rows(Instance, scene_id)}
    frames = {row.frame_id for row in walk.rows(Frame, scene_id)}
    placements = walk.rows(Placement, scene_id)
    placed = {row.instance_id for row in placements}
    candidates = walk.rows(Candidate, scene_id)
    slots = {f"{row.instance_id}/{row.slot}": row.asset_id for row in candidates}
    selections = walk.rows(Selection, scene_id)
    assets = {row.asset_id for row in placements} | {row.asset_id for row in selections}
    assets |= {row.asset_id for row in candidates if row.asset_id is not None}
    known = {row.asset_id for row in walk.reader.rows_by_key(Asset, assets)}

    def check(source: str, kind: str, named: Iterable[str], among: Iterable[str]) -> None:
        node = f"stage:{scene_id}/{source}"
        for key in lost(named, set(among)):
            walk.missing(node if walk.has(node) else root, kind, key if kind == "asset" else f"{scene_id}/{key}", "names")

    check("capture", "frame", (f for row in walk.rows(Instance, scene_id) for f in row.best_frames), frames)
    check("capture", "frame", (row.frame_id for row in walk.rows(Mask, scene_id)), frames)
    check("capture", "instance", (row.instance_id for row in walk.rows(Mask, scene_id)), instances)
    check("captions", "instance", (row.instance_id for row in walk.rows(Caption, scene_id)), instances)
    check("candidates", "instance", (row.instance_id for row in candidates), instances)
    check("candidates", "asset", (row.asset_id for row in candidates if row.asset_id is not None), known)
    check("selection", "instance", (row.instance_id for row in selections), instances)
    check("selection", "candidate", (f"{row.instance_id}/{row.slot}" for row in selections), slots)
    check("selection", "asset", (row.asset_id for row in selections), known)
    check("optimization", "instance", placed, instances)
    check("optimization", "asset", (row.asset_id for row in placements), known)
    check("optimization", "placement", (row.instance_id for row in walk.rows(Support, scene_id)), placed)
    check("optimization", "placement", (row.instance_id for row in walk.rows(Certificate, scene_id)), placed)
    check("optimization", "placement", (i for row in walk.rows(OptimizationStep, scene_id) if (i := row.instance_id)), placed)
    check("optimization", "instance", (p for row in walk.rows(Support, scene_id) if (p := row.parent_id)), instances)
    check("navigation", "instance", (row.instance_id for row in walk.rows(Episode, scene_id)), instances)
    check("navigation", "instance", (row.instance_id for row in walk.rows(UnreachableTarget, scene_id)), instances)
    for row in selections:
        slot = f"{row.instance_id}/{row.slot}"
        if slots.get(slot, row.asset_id) != row.asset_id:
            text = f"selections has asset {row.asset_id[:12]} in slot {slot}, and candidates {slots[slot]}"
            walk.problem("differs", f"stage:{scene_id}/selection", text)


def _count(values: Iterable[Any]) -> dict[str, int]:
    return dict(sorted(Counter(map(str, values)).items()))


def _capture(walk: Walk, scene_id: str) -> dict[str, Any]:
    shell, rooms = walk.row(Shell, scene_id), walk.rows(Room, scene_id)
    instances = walk.rows(Instance, scene_id)
    return {
        "instances": len(instances), "structure": sum(row.is_structure for row in instances), "frames": len(walk.rows(Frame, scene_id)),
        "masks": len(walk.rows(Mask, scene_id)), **(picked(shell, "room_type", "floor_area_m2", "height_m") if shell is not None else {}),
        **({"rooms": [picked(row, "room_index", "room_type", "floor_area_m2") for row in rooms]} if len(rooms) > 1 else {}),
    }  # fmt: skip


def _captions(walk: Walk, scene_id: str) -> dict[str, Any]:
    rows = walk.rows(Caption, scene_id)
    return {"captions": len(rows), "providers": _count(row.provider for row in rows), "fallbacks": sum(row.is_fallback for row in rows)}


def _candidates(walk: Walk, scene_id: str) -> dict[str, Any]:
    rows = walk.rows(Candidate, scene_id)
    return {
        "candidates": len(rows), "outcomes": _count(row.outcome for row in rows), "providers": _count(row.provider for row in rows),
        "fallbacks": sum(row.is_fallback for row in rows),
    }  # fmt: skip


def _selection(walk: Walk, scene_id: str) -> dict[str, Any]:
    rows = walk.rows(Selection, scene_id)
    providers = {(row.instance_id, row.slot): row.provider for row in walk.rows(Candidate, scene_id)}
    best = [row for row in rows if row.rank == 1]
    return {
        "scored": len(rows), "wins": _count(providers.get((row.instance_id, row.slot), "unknown") for row in best),
        "mean_best_score": sum(row.score for row in best) / len(best) if best else None,
    }  # fmt: skip


def _optimization(walk: Walk, scene_id: str) -> dict[str, Any]:
    row = walk.row(Optimization, scene_id)
    certificates = [entry for entry in walk.rows(Certificate, scene_id) if entry.engine == "mujoco"]
    categories = {entry.instance_id: entry.category for entry in walk.rows(Instance, scene_id)}
    objects = [
        {"category": categories.get(entry.instance_id), **picked(entry, "instance_id", "asset_id", "origin", "annotator")}
        for entry in walk.rows(Placement, scene_id)
    ]
    summary = picked(row, "method", "loss_start", "loss_final", "moves", "ended", "remains") if row is not None else {}
    return {
        **summary, "certificates": len(certificates), "stable_5cm": sum(entry.is_stable_5cm for entry in certificates), "objects": objects,
    }  # fmt: skip


def _navigation(walk: Walk, scene_id: str) -> dict[str, Any]:
    meshes = walk.rows(Navmesh, scene_id)
    episodes = walk.rows(Episode, scene_id)
    return {
        "navmeshes": [picked(row, "agent", "area_m2", "path_finder") for row in meshes], "episodes": len(episodes),
        "splits": _count(row.split for row in episodes), "unreachable": [row.instance_id for row in walk.rows(UnreachableTarget, scene_id)],
    }  # fmt: skip


def _fidelity(walk: Walk, scene_id: str) -> dict[str, Any]:
    columns = ("object_f_5cm", "shell_f_5cm", "unexplained_share", "seen_empty_share", "cameras", "camera_count")
    return {"fidelity": [picked(row, *columns) for row in walk.rows(SceneFidelity, scene_id)]}


def _exports(walk: Walk, scene_id: str) -> dict[str, Any]:
    return {table_of(ExportFile).name: len(walk.rows(ExportFile, scene_id))}


_SUMMARIES: Mapping[str, Callable[[Walk, str], dict[str, Any]]] = {
    "capture": _capture, "captions": _captions, "candidates": _candidates, "selection": _selection, "optimization": _optimization,
    "navigation": _navigation, "fidelity": _fidelity, "exports": _exports,
}  # fmt: skip
