"""Whole scenes for tests: rows in every table, which name one another as a pipeline's rows do, made in milliseconds."""

from __future__ import annotations

from typing import Any

from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.evaluation import Trajectory
from schemas.record import Table
from schemas.tables import TABLES
from tests.samples import fingerprint, sample, stage_run
from warehouse.adoption import SCENE_STAGES
from warehouse.lake import Lake

INSTANCES = ("0001", "0002")


def stage_whole_scene(lake: Lake, scene: str, tag: object, at: float, room: str | None = None, shared: object = "of all") -> None:
    """Stage every stage of a scene, with blobs of its own, an asset of its own and one that scenes with one `shared` share."""
    assets = [fingerprint("asset", scene), fingerprint("asset", shared)]
    upstream: list[str] = []
    for index, stage in enumerate(SCENE_STAGES):
        tables = [table for table in TABLES.values() if table.stage == stage]
        rows = {table.name: _rows(lake, table, scene, tag, room or scene, assets) for table in tables}
        run = stage_run(scene, stage, fingerprint(scene, tag, stage), *upstream, at=at + index / 100, host="here:1")
        lake.stage_rows(run, rows)
        upstream.append(f"{stage}={run.fingerprint}")


def stage_batch(lake: Lake, batch: str, scenes: list[str], at: float, error: str = "") -> None:
    """Stage a batch of annotations and one of trajectories (`<batch>-runs`) about some scenes."""
    answers = [sample(Annotation, batch_id=batch, scene_id=scene, instance_id=i, annotator="anna") for scene in scenes for i in INSTANCES]
    lake.stage_rows(stage_run(batch, "annotation", fingerprint(batch), at=at), {"annotations": answers})
    ways = [sample(Trajectory, batch_id=f"{batch}-runs", scene_id=scene, episode_id="0001") for scene in scenes]
    run = stage_run(f"{batch}-runs", "evaluation", fingerprint(batch, "runs"), at=at + 0.01, degradations=(error,) if error else ())
    lake.stage_rows(run, {"trajectories": ways})


def _rows(lake: Lake, table: Table, scene: str, tag: object, room: str, assets: list[str]) -> list[Any]:
    if table.name == "assets":
        made = []
        for asset in assets:
            content = f"mesh {asset}".encode()
            made.append(
                sample(
                    Asset,
                    asset_id=asset,
                    mesh_blob=lake.blobs.put(content, "glb"),
                    source="scan" if asset == assets[1] else f"scan {scene}",
                )
            )
        return made
    known = {column.name for column in table.columns}
    given: dict[str, Any] = {"scene_id": scene, "room_id": room, "asset_id": assets[0], "license": str(tag), "scan_path": f"/scans/{scene}"}
    given |= {column: lake.blobs.put(f"{scene} {tag} {table.name} {column}".encode(), "glb") for column in table.blob_columns}
    if table.name == "scenes":
        given |= {"dataset": scene.partition("/")[0], "scan": scene.partition("/")[2]}
    many = INSTANCES if "instance_id" in table.key else INSTANCES[:1]
    rows = []
    for index, instance in enumerate(many):
        values = given | {"instance_id": instance, "instance_a": instance, "parent_id": INSTANCES[0] if index else None}
        values |= {"asset_id": assets[index]} if table.name in ("candidates", "selections", "placements") else {}
        rows.append(sample(table.record, **{name: value for name, value in values.items() if name in known}))
    return rows
