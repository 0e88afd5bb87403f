"""The flow that turns scans into replica scenes: `flows.pipeline.replicate`, fanned out over scenes.

By default a task is a thread, which hands the stages of its scenes to one warm process pool: threads cost Prefect 3 ms a
task where its process runners cost 55 to 90, and Python geometry needs processes. The same tasks run on Prefect's process
runner, on Dask and on Ray.
"""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import BrokenExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from prefect import task
from prefect.cache_policies import NO_CACHE
from prefect.states import Completed, Failed, State
from prefect.tasks import exponential_backoff

from flows.progress import current
from flows.run.configuration import configure
from flows.run.devices import with_devices
from flows.run.fanout.batch import SceneBatch
from flows.run.fanout.coordinator import Coordinator, FanOut, RunOutcome
from flows.run.fanout.pools import shared_pool
from flows.run.fanout.runners import Runner, task_runner
from flows.run.identity import sentence
from flows.run.ledger import CallRules
from flows.run.limits import LIMITED
from flows.run.outcome import MAX_NOTES
from flows.run.parameters import Address, StageTables, stages_flow
from flows.run.patience import patiently
from flows.run.plan import Plan, ScenePlan, make_plan, planned_again
from flows.run.report import RunReport, broken_checks, keep, report_of
from flows.run.rescans import with_rescans
from flows.run.scene import STAGE_SECONDS, SceneResult, settle
from flows.scans.choice import found_scans, settled
from flows.scans.refusals import keep_refusals
from flows.server.artifacts import Board, committed, flow_run_name, run_log, task_run_name
from flows.server.notifications import AS_BEFORE
from schemas.runs import StageRun
from schemas.wording import counted
from tasks.capture.scan import Scan
from warehouse.lake import Lake

# Prefect prints a traceback for every line that its server does not take; the board says once that it is away.
logging.raiseExceptions = False

LOST_RETRIES = 2
"""A worker may be lost to something else on the machine twice; a third time the scene itself is the likely reason."""


class WorkerGone(Exception):
    """A worker died while it computed a stage; the text says which."""


def is_worth_another_try(task: Any, task_run: Any, state: State[Any]) -> bool:
    """Prefect's retry condition: a lost worker is tried again; bad input, a timeout or a defect gives the same once more."""
    return isinstance(state.result(raise_on_failure=False), WorkerGone)


class Work:
    """A stage to compute, as a parameter that Prefect leaves alone; `run` is what came of it."""

    def __init__(self, compute: Callable[[], StageRun]) -> None:
        self.compute = compute
        self.run: StageRun | None = None


class Results(list[SceneResult]):
    """Results of a task's scenes. Prefect writes what a failed task returns into its log: the message there says enough."""

    def __repr__(self) -> str:
        return f"results of {counted(len(self), 'scene')}"


@task(name="stage", task_run_name="{name}", persist_result=False, cache_policy=NO_CACHE)
def compute_stage(name: str, work: Work) -> Any:
    """One stage of one scene."""
    work.run = work.compute()
    return None if work.run.outcome == "done" else Failed(message=work.run.error or work.run.outcome)


@task(
    name="scenes",
    task_run_name="{name}",
    retries=LOST_RETRIES,
    retry_delay_seconds=exponential_backoff(2),
    retry_jitter_factor=0.5,
    retry_condition_fn=is_worth_another_try,
    persist_result=False,
    cache_policy=NO_CACHE,
)
def compute_scenes(name: str, batch: SceneBatch) -> Any:
    """Some scenes through their stages. What is finished when a worker is lost is not computed again."""
    from prefect.runtime import task_run

    def around(scene_id: str, stage: str, work: Callable[[], StageRun]) -> StageRun:
        with _limited(stage, batch.limits):
            if not batch.shows_stages:
                return work()
            stage_work = Work(work)
            state = compute_stage(task_run_name(scene_id, stage), stage_work, return_state=True)
        if stage_work.run is None:
            raise state.result(raise_on_failure=False)
        return stage_work.run

    results = Results(batch.compute(around))
    lost = [result for result in results if result.is_lost]
    if lost and task_run.run_count <= LOST_RETRIES:
        raise WorkerGone("; ".join(result.retried[-1] for result in lost))
    failed = [f"{result.scene_id}: {result.failed}: {result.error}" for result in results if result.failed]
    return Failed(message="; ".join(failed)[:2000], data=results) if failed else results


def _limited(stage: str, limits: Mapping[str, str]) -> contextlib.AbstractContextManager[None]:
    """A slot of the stage's global concurrency limit; nothing where it has none."""
    if stage not in limits:
        return contextlib.nullcontext()
    from flows.run.limits import limited

    return limited(stage, limits)


