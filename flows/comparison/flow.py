"""The flow that compares datasets: `flows.comparison.flow.compare`. Trainings one after another, scenes fanned out as by `evaluate`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from prefect import task
from prefect.cache_policies import NO_CACHE
from prefect.states import Completed, Failed

from flows.comparison.comparing import Compared, left_to_do
from flows.comparison.comparing import compare as carried_out
from flows.comparison.planning import SYSTEM, ComparedTraining, asked_comparison, planned_comparison
from flows.evaluation.acting import ActIn, PlannedScene
from flows.evaluation.flow import ACTING
from flows.progress import current
from flows.run.parameters import Address, StageTables, stages_flow
from flows.run.patience import patiently
from flows.server.artifacts import run_log, short_name
from flows.server.here import keep
from flows.server.scene_tasks import fanned_out, workers_for
from flows.training.flow import told_now_and_then
from flows.training.progress import watched
from flows.training.training import system_configuration
from flows.training.training import train as trained
from schemas.runs import StageRun
from schemas.training import LearnedModel
from schemas.wording import counted
from warehouse.lake import Lake


def with_bar(act_in: ActIn) -> ActIn:
    """`act_in`, with a bar of the scenes that are to be done: trainings, which come first, have bars of their own."""

    def act_in_scenes(scenes: Sequence[PlannedScene]) -> Iterable[StageRun]:
        current().begin(len(scenes))
        return act_in(scenes)

    return act_in_scenes


class TrainingWork:
    """A training, as a parameter that Prefect leaves alone, and the model that came of it."""

    def __init__(self, lake: Lake, training: ComparedTraining) -> None:
        self.lake, self.training = lake, training
        self.model: LearnedModel | None = None


@task(name="training", task_run_name="{name}", persist_result=False, cache_policy=NO_CACHE)
def train_policy(name: str, work: TrainingWork) -> None:
    """One of the trainings that are compared, in this process; killed, it goes on from its last checkpoint."""
    tell, watch = told_now_and_then(name), watched()

    def report(done: int, of: int, text: str) -> None:
        tell(done, of, text)
        watch(name, done, of, text)

    work.model = trained(work.lake, work.training.planned, report)


def _name() -> str:
    from prefect.runtime import flow_run

    parameters = flow_run.parameters
    return f"{', '.join(parameters['train'])} tested on {', '.join(parameters['test'])} of {short_name(parameters['lake'])}"


@stages_flow(name="compare", flow_run_name=_name, persist_result=False, validate_parameters=True)
def compare(
    lake: Address,
    train: list[str],
    test: list[str],
    snapshot: int | None = None,
    release: str | None = None,
    workers: int | None = None,
    seed: int | None = None,
    config_file: str | None = None,
    settings: list[str] = [],  # noqa: B006  # a default that Prefect's form shows; it is never changed
    stages: StageTables = {},  # noqa: B006
) -> Any:
    """Train policies on datasets of a lake, with one budget, and test them in the same episodes of others. What is there is not done again.

    The run fails where a scene had to be left out. Its result is a `flows.comparison.comparing.Compared`.

    Args:
        lake: Address of the lake: a folder or s3://bucket/prefix.
        train: Datasets to learn from, two or more; `a+b` learns from both.
        test: Datasets to be tested in; rooms that are learned from are left out.
        snapshot: Snapshot to compare on; the newest by default.
        release: Release to compare on, instead of a snapshot.
        workers: Worker processes that test policies; by default one for every core of the machine that runs this.
        seed: Seed of the first training on each choice of datasets.
        config_file: TOML file with a table per stage.
        settings: Single values, `stage.field=value`, of the stages comparison, training and evaluation.
        stages: What stages are told, a table each.
    """
    store = Lake.existing(lake)
    configuration = system_configuration(SYSTEM, Path(config_file) if config_file else None, settings, seed, stages or None)
    request = asked_comparison(train, test)

    def once() -> Compared:
        planned = planned_comparison(store, request, configuration, snapshot_id=snapshot, release=release)

        def model_of(training: ComparedTraining) -> LearnedModel:
            work = TrainingWork(store, training)
            train_policy(f"{training.trained_on}, seed {training.seed}", work)
            assert work.model is not None
            return work.model

        for note in planned.notes:
            run_log(note)
        to_train, to_measure, _ = left_to_do(store, planned)
        run_log(
            f"{planned.comparison_id}: {counted(to_train, 'model')} to train, "
            f"{counted(to_measure, 'trajectory', 'trajectories')} to measure"
        )
        with fanned_out(workers_for(workers, len(planned.trainings) * len(planned.episodes)), ACTING) as act_in:
            return carried_out(store, planned, model_of, with_bar(act_in))

    done = patiently(once)
    keep(done)
    for line in done.failed:
        run_log(line, warning=True)
    summary = (
        f"{done.comparison_id}: {counted(done.trained, 'model')} trained, {counted(done.measured, 'trajectory', 'trajectories')} measured"
    )
    run_log(summary)
    return Failed(message=f"{summary}; {done.failed[0]}", data=done) if done.failed else Completed(message=summary, data=done)
