"""Carrying out a comparison: trainings, their policies in the test episodes, and tests of pairs. Does not import Prefect.

What is there is not computed again: models by their trainings, trajectories by their batches, the comparison by these.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from flows.comparison.planning import STAGE, ComparedTraining, PlannedComparison
from flows.evaluation.acting import ActIn, PlannedPolicy, PlannedScene, planned_policy
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from flows.training.training import model_of_training
from flows.worker import Job, execute
from schemas.comparison import ComparedRun
from schemas.errors import InputError, LakeError
from schemas.evaluation import Trajectory
from schemas.record import arrow_to_rows
from schemas.training import LearnedModel
from warehouse.lake import Lake
from warehouse.questions.views import asked_by

Train = Callable[[ComparedTraining], LearnedModel]
"""Carries a training out that the lake does not have the model of."""


@dataclasses.dataclass(frozen=True)
class Compared:
    """What came of a comparison.

    trained, measured: Models and trajectories that were not in the lake before. rows: Of the view `navigation_comparison`. tests: Of the
    view `navigation_comparison_tests`. failed: Scenes that are left out since a policy could not be run in them, and why, a line each.
    """

    comparison_id: str
    trained: int
    measured: int
    rows: tuple[dict[str, Any], ...]
    tests: tuple[dict[str, Any], ...]
    notes: tuple[str, ...]
    failed: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Contestant:
    """A policy of a comparison that is trained, and what it is to do."""

    training: ComparedTraining
    model: LearnedModel
    acting: PlannedPolicy


def contestant_of(lake: Lake, planned: PlannedComparison, training: ComparedTraining, model: LearnedModel) -> Contestant:
    """What a trained policy is to do in the test episodes."""
    acting = planned_policy(lake, model.model_id, planned.configuration, planned.episodes, planned.snapshot_id)
    return Contestant(training, model, acting)


def contestants_so_far(lake: Lake, planned: PlannedComparison) -> list[Contestant]:
    """Those whose models the lake has."""
    return [
        contestant_of(lake, planned, training, training.planned.held)
        for training in planned.trainings
        if training.planned.held is not None
    ]  # fmt: skip


def left_to_do(lake: Lake, planned: PlannedComparison) -> tuple[int, int, bool]:
    """Models that are to be trained, trajectories that are to be measured of all, and whether pairs are to be tested."""
    there = contestants_so_far(lake, planned)
    to_train = len(planned.trainings) - len(there)
    to_measure = sum(scene.episodes for each in there for scene in each.acting.todo)
    to_measure += to_train * sum(map(len, planned.episodes.values()))
    if to_train or to_measure:
        return to_train, to_measure, True
    state = lake.history([planned.comparison_id]).get((planned.comparison_id, STAGE.name))
    job = _job(lake, planned, there, {*planned.episodes}, ())
    return 0, 0, state is None or state.done is None or state.done.fingerprint != job.fingerprint


def compare(lake: Lake, planned: PlannedComparison, train: Train, act_in: ActIn) -> Compared:
    """Carry a comparison out: train what is not there, let all policies act in the test episodes, test pairs.

    A scene in which one policy could not be run is left out for all, and said to be.

    Raises:
        InputError: a training has nothing to learn from, or no scene is left.
        LakeError: the test of pairs failed by a defect.
    """
    trained, contestants = 0, []
    for training in planned.trainings:
        model = training.planned.held
        if model is None:
            model = model_of_training(lake, training.planned.training_id)  # of a choice that has the same rows as one before
        if model is None:
            model, trained = train(training), trained + 1
        contestants.append(contestant_of(lake, planned, training, model))
    todo = _once(scene for each in contestants for scene in each.acting.todo)
    runs = {run.scene_id: run for run in act_in(todo)}
    batches = sorted({name for each in contestants for name in each.acting.batches})
    lake.commit(note=f"trajectories of {planned.comparison_id}", scenes=batches)
    errors: dict[str, str] = {}
    for each in contestants:
        for scene in each.acting.scenes:
            run = runs.get(scene.batch_id)
            if run is not None and run.error:
                errors[scene.task.scene_id] = f"{scene.task.scene_id}: trained on {each.training.trained_on}: {run.error}"
    scenes = {*planned.episodes} - {*errors}
    if not scenes:
        raise InputError(
            planned.comparison_id, "scenes", f"none is left: {next(iter(errors.values()))}", "mend them, or name other datasets"
        )
    _test_pairs(lake, planned, contestants, scenes)
    measured = sum(scene.episodes for scene in todo if not runs[scene.batch_id].error)
    rows, tests = answers_of_comparison(lake, planned.comparison_id)
    return Compared(planned.comparison_id, trained, measured, rows, tests, planned.notes, tuple(errors[name] for name in sorted(errors)))


def _once(scenes: Any) -> list[PlannedScene]:
    """Each batch once: two choices of datasets may have led to one model."""
    return list({scene.batch_id: scene for scene in scenes}.values())


def _test_pairs(lake: Lake, planned: PlannedComparison, contestants: Sequence[Contestant], scenes: set[str]) -> None:
    """Write down who was compared, and the tests, unless the lake has them."""
    name = planned.comparison_id
    batches = sorted({scene.batch_id for each in contestants for scene in each.acting.scenes})
    rows = arrow_to_rows(lake.snapshot().matching("trajectories", {"batch_id": batches}), Trajectory)
    job = _job(lake, planned, contestants, scenes, rows)
    state = lake.history([name]).get((name, STAGE.name))
    if state is None or state.done is None or state.done.fingerprint != job.fingerprint:
        run = execute(job)
        if run.error is not None:
            lake.commit(note=f"{name} failed", scenes=[name])
            raise (InputError(name, "comparison", run.error) if run.error_kind == "input" else LakeError(f"{name}: {run.error}"))
    lake.commit(note=f"comparison of {', '.join(planned.request.labels)}", scenes=[name])


def _job(
    lake: Lake, planned: PlannedComparison, contestants: Sequence[Contestant], scenes: set[str], trajectories: Sequence[Trajectory]
) -> Job:  # fmt: skip
    """The job that compares what contestants did in scenes."""
    rows, measured = [], []
    for each in contestants:
        for scene in each.acting.scenes:
            if scene.task.scene_id in scenes:
                measured.append(scene.job.fingerprint)
                rows.append(
                    ComparedRun(
                        comparison_id=planned.comparison_id, trained_on=each.training.trained_on, seed=each.training.seed,
                        scene_id=scene.task.scene_id, model_id=each.model.model_id, training_id=each.training.planned.training_id,
                        batch_id=scene.batch_id, episodes=scene.episodes,
                    )
                )  # fmt: skip
    facts = {
        "request": digest(canonical_json(planned.request)), "batches": digest(canonical_json(rows), *measured),
        "code": code_fingerprint("tasks.comparison"),
    }  # fmt: skip
    return Job(
        lake=lake.address,
        scene_id=planned.comparison_id,
        stage=STAGE.name,
        config=planned.config,
        config_json=canonical_json(planned.config),
        seed=planned.configuration.seed,
        fingerprint=digest("comparison", *facts.values(), canonical_json(planned.config), str(planned.configuration.seed)),
        reasons=tuple(f"{fact}={value}" for fact, value in facts.items()),
        upstream=(),
        attempt=1,
        outside=(("compared_batches", rows), ("trajectories", trajectories)),
    )


def answers_of_comparison(lake: Lake, comparison_id: str) -> tuple[tuple[dict[str, Any], ...], tuple[dict[str, Any], ...]]:
    """Rows of the views `navigation_comparison` and `navigation_comparison_tests` for one comparison."""
    views = ("navigation_comparison", "navigation_comparison_tests")
    with lake.snapshot().connect(names=asked_by(" ".join(views))) as connection:
        rows, tests = (
            connection.sql(f"SELECT * FROM {view} WHERE comparison_id = '{comparison_id}'").to_arrow_table().to_pylist() for view in views
        )
    return tuple(rows), tuple(tests)
