"""The flow that measures policies: `flows.evaluation.flow.evaluate`, fanned out over scenes.

A Prefect task is a thread that hands one scene to a warm pool of processes, as in `flows.pipeline`.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from prefect import flow, task
from prefect.cache_policies import NO_CACHE
from prefect.states import Completed, Failed, State
from prefect.task_runners import ThreadPoolTaskRunner
from prefect.tasks import exponential_backoff

from flows.evaluation.acting import ActIn, PlannedScene, act, evaluated, left_behind, planned_policy
from flows.evaluation.measuring import Evaluated, evaluation_config
from flows.progress import current
from flows.run.configuration import configure
from flows.run.parameters import Address, StageTables
from flows.run.patience import patiently
from flows.run.pool import WorkerLost, WorkerPool, WorkerTimeout
from flows.run.scene import STAGE_SECONDS
from flows.server.artifacts import run_log, short_name, task_run_name
from flows.server.here import keep
from schemas.runs import StageRun
from warehouse.lake import Lake

LOST_RETRIES = 2
"""A worker may be lost to something else on the machine twice; a third time the scene itself is the likely reason."""


ACTION_SECONDS = 4.0
"""Time for one action, on top of `STAGE_SECONDS`. The slowest eyes, SigLIP's of 86 million numbers on 336 patches, are 6e10 operations for
a picture: 1 to 3 s at what one core does, 2e10 to 6e10 in a second."""


def seconds_for(scene: PlannedScene) -> float:
    """How long a policy may be at a scene before it passes for hung [s]: every episode may take all its steps."""
    config = evaluation_config(scene.task.configuration)
    return STAGE_SECONDS + ACTION_SECONDS * scene.episodes * config.max_steps


class ActingWork:
    """A scene to act in, as a parameter that Prefect leaves alone; the pool that does it, and the run that came of it."""

    def __init__(self, scene: PlannedScene, pool: WorkerPool) -> None:
        self.scene, self.pool = scene, pool
        self.run: StageRun | None = None


def was_lost(task: Any, task_run: Any, state: State[Any]) -> bool:
    """Prefect's retry condition: what a lost worker was at is tried again."""
    return isinstance(state.result(raise_on_failure=False), WorkerLost)


@task(
    name="policy in a scene",
    task_run_name="{name}",
    retries=LOST_RETRIES,
    retry_delay_seconds=exponential_backoff(2),
    retry_condition_fn=was_lost,
    persist_result=False,
    cache_policy=NO_CACHE,
)
def act_in_scene(name: str, work: ActingWork) -> Any:
    """A policy in the episodes of one scene, in a worker process."""
    from prefect.runtime import task_run

    began = time.perf_counter()
    try:
        work.run = work.pool.call(act, work.scene.task, timeout=seconds_for(work.scene))
    except WorkerLost as error:
        if task_run.run_count <= LOST_RETRIES:
            raise
        work.run = left_behind(work.scene, "lost", str(error), time.perf_counter() - began)
    except WorkerTimeout as error:
        work.run = left_behind(work.scene, "timeout", str(error), time.perf_counter() - began)
    return Failed(message=work.run.error) if work.run.error else None


@contextlib.contextmanager
def fanned_out(workers: int) -> Iterator[ActIn]:
    """``with fanned_out(2) as act_in: ...``: inside a flow, what lets policies act in scenes, by so many processes."""
    with ThreadPoolTaskRunner(max_workers=workers + 1) as runner, WorkerPool(workers) as pool:  # type: ignore[var-annotated]

        def act_in(scenes: Sequence[PlannedScene]) -> Iterable[StageRun]:
            """The runs in order; as many scenes are in flight as keep the workers busy."""
            flight: deque[tuple[ActingWork, Any]] = deque()
            for scene in scenes:
                work = ActingWork(scene, pool)
                name = task_run_name(scene.task.scene_id, scene.job.scene_id)
                flight.append((work, runner.submit(act_in_scene, parameters={"name": name, "work": work})))
                if len(flight) > 2 * workers:
                    yield _landed(*flight.popleft())
            while flight:
                yield _landed(*flight.popleft())

        yield act_in


def _landed(work: ActingWork, future: Any) -> StageRun:
    """The run of a scene, waited for."""
    result = future.result(raise_on_failure=False)
    if work.run is None:
        assert isinstance(result, BaseException)
        raise result
    current().advance(work.scene.task.scene_id)
    return work.run


def workers_for(wanted: int | None, scenes: int) -> int:
    """How many processes act: one for every core, no more than there are scenes."""
    return max(min(wanted or os.cpu_count() or 1, scenes), 1)


def _name() -> str:
    from prefect.runtime import flow_run

    parameters = flow_run.parameters
    return f"{', '.join(parameters['policies'])} in {short_name(parameters['lake'])}"


@flow(name="evaluate", flow_run_name=_name, persist_result=False, validate_parameters=True)
def evaluate(
    lake: Address,
    policies: list[str] = ["navigation"],  # noqa: B006  # a default that Prefect's form shows; it is never changed
    workers: int | None = None,
    library: str | None = None,
    seed: int | None = None,
    config_file: str | None = None,
    settings: list[str] = [],  # noqa: B006
    stages: StageTables = {},  # noqa: B006
) -> Any:
    """Let policies act in all episodes of a lake, and measure what they did. What the lake has is not measured again.

    The run fails where a scene could not be run.

    Args:
        lake: Address of the lake: a folder or s3://bucket/prefix.
        policies: Built-in policies, ids of models, or `navigation`, the newest model.
        workers: Worker processes; by default one for every core of the machine that runs this.
        library: Folder of GLB assets; it changes nothing here.
        seed: Run seed.
        config_file: TOML file with a table per stage.
        settings: Single values, `evaluation.field=value`.
        stages: What stages are told, a table each.
    """
    store = Lake.existing(lake)
    configuration = configure(
        Path(config_file) if config_file else None, settings, Path(library) if library else None, seed, tables=stages or None
    )

    def once() -> list[Evaluated]:
        planned = [planned_policy(store, policy, configuration) for policy in dict.fromkeys(policies)]
        todo = [scene for each in planned for scene in each.todo]
        with fanned_out(workers_for(workers, len(todo))) as act_in:
            runs = {run.scene_id: run for run in act_in(todo)}
        for each in planned:
            store.commit(note=f"trajectories of {each.policy}", scenes=each.batches)
        return [evaluated(each, runs) for each in planned]

    done = patiently(once)
    keep(done)
    return _state(done)


def _state(done: Sequence[Evaluated]) -> State[Any]:
    """How the run ends: failed where a scene did."""
    failed = [f"{each.policy}: {line}" for each in done for line in each.failed]
    for line in failed:
        run_log(line, warning=True)
    summary = "; ".join(f"{each.policy}, {each.run_name}: {each.new} of {each.trajectories} trajectories measured" for each in done)
    run_log(summary)
    return Failed(message=f"{summary}; {failed[0]}", data=done) if failed else Completed(message=summary, data=done)
