"""The one wrapper around every stage: fetch inputs, call `run`, check and stage the result, record it.

Pool workers import this module; it does not import Prefect.
"""

from __future__ import annotations

import dataclasses
import errno
import os
import resource
import socket
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

import pyarrow as pa

from flows.run.crew import crew_of
from flows.run.fingerprints import ModuleCaches, annotations_digest
from flows.run.ledger import FREE, CallRules, LakeLedger
from flows.run.libraries import NamedLibrary, library_for_worker
from flows.run.parts import place_of
from schemas.errors import InputError, LakeError, RecordError
from schemas.record import arrow_to_rows, check
from schemas.runs import StageRun
from schemas.tables import TABLES
from schemas.text import one_line
from schemas.wording import counted
from tasks.library.library import OpenLibrary
from tasks.models import Model
from tasks.stage import Context, Outcome, Spread, Stage, silently
from warehouse.lake import Lake
from warehouse.release.licenses import with_licenses_of_scans
from warehouse.tables.history import parse_elsewhere
from warehouse.tables.reviews import standing_answers
from warehouse.tables.snapshot import Reader


@dataclasses.dataclass(frozen=True)
class Job:
    """One stage to run on one scene (or batch). Travels to a worker process, which may use `processes` of its own.

    `snapshot_id` is the snapshot that it was planned from; None is the newest. `calls`: What it may ask models for.
    """

    lake: str
    scene_id: str
    stage: str
    config: Any
    config_json: str
    seed: int
    fingerprint: str
    reasons: tuple[str, ...]
    upstream: tuple[str, ...]
    attempt: int
    outside: tuple[tuple[str, Any], ...] = ()
    processes: int = 1
    snapshot_id: int | None = None
    calls: CallRules = FREE


Report = Callable[[int, int, str], None]
"""Who is told how far a run is, as `Context.report`."""


def execute(job: Job, spread: Spread | None = None, report: Report = silently) -> StageRun:
    """Run a stage and stage its rows; a failure is staged as a row too. Returns the row of `stage_runs`.

    `spread` stands in for the worker's own map over parts of the work, to show how far it is.
    """
    stage = _stage_of(job)
    lake = Lake.open(job.lake)
    started, clock = datetime.now(UTC), time.perf_counter()
    rows: dict[str, list[Any]] = {}
    error: str | None = None
    kind: str | None = None
    degradations: tuple[str, ...] = ()
    try:
        outcome = _kept(stage, job, lake, _computed(stage, job, lake, spread or crew_of(job.processes), report))
        rows, degradations = outcome.rows, outcome.degradations
    except Exception as problem:
        kind, error = kind_and_text(problem)
    run = dataclasses.replace(
        lost_run(job, kind, error, time.perf_counter() - clock),
        row_counts=tuple(f"{table}={len(values)}" for table, values in sorted(rows.items())),
        degradations=tuple(degradations),
        started_at=started,
        host=f"{socket.gethostname()}:{os.getpid()}",
        peak_memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )
    lake.stage_rows(run, rows)
    return run


def kind_and_text(problem: Exception) -> tuple[str, str]:
    """How the row of a run that ended with this says so: kind of error, and one line. Called while it is handled."""
    if isinstance(problem, InputError):
        return "input", str(problem)
    if isinstance(problem, RowsGone):
        return "lost", str(problem)
    if os.environ.get("METASCENES_TRACEBACK"):
        traceback.print_exc(file=sys.stderr)
    return "lost" if _passes(problem) else "defect", _one_line(problem)


def followed(job: Job, report: Report = silently) -> Outcome:
    """What a stage gives, and nothing kept of it: for processes that take part in a run whose first one keeps its rows."""
    return _computed(_stage_of(job), job, Lake.open(job.lake), crew_of(job.processes), report)


def _stage_of(job: Job) -> Stage:
    from tasks.pipeline import STAGES

    return next(stage for stage in STAGES if stage.name == job.stage)


