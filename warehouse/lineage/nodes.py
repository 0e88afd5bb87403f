"""Nodes of a walk: one function per kind of row, which follows the ids that the row names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Scene
from schemas.exports import ExportCheck, ExportFile
from schemas.lineage import Place
from schemas.lineage.licenses import is_of_scan, of_asset, scan_of
from schemas.optimization import Contact, Placement
from schemas.synthesis import Synthesis, SynthesisObject
from schemas.training import LearnedModel
from warehouse.lineage.libraries import follow_library
from warehouse.lineage.models import model_node
from warehouse.lineage.walk import Walk, picked, position


def instance_node(walk: Walk, instance: Instance) -> str:
    """The node of an instance."""
    facts = picked(
        instance, "category", "raw_label", "found_by", "category_probability", "nyu40_label", "is_structure", "source_id", "box_size",
        "box_volume_m3", "point_count", "points_blob", "mesh_blob", "view_blob",
    )  # fmt: skip
    drawn = walk.row(Synthesis, instance.scene_id)
    drawn_object = walk.row(SynthesisObject, instance.scene_id, instance_id=instance.instance_id)
    if drawn is not None and (drawn.based_on is None or drawn_object is not None):
        facts["is_drawn"] = True
    node = walk.node("instance", f"{instance.scene_id}/{instance.instance_id}", facts, walk.run(instance.scene_id, "capture"))
    walk.check_blobs(node, (instance.points_blob, instance.mesh_blob, instance.view_blob))
    return node


def follow_instance(walk: Walk, source: str, scene_id: str, instance_id: str, role: str) -> str:
    """An edge to an instance that something names; the id of the node."""
    row = walk.row(Instance, scene_id, instance_id=instance_id)
    if row is None:
        return walk.missing(source, "instance", f"{scene_id}/{instance_id}", role)
    node = instance_node(walk, row)
    walk.edge(source, node, role)
    return node


def scene_node(walk: Walk, source: str, scene_id: str, role: str) -> str:
    """An edge to the scene; the id of its node."""
    row = walk.row(Scene, scene_id)
    if row is None:
        return walk.missing(source, "scene", scene_id, role)
    facts = picked(
        row, "room_id", "instance_count", "frame_count", "vertex_count", "face_count", "segmentation", "alignment_source", "mesh_blob"
    )
    node = walk.node("scene", scene_id, facts, walk.run(scene_id, "capture"))
    walk.check_blobs(node, (row.mesh_blob,))
    walk.edge(source, node, role)
    return node


def follow_scan(walk: Walk, scene: str, scene_id: str, depth: int, role: str = "read from") -> None:
    """The scan that a scene was read from, or the model that drew it and the scene that it drew it into, where the scene is there."""
    drawn = walk.row(Synthesis, scene_id)
    if drawn is not None:
        _follow_drawing(walk, scene, drawn, depth)
        return
    scan = scan_node(walk, scene_id)
    if scan is not None:
        walk.edge(scene, scan, role)
        walk.line(depth, "read from", scan)


def _follow_drawing(walk: Walk, source: str, row: Synthesis, depth: int) -> None:
    facts = picked(
        row, "category", "room_type", "box_size", "seed", "number", "model_kind", "object_count", "colliding_count", "off_support_count",
        "stable_share",
    )  # fmt: skip
    node = walk.node("synthesis", row.scene_id, facts, walk.run(row.scene_id, "capture"))
    walk.leads(depth, source, node, "drawn on")
    models = walk.reader.rows_by_key(LearnedModel, [row.model_id])
    elsewhere = {"origin": "elsewhere"}  # it ships inside the package
    model = model_node(walk, models[0]) if models else walk.node("model", row.model_id, elsewhere)
    walk.leads(depth + 1, node, model, "drawn by")
    if row.based_on is not None and row.based_on_instance is not None:
        walk.line(depth + 1, "instead of what was on", follow_instance(walk, node, row.based_on, row.based_on_instance, "furnishes anew"))


def scan_node(walk: Walk, scene_id: str) -> str | None:
    """The node of the scan that a scene was read from; None when the scene is not there. Its hash is the one of capture's input."""
    row = walk.row(Scene, scene_id)
    if row is None:
        return None
    run = walk.facts_of_run(scene_id, "capture")
    facts = picked(row, "dataset", "scan", "scan_format", "scan_path", "license")
    return walk.node("scan", scene_id, facts | {"content_hash": run.inputs.get("scan") if run is not None else None})


