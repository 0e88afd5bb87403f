"""Annotation batches into the lake: the annotation stage, run here and now on one batch. Does not import Prefect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flows.configuration import configure
from flows.fingerprints import canonical_json, code_fingerprint, digest
from flows.worker import Job, execute
from schemas.annotation import Annotation
from schemas.candidates import Candidate
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.record import rows_to_arrow
from tasks import annotation
from tasks.annotation.batch import read_batch
from tasks.stage import Context
from warehouse.lake import Lake


def import_annotations(lake: Lake, file: Path, dry_run: bool = False) -> dict[str, Any]:
    """Read a batch, hold it against the lake's scenes, and append it. Returns what was imported, as plain values.

    Raises:
        InputError: the file, or an answer in it, cannot be used; nothing is imported then. A batch that is in the lake
            already with other answers is refused: answers are history, and history is not rewritten.
    """
    batch = read_batch(file)
    stage = annotation.STAGE
    configuration = configure()
    config = configuration.stages[stage.name]
    reader = lake.snapshot()
    scenes = sorted({answer.scene_id for answer in batch.annotations})
    instances: list[Instance] = [row for scene in scenes for row in reader.rows(Instance, scene)]
    candidates: list[Candidate] = [row for scene in scenes for row in reader.rows(Candidate, scene)]
    context = Context(scene_id=batch.batch_id, stage=stage.name, seed=configuration.seed, blobs=lake.blobs)
    rows: list[Annotation] = stage.run(
        annotation_batch=batch, instances=instances, candidates=candidates, context=context, config=config
    ).rows["annotations"]
    present = [row for row in reader.rows(Annotation) if row.batch_id == batch.batch_id]
    summary = {
        "batch_id": batch.batch_id,
        "annotations": len(rows),
        "annotators": len({row.annotator for row in rows}),
        "scenes": len(scenes),
        "already": _same(present, rows),
    }
    if present and not summary["already"]:
        raise InputError(
            file.name, "batch_id", f"{batch.batch_id} is in the lake with other answers", "give the new answers a batch_id of their own"
        )
    if dry_run or present:
        return summary
    content = digest(*(canonical_json(row) for row in rows))
    job = Job(
        lake=lake.address,
        scene_id=batch.batch_id,
        stage=stage.name,
        config=config,
        config_json=canonical_json(config),
        seed=configuration.seed,
        fingerprint=digest("annotation", content, code_fingerprint("tasks.annotation")),
        reasons=(f"annotation_batch={content}",),
        upstream=(),
        attempt=1,
        outside=(("annotation_batch", batch), ("instances", instances), ("candidates", candidates)),
    )
    run = execute(job)
    if run.error:
        raise InputError(file.name, "annotations", run.error)
    lake.commit(note=f"annotation batch {batch.batch_id}", scenes=[batch.batch_id])
    return summary


def _same(present: list[Annotation], rows: list[Annotation]) -> bool:
    """Whether the lake holds exactly these answers."""
    return bool(present) and rows_to_arrow(present, Annotation).equals(rows_to_arrow(rows, Annotation))