def lost_run(job: Job, kind: str | None, message: str | None, seconds: float) -> StageRun:
    """The row of `stage_runs` for a job whose worker did not come back; staged by the coordinator.

    With no `kind` of error it is that of a job that is done and wrote nothing.
    """
    return StageRun(
        scene_id=job.scene_id,
        stage=job.stage,
        fingerprint=job.fingerprint,
        attempt=job.attempt,
        outcome="lost" if kind == "lost" else "failed" if kind else "done",
        upstream=job.upstream,
        reasons=job.reasons,
        config=job.config_json,
        row_counts=(),
        degradations=(),
        error=message,
        error_kind=kind,
        started_at=datetime.now(UTC),
        seconds=seconds,
        host=socket.gethostname(),
        peak_memory_mb=0.0,
        snapshot_id=0,
    )


def _computed(stage: Stage, job: Job, lake: Lake, spread: Spread, report: Report) -> Outcome:
    """Inputs in, and `run`."""
    fingerprints = dict(part.split("=", 1) for part in job.upstream)
    inputs: dict[str, Any] = dict(job.outside)
    if stage.grain == "rescan":
        inputs |= _of_several(stage, lake, job)
    for table in stage.reads:
        if table in inputs:  # a batch brings the rows of the scenes that it names
            continue
        inputs[table] = _rows(lake, table, job.scene_id, fingerprints.get(TABLES[table].stage))
    for table in stage.history:
        inputs[table] = history_rows(lake, table, job)
    if "assets" in inputs:
        inputs["assets"] = with_licenses_of_scans(inputs["assets"], lake.snapshot, job.scene_id)
    if isinstance(inputs.get("library"), NamedLibrary):
        inputs["library"] = _library(job, inputs["library"])
    if inputs.get("model") is not None and stage.model_wanted is not None:
        inputs["model"] = _model(stage, job, str(inputs["model"]))
    context = Context(
        scene_id=job.scene_id, stage=job.stage, seed=job.seed, blobs=lake.blobs, caches=ModuleCaches(), spread=spread, report=report,
        ledger=LakeLedger(lake, job.calls),
    )  # fmt: skip
    return stage.run(**inputs, context=context, config=job.config)


def _library(job: Job, named: NamedLibrary) -> OpenLibrary:
    """The library that a job names, as it was when that was planned.

    Raises:
        RowsGone: it is another by now, or was removed.
    """
    library = library_for_worker(job.lake, named.name, named.content, job.snapshot_id)
    if library is None:
        raise RowsGone(f"{job.scene_id}: library {named.name}: it was indexed again or removed while this stage was under way; run again")
    return library


def _model(stage: Stage, job: Job, model_id: str) -> Model:
    """The model that a job names, of the learned system that the stage's config asks for."""
    from flows.training.models import model_for_worker

    wanted = stage.model_wanted(job.config) if stage.model_wanted is not None else None
    return model_for_worker(job.lake, wanted.kind if wanted is not None else "", model_id)


def _kept(stage: Stage, job: Job, lake: Lake, outcome: Outcome) -> Outcome:
    """The result, held against the declaration and the schemas, and its blobs in the lake."""
    if set(outcome.rows) != set(stage.writes):
        raise LakeError(f"stage {stage.name} declares {', '.join(stage.writes)} and returned {', '.join(outcome.rows)}")
    named: set[str] = set()
    for table, values in outcome.rows.items():
        check(values, TABLES[table].record)
        _check_owner(table, values, job)
        named.update(getattr(row, c) for row in values for c in TABLES[table].blob_columns if getattr(row, c))
    try:
        lake.blobs.put_all({name: outcome.blobs[name] for name in sorted(named & set(outcome.blobs))})
    except LakeError as error:
        raise LakeError(f"stage {stage.name}: {error}") from error
    missing = [name for name in sorted(named - set(outcome.blobs)) if name not in lake.blobs]
    if missing:
        raise LakeError(f"stage {stage.name}: rows name {counted(len(missing), 'blob')} that nobody made, {missing[0]} first")
    return outcome


