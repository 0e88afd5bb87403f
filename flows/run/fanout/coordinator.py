"""The coordinator of a run: keeps a few portions of work in flight, takes results in, and remembers nothing else.

Only a window of tasks is in flight, so that ten thousand scenes are names in a list until it is their turn. A scene goes
through all its stages without waiting for any other.
"""

from __future__ import annotations

import dataclasses
import queue
import uuid
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from flows.progress import current
from flows.run.configuration import Configuration
from flows.run.fanout.backlog import Backlog, Replan
from flows.run.fanout.batch import SceneBatch
from flows.run.fanout.committer import Committer
from flows.run.fanout.pace import Pace
from flows.run.fanout.pools import at_work
from flows.run.fanout.quota import Quota
from flows.run.ledger import FREE, CallRules
from flows.run.plan import Plan, ScenePlan
from flows.run.scene import STAGE_SECONDS, SceneResult, job_of, one_process
from flows.worker import lost_run
from schemas.text import one_line
from warehouse.lake import Lake
from warehouse.sharing.presence import Presence

LOST_SCENES = 5
"""So often a scene may be in flight when a worker goes: most are by chance, and the others in flight are blamed with the one at fault."""

WAIT_SECONDS = 1.0
"""How long at most nothing is looked at."""


@dataclasses.dataclass(frozen=True)
class FanOut:
    """How the scenes of a run are spread, and where it stops.

    workers: processes. runner: of `flows.run.fanout.runners.RUNNERS`. batch: scenes per task, None to let it follow from how
    long they take. limits: global concurrency limits by stage. keep_free_gb, quota_gb: see `flows.run.fanout.quota`.
    stage_seconds: time limit of a stage of a scene. calls: What it may ask models for.
    """

    workers: int = 2
    runner: str = "pool"
    dask_address: str | None = None
    batch: int | None = None
    limits: Mapping[str, str] = dataclasses.field(default_factory=dict)
    keep_free_gb: float | None = None
    quota_gb: float | None = None
    stage_seconds: float = STAGE_SECONDS
    calls: CallRules = FREE


@dataclasses.dataclass
class RunOutcome:
    """What came of a run's scenes, besides what was planned not to be computed."""

    results: list[SceneResult] = dataclasses.field(default_factory=list)
    shared: list[str] = dataclasses.field(default_factory=list)
    failed_elsewhere: dict[str, str] = dataclasses.field(default_factory=dict)
    postponed: list[str] = dataclasses.field(default_factory=list)
    stopped: str | None = None
    retried: list[str] = dataclasses.field(default_factory=list)


class Future(Protocol):
    """A task that was submitted."""

    task_run_id: Any

    def add_done_callback(self, fn: Callable[[Any], None]) -> None:
        """Call `fn` with this future once it is done."""


class Tasks(Protocol):
    """Where batches are computed."""

    def submit(self, batch: SceneBatch) -> Future:
        """Have a batch computed."""

    def results(self, future: Any) -> list[SceneResult]:
        """Results of a future that is done. Raises what made its worker go."""


Told = Callable[[int, int, str], None]
"""Told how many stage runs are done, of how many, and what was last."""


