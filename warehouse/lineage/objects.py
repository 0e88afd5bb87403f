"""The walk from an object of a scene: from exported files to the layout, the choice, the asset, what describes it, and the scan."""

from __future__ import annotations

from schemas.annotation import Annotation
from schemas.candidates import Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.exports import ExportFile
from schemas.fidelity import Fidelity
from schemas.navigation import Episode, UnreachableTarget
from schemas.optimization import APPLIED, Certificate, OptimizationStep, Placement, Support
from schemas.selection import Selection
from schemas.synthesis import Synthesis, SynthesisObject
from warehouse.lineage.calls import follow_call
from warehouse.lineage.nodes import (
    add_annotation,
    answer_key,
    asset_node,
    candidate_node,
    exported_node,
    exported_places,
    follow_instance,
    follow_provider,
    follow_scan,
    instance_node,
    part,
    placement_node,
    scan_node,
    scene_node,
)
from warehouse.lineage.walk import Walk, picked, position


def walk_object(walk: Walk, instance: Instance, depth: int = 0, role: str = "") -> str:
    """Walk an instance: what it was made from, and what was made from it; the id of its node."""
    scene_id, instance_id = instance.scene_id, instance.instance_id
    root = instance_node(walk, instance)
    walk.line(depth, role, root)
    placement = walk.row(Placement, scene_id, instance_id=instance_id)
    if placement is not None:
        _layout(walk, placement, depth + 1)
    else:
        _offered(walk, instance, root, depth + 1)
    _caption(walk, instance, root, depth + 1)
    _views(walk, instance, root, depth + 1)
    _drawn(walk, instance, root, depth + 1)
    scene = scene_node(walk, root, scene_id, "cut from")
    walk.line(depth + 1, "cut from" if walk.row(Synthesis, scene_id) is None else "in", scene)
    follow_scan(walk, scene, scene_id, depth + 2)
    return root


def _drawn(walk: Walk, instance: Instance, root: str, depth: int) -> None:
    """Where a model drew an object, before anything was moved."""
    row = walk.row(SynthesisObject, instance.scene_id, instance_id=instance.instance_id)
    if row is not None:
        facts = picked(row, "category", "box_center", "box_size", "yaw_radians", "is_colliding", "is_off_support", "is_stable")
        key = f"{instance.scene_id}/{instance.instance_id}"
        walk.leads(depth, root, walk.node("drawing", key, facts, walk.run(instance.scene_id, "capture")), "drawn as")


def _layout(walk: Walk, row: Placement, depth: int) -> None:
    """Exports that show a placement, the placement, what moved it, and why this asset stands there."""
    scene_id, instance_id = row.scene_id, row.instance_id
    absent: list[str] = []
    for file in walk.rows(ExportFile, scene_id):
        if file.role == "scene":
            places = [place for place in exported_places(walk, file) if place.instance_id == instance_id]
            absent += [] if places else [f"{file.format}/{file.path}"]
            for place in places:
                walk.line(depth, "exported as", exported_node(walk, file, place))
    node = placement_node(walk, row, absent)
    walk.line(depth, "placed as", node)
    _support(walk, node, scene_id, instance_id, depth + 1)
    _moves(walk, node, scene_id, instance_id, depth + 1)
    for issued in walk.rows(Certificate, scene_id):
        if issued.instance_id == instance_id:
            certificate = walk.node(
                "certificate", f"{scene_id}/{instance_id}/{issued.engine}",
                picked(
                    issued, "engine", "engine_version", "simulated_seconds", "is_fixed", "problem", "is_stable_1cm", "is_stable_5cm",
                    "is_stable_nudged", "displacement_m", "tilt_radians", "mass_kg", "density_kg_m3", "is_density_plausible",
                ), walk.run(scene_id, "optimization"),
            )  # fmt: skip
            walk.edge(certificate, node, "certifies")
            walk.line(depth + 1, "certified by", certificate)
    _episodes(walk, node, scene_id, instance_id, depth + 1)
    _fidelity(walk, node, scene_id, instance_id, depth + 1)
    # Of a finished dataset whose assets people chose, their answers are nowhere.
    if row.origin == "annotation" and row.method != "imported":
        _annotated(walk, row, node, depth + 1)
    elif not _selected(walk, scene_id, instance_id, row.asset_id, node, "proposed by", depth + 1):
        if walk.run(scene_id, "selection") is not None:
            walk.line(
                depth + 1,
                "proposed by",
                walk.missing(node, "selection", f"{scene_id}/{instance_id} of asset {row.asset_id[:12]}", "proposed by"),
            )
        else:
            offered = walk.row(Candidate, scene_id, instance_id=instance_id, asset_id=row.asset_id)
            if offered is not None:
                walk.edge(node, candidate_node(walk, offered, depth + 1, "offered as"), "offered as")
            else:
                walk.line(depth + 1, "uses", f"asset:{row.asset_id}")