def _check_owner(table: str, rows: list[Any], job: Job) -> None:
    """A stage may write rows of its own scene only; a batch writes rows that name it."""
    column = TABLES[table].owner
    for index, row in enumerate(rows):
        if column and getattr(row, column) != job.scene_id:
            raise RecordError(table, str(index), column, f"must be {job.scene_id}, got {getattr(row, column)!r}")


class RowsGone(LakeError):
    """Rows that a stage reads are neither staged nor in the lake any more: another run replaced them meanwhile."""


def history_rows(lake: Lake, table: str, job: Job) -> list[Any]:
    """Rows of a history that count: those that the job's fingerprint names, also where more came in since it was planned.

    Else rows would pass for those of a state that they were not made from, and never be made again.

    Raises:
        RowsGone: the lake has no state any more in which it was as it was planned.
    """
    planned = next((part.partition("=")[2] for part in job.reasons if part.startswith(f"{table}=")), None)
    for snapshot_id in (None, job.snapshot_id):
        try:
            rows = HISTORIES[table](lake.snapshot(snapshot_id), job.scene_id)
        except InputError:  # removed since
            continue
        if planned is None or annotations_digest(rows.to_pylist()) == planned:
            return list(arrow_to_rows(rows, TABLES[table].record))
    raise RowsGone(f"{job.scene_id}: {table}: they changed while this stage was under way; run again")


HISTORIES: Mapping[str, Callable[[Reader, str | None], pa.Table]] = {"annotations": standing_answers}
"""How the rows of each history that count are read."""


def _rows(lake: Lake, table: str, scene_id: str, fingerprint: str | None) -> list[Any]:
    """A table's rows of a scene: those that the run with a fingerprint gave, or as the lake has them where none is named.

    Rows of a shared table (assets) are those that the run itself wrote, or those that its rows name.

    Raises:
        RowsGone: the run with that fingerprint left no rows, or they were replaced.
    """
    spec = TABLES[table]
    if fingerprint is None:
        return list(lake.snapshot().rows(spec.record, scene_id))
    if spec.rule != "share":
        return _still_there(lake.rows_of(table, scene_id, fingerprint), table, scene_id)
    staged = lake.staged_rows(table, scene_id, fingerprint)
    if staged is not None:
        return list(staged)
    sharing = _still_there(lake.rows_of(spec.shared_by, scene_id, fingerprint), table, scene_id)
    names = sorted({getattr(row, spec.key[0]) for row in sharing} - {None})
    return list(lake.snapshot().rows_by_key(spec.record, names))


def _of_several(stage: Stage, lake: Lake, job: Job) -> dict[str, list[Any]]:
    """Rows of all scenes that the job's upstream names, by table, each as the run with its fingerprint gave them.

    Raises:
        RowsGone: they were replaced.
    """
    named = parse_elsewhere(job.upstream)
    return {
        table: [
            row
            for (scene, name), fingerprint in named.items()
            if name == TABLES[table].stage
            for row in _rows(lake, table, scene, fingerprint)
        ]
        for table in stage.reads
    }


def _still_there(rows: list[Any] | None, table: str, scene_id: str) -> list[Any]:
    if rows is None:
        raise RowsGone(f"{scene_id}: {table}: the rows that this stage reads were replaced by another run; run again")
    return rows


def _passes(error: Exception) -> bool:
    """Whether the cause lies outside of scan and code, so that another try may succeed: a store that is away, a full disk."""
    from flows.run.patience import is_away

    return is_away(error) or (isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT))


def _one_line(error: BaseException) -> str:
    """An unexpected error as one line with the place in our code that it came from."""
    place = f" at {where}" if (where := place_of(error)) else ""
    return f"{type(error).__name__}: {one_line(error)[:500]}{place}"
