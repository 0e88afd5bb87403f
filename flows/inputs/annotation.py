"""Annotation batches and reviews of them into the lake: the annotation stage, run here and now. Does not import Prefect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flows.run.configuration import configure
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from flows.worker import Job, execute
from schemas.annotation import Annotation, QualityReview
from schemas.candidates import Candidate
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.record import rows_to_arrow
from tasks import annotation
from tasks.annotation import check_reviews, read_batch, read_reviews
from tasks.stage import Context
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader

STAGE = annotation.STAGE


def import_annotations(lake: Lake, file: Path, dry_run: bool = False) -> dict[str, Any]:
    """Read a batch, hold it against the lake's scenes, and append it. Returns what was imported, as plain values.

    Raises:
        InputError: the file, or an answer in it, cannot be used; nothing is imported then. A batch that is in the lake
            already with other answers is refused: answers are history, and history is not rewritten.
    """
    batch = read_batch(file)
    if not dry_run:
        _take_in(lake, batch.batch_id)
    reader = lake.snapshot()
    instances: list[Instance] = [row for scene in batch.scene_ids for row in reader.rows(Instance, scene)]
    candidates: list[Candidate] = [row for scene in batch.scene_ids for row in reader.rows(Candidate, scene)]
    inputs = {"annotation_batch": batch, "review_batch": None, "instances": instances, "candidates": candidates}
    rows: list[Annotation] = _computed(lake, batch.batch_id, inputs)["annotations"]
    present = _of_batch(reader, Annotation, batch.batch_id)
    summary = {
        "batch_id": batch.batch_id,
        "annotations": len(rows),
        "annotators": len({row.annotator for row in rows}),
        "scenes": len(batch.scene_ids),
        "already": _same(present, rows),
    }
    if present and not summary["already"]:
        raise InputError(
            file.name, "batch_id", f"{batch.batch_id} is in the lake with other answers", "give the new answers a batch_id of their own"
        )
    if not dry_run and not present:
        _append(lake, file, batch.batch_id, inputs, rows, f"annotation batch {batch.batch_id}")
    return summary


def import_reviews(lake: Lake, file: Path, dry_run: bool = False) -> dict[str, Any]:
    """Read reviews of an annotation batch, hold them against its answers, and append those that are new.

    Returns what was imported, as plain values: `already` counts the reviews that the lake had.

    Raises:
        InputError: the file, or a review in it, cannot be used, or its batch is not in the lake; nothing is imported then.
            A review that is in the lake already and says something else is refused: reviews are history.
    """
    batch = read_reviews(file)
    if not dry_run:
        _take_in(lake, batch.batch_id)
    reader = lake.snapshot()
    check_reviews(batch, len(_of_batch(reader, Annotation, batch.batch_id)))
    inputs = {"annotation_batch": None, "review_batch": batch, "instances": (), "candidates": ()}
    rows: list[QualityReview] = _computed(lake, batch.batch_id, inputs)["quality_reviews"]
    present = {row.review_id: row for row in _of_batch(reader, QualityReview, batch.batch_id)}
    for row in rows:
        if row.review_id in present and not _same([present[row.review_id]], [row]):
            problem = f"{row.review_id} of batch {batch.batch_id} is in the lake and says something else"
            raise InputError(file.name, "review_id", problem, "give the new review a review_id of its own")
    new = [row for row in rows if row.review_id not in present]
    if not dry_run and new:
        _append(lake, file, batch.batch_id, inputs, rows, f"review of annotation batch {batch.batch_id}")
    return {
        "batch_id": batch.batch_id,
        "reviews": len(rows),
        "already": len(rows) - len(new),
        "sampled": sum(row.sampled for row in rows),
        "wrong": sum(row.wrong for row in rows),
        "returned": sum(row.verdict == "returned" for row in rows),
    }


def _take_in(lake: Lake, batch_id: str) -> None:
    """Commit what an import of the batch staged that was killed, so that it is not done a second time."""
    if batch_id in lake.abandoned():
        lake.commit(f"annotation batch {batch_id}", scenes=[batch_id])


def _computed(lake: Lake, batch_id: str, inputs: dict[str, Any]) -> dict[str, list[Any]]:
    """Rows that the stage would write, by table."""
    configuration = configure()
    context = Context(scene_id=batch_id, stage=STAGE.name, seed=configuration.seed, blobs=lake.blobs)
    rows: dict[str, list[Any]] = STAGE.run(**inputs, context=context, config=configuration.stages[STAGE.name]).rows
    return rows


def _of_batch(reader: Reader, record: type[Any], batch_id: str) -> list[Any]:
    """The lake's rows of a batch, sorted by key."""
    return list(reader.rows_by_key(record, [batch_id]))


def _append(lake: Lake, file: Path, batch_id: str, inputs: dict[str, Any], rows: list[Any], note: str) -> None:
    """Run the stage on a batch and commit what it wrote."""
    configuration = configure()
    config = configuration.stages[STAGE.name]
    content = digest(*(canonical_json(row) for row in rows))
    given = next(name for name in STAGE.outside if inputs[name] is not None)
    job = Job(
        lake=lake.address,
        scene_id=batch_id,
        stage=STAGE.name,
        config=config,
        config_json=canonical_json(config),
        seed=configuration.seed,
        fingerprint=digest("annotation", content, code_fingerprint("tasks.annotation")),
        reasons=(f"{given}={content}",),
        upstream=(),
        attempt=1,
        outside=tuple(inputs.items()),
    )
    run = execute(job)
    if run.error:
        raise InputError(file.name, "annotations", run.error)
    lake.commit(note=note, scenes=[batch_id])


def _same(present: list[Any], rows: list[Any]) -> bool:
    """Whether the lake holds exactly these rows."""
    return bool(present) and rows_to_arrow(present, type(present[0])).equals(rows_to_arrow(rows, type(rows[0])))