def _offered(walk: Walk, instance: Instance, root: str, depth: int) -> None:
    """Of an instance that nothing stands for: the best candidate, where there is one."""
    best = walk.row(Selection, instance.scene_id, instance_id=instance.instance_id, rank=1)
    if best is not None:
        _selected(walk, instance.scene_id, instance.instance_id, best.asset_id, root, "best candidate", depth)
    for row in walk.rows(UnreachableTarget, instance.scene_id):
        if row.instance_id == instance.instance_id:
            walk.line(depth, "reached by", _unreached(walk, root, row))


def _support(walk: Walk, placement: str, scene_id: str, instance_id: str, depth: int) -> None:
    row = walk.row(Support, scene_id, instance_id=instance_id)
    if row is None:
        return
    facts = picked(row, "relation", "parent_id", "against", "gap_m", "is_fixed", "is_kept", "is_inferred", "bracket_blob")
    node = walk.node("support", f"{scene_id}/{instance_id}", facts, walk.run(scene_id, "optimization"))
    walk.check_blobs(node, (row.bracket_blob,))
    walk.edge(node, placement, "carries")
    walk.line(depth, "carried by", node)
    if row.parent_id is not None:
        parent = follow_instance(walk, node, scene_id, row.parent_id, "rests on")
        walk.line(depth + 1, row.relation, parent)


def _moves(walk: Walk, placement: str, scene_id: str, instance_id: str, depth: int) -> None:
    """Steps that moved an object: its own, and those of what carries it."""
    parents = {row.instance_id: row.parent_id for row in walk.rows(Support, scene_id)}
    chain = [instance_id]
    while (above := parents.get(chain[-1])) is not None and above not in chain:
        chain.append(above)
    moved = [row for row in walk.rows(OptimizationStep, scene_id) if row.outcome in APPLIED and row.instance_id in chain]
    if not walk.rows(OptimizationStep, scene_id):
        return
    names = ("step", "instance_id", "outcome", "dx_m", "dy_m", "dz_m", "turn_x_radians", "turn_y_radians", "turn_z_radians", "loss")
    facts = {
        "own": sum(row.instance_id == instance_id for row in moved),
        "of_what_carries_it": sum(row.instance_id != instance_id for row in moved),
        "steps": [picked(row, *names) for row in moved],
    }
    node = walk.node("moves", f"{scene_id}/{instance_id}", facts, walk.run(scene_id, "optimization"))
    walk.leads(depth, placement, node, "moved by")


def _episodes(walk: Walk, placement: str, scene_id: str, instance_id: str, depth: int) -> None:
    rows = [row for row in walk.rows(Episode, scene_id) if row.instance_id == instance_id]
    if rows:
        facts = {
            "count": len(rows), "split": rows[0].split, "agent": rows[0].agent, "path_finder": rows[0].path_finder,
            "episodes": [row.episode_id for row in rows],
        }  # fmt: skip
        node = walk.node("episodes", f"{scene_id}/{instance_id}", facts, walk.run(scene_id, "navigation"))
        walk.edge(node, placement, "lead to")
        walk.line(depth, "reached by", node)
    for row in walk.rows(UnreachableTarget, scene_id):
        if row.instance_id == instance_id:
            walk.line(depth, "reached by", _unreached(walk, placement, row))


def _fidelity(walk: Walk, placement: str, scene_id: str, instance_id: str, depth: int) -> None:
    row = walk.row(Fidelity, scene_id, instance_id=instance_id)
    if row is not None:
        columns = ("completeness_5cm", "accuracy_5cm", "f_2cm", "f_5cm", "f_10cm", "seen_empty_share", "in_others_share")
        node = walk.node("fidelity", f"{scene_id}/{instance_id}", picked(row, *columns), walk.run(scene_id, "fidelity"))
        walk.edge(node, placement, "measures")
        walk.line(depth, "measured by", node)


def _unreached(walk: Walk, target: str, row: UnreachableTarget) -> str:
    key = f"{row.scene_id}/{row.instance_id}"
    node = walk.node("episodes", key, {"count": 0, "reason": row.reason}, walk.run(row.scene_id, "navigation"))
    walk.edge(node, target, "lead to")
    return node


def _selected(walk: Walk, scene_id: str, instance_id: str, asset_id: str, source: str, role: str, depth: int) -> bool:
    """The selection of an asset for an instance and the candidate that it scored; whether there is one."""
    rows = [row for row in walk.rows(Selection, scene_id) if row.instance_id == instance_id]
    row = min((row for row in rows if row.asset_id == asset_id), key=lambda row: row.rank, default=None)
    if row is None:
        return False
    names = ("rank", "score", "chamfer_m", "coverage", "box_iou", "color_similarity", "provider", "provider_version")
    facts = picked(row, *names) | {"ranked": len(rows)}
    node = walk.node("selection", f"{scene_id}/{instance_id}/{row.rank}", facts, walk.run(scene_id, "selection"))
    walk.leads(depth, source, node, role)
    key = f"{scene_id}/{instance_id}/{row.slot}"
    candidate = walk.row(Candidate, scene_id, instance_id=instance_id, slot=row.slot)
    if candidate is None:
        walk.line(depth + 1, "scored", walk.missing(node, "candidate", key, "scored"))
        walk.line(depth + 1, "uses", asset_node(walk, node, row.asset_id, "uses"))
        return True
    scored = candidate_node(walk, candidate, depth + 1, "scored")
    walk.edge(node, scored, "scored")
    if candidate.asset_id != row.asset_id:
        walk.problem("differs", node, f"selections has asset {row.asset_id[:12]} in slot {row.slot}, and candidates {candidate.asset_id}")
    return True