def asset_node(walk: Walk, source: str, asset_id: str, role: str) -> str:
    """An edge to an asset; the id of its node."""
    node = f"asset:{asset_id}"
    if not walk.has(node):
        rows = walk.reader.rows_by_key(Asset, [asset_id])
        if not rows:
            return walk.missing(source, "asset", asset_id, role)
        add_asset(walk, rows[0])
    walk.edge(source, node, role)
    return node


def add_asset(walk: Walk, asset: Asset) -> str:
    """The node of an asset."""
    facts = picked(
        asset, "provider", "name", "category", "source", "source_url", "license", "author", "extents", "volume_m3", "is_watertight",
        "face_count", "mesh_blob", "pieces_blob", "thumbnail_blob",
    )  # fmt: skip
    if is_of_scan(asset.license):
        scans = {scene.scene_id: scene.license for scene in walk.rows(Scene, scan_of(asset.source))}
        facts["license"] = of_asset(asset.license, asset.source, scans)
    node = walk.node("asset", asset.asset_id, facts)
    walk.check_blobs(node, (asset.mesh_blob, asset.pieces_blob, asset.thumbnail_blob))
    return node


def candidate_node(walk: Walk, row: Candidate, depth: int, role: str) -> str:
    """A candidate with its provider and asset; the id of its node."""
    key = f"{row.scene_id}/{row.instance_id}/{row.slot}"
    facts = picked(row, "slot", "provider", "provider_version", "is_fallback", "outcome", "reason", "twin_of")
    node = walk.node("candidate", key, facts, walk.run(row.scene_id, "candidates"))
    walk.line(depth, role, node)
    follow_instance(walk, node, row.scene_id, row.instance_id, "stands in for")
    run = walk.facts_of_run(row.scene_id, "candidates")
    settings = _slot_settings(run.config if run is not None else None, row.slot, row.is_fallback)
    follow_provider(walk, node, row, f"in slot {row.slot}", "candidates", settings, depth + 1)
    if row.asset_id is not None:
        walk.line(depth + 1, "filled with", asset_node(walk, node, row.asset_id, "filled with"))
    follow_library(walk, node, row, depth + 1)
    return node


def follow_provider(walk: Walk, source: str, row: Candidate | Caption, where: str, stage: str, settings: Any, depth: int) -> None:
    """The provider of a row, with its settings."""
    facts = picked(row, "provider", "provider_version") | {"stage": stage, "settings": settings}
    node = walk.node("provider", f"{row.scene_id}/{row.provider} {where}", facts, walk.run(row.scene_id, stage))
    walk.leads(depth, source, node, "made by")


def exported_places(walk: Walk, file: ExportFile) -> Sequence[Place]:
    """What a scene's exported file says of its objects; none when its blob is not there, which is noted."""
    if file.file_blob not in walk.blobs:
        node = walk.node("export_file", f"{file.format}/{file.path}", picked(file, "role"), walk.run(file.scene_id, "exports"))
        walk.check_blobs(node, (file.file_blob,))
        return ()
    return walk.read_places(file.format, f"{file.format}/{file.path}", walk.blobs[file.file_blob])


def verdict(walk: Walk, file: ExportFile) -> dict[str, Any]:
    """What the gate says of a scene's export in the format of a file. That file and rules say the same is checked."""
    rules = [row for row in walk.rows(ExportCheck, file.scene_id) if row.format == file.format]
    broken = [f"{row.rule}: {row.message}" for row in rules if not row.passed]
    if rules and file.passed != (not broken):
        text = f"export_files says passed = {file.passed} of {file.format}/{file.path}, and export_checks has {len(broken)} broken rules"
        walk.problem("differs", walk.run(file.scene_id, "exports") or file.scene_id, text)
    return {"passed": file.passed, "rules": len(rules) or None, "broken_rules": broken}


