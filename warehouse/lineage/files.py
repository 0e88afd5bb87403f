"""The walk from a file: one of an export, an object in it, an asset, or a blob by its name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene
from schemas.exports import ExportFile
from schemas.lineage import Place
from schemas.optimization import Placement
from schemas.record import Table, arrow_to_rows
from schemas.tables import TABLES
from warehouse.lineage.nodes import (
    add_annotation,
    add_asset,
    candidate_node,
    exported_node,
    exported_places,
    follow_scan,
    instance_node,
    placement_node,
    scene_node,
    verdict,
)
from warehouse.lineage.objects import walk_object
from warehouse.lineage.walk import Walk, picked

_HASH = rb"(?<![0-9a-f])[0-9a-f]{64}(?![0-9a-f])"

SHOWN = 8
"""Uses of an asset or a blob that are walked; all are counted."""


def walk_export(walk: Walk, file: ExportFile, also_in: Sequence[str] = (), content: str | None = None) -> str:
    """Walk a file of a scene's export; the id of its node.

    `also_in` are other scenes that have a file at the same path, `content` says how a copy outside the lake compares.
    """
    named: list[str] | None = None
    if file.role != "scene" and file.file_blob in walk.blobs:
        placed = {row.asset_id for row in walk.rows(Placement, file.scene_id)}
        stated = {hash_text.decode() for hash_text in re.findall(_HASH, walk.blobs[file.file_blob])}
        named = sorted(placed & stated)
    root = _file_node(walk, file, {"also_in": list(also_in), "content": content, "assets": named})
    walk.line(0, "", root)
    if file.role == "scene":
        for place in exported_places(walk, file):
            obj = exported_node(walk, file, place)
            walk.leads(1, root, obj, "holds")
            row = walk.row(Placement, file.scene_id, instance_id=place.instance_id)
            if row is not None:
                walk.line(2, "shows", placement_node(walk, row))
    for row in walk.rows(Placement, file.scene_id) if named else ():
        if row.asset_id in (named or ()):
            placement = placement_node(walk, row)
            walk.leads(1, root, f"asset:{row.asset_id}", "made from")
            walk.line(2, "used by", placement)
    scene = scene_node(walk, root, file.scene_id, "part of")
    walk.line(1, "part of", scene)
    follow_scan(walk, scene, file.scene_id, 2)
    return root


def walk_exported(walk: Walk, file: ExportFile, place: Place, content: str | None = None) -> str:
    """Walk an object in an exported scene; the id of its node."""
    root = exported_node(walk, file, place)
    walk.line(0, "", root)
    node = _file_node(walk, file, {"content": content})
    walk.edge(node, root, "holds")
    walk.line(1, "in", node)
    instance = walk.row(Instance, file.scene_id, instance_id=place.instance_id)
    if instance is None:
        walk.line(1, "shows", walk.missing(root, "instance", f"{file.scene_id}/{place.instance_id}", "shows"))
    else:
        walk.edge(root, walk_object(walk, instance, 1, "shows"), "shows")
    return root


def walk_asset(walk: Walk, asset: Asset, depth: int = 0, role: str = "") -> str:
    """Walk an asset: who offered it, who chose it, and where it stands; the id of its node."""
    root = add_asset(walk, asset)
    walk.line(depth, role, root)
    placements = walk.reader.matching("placements", {"asset_id": [asset.asset_id]}, ["asset_id"]).to_pylist()
    answers = arrow_to_rows(walk.reader.matching("annotations", {"choice": [asset.asset_id]}), Annotation)
    offer = _offer(walk, asset.asset_id, placements[0]["scene_id"] if placements else None)
    scenes = {row["scene_id"] for row in placements} | {row.scene_id for row in answers}
    uses = {"placements": len(placements), "annotations": len(answers), "scenes": len(scenes)}
    node = walk.node("uses", asset.asset_id, uses)
    walk.edge(node, root, "of")
    walk.line(depth + 1, "used in", node)
    for placed in placements[:SHOWN]:
        placement = walk.row(Placement, placed["scene_id"], instance_id=placed["instance_id"])
        if placement is not None:
            walk.line(depth + 2, "stands in", placement_node(walk, placement))
    for answer in answers[:SHOWN]:
        add_annotation(walk, answer, depth + 2, "chosen by")
    if offer is not None:
        candidate_node(walk, offer, depth + 1, "offered as")
    return root


def _offer(walk: Walk, asset_id: str, scene_id: str | None) -> Candidate | None:
    """A candidate that holds an asset, of a scene that placed it, else the first of all; None when nobody offers it.

    Who made the asset is the same wherever it is offered, and there are ten times as many candidates as placements.
    """
    if scene_id is None:
        first = walk.reader.matching("candidates", {"asset_id": [asset_id]}, ["asset_id"]).slice(0, 1).to_pylist()
        scene_id = first[0]["scene_id"] if first else None
    return walk.row(Candidate, scene_id, asset_id=asset_id) if scene_id is not None else None


def walk_blob(walk: Walk, name: str, owners: Sequence[tuple[Table, str, Any]]) -> str:
    """Walk a blob from the rows that name it, given as (table, column, row); the id of its node."""
    is_there = name in walk.blobs
    facts = {
        "named_by": [f"{table.name}.{column}" for table, column, _ in owners[:SHOWN]], "rows": len(owners),
        "size_bytes": len(walk.blobs[name]) if is_there else None,
    }  # fmt: skip
    root = walk.node("blob", name, facts)
    walk.line(0, "", root)
    if not is_there:
        walk.problem("missing", root, f"blob {name} is named, but not there")
    for index, (table, column, row) in enumerate(owners[:SHOWN]):
        role = f"{column} of"
        if isinstance(row, Instance):
            owner = instance_node(walk, row) if index else walk_object(walk, row, 1, role)
        elif isinstance(row, Asset):
            owner = add_asset(walk, row) if index else walk_asset(walk, row, 1, role)
        elif isinstance(row, ExportFile):
            owner = _file_node(walk, row)
        elif isinstance(row, Scene):
            owner = scene_node(walk, root, row.scene_id, role)
        else:
            key = "/".join(str(getattr(row, part)) for part in table.key)
            scene_id = getattr(row, "scene_id", None)
            owner = walk.node("row", f"{table.name}/{key}", {"table": table.name}, walk.run(scene_id, table.stage) if scene_id else None)
        walk.edge(root, owner, role)
        if index or not isinstance(row, Instance | Asset):
            walk.line(1, role, owner)
        if not index and getattr(row, "scene_id", None) and not isinstance(row, Instance):
            scene = scene_node(walk, owner, row.scene_id, "part of") if not isinstance(row, Scene) else owner
            follow_scan(walk, scene, row.scene_id, 2)
    return root


def blob_owners(walk: Walk, name: str) -> list[tuple[Table, str, Any]]:
    """Rows that name a blob, as (table, column, row), in the order of the data path."""
    owners: list[tuple[Table, str, Any]] = []
    for table in TABLES.values():
        for column in table.blob_columns:
            rows = walk.reader.matching(table.name, {column: [name]})
            records: list[Any] = arrow_to_rows(rows, table.record)
            owners += [(table, column, record) for record in records]
    return owners


def _file_node(walk: Walk, file: ExportFile, extra: Mapping[str, Any] | None = None) -> str:
    """The node of an exported file; `extra` are facts beside the row: of a copy outside the lake, of other scenes, of what it says."""
    facts = {
        "format": file.format,
        "file": f"{file.format}/{file.path}",
        "scene_id": file.scene_id,
        **picked(file, "role", "file_blob", "size_bytes"),
        **verdict(walk, file),
        **(extra or {}),
    }
    node = walk.node("export_file", f"{file.scene_id}/{file.format}/{file.path}", facts, walk.run(file.scene_id, "exports"))
    walk.check_blobs(node, (file.file_blob,))
    if facts.get("content") == "differs":
        walk.problem("differs", node, f"the file is not what the lake has as {file.format}/{file.path} of {file.scene_id}")
    return node