class Coordinator:
    """``Coordinator(plan, lake, ...).run(tasks)``: everything that a plan has to compute, claimed, computed, committed."""

    def __init__(
        self, plan: Plan, lake: Lake, configuration: Configuration, fan_out: FanOut, replan: Replan, *, retry_failed: bool
    ) -> None:
        self._plan, self._lake, self._configuration, self._fan_out = plan, lake, configuration, fan_out
        self._replan, self._retry_failed = replan, retry_failed
        self.run_id = uuid.uuid4().hex
        self._pace = Pace(fan_out.runner, fan_out.workers, fan_out.batch)
        self._planned = {scene.scan.scene_id: tuple(step.stage for step in scene.todo) for scene in plan.todo}
        self._scenes = len(self._planned)
        self._left = Counter(stage for stages in self._planned.values() for stage in stages)
        self._total = sum(self._left.values())
        self._crashes: Counter[str] = Counter()
        self._outcome = RunOutcome()

    @property
    def window(self) -> int:
        """Tasks in flight at most: one for every worker, and what it takes up next. Threads hold theirs while they wait.

        Under a quota none waits: what it takes up next is to be decided when there is a worker.
        """
        if self._fan_out.quota_gb is not None:
            return self._fan_out.workers
        return self._fan_out.workers + 1 if self._fan_out.runner == "pool" else 2 * self._fan_out.workers

    def run(self, tasks: Tasks, progress: Told, facts: Mapping[str, Any]) -> RunOutcome:
        """Compute until nothing is left, or the disk is nearly full. `facts` are told to others that look at the lake."""
        facts = {**facts, "workers": self._fan_out.workers, "runner": self._fan_out.runner, "scenes": self._scenes}
        facts |= {"left": dict(self._left), "at_work": at_work(self.run_id)}
        with self._lake.presence(facts) as presence, self._lake.claims() as claims, Committer(self._lake) as committer:
            backlog = Backlog(self._lake, self._plan, claims, committer, self._replan, self._retry_failed)
            self._loop(tasks, backlog, committer, presence, progress)
        outcome = self._outcome
        for scene_id in [scene for scene in backlog.shared if self._crashes[scene]]:  # this run's, whose worker went before it said so
            outcome.results.append(SceneResult(scene_id, (), None, None, ()))
        for scene_id in [scene for scene in backlog.failures if self._crashes[scene]]:
            stage, _, error = backlog.failures.pop(scene_id).partition(": ")
            outcome.results.append(SceneResult(scene_id, (), stage, error, ()))
        outcome.shared = [scene for scene in backlog.shared if not self._crashes[scene]]
        outcome.failed_elsewhere = backlog.failures
        outcome.postponed = sorted(scene.scan.scene_id for scene in backlog.left())
        return outcome

    def _loop(self, tasks: Tasks, backlog: Backlog, committer: Committer, presence: Presence, progress: Told) -> None:
        quota = Quota(self._lake, self._fan_out.keep_free_gb, self._fan_out.quota_gb)
        done: queue.SimpleQueue[Future] = queue.SimpleQueue()
        in_flight: dict[Any, SceneBatch] = {}
        while True:
            quota.ended(commits=len(committer.snapshots))
            while (
                len(in_flight) < self.window and len(backlog) and not self._is_stopped(quota, len(in_flight)) and quota.fits(len(in_flight))
            ):
                scenes = backlog.take(1 if self._fan_out.quota_gb is not None else self._pace.batch_size(len(backlog)))
                self._skip(backlog, presence)
                if not scenes:
                    break
                batch = self._batch(scenes)
                future = tasks.submit(batch)
                in_flight[future.task_run_id] = batch
                future.add_done_callback(done.put)
            if not in_flight and (self._outcome.stopped or not len(backlog)):
                self._outcome.stopped = self._outcome.stopped or quota.excess()
                return
            try:
                future = done.get(timeout=min(WAIT_SECONDS, backlog.pause or WAIT_SECONDS))
            except queue.Empty:
                if presence.run.at_work != (now := at_work(self.run_id)):
                    presence.tell({"at_work": now})
                continue
            batch = in_flight.pop(future.task_run_id)
            for result in self._results(tasks, future, batch, backlog):
                self._take_in(result, batch, backlog, committer, progress)
                quota.ended(scenes=1, commits=len(committer.snapshots))
            self._tell(presence)

    def _is_stopped(self, quota: Quota, under_way: int) -> bool:
        """Whether no further scene may begin; says so once."""
        if self._outcome.stopped is None and (reason := quota.reason(under_way)):
            self._outcome.stopped = reason
            current().say(f"stopping: {reason}")
        return self._outcome.stopped is not None

    def _batch(self, scenes: list[ScenePlan]) -> SceneBatch:
        return SceneBatch(
            self.run_id, self._lake, scenes, self._configuration, processes=self._share if self._fan_out.runner == "pool" else one_process,
            shows_stages=self._pace.shows_stages, limits=self._fan_out.limits, timeout=self._fan_out.stage_seconds,
            calls=dataclasses.replace(self._fan_out.calls, run=self.run_id),
        )  # fmt: skip

    def _share(self) -> int:
        """Processes for a stage that begins now: more than one when fewer scenes are left than there are workers."""
        return max(1, self._fan_out.workers // max(1, len(self._planned)))

    def _results(self, tasks: Tasks, future: Future, batch: SceneBatch, backlog: Backlog) -> list[SceneResult]:
        """Results of a batch. When its worker went with it, its scenes wait again, or are given up."""
        try:
            return tasks.results(future)
        except Exception as error:
            why = f"{type(error).__name__}: {one_line(error)}"
        given_up = []
        for scene in batch.scenes:
            scene_id = scene.scan.scene_id
            self._crashes[scene_id] += 1
            if self._crashes[scene_id] < LOST_SCENES:
                text = f"{scene_id}: {scene.todo[0].stage}: worker lost ({why}), attempt {self._crashes[scene_id]}"
                self._outcome.retried.append(text)
                current().say(text)
                backlog.give_back(scene)
            else:
                given_up.append(self._give_up(scene, why))
        return given_up

    def _give_up(self, scene: ScenePlan, why: str) -> SceneResult:
        """A scene that took its worker along every time: its next stage is lost, which the lake is told."""
        scene_id = scene.scan.scene_id
        states = self._lake.history({scene_id})
        done = {stage: state.done.fingerprint for (_, stage), state in states.items() if state.done is not None}
        step = next((step for step in scene.todo if done.get(step.stage) != step.fingerprint.value), scene.todo[-1])
        text = f"{why}; its worker was lost {LOST_SCENES} times"
        job = dataclasses.replace(job_of(self._lake, scene, step, self._configuration), attempt=step.attempt + LOST_SCENES - 1)
        self._lake.stage_rows(lost_run(job, "lost", text, 0.0), {})
        return SceneResult(scene_id, (), step.stage, text, (), is_lost=True)

    def _take_in(self, result: SceneResult, batch: SceneBatch, backlog: Backlog, committer: Committer, progress: Told) -> None:
        self._outcome.results.append(result)
        self._outcome.retried += result.retried
        self._pace.saw(result)
        scene = next(scene for scene in batch.scenes if scene.scan.scene_id == result.scene_id)
        self._strike(result.scene_id)
        if self._fan_out.runner != "pool":  # else the threads of this process told of every stage
            for step in scene.todo:
                current().advance(f"{result.scene_id} {step.stage}")
        if result.is_full and self._outcome.stopped is None:
            self._outcome.stopped = f"there is no room left: {result.error}"
        if result.is_spent and self._outcome.stopped is None:
            self._outcome.stopped = str(result.error).partition(": ")[2]
        backlog.finished(result.scene_id)
        committer.add(result.scene_id)
        progress(self._total - sum(self._left.values()), self._total, result.scene_id)

    def _skip(self, backlog: Backlog, presence: Presence) -> None:
        """Count what turned out to be computed already."""
        if backlog.over:
            for scene_id in backlog.over:
                for stage in self._strike(scene_id):
                    current().advance(f"{scene_id} {stage}")
            backlog.over.clear()
            self._tell(presence)

    def _strike(self, scene_id: str) -> tuple[str, ...]:
        """Take a scene off what is left, as it was planned: what is computed may be less, when another run had begun it."""
        stages = self._planned.pop(scene_id, ())
        self._left.subtract(stages)
        return stages

    def _tell(self, presence: Presence) -> None:
        results = self._outcome.results
        presence.tell(
            {
                "at_work": at_work(self.run_id),
                "left": {stage: count for stage, count in self._left.items() if count > 0},
                "done": sum(result.failed is None for result in results),
                "failed": sum(result.failed is not None for result in results),
                "seconds_done": sum(result.seconds for result in results),
            }
        )