class _Tasks:
    """Batches as Prefect tasks. A runner that broke is replaced by a new one."""

    def __init__(self, make_runner: Callable[[], Any]) -> None:
        self._make_runner = make_runner
        self._runner: Any = None
        self._is_broken = False
        self._from: dict[Any, Any] = {}
        self._stack = contextlib.ExitStack()

    def submit(self, batch: SceneBatch) -> Any:
        """See flows.run.fanout.coordinator.Tasks."""
        parameters = {"name": task_run_name([scene.scan.scene_id for scene in batch.scenes]), "batch": batch}
        if self._is_broken:
            self._renew()
        try:
            future = self._runner.submit(compute_scenes, parameters=parameters)
        except BrokenExecutor:
            self._renew()
            future = self._runner.submit(compute_scenes, parameters=parameters)
        self._from[future.task_run_id] = self._runner
        return future

    def results(self, future: Any) -> list[SceneResult]:
        """See flows.run.fanout.coordinator.Tasks."""
        runner = self._from.pop(future.task_run_id)
        try:
            result = future.result(raise_on_failure=False)
            if isinstance(result, BaseException):
                raise result
        except BrokenExecutor:  # one of its processes was killed; the others have ended with it
            self._is_broken = self._is_broken or runner is self._runner
            raise
        results: list[SceneResult] = result
        return results

    def _renew(self) -> None:
        current().say("worker processes were lost; new ones are started")
        self._stack.close()
        self._runner = self._stack.enter_context(self._make_runner())
        self._is_broken = False

    def __enter__(self) -> _Tasks:
        self._runner = self._stack.enter_context(self._make_runner())
        return self

    def __exit__(self, *exception: Any) -> None:
        self._stack.__exit__(*exception)


def _name() -> str:
    from prefect.runtime import flow_run

    parameters = flow_run.parameters
    return flow_run_name(parameters["scans"], parameters["lake"], dataset=parameters.get("dataset"))


@stages_flow(name="replicate", flow_run_name=_name, persist_result=False, validate_parameters=True)
def replicate(
    scans: Address,
    lake: Address,
    format: str = "auto",
    dataset: str | None = None,
    workers: int | None = None,
    library: str | None = None,
    seed: int | None = None,
    config_file: str | None = None,
    settings: list[str] = [],  # noqa: B006  # a default that Prefect's form shows; it is never changed
    stages: StageTables = {},  # noqa: B006
    retry_failed: bool = False,
    again: bool = False,
    scenes: list[str] = [],  # noqa: B006
    first: str | None = None,
    last: str | None = None,
    since: str | None = None,
    until: str | None = None,
    runner: Runner = "pool",
    dask_address: str | None = None,
    batch: int | None = None,
    limits: dict[str, str] = {},  # noqa: B006
    keep_free_gb: float | None = None,
    quota_gb: float | None = None,
    stage_seconds: float = STAGE_SECONDS,
    settle_seconds: float = 0.0,
    links_into: list[str] = [],  # noqa: B006
    budget_usd: float | None = None,
    most_calls: int | None = None,
    replay: Address | None = None,
) -> Any:
    """Replica scenes of the scans at an address, into a lake. Scenes are independent: one that fails stops no other.

    The run fails if a scan was refused, or a scene failed that had not failed before on the same input. Its result is a
    `flows.run.report.RunReport`.

    Args:
        scans: Folder of scans, one scan, or s3://bucket/prefix.
        lake: Address of the lake: a folder or s3://bucket/prefix.
        format: Scan format, or 'auto'.
        dataset: Name of the dataset; by default what the format says.
        workers: Worker processes; by default one for every core of the machine that runs this.
        library: Library of the lake to take candidates from, else a folder.
        seed: Run seed.
        config_file: TOML file with a table per stage.
        settings: Single values, `stage.field=value`.
        stages: What stages are told, a table each.
        retry_failed: Compute again what failed on unchanged input.
        again: Compute scans that the lake has under another name again, under the names that they have here.
        scenes: Only these scenes: ids or shell patterns.
        first: Only scenes from this id on.
        last: Only scenes up to this id.
        since: Only scans that arrived on this date or later.
        until: Only scans that arrived on this date or earlier.
        runner: What computes: 'pool', 'processes', 'dask' or 'ray'.
        dask_address: Scheduler of a Dask cluster; by default one is started on this machine.
        batch: Scenes per task; by default it follows from how long they take.
        limits: Global concurrency limits by stage; of `calls`, the one that requests of calls to models keep. A stage without one whose
            settings put networks on a graphics card keeps that of the card, where the server has it.
        keep_free_gb: Stop before less is free on the disk.
        quota_gb: Stop before the lake holds more.
        stage_seconds: Time limit of one stage of one scene.
        settle_seconds: Leave scans that changed less long ago to a later run: they may still be on their way.
        links_into: Folders that links out of the folder of scans may lead into, as those of a store are.
        budget_usd: Stop before calls to models cost more.
        most_calls: Stop before more calls to models are made.
        replay: Lake whose replies stand in for calls to models; none is made.
    """
    configuration = configure(
        Path(config_file) if config_file else None, settings, Path(library) if library else None, seed, tables=stages or None
    )
    if limits:
        from flows.run.limits import check_limits

        check_limits(limits)
    limits = with_devices(limits, configuration.stages)
    if replay:
        Lake.existing(replay, "replay")
    calls = CallRules(budget_usd=budget_usd, most_calls=most_calls, replay=replay or "", limit=limits.get(LIMITED, ""))
    fan_out = FanOut(workers or os.cpu_count() or 1, runner, dask_address, batch, limits, keep_free_gb, quota_gb, stage_seconds, calls)

    began = datetime.now(UTC)

    def once() -> RunReport:
        store = Lake.open(lake)
        scan_list, unusable = found_scans(
            scans, format, dataset, scenes=scenes, first=first, last=last, since=since, until=until, links_into=links_into
        )
        waiting: list[Scan] = []
        if settle_seconds > 0:
            scan_list, arriving = settled(scan_list, settle_seconds, by_change="://" not in scans)
            waiting = arriving
            for scan in arriving:
                run_log(f"{scan.scene_id}: changed less than {settle_seconds:g} s ago, or is being copied; left to a later run")
        plan = make_plan(store, scan_list, unusable, configuration, retry_failed, again=again)
        for given, scene_id in list(plan.same.items())[:MAX_NOTES]:
            run_log(sentence(given, scene_id))

        def replan(scene: ScenePlan, retry: bool) -> ScenePlan | None:
            return planned_again(store, scene, configuration, retry)

        is_whole = format == "auto" and not (scenes or first or last or since or until)
        refused_before = keep_refusals(store, scans, plan, began, is_whole=is_whole, waiting=waiting)
        coordinator = Coordinator(plan, store, configuration, fan_out, replan, retry_failed=retry_failed)
        report = _carry_out(plan, store, coordinator, scans, dataset, fan_out, began, refused_before)
        return with_rescans(report, store, plan, configuration, fan_out.workers, retry_failed)

    report = patiently(once)
    keep(report)
    return state_of(report)


