"""One scene through its stages, in a worker process: rows of a drawn layout, then the stages that any scene goes through."""

from __future__ import annotations

import dataclasses
import os
import resource
import socket
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from flows.run.fingerprints import ModuleCaches
from flows.run.patience import is_away
from flows.run.scene import NO_ROOM
from flows.worker import Job, RowsGone, history_rows, lost_run
from schemas.candidates import Asset
from schemas.capture import SYNTHESIS
from schemas.errors import InputError, LakeError
from schemas.record import check
from schemas.runs import StageRun
from schemas.tables import TABLES
from schemas.text import one_line
from tasks.pipeline import STAGES
from tasks.stage import Context, Outcome, Stage
from tasks.synthesis.scenes.bases import with_origins
from tasks.synthesis.scenes.drawn import BaseScene, Drawn
from tasks.synthesis.scenes.rows import drawn_rows
from warehouse.lake import Lake
from warehouse.release.licenses import with_licenses_of_scans
from warehouse.storage.refusals import number_of

FRONT = ("capture", "captions", "candidates", "selection")
"""Stages whose rows follow from the layout, made together."""

BACK = ("optimization", "micro_scenes", "navigation", "exports")
"""Stages that are run on these, as on those of any scene."""


@dataclasses.dataclass(frozen=True)
class SynthesisJob:
    """A scene to make or to go on with. Travels to a worker process.

    jobs: Of all its stages, in order. todo: Stages to be run; the rest is in the lake, or staged. drawn, chosen, base: As `drawn_rows`
    takes them; drawn is None where the layout's rows are there.
    """

    lake: str
    scene_id: str
    dataset: str
    jobs: tuple[Job, ...]
    todo: tuple[str, ...]
    drawn: Drawn | None
    chosen: tuple[Asset | None, ...]
    base: BaseScene | None


@dataclasses.dataclass(frozen=True)
class SceneDone:
    """What came of a scene. objects: That were drawn. proposed, settled: Of these, stable as drawn, and in the end. broken: Rules of gates
    that its exports break. error: Why it failed, with the stage."""

    scene_id: str
    objects: int = 0
    proposed: int = 0
    settled: int = 0
    broken: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    error: str | None = None


def make_scene(job: SynthesisJob) -> SceneDone:
    """Run what is to be done of a scene and stage it, stage by stage; a failure is staged as a row too. Runs in a worker process.

    What fails beside the stages, such as a disk without room for the rows, is said and leaves no row: the next command tries it again.
    """
    try:
        return _made(job)
    except Exception as error:
        text = str(error) if isinstance(error, LakeError) else f"{type(error).__name__}: {one_line(error)[:500]}"
        return SceneDone(job.scene_id, error=text)


def _made(job: SynthesisJob) -> SceneDone:
    scene = _Scene(job)
    jobs = {item.stage: item for item in job.jobs}
    if job.drawn is not None:
        error = scene.draw(job.drawn, jobs)
        if error is not None:
            return SceneDone(job.scene_id, error=error)
    for name in BACK:
        if name in job.todo:
            error = scene.run(jobs[name])
            if error is not None:
                return SceneDone(job.scene_id, error=error)
    return scene.done()


def left_behind(job: SynthesisJob, kind: str, text: str, seconds: float) -> SceneDone:
    """What came of a scene whose worker did not come back: the stage that it was at is staged, with a `kind` of error and its text."""
    lake = Lake.open(job.lake)
    states = lake.history({job.scene_id})
    done = {stage: state.done.fingerprint for (_, stage), state in states.items() if state.done is not None}
    at = next((item for item in job.jobs if item.stage in job.todo and done.get(item.stage) != item.fingerprint), None)
    if at is None:  # it was lost after its last word to the lake, before its last word to us
        return _Scene(job).done()
    lake.stage_rows(lost_run(at, kind, text, seconds), {})
    return SceneDone(job.scene_id, error=f"{at.stage}: {text}")


