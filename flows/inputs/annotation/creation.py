"""A batch made by the lake: objects picked and assigned, and a folder with all that it takes to answer. Whole or not at all."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import secrets
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flows.inputs.annotation.acts import changing, now, rows_of, state_in
from flows.inputs.annotation.handouts import write_handouts
from flows.progress import Progress
from flows.run.configuration import Configuration, configure
from schemas.annotation import BATCH_PATTERN, Annotation, Assignment, WorkBatch
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Shell
from schemas.errors import InputError
from schemas.optimization import Certificate
from schemas.selection import Selection
from schemas.wording import meant, noun
from tasks.annotation import SCHEMA_FILE, BatchActs
from tasks.annotation.picking import assigned, doubts, picked
from tasks.annotation.revisions import latest
from tasks.annotation.work import ANSWERS, DOCUMENT, WORK_SCHEMA_FILE, asset_file, crop_file, crops, thumbnail_file, work_document
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader

LONGEST_NAME = 100
"""Characters of a batch's name and of an annotator's, as in the published schemas."""


@dataclasses.dataclass(frozen=True)
class BatchPlan:
    """What a new batch is to ask, and of whom. `scenes`: all when none are named. `count`: objects at most."""

    batch_id: str
    annotators: tuple[str, ...]
    overlap: int = 1
    pick: str = "all"
    scenes: tuple[str, ...] = ()
    count: int | None = None


def create_batch(
    lake: Lake,
    plan: BatchPlan,
    out: Path,
    *,
    again: bool = False,
    dry_run: bool = False,
    configuration: Configuration | None = None,
) -> dict[str, Any]:
    """Record a batch in the lake and write its folder; with `again`, only write the folder of one that is there already.

    A batch that is killed half-way leaves no folder; the lake may have it: `again`.

    Raises:
        InputError: the names cannot be used, the folder or the batch is there already, nothing is left to ask, or the scenes do not
            have candidates.
    """
    configuration = configuration or configure()
    if out.exists():
        raise InputError(str(out), "--out", "is there already", "name a folder that is not")
    _check_names(plan)
    if dry_run:
        batch, assignments = _planned(lake.snapshot(), plan, again, configuration)
    else:
        with changing(lake, plan.batch_id) as change:
            batch, assignments = _planned(change.reader, plan, again, configuration)
            part = out.with_name(f".{out.name}.{secrets.token_hex(6)}.making")
            try:
                _write(part, lake, change.reader, batch, assignments)
                if not again:
                    acts = BatchActs(annotation_batches=(batch,), assignments=tuple(assignments))
                    change.commit(acts, f"annotation batch {plan.batch_id} created", configuration)
                part.rename(out)
            except OSError as error:
                raise InputError(str(out), "--out", f"cannot be written ({error.strerror})", "check path, permissions and space") from error
            finally:
                shutil.rmtree(part, ignore_errors=True)
    loads = {name: sum(row.annotator == name for row in assignments) for name in sorted({row.annotator for row in assignments})}
    return {
        "batch_id": batch.batch_id,
        "objects": len({(row.scene_id, row.instance_id) for row in assignments}),
        "scenes": len({row.scene_id for row in assignments}),
        "assignments": loads,
        "overlap": batch.overlap,
        "pick": batch.pick,
        "out": None if dry_run else str(out),
    }


def _check_names(plan: BatchPlan) -> None:
    if not re.fullmatch(BATCH_PATTERN, plan.batch_id) or len(plan.batch_id) > LONGEST_NAME:
        raise InputError("--batch", plan.batch_id[:60], "is no name of a batch", "give letters, digits, '_', '.', '-'")
    for name in plan.annotators:
        if not name.strip() or name != name.strip() or not name.isprintable() or len(name) > LONGEST_NAME:
            raise InputError("--annotator", repr(name[:60]), "is no name", f"give up to {LONGEST_NAME} letters without spaces around them")


def _planned(reader: Reader, plan: BatchPlan, again: bool, configuration: Configuration) -> tuple[WorkBatch, list[Assignment]]:
    """The rows of a batch: new ones, or those of the lake."""
    state = state_in(reader, plan.batch_id)
    if again:
        if state.batch is None or state.origin != "created":
            raise InputError("--batch", plan.batch_id, "was not created in this lake", "leave --again out")
        return state.batch, rows_of(reader, Assignment, plan.batch_id)
    if state.batch is not None or rows_of(reader, Annotation, plan.batch_id):
        raise InputError("--batch", plan.batch_id, "is in the lake already", "give another name, or --again to write its folder anew")
    config = configuration.stages["annotation"]
    batch = WorkBatch(
        batch_id=plan.batch_id,
        origin="created",
        created_at=now(),
        pick=plan.pick,
        overlap=plan.overlap,
        seed=configuration.seed,
        sample_share=config.sample_share,
        least_sample=config.least_sample,
        pass_share=config.pass_share,
        counts_unreviewed=False,
    )
    instances: list[Instance] = _rows(reader, Instance, plan.scenes)
    unknown = sorted(set(plan.scenes) - {row.scene_id for row in instances})
    if unknown:
        known = reader.matching("scenes", {}, ["scene_id"]).column("scene_id").to_pylist()
        raise InputError("--scene", unknown[0], "is not in the lake", f"{meant(unknown[0], known)}`metascenes scenes` names its scenes")
    by_batch: dict[str, list[Annotation]] = {}
    for answer in _rows(reader, Annotation, plan.scenes):
        by_batch.setdefault(answer.batch_id, []).append(answer)
    answers = [answer for rows in by_batch.values() for answer in latest(rows).values()]
    certificates = [row for row in _rows(reader, Certificate, plan.scenes) if row.engine == "mujoco"]
    tasks = doubts(instances, _rows(reader, Selection, plan.scenes), answers, certificates)
    answered = {(answer.scene_id, answer.instance_id) for answer in answers}
    entropy = hashlib.sha256(f"{configuration.seed}|{plan.batch_id}|assignment".encode()).digest()
    rows = assigned(picked(tasks, plan.pick, answered, plan.count), plan.annotators, plan.overlap, np.random.default_rng(list(entropy)))
    assignments = [
        Assignment(
            batch_id=plan.batch_id, scene_id=task.scene_id, instance_id=task.instance_id, annotator=annotator, place=place,
            doubt=task.doubt, reasons=task.reasons, proposed=task.proposed,
        )
        for task, annotator, place in rows
    ]  # fmt: skip
    return batch, assignments


def _rows(reader: Reader, record: type[Any], scenes: Sequence[str]) -> list[Any]:
    """Rows of some scenes, of all when none are named."""
    return [row for scene in scenes for row in reader.rows(record, scene)] if scenes else list(reader.rows(record))


@dataclasses.dataclass(frozen=True)
class Asked:
    """What a batch asks about: instances with what is offered for them, and the document that says so (`work.schema.json`)."""

    instances: tuple[Instance, ...]
    assets: tuple[Asset, ...]
    document: dict[str, Any]


def asked_of(reader: Reader, batch: WorkBatch, assignments: Sequence[Assignment]) -> Asked:
    """What a batch asks about, as a snapshot has it.

    Raises:
        InputError: some of it is not in the snapshot any more.
    """
    scenes = sorted({row.scene_id for row in assignments})
    keys = {(row.scene_id, row.instance_id) for row in assignments}
    instances = [row for row in _rows(reader, Instance, scenes) if (row.scene_id, row.instance_id) in keys]
    gone = keys - {(row.scene_id, row.instance_id) for row in instances}
    if gone:
        raise InputError(
            "--batch",
            batch.batch_id,
            f"{len(gone)} of its objects {noun(len(gone), 'is', 'are')} not in the lake any more",
            "create a new batch",
        )
    candidates = _rows(reader, Candidate, scenes)
    named = {row.asset_id for row in candidates if (row.scene_id, row.instance_id) in keys and row.asset_id is not None}
    assets: list[Asset] = reader.rows_by_key(Asset, named)
    document = work_document(
        batch, assignments, instances, _rows(reader, Caption, scenes), candidates, _rows(reader, Selection, scenes),
        _rows(reader, Shell, scenes), assets,
    )  # fmt: skip
    return Asked(tuple(instances), tuple(assets), document)


def _write(folder: Path, lake: Lake, reader: Reader, batch: WorkBatch, assignments: Sequence[Assignment]) -> None:
    """Write the folder of a batch."""
    from tasks.geometry.meshes import load_glb
    from tasks.stats.thumbnails import object_thumbnail

    asked = asked_of(reader, batch, assignments)
    document = asked.document
    for name in ("assets", "thumbnails", "scans", "answers"):
        (folder / name).mkdir(parents=True)
    with Progress("candidates", len(asked.assets)) as bar:
        for asset in asked.assets:
            glb = lake.blobs[asset.mesh_blob]
            (folder / asset_file(asset.asset_id)).write_bytes(glb)
            (folder / thumbnail_file(asset.asset_id)).write_bytes(object_thumbnail(load_glb(glb, f"{asset.name}.glb")))
            bar.advance(asset.name)
    for blob in sorted({blob for row in asked.instances for blob in crops(row)}):
        (folder / crop_file(blob)).write_bytes(lake.blobs[blob])
    files = [row["answers"] for row in document["annotators"]]
    for name in files:
        _json(folder / name, {"$schema": f"../{SCHEMA_FILE.name}", "batch_id": batch.batch_id, "annotations": []})
    _json(folder / ANSWERS, {"$schema": SCHEMA_FILE.name, "batch_id": batch.batch_id, "files": files})
    for schema in (SCHEMA_FILE, WORK_SCHEMA_FILE):
        shutil.copyfile(schema, folder / schema.name)
    write_handouts(folder, document)
    _json(folder / DOCUMENT, document)


def _json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
