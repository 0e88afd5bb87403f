"""Many scenes at once: a Prefect task for each, a thread that hands the scene to a warm pool of processes, as in `flows.pipeline`."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Generic, Protocol, TypeVar

from prefect import task
from prefect.cache_policies import NO_CACHE
from prefect.states import Failed, State
from prefect.task_runners import ThreadPoolTaskRunner
from prefect.tasks import exponential_backoff

from flows.progress import current
from flows.run.pool import WorkerLost, WorkerPool, WorkerTimeout
from flows.server.artifacts import task_run_name
from flows.worker import Job, lost_run
from schemas.runs import StageRun
from warehouse.lake import Lake

LOST_RETRIES = 2
"""A worker may be lost to something else on the machine twice; a third time the scene itself is the likely reason."""


class PlannedWork(Protocol):
    """A scene in which something is to be done."""

    @property
    def scene_id(self) -> str:
        """The scene."""
        ...

    @property
    def batch_id(self) -> str:
        """The batch that its rows belong to."""
        ...

    @property
    def task(self) -> Any:
        """What a worker process is told."""
        ...

    @property
    def job(self) -> Job:
        """What its row of `stage_runs` names, without its rows."""
        ...


Planned = TypeVar("Planned", bound=PlannedWork)


@dataclasses.dataclass(frozen=True)
class SceneWay(Generic[Planned]):
    """What is done in scenes. label: Of its Prefect tasks. carry_out: Does what a scene's `task` says, in a worker process.
    seconds_for: How long that may take before it passes for hung [s]."""

    label: str
    carry_out: Callable[[Any], StageRun]
    seconds_for: Callable[[Planned], float]


class PooledScene(Generic[Planned]):
    """A scene as a parameter that Prefect leaves alone; what is done in it, the pool that does it, and the run that came of it."""

    def __init__(self, scene: Planned, way: SceneWay[Planned], pool: WorkerPool) -> None:
        self.scene, self.way, self.pool = scene, way, pool
        self.run: StageRun | None = None


def was_lost(task: Any, task_run: Any, state: State[Any]) -> bool:
    """Prefect's retry condition: what a lost worker was at is tried again."""
    return isinstance(state.result(raise_on_failure=False), WorkerLost)


@task(
    name="scene",
    task_run_name="{name}",
    retries=LOST_RETRIES,
    retry_delay_seconds=exponential_backoff(2),
    retry_condition_fn=was_lost,
    persist_result=False,
    cache_policy=NO_CACHE,
)
def in_scene(name: str, work: PooledScene[Any]) -> Any:
    """What is done in one scene, in a worker process."""
    from prefect.runtime import task_run

    began = time.perf_counter()
    try:
        work.run = work.pool.call(work.way.carry_out, work.scene.task, timeout=work.way.seconds_for(work.scene))
    except WorkerLost as error:
        if task_run.run_count <= LOST_RETRIES:
            raise
        work.run = left_behind(work.scene, "lost", str(error), time.perf_counter() - began)
    except WorkerTimeout as error:
        work.run = left_behind(work.scene, "timeout", str(error), time.perf_counter() - began)
    return Failed(message=work.run.error) if work.run.error else None


def left_behind(scene: PlannedWork, kind: str, text: str, seconds: float) -> StageRun:
    """The run of a scene whose worker did not come back, staged: kind 'lost' or 'timeout'."""
    run = lost_run(scene.job, kind, text, seconds)
    Lake.open(scene.job.lake).stage_rows(run, {})
    return run


@contextlib.contextmanager
def fanned_out(workers: int, way: SceneWay[Planned]) -> Iterator[Callable[[Sequence[Planned]], Iterable[StageRun]]]:
    """``with fanned_out(2, ACTING) as act_in: ...``: inside a flow, what does something in scenes, by so many processes."""
    labelled = in_scene.with_options(name=way.label)
    with ThreadPoolTaskRunner(max_workers=workers + 1) as runner, WorkerPool(workers) as pool:  # type: ignore[var-annotated]

        def done_in(scenes: Sequence[Planned]) -> Iterable[StageRun]:
            """The runs in order; as many scenes are in flight as keep the workers busy."""
            flight: deque[tuple[PooledScene[Planned], Any]] = deque()
            for scene in scenes:
                work = PooledScene(scene, way, pool)
                name = task_run_name(scene.scene_id, scene.batch_id)
                flight.append((work, runner.submit(labelled, parameters={"name": name, "work": work})))
                if len(flight) > 2 * workers:
                    yield _landed(*flight.popleft())
            while flight:
                yield _landed(*flight.popleft())

        yield done_in


def _landed(work: PooledScene[Any], future: Any) -> StageRun:
    """The run of a scene, waited for."""
    result = future.result(raise_on_failure=False)
    if work.run is None:
        assert isinstance(result, BaseException)
        raise result
    current().advance(work.scene.scene_id)
    return work.run


def workers_for(wanted: int | None, scenes: int) -> int:
    """How many processes work: one for every core, no more than there are scenes."""
    return max(min(wanted or os.cpu_count() or 1, scenes), 1)