class _Scene:
    """A scene in the making: its rows by table as far as they are known, read where they are not."""

    def __init__(self, job: SynthesisJob) -> None:
        self._job, self._lake = job, Lake.open(job.lake)
        self._prints = {item.stage: item.fingerprint for item in job.jobs}
        self._rows: dict[str, list[Any]] = {}
        self._notes: list[str] = []

    def draw(self, drawn: Drawn, jobs: Mapping[str, Job]) -> str | None:
        """Rows of the layout, staged; why that failed, or None."""
        first = jobs[FRONT[0]]
        started, clock = datetime.now(UTC), time.perf_counter()
        try:
            context = self._context(first)
            outcomes = drawn_rows(drawn, self._job.dataset, self._job.chosen, self._job.base, context, jobs["optimization"].config)
            seconds = drawn.seconds + time.perf_counter() - clock
            capture = outcomes["capture"].rows
            capture["syntheses"] = [dataclasses.replace(row, seconds=seconds) for row in capture["syntheses"]]
            for name in FRONT:
                self._keep(outcomes[name])
        except Exception as error:
            return self._failed(first, error, started, time.perf_counter() - clock)
        # The first stage last: without it none of the others counts.
        for name in reversed(FRONT):
            self._stage(jobs[name], outcomes[name], started, seconds if name == FRONT[0] else 0.0)
        return None

    def run(self, job: Job) -> str | None:
        """A stage, run on the scene's rows and staged; why it failed, or None."""
        stage = _stage(job.stage)
        started, clock = datetime.now(UTC), time.perf_counter()
        try:
            inputs = {table: self._table(table) for table in stage.reads}
            if "assets" in inputs:
                inputs["assets"] = with_licenses_of_scans(inputs["assets"], self._lake.snapshot, job.scene_id)
            for table in stage.history:
                inputs[table] = history_rows(self._lake, table, job)
            outcome = stage.run(**inputs, context=self._context(job), config=job.config)
            if stage.name == "optimization":
                outcome.rows["placements"] = self._with_origins(outcome.rows["placements"])
            self._keep(outcome)
        except Exception as error:
            return self._failed(job, error, started, time.perf_counter() - clock)
        self._stage(job, outcome, started, time.perf_counter() - clock)
        return None

    def done(self) -> SceneDone:
        """What came of it."""
        drawn = self._table("synthesis_objects")
        names = {row.instance_id for row in drawn}
        settled = [row for row in self._table("certificates") if row.engine == "mujoco" and row.instance_id in names]
        return SceneDone(
            self._job.scene_id,
            objects=len(drawn),
            proposed=sum(row.is_stable is True for row in drawn),
            settled=sum(row.is_stable_1cm for row in settled),
            broken=tuple(f"{row.format}: {row.rule}" for row in self._table("export_checks") if not row.passed),
            notes=tuple(self._notes),
        )

    def _context(self, job: Job) -> Context:
        return Context(scene_id=job.scene_id, stage=job.stage, seed=job.seed, blobs=self._lake.blobs, caches=ModuleCaches())

    def _with_origins(self, placements: list[Any]) -> list[Any]:
        drawn = {row.instance_id for row in self._table("synthesis_objects")}
        base = self._job.base
        if base is None:
            drawn |= {row.instance_id for row in self._table("syntheses")}
        return with_origins(placements, frozenset(drawn), base.placements if base is not None else (), SYNTHESIS)

    def _table(self, table: str) -> list[Any]:
        """Rows of a table: those of this run, else those that the lake has, staged or committed."""
        if table not in self._rows:
            spec, fingerprint = TABLES[table], self._prints[TABLES[table].stage]
            scene_id = self._job.scene_id
            rows = self._lake.staged_rows(table, scene_id, fingerprint)
            if rows is None and spec.rule == "share":
                names = sorted({row.asset_id for row in self._table("candidates")} - {None})
                rows = list(self._lake.snapshot().rows_by_key(spec.record, names))
            elif rows is None:
                rows = self._lake.rows_of(table, scene_id, fingerprint)
            if rows is None:
                raise RowsGone(f"{scene_id}: {table}: the rows that this stage reads were replaced by another run; run again")
            self._rows[table] = list(rows)
        return self._rows[table]

    def _keep(self, outcome: Outcome) -> None:
        """Hold rows against their schemas, and keep the blobs that they name."""
        named: set[str] = set()
        for table, rows in outcome.rows.items():
            check(rows, TABLES[table].record)
            named.update(getattr(row, c) for row in rows for c in TABLES[table].blob_columns if getattr(row, c))
        self._lake.blobs.put_all({name: outcome.blobs[name] for name in sorted(named & set(outcome.blobs))})

    def _stage(self, job: Job, outcome: Outcome, started: datetime, seconds: float) -> None:
        run = dataclasses.replace(_run(job, None, None, started, seconds), degradations=outcome.degradations)
        counts = tuple(f"{table}={len(rows)}" for table, rows in sorted(outcome.rows.items()))
        self._lake.stage_rows(dataclasses.replace(run, row_counts=counts), outcome.rows)
        self._rows |= outcome.rows
        self._notes += outcome.degradations

    def _failed(self, job: Job, error: Exception, started: datetime, seconds: float) -> str:
        """Leave the row of a failure; what is to be said of it. What passes, such as a full disk, is lost, and tried again next time."""
        passes = isinstance(error, RowsGone) or is_away(error) or number_of(error) in NO_ROOM
        known = isinstance(error, LakeError)
        text = str(error) if known else f"{type(error).__name__}: {one_line(error)[:500]}"
        kind = "lost" if passes else "input" if isinstance(error, InputError) else "defect"
        self._lake.stage_rows(_run(job, kind, text, started, seconds), {})
        return f"{job.stage}: {text}"


def _run(job: Job, kind: str | None, error: str | None, started: datetime, seconds: float) -> StageRun:
    return dataclasses.replace(
        lost_run(job, kind, error, seconds),
        started_at=started,
        host=f"{socket.gethostname()}:{os.getpid()}",
        peak_memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )


def _stage(name: str) -> Stage:
    return next(stage for stage in STAGES if stage.name == name)
