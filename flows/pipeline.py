"""The flow that turns scans into replica scenes: `flows.pipeline.replicate`, fanned out over scenes.

A scene is one Prefect task on a thread, which walks its stages through one warm process pool: threads cost Prefect
3 ms a task where its process runners cost 55 to 90, and Python geometry needs processes.
"""

from __future__ import annotations

import dataclasses
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from prefect import flow, task
from prefect.futures import PrefectFuture, as_completed
from prefect.task_runners import TaskRunner, ThreadPoolTaskRunner

from flows.configuration import Configuration, configure
from flows.plan import Plan, ScenePlan, make_plan
from flows.pool import WorkerPool
from flows.report import RunReport, report_of
from flows.scene import SceneResult, run_scene, settle
from tasks.capture.formats import find_scans
from warehouse.lake import Lake

COMMIT_SCENES = 25
"""Scenes per commit: a commit rewrites a part of every table (0.3 to 0.8 s), and what is uncommitted is still staged."""


THREADS = 16
"""Scenes in flight at most; each thread only waits for the pool, which has as many processes as were asked for."""

_RUNNER: TaskRunner[PrefectFuture[Any]] = ThreadPoolTaskRunner(max_workers=THREADS)  # type: ignore[assignment]  # invariant generic


@dataclasses.dataclass(frozen=True)
class _Work:
    """What the scene tasks of one run share; it stays in this process, so that Prefect sees names only."""

    plans: Mapping[str, ScenePlan]
    lake: Lake
    configuration: Configuration
    pool: WorkerPool
    processes: int


_WORK: dict[str, _Work] = {}


@task(name="replicate-scene", task_run_name="{scene_id}", persist_result=False)
def replicate_scene(scene_id: str, run: str) -> SceneResult:
    """One scene through its stages."""
    work = _WORK[run]
    return run_scene(work.lake, work.plans[scene_id], work.configuration, work.pool, work.processes)


@flow(name="replicate", persist_result=False, task_runner=_RUNNER)
def replicate(
    scans: str,
    lake: str,
    format: str = "auto",
    dataset: str | None = None,
    workers: int = 2,
    library: str | None = None,
    seed: int | None = None,
    config_file: str | None = None,
    settings: Sequence[str] = (),
    retry_failed: bool = False,
) -> RunReport:
    """Replica scenes of all scans in a folder, into a lake. Scenes are independent: one that fails stops no other.

    Args:
        scans: Folder of scans, or one scan.
        lake: Address of the lake: a folder or s3://bucket/prefix.
        format: Scan format, or 'auto'.
        dataset: Name of the dataset; by default what the format says.
        workers: Worker processes.
        library: Folder of GLB assets for retrieval.
        seed: Run seed.
        config_file: TOML file with a table per stage.
        settings: Single values, `stage.field=value`.
        retry_failed: Compute again what failed on unchanged input.
    """
    configuration = configure(
        Path(config_file) if config_file else None, list(settings), library=Path(library) if library else None, seed=seed
    )
    store = Lake.open(lake)
    found, unusable = find_scans(Path(scans), format, dataset)
    plan = make_plan(store, found, unusable, configuration, retry_failed)
    return carry_out(plan, store, configuration, workers)


def carry_out(plan: Plan, lake: Lake, configuration: Configuration, workers: int) -> RunReport:
    """Compute what a plan says, commit it in batches, and leave no staged or temporary file behind."""
    keep = {(s.scan.scene_id, step.stage, step.fingerprint.value) for s in plan.scenes for step in s.steps}
    lake.sweep(keep)
    results: list[SceneResult] = []
    if plan.todo:
        with WorkerPool(workers) as pool:
            spare = max(1, workers // len(plan.todo))  # with fewer scenes than workers, a scene may use more than one
            results = _fan_out(plan, _Work({s.scan.scene_id: s for s in plan.scenes}, lake, configuration, pool, spare))
    settle(lake, plan)
    return report_of(plan, results)


def _fan_out(plan: Plan, work: _Work) -> list[SceneResult]:
    """One Prefect task per scene; finished scenes are committed in batches."""
    run = uuid.uuid4().hex
    _WORK[run] = work
    results: list[SceneResult] = []
    finished: list[str] = []
    try:
        futures = [replicate_scene.submit(scene.scan.scene_id, run) for scene in plan.todo]
        for future in as_completed(futures):
            result = future.result()
            results.append(result)
            finished.append(result.scene_id)
            if len(finished) >= COMMIT_SCENES:
                work.lake.commit(scenes=finished)
                finished = []
    finally:
        del _WORK[run]
    return results