def state_of(report: RunReport) -> State[Any]:
    """Final state of a run in Prefect: `Failed` if a scene failed that had not failed before on the same input, a scan was refused, or a
    scene was not begun."""
    anew = [line for line in report.failures if line not in report.known and line not in report.refused]
    refused = sorted(report.refused, key=lambda line: line in report.known)  # news first
    parts = [f"{counted(len(report.done), 'scene')} done", f"{len(report.unchanged) + len(report.shared)} up to date"]
    if report.same:
        parts.append(f"{counted(len(report.same), 'scan')} known under another name")
    failed_before = [line for line in report.known if line not in report.refused]
    if failed_before:
        parts.append(f"{len(failed_before)} failed before")
    if refused:
        parts.append(f"{counted(len(refused), 'scan')} refused: {refused[0]}" + (" and others" if len(refused) > 1 else ""))
    if anew:
        parts.append(f"{len(anew)} failed: {anew[0]}" + (" and others" if len(anew) > 1 else ""))
    if report.postponed:
        parts.append(f"{len(report.postponed)} postponed: {report.stopped}")
    elif report.stopped:
        parts.append(report.stopped)
    is_news = bool(anew or report.stopped or set(report.refused) - set(report.known))
    message = ("" if is_news or not refused else AS_BEFORE) + ", ".join(parts)
    return Failed(message=message, data=report) if is_news or refused else Completed(message=message, data=report)


def _carry_out(
    plan: Plan,
    lake: Lake,
    coordinator: Coordinator,
    scans: str,
    dataset: str | None,
    fan_out: FanOut,
    began: datetime,
    refused_before: Collection[str],
) -> RunReport:
    """Compute what a plan says, commit it in batches, and leave no staged or temporary file behind."""
    keep = {(s.scan.scene_id, step.stage, step.fingerprint.value) for s in plan.scenes for step in s.steps}
    lake.sweep(keep)
    outcome = RunOutcome()
    with Board() as board:
        board.begin(plan, lake.address, scans, dataset)
        if plan.todo:
            with computing(coordinator.run_id, fan_out, len(plan.todo)) as tasks:
                outcome = coordinator.run(tasks, board.advance, {"scans": scans})
        settle(lake, plan)
        broken = broken_checks(lake, {scene.scan.scene_id for scene in plan.scenes})
        report = report_of(plan, outcome, began, broken, refused_before)
        for line in (*report.retried, *report.failures):
            run_log(line, warning=True)
        if report.done:
            committed(lake.address, lake.snapshot().snapshot_id, scans, len(report.done))
        board.end(report, plan, lake, _outputs(lake))
    return report


def _outputs(lake: Lake) -> dict[str, str]:
    """What was made from a lake and lies beside it: the report that the flow `statistics` draws by default."""
    from flows.stats.flow import beside

    if lake.storage.local_path("") is None:  # of a store nobody can be asked cheaply
        return {}
    report = Path(beside(lake.address))
    return {"report": str(report)} if report.is_file() else {}


@contextlib.contextmanager
def computing(run: str, fan_out: FanOut, scenes: int) -> Iterator[_Tasks]:
    """Runner of the tasks. Scenes fewer than workers get one process each, which spreads their work over processes of its own.

    The pool ends before the threads that wait for it do, or they would wait for ever.
    """
    with _Tasks(lambda: task_runner(fan_out.runner, fan_out.workers, fan_out.dask_address)) as tasks, contextlib.ExitStack() as pool:
        if fan_out.runner == "pool":
            pool.enter_context(shared_pool(run, min(fan_out.workers, scenes)))
        yield tasks
