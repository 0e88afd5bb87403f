"""One scene through its stages: each handed to the pool, in order, until one fails. Does not import Prefect."""

from __future__ import annotations

import dataclasses
import errno
import os
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from flows.progress import current
from flows.run.configuration import Configuration
from flows.run.fingerprints import canonical_json
from flows.run.ledger import FREE, SPENT, CallRules
from flows.run.libraries import library_of_input
from flows.run.plan import LIBRARY, MODEL, SCAN, Plan, ScenePlan, Step
from flows.run.pool import PoolStopped, WorkerLost, WorkerPool, WorkerTimeout
from flows.worker import Job, execute, lost_run
from schemas.runs import StageRun
from schemas.text import one_line
from tasks.pipeline import STAGES
from warehouse.lake import Lake

STAGE_SECONDS = 3600.0
"""No stage of one scene takes an hour on one core; one that does hangs."""

NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
"""A full disk, a full share of it."""

Around = Callable[[str, str, Callable[[], StageRun]], StageRun]
"""What is done around a stage: told scene, stage and the work, it does the work and gives its row."""


@dataclasses.dataclass(frozen=True)
class SceneResult:
    """What came of a scene in this run. `seconds` is the wall time of its stages [s], `retried` what was lost and done again.

    `is_lost`: its worker died, and it is worth another try. `is_full`: there was no room on the disk. `is_spent`: no further call to
    a model may be made.
    """

    scene_id: str
    ran: tuple[str, ...]
    failed: str | None
    error: str | None
    degradations: tuple[str, ...]
    seconds: float = 0.0
    retried: tuple[str, ...] = ()
    is_lost: bool = False
    is_full: bool = False
    is_spent: bool = False


def one_process() -> int:
    """Processes of a stage where every core has a scene of its own."""
    return 1


class SceneWork:
    """A scene on its way through its stages. After a worker was lost, `advance` goes on with the stage that it was lost in.

    processes: What each stage may use, asked when it begins.
    """

    def __init__(
        self,
        plan: ScenePlan,
        processes: Callable[[], int] = one_process,
        timeout: float = STAGE_SECONDS,
        calls: CallRules = FREE,
    ) -> None:
        self.plan, self._processes, self._timeout, self._calls = plan, processes, timeout, calls
        self._ran: list[str] = []
        self._degradations: list[str] = []
        self._retried: list[str] = []
        self._seconds = 0.0
        self._lost = 0
        self.result: SceneResult | None = None
        """What came of it; None before `advance`."""

    @property
    def is_finished(self) -> bool:
        """Whether there is nothing more to try."""
        return self.result is not None and not self.result.is_lost

    def advance(self, lake: Lake, configuration: Configuration, pool: WorkerPool, around: Around | None = None) -> SceneResult:
        """Compute what is left of the scene, each stage over as many processes as there are for it. A failure ends the scene, never the
        run."""
        try:
            self.result = self._advance(lake, configuration, pool, around or _plainly)
        except PoolStopped:
            raise
        except Exception as error:  # a full disk, a lake that went away: this scene's, until others say the same
            text = f"{type(error).__name__}: {one_line(error)}"
            full = isinstance(error, OSError) and error.errno in NO_ROOM
            self.result = self._result(self.plan.todo[len(self._ran)].stage, text, is_full=full)
        return self.result

    def _advance(self, lake: Lake, configuration: Configuration, pool: WorkerPool, around: Around) -> SceneResult:
        progress, scene = current(), self.plan.scan.scene_id
        for step in self.plan.todo[len(self._ran) :]:
            job = job_of(lake, self.plan, step, configuration)
            job = dataclasses.replace(job, processes=self._processes(), attempt=job.attempt + self._lost, calls=self._calls)
            run = around(scene, step.stage, partial(_run_job, lake, job, pool, self._timeout))
            self._seconds += run.seconds
            if run.outcome == "lost" and any(os.strerror(number) in str(run.error) for number in NO_ROOM):
                return self._result(step.stage, run.error, is_full=True)
            if run.outcome == "lost" and SPENT in str(run.error):
                return self._result(step.stage, run.error, is_spent=True)
            if run.outcome == "lost":
                self._lost += 1
                self._retried.append(f"{scene}: {step.stage}: {run.error}, attempt {run.attempt}")
                progress.say(f"{scene}: {step.stage}: worker lost, attempt {run.attempt}")
                return self._result(step.stage, run.error, is_lost=True)
            self._degradations += [f"{scene}: {step.stage}: {text}" for text in run.degradations]
            progress.advance(f"{scene} {step.stage}")
            if run.outcome != "done":
                for _ in range(len(self.plan.todo) - len(self._ran) - 1):
                    progress.advance()
                return self._result(step.stage, run.error)
            self._ran.append(step.stage)
            self._lost = 0
        return self._result(None, None)

    def _result(
        self, failed: str | None, error: str | None, *, is_lost: bool = False, is_full: bool = False, is_spent: bool = False
    ) -> SceneResult:
        return SceneResult(
            self.plan.scan.scene_id, tuple(self._ran), failed, error, tuple(self._degradations), self._seconds, tuple(self._retried),
            is_lost, is_full, is_spent,
        )  # fmt: skip


def settle(lake: Lake, plan: Plan) -> None:
    """Commit what is finished of a plan's scenes, and of runs that died; remove what nobody needs. Live runs are left alone."""
    own = {scene.scan.scene_id for scene in plan.scenes}
    lake.commit(scenes=(own | lake.abandoned()) - lake.claimed().keys())
    lake.sweep(set())


def job_of(lake: Lake, plan: ScenePlan, step: Step, configuration: Configuration) -> Job:
    """The job for one step of a scene's plan."""
    stage = next(s for s in STAGES if s.name == step.stage)
    library = library_of_input(configuration.library, plan.library)
    config = configuration.stages[stage.name]
    scan = plan.scan if stage.takes_scan(config) else None
    outside: dict[str, Any] = {SCAN: scan, LIBRARY: library, MODEL: plan.models.get(step.stage)}
    return Job(
        lake=lake.address,
        scene_id=plan.scan.scene_id,
        stage=stage.name,
        config=config,
        config_json=canonical_json(config),
        seed=configuration.seed,
        fingerprint=step.fingerprint.value,
        reasons=step.fingerprint.parts,
        upstream=step.upstream,
        attempt=step.attempt,
        outside=tuple((name, outside[name]) for name in stage.outside),
        snapshot_id=plan.snapshot_id,
    )


def _run_job(lake: Lake, job: Job, pool: WorkerPool, timeout: float) -> StageRun:
    """Run a job in the pool; what its worker could not say any more is said, and staged, here."""
    clock = time.perf_counter()
    try:
        return pool.call(execute, job, timeout=timeout, label=(job.scene_id, job.stage))
    except WorkerLost as error:
        state = lake.history({job.scene_id}).get((job.scene_id, job.stage))
        if state is not None and state.done is not None and state.done.fingerprint == job.fingerprint:
            return state.done  # it was killed after its last word to the lake, before its last word to us
        run = lost_run(job, "lost", str(error), time.perf_counter() - clock)
    except WorkerTimeout as error:
        run = lost_run(job, "timeout", f"{error}; simplify the scan, or give more time: --stage-seconds", time.perf_counter() - clock)
    lake.stage_rows(run, {})
    return run


def _plainly(scene_id: str, stage: str, work: Callable[[], StageRun]) -> StageRun:
    return work()