def _annotated(walk: Walk, placement: Placement, node: str, depth: int) -> None:
    """The answer that won, the candidate that it chose, and what others answered."""
    scene_id, instance_id = placement.scene_id, placement.instance_id
    answers = walk.rows(Annotation, scene_id)
    same = [row for row in answers if row.annotator == placement.annotator and row.choice == placement.asset_id]
    # Instances are numbered anew when a scan is captured again: then who chose what is all that the placement says.
    # An answer that does not count now won only where the layout is older than the review.
    winner = max(
        same,
        key=lambda row: (row.batch_id in walk.counting, row.instance_id == instance_id, row.answered_at, row.batch_id, row.revision),
        default=None,
    )
    if winner is None:
        key = f"{scene_id}/{instance_id} by {placement.annotator}"
        walk.line(depth, "chosen by", walk.missing(node, "annotation", key, "chosen by"))
    else:
        walk.edge(node, add_annotation(walk, winner, depth, "chosen by"), "chosen by")
    rows = [row for row in walk.rows(Candidate, scene_id) if row.instance_id == instance_id and row.asset_id == placement.asset_id]
    if rows and winner is not None:
        chosen = candidate_node(walk, rows[0], depth + 1, "chose")
        walk.edge(f"annotation:{answer_key(winner)}", chosen, "chose")
    else:
        walk.line(depth, "uses", f"asset:{placement.asset_id}")
    for row in answers:
        if row.instance_id == instance_id and row != winner:
            walk.edge(add_annotation(walk, row, depth, "also answered by"), f"instance:{scene_id}/{instance_id}", "answers for")


def _caption(walk: Walk, instance: Instance, root: str, depth: int) -> None:
    row = walk.row(Caption, instance.scene_id, instance_id=instance.instance_id)
    if row is None:
        return
    key = f"{instance.scene_id}/{instance.instance_id}"
    run = walk.run(instance.scene_id, "captions")
    facts = picked(
        row, "sentence", "provider", "provider_version", "is_fallback", "materials", "colors", "shape", "body_type", "mass_kg",
        "density_kg_m3", "solid_fraction", "friction", "restitution", "attribute_source",
    )  # fmt: skip
    node = walk.node("caption", key, facts, run)
    walk.edge(node, root, "describes")
    walk.line(depth, "described by", node)
    known = walk.facts_of_run(instance.scene_id, "captions")
    config = known.config if known is not None else None
    settings = part(config, "fallback" if row.is_fallback else "provider")
    follow_provider(walk, node, row, "of captions", "captions", settings, depth + 1)
    follow_call(walk, node, row.appearance_call_id, "looks told by", depth + 1)
    follow_call(walk, node, row.physics_call_id, "behavior told by", depth + 1)


def _views(walk: Walk, instance: Instance, root: str, depth: int) -> None:
    """Masks and the frames that they lie in; best frames without a mask, too."""
    scene_id, run = instance.scene_id, walk.run(instance.scene_id, "capture")
    frames = {row.frame_id: row for row in walk.rows(Frame, scene_id)}
    masks = {row.frame_id: row for row in walk.rows(Mask, scene_id) if row.instance_id == instance.instance_id}
    order = [*instance.best_frames, *(frame_id for frame_id in masks if frame_id not in instance.best_frames)]
    for frame_id in order:
        source, below, role = root, depth, "seen in"
        if frame_id in masks:
            facts = picked(masks[frame_id], "pixel_box", "pixel_count", "visible_share", "score")
            source = walk.node("mask", f"{scene_id}/{frame_id}/{instance.instance_id}", facts, run)
            walk.edge(source, root, "shows")
            walk.line(depth, "seen as", source)
            below, role = depth + 1, "in"
        if frame_id not in frames:
            walk.line(below, role, walk.missing(source, "frame", f"{scene_id}/{frame_id}", role))
            continue
        row = frames[frame_id]
        facts = picked(row, "color_file", "depth_file", "width", "height") | {"has_pose": row.pose is not None}
        node = walk.node("frame", f"{scene_id}/{frame_id}", facts | {"camera_position_m": position(row.pose)}, run)
        walk.leads(below, source, node, role)
        scan = scan_node(walk, scene_id)
        if scan is not None:
            walk.edge(node, scan, "file of")
