"""One scene through its stages: each handed to the pool, in order, until one fails. Does not import Prefect."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

from flows.configuration import Configuration
from flows.fingerprints import canonical_json
from flows.plan import Plan, ScenePlan, Step
from flows.pool import WorkerLost, WorkerPool, WorkerTimeout
from flows.progress import current
from flows.worker import Job, execute, lost_run
from schemas.runs import StageRun
from tasks.pipeline import STAGES
from warehouse.lake import Lake

LOST_ATTEMPTS = 3
"""A worker may be lost to something else on the machine twice; a third time the scene itself is the likely reason."""

STAGE_SECONDS = 3600.0
"""No stage of one scene takes an hour on one core; one that does hangs."""


@dataclasses.dataclass(frozen=True)
class SceneResult:
    """What came of a scene in this run."""

    scene_id: str
    ran: tuple[str, ...]
    failed: str | None
    error: str | None
    degradations: tuple[str, ...]


def run_scene(lake: Lake, plan: ScenePlan, configuration: Configuration, pool: WorkerPool, processes: int = 1) -> SceneResult:
    """Compute what the plan says for one scene, each stage over at most `processes`. A failure ends the scene, never the run."""
    try:
        return _run_scene(lake, plan, configuration, pool, processes)
    except Exception as error:  # a full disk, a lake that went away: this scene's, until others say the same
        text = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return SceneResult(plan.scan.scene_id, (), plan.todo[0].stage, text, ())


def _run_scene(lake: Lake, plan: ScenePlan, configuration: Configuration, pool: WorkerPool, processes: int) -> SceneResult:
    """The steps of one scene, in order."""
    progress = current()
    ran: list[str] = []
    degradations: list[str] = []
    for step in plan.todo:
        run = _run_step(lake, dataclasses.replace(job_of(lake, plan, step, configuration), processes=processes), pool)
        progress.advance(f"{plan.scan.scene_id} {step.stage}")
        degradations += [f"{plan.scan.scene_id}: {step.stage}: {text}" for text in run.degradations]
        if run.outcome != "done":
            for _ in range(len(plan.todo) - len(ran) - 1):
                progress.advance()
            return SceneResult(plan.scan.scene_id, tuple(ran), step.stage, run.error, tuple(degradations))
        ran.append(step.stage)
    return SceneResult(plan.scan.scene_id, tuple(ran), None, None, tuple(degradations))


def settle(lake: Lake, plan: Plan) -> None:
    """Commit what is finished of a plan's scenes, and of runs that died; remove what nobody needs. Live runs are left alone."""
    own = {scene.scan.scene_id for scene in plan.scenes}
    lake.commit(scenes=own | lake.abandoned())
    lake.sweep(set())


def job_of(lake: Lake, plan: ScenePlan, step: Step, configuration: Configuration) -> Job:
    """The job for one step of a scene's plan."""
    stage = next(s for s in STAGES if s.name == step.stage)
    outside: dict[str, Any] = {"scan": plan.scan, "library": configuration.library}
    config = configuration.stages[stage.name]
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
    )


def _run_step(lake: Lake, job: Job, pool: WorkerPool) -> StageRun:
    """Run a job in the pool; a lost worker is replaced and the job tried again."""
    for lost in range(LOST_ATTEMPTS):
        attempt = dataclasses.replace(job, attempt=job.attempt + lost)
        clock = time.perf_counter()
        try:
            return pool.call(execute, attempt, timeout=STAGE_SECONDS)
        except WorkerLost as error:
            run = lost_run(attempt, "lost", f"{error}; it is retried by the next run", time.perf_counter() - clock)
        except WorkerTimeout as error:
            run = lost_run(attempt, "timeout", f"{error}; simplify the scan", time.perf_counter() - clock)
        lake.stage_rows(run, {})
        if run.outcome == "failed":
            return run
        current().say(f"{job.scene_id}: {job.stage}: worker lost, attempt {attempt.attempt}")
    return run
