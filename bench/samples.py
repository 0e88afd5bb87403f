"""Rows made from the schemas alone: one valid row of any record type, and whole scenes of them, in milliseconds."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime, timedelta
from typing import Any

import pyarrow as pa

from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.capture import SURFACE_PATTERN
from schemas.evaluation import Trajectory
from schemas.optimization import AGAINST_PATTERN, BODY_PATTERN
from schemas.record import Column, Table, table_of
from schemas.runs import StageRun
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.tables.adoption import SCENE_STAGES

START = datetime(2026, 1, 1, tzinfo=UTC)

INSTANCES = ("0001", "0002")
"""Objects of a whole scene."""


def fingerprint(*words: object) -> str:
    """A fingerprint made of words."""
    return hashlib.sha256("|".join(map(str, words)).encode()).hexdigest()


def stage_run(scene_id: str, stage: str, print_: str, *upstream: str, at: float = 0.0, **values: Any) -> StageRun:
    """A done run that started `at` seconds after START."""
    given: dict[str, Any] = {
        "scene_id": scene_id, "stage": stage, "fingerprint": print_, "attempt": 1, "outcome": "done", "upstream": upstream,
        "reasons": (), "config": "{}", "row_counts": (), "degradations": (), "error": None, "error_kind": None,
        "started_at": START + timedelta(seconds=at), "seconds": 1.0, "host": "here:1", "peak_memory_mb": 1.0, "snapshot_id": 0,
    }  # fmt: skip
    return StageRun(**(given | values))


def sample(record: type, **values: Any) -> Any:
    """A valid row of a record type; `values` are taken as given, the others made up from the column."""
    return record(**{c.name: values[c.name] if c.name in values else _made_up(c) for c in table_of(record).columns})


def stage_whole_scene(lake: Lake, scene: str, tag: object, at: float, room: str | None = None, shared: object = "of all") -> None:
    """Stage every stage of a scene, with blobs of its own, an asset of its own and one that scenes with one `shared` share."""
    for stage in SCENE_STAGES:
        stage_part(lake, scene, stage, tag, at, room, shared)


def stage_part(lake: Lake, scene: str, stage: str, tag: object, at: float, room: str | None = None, shared: object = "of all") -> None:
    """Stage one stage of a scene, as `stage_whole_scene` does."""
    index = SCENE_STAGES.index(stage)
    assets = [fingerprint("asset", scene), fingerprint("asset", shared)]
    upstream = [f"{name}={fingerprint(scene, tag, name)}" for name in SCENE_STAGES[:index]]
    rows = {table.name: _rows(lake, table, scene, tag, room or scene, assets) for table in TABLES.values() if table.stage == stage}
    run = stage_run(scene, stage, fingerprint(scene, tag, stage), *upstream, at=at + index / 100, host="here:1")
    lake.stage_rows(run, rows)


def stage_batch(lake: Lake, batch: str, scenes: list[str], at: float, error: str = "") -> None:
    """Stage a batch of annotations and one of trajectories (`<batch>-runs`) about some scenes."""
    answers = [sample(Annotation, batch_id=batch, scene_id=scene, instance_id=i, annotator="anna") for scene in scenes for i in INSTANCES]
    lake.stage_rows(stage_run(batch, "annotation", fingerprint(batch), at=at), {"annotations": answers})
    ways = [sample(Trajectory, batch_id=f"{batch}-runs", scene_id=scene, episode_id="0001") for scene in scenes]
    run = stage_run(f"{batch}-runs", "evaluation", fingerprint(batch, "runs"), at=at + 0.01, degradations=(error,) if error else ())
    lake.stage_rows(run, {"trajectories": ways})


_PATTERNS = {
    r"[0-9]{4,}": "0001",
    r"[0-9]{6}": "000001",
    r"[0-9a-f]{64}": "a" * 64,
    r"[A-Za-z0-9][A-Za-z0-9_.-]*": "batch-1",
    AGAINST_PATTERN: "wall_00",
    BODY_PATTERN: "wall_00",
    SURFACE_PATTERN: "wall_00",
}


def _made_up(column: Column) -> Any:
    if column.nullable:
        return None
    if column.values:
        return column.values[0]
    if column.blob:
        return "b" * 64 + ".glb"
    if column.pattern:
        return _PATTERNS.get(column.pattern, "demo/room_a")
    if pa.types.is_list(column.type):
        inner = column.type.value_type
        number: Any = max(1, int(column.minimum or 1)) if pa.types.is_integer(inner) else max(1.0, column.minimum or 1.0)
        if column.maximum is not None:
            number = min(number, type(number)(column.maximum))
        item: Any = "word" if pa.types.is_string(inner) else (1.0, 2.0) if pa.types.is_list(inner) else number
        return (item,) * (column.length or 2)
    if pa.types.is_string(column.type):
        return "text"
    if pa.types.is_boolean(column.type):
        return True if column.earlier is None else column.earlier
    if pa.types.is_timestamp(column.type):
        return START
    number = max(1.0, column.minimum or 1.0) if column.maximum is None else min(max(1.0, column.minimum or 1.0), column.maximum)
    return int(number) if pa.types.is_integer(column.type) else number


def _rows(lake: Lake, table: Table, scene: str, tag: object, room: str, assets: list[str]) -> list[Any]:
    if table.name == "assets":
        made = []
        for asset in assets:
            source = "scan" if asset == assets[1] else f"scan {scene}"
            made.append(sample(Asset, asset_id=asset, mesh_blob=lake.blobs.put(f"mesh {asset}".encode(), "glb"), source=source))
        return made
    known = {column.name for column in table.columns}
    given: dict[str, Any] = {"scene_id": scene, "room_id": room, "asset_id": assets[0], "license": str(tag), "scan_path": f"/scans/{scene}"}
    given |= {"is_structure": False}
    given |= {column: lake.blobs.put(f"{scene} {tag} {table.name} {column}".encode(), "glb") for column in table.blob_columns}
    if table.name == "scenes":
        given |= {"dataset": scene.partition("/")[0], "scan": scene.partition("/")[2]}
    many = INSTANCES if "instance_id" in table.key else INSTANCES[:1]
    must_be_carried = any(column.name == "parent_id" and not column.nullable for column in table.columns)
    rows = []
    for index, instance in enumerate(many):
        values = given | {"instance_id": instance, "instance_a": instance, "parent_id": INSTANCES[0] if index or must_be_carried else None}
        values |= {"asset_id": assets[index]} if table.name in ("candidates", "selections", "placements") else {}
        rows.append(sample(table.record, **{name: value for name, value in values.items() if name in known}))
    return rows