def exported_node(walk: Walk, file: ExportFile, place: Place) -> str:
    """The node of an object in an exported scene, compared with the placement that it shows; its id."""
    facts = {"format": file.format, "file": f"{file.format}/{file.path}", "name": place.name, "file_blob": file.file_blob}
    node = walk.node("export", f"{file.format}/{file.path}:{place.name}", facts | verdict(walk, file), walk.run(file.scene_id, "exports"))
    placement = walk.row(Placement, file.scene_id, instance_id=place.instance_id)
    key = f"{file.scene_id}/{place.instance_id}"
    if placement is None:
        walk.missing(node, "placement", key, "shows")
    else:
        walk.edge(node, f"placement:{key}", "shows")
        for name, stated, true in (
            ("asset", place.asset_id, placement.asset_id),
            ("scene", place.scene_id, placement.scene_id),
        ):
            if stated is not None and stated != true:
                walk.problem("differs", node, f"{file.format}/{file.path} says {name} {stated} of {place.name}, and the placement {true}")
    return node


def placement_node(walk: Walk, row: Placement, absent: Sequence[str] | None = None) -> str:
    """The node of a placement with its instance and asset. `absent` are exported scenes that do not hold it, where they were looked at."""
    facts = {
        **picked(row, "origin", "annotator", "annotation_match", "scale", "displacement_m", "lift_m", "method", "remains"),
        **picked(row, "collider_blob", "collider_cut_share", "collider_distance_m", "fidelity_loss"),
        "proposed_position_m": position(row.proposed_pose),
        "optimized_position_m": position(row.optimized_pose),
        "settled_position_m": position(row.settled_pose),
        **_contact_facts(walk, row.scene_id, row.instance_id),
        "not_in": absent,
    }
    node = walk.node("placement", f"{row.scene_id}/{row.instance_id}", facts, walk.run(row.scene_id, "optimization"))
    walk.check_blobs(node, (row.collider_blob,))
    follow_instance(walk, node, row.scene_id, row.instance_id, "stands for")
    asset_node(walk, node, row.asset_id, "uses")
    return node


def _contact_facts(walk: Walk, scene_id: str, instance_id: str) -> dict[str, Any]:
    """What an object overlaps with, before and after: bodies, and the deepest penetration [m]."""
    facts: dict[str, Any] = {}
    for phase in ("proposed", "optimized"):
        rows = [r for r in walk.rows(Contact, scene_id) if r.phase == phase and instance_id in (r.instance_a, r.body_b)]
        facts[f"{phase}_contacts"] = sorted(r.body_b if r.instance_a == instance_id else r.instance_a for r in rows)
        facts[f"{phase}_penetration_m"] = max((r.penetration_m for r in rows), default=0.0)
    return facts


def add_annotation(walk: Walk, row: Annotation, depth: int, role: str) -> str:
    """An answer with the run that took its batch in; the id of its node."""
    names = ("batch_id", "annotator", "answered_at", "choice", "instance_id", "source_file")
    facts = picked(row, *names) | {"position_m": position(row.pose), "ranked": len(row.ranking)}
    facts["is_returned"] = row.batch_id in walk.returned
    node = walk.node("annotation", answer_key(row), facts, walk.run(row.batch_id, "annotation"))
    walk.line(depth, role, node)
    if row.choice is not None:
        asset_node(walk, node, row.choice, "chose")
    return node


def answer_key(row: Annotation) -> str:
    """Key of an answer; of a correction with its revision."""
    corrected = f"#{row.revision}" if row.revision > 1 else ""
    return f"{row.batch_id}/{row.scene_id}/{row.instance_id}/{row.annotator}{corrected}"


def _slot_settings(config: Any, slot: int, is_fallback: bool) -> Any:
    """Settings of the provider of a slot; None where the config does not state them."""
    slots = part(config, "slots")
    if not isinstance(slots, list) or not 1 <= slot <= len(slots):
        return None
    return part(slots[slot - 1], "fallback" if is_fallback else "provider")


def part(config: Any, name: str) -> Any:
    """A field of a config's JSON value; None where there is none."""
    return config.get(name) if isinstance(config, Mapping) else None
