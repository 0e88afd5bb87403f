"""Trajectories into the lake: the evaluation stage on a file, a built-in policy or a model. Does not import Prefect."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from flows.evaluation.acting import ActIn, Episodes, evaluated, in_this_process, planned_policy
from flows.evaluation.measuring import STAGE, Evaluated, evaluation_config, measured_rows, measuring_job
from flows.progress import Progress
from flows.run.configuration import Configuration
from flows.run.fingerprints import canonical_json, digest
from flows.worker import execute
from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.evaluation import check_batch
from tasks.evaluation.batch import read_batch
from tasks.stage import Spread
from warehouse.lake import Lake
from warehouse.questions.views import asked_by
from warehouse.tables.history import Key, StageState
from warehouse.tables.snapshot import Reader


def import_trajectories(lake: Lake, file: Path, configuration: Configuration, dry_run: bool = False) -> Evaluated:
    """Read a batch of trajectories, hold it against the lake's episodes, measure and append it.

    Raises:
        InputError: the file, or a trajectory in it, is refused; nothing is imported then. A batch that is in the lake
            already with other trajectories, or measured at another success distance, is refused: trajectories are history.
    """
    batch = read_batch(file)
    content = digest(canonical_json([dataclasses.replace(attempt, where="") for attempt in batch.attempts]), batch.policy, batch.run_name)
    held = _held(lake.history([batch.batch_id]), batch.batch_id)
    if held is not None and held.content != content:
        problem = f"{batch.batch_id} is in the lake with other trajectories"
        raise InputError(file.name, "batch_id", problem, "give the new ones a batch_id of their own")
    config = evaluation_config(configuration)
    if held is not None and held.success_m != config.success_m:
        problem = f"{batch.batch_id} is in the lake, measured at a success distance of {held.success_m:g} m, not {config.success_m:g} m"
        raise InputError(file.name, "batch_id", problem, "import the file under another batch_id, or set evaluation.success_m as it was")
    new = 0
    notes: tuple[str, ...] = ()
    if held is None:
        reader = lake.snapshot()
        rows = measured_rows(reader, batch.scene_ids)
        check_batch(batch, rows.episodes, rows.navmeshes, config)
        new = len(batch.attempts)
        if not dry_run:
            with Progress(f"{batch.policy}: scenes", len(batch.scene_ids)) as progress:
                run = execute(measuring_job(lake, batch, content, rows, configuration), _advancing(progress))
            if run.error:
                raise InputError(file.name, "trajectories", run.error)
            notes = run.degradations
    if not dry_run:
        lake.commit(note=f"trajectory batch {batch.batch_id}", scenes=[batch.batch_id])
    return Evaluated(batch.policy, batch.run_name, (batch.batch_id,), len(batch.attempts), len(batch.scene_ids), new, notes)


def run_policy(
    lake: Lake, policy: str, configuration: Configuration, dry_run: bool = False, act_in: ActIn = in_this_process,
    episodes: Episodes | None = None,
) -> Evaluated:  # fmt: skip
    """Let a built-in policy, or a model, act in episodes of the lake, by default in all, measure and append what it did: a batch for
    every scene.

    A batch is named by all that its rows follow from but the code, so only scenes are computed whose episodes, navmesh or
    settings are new; of a model also whose looks are, or when newer code acts. Newer code measures a batch again, and its
    rows take the place of those that it had. A scene that fails does not stop the others, and leaves a row in `stage_runs`
    that says why. What was measured before a kill is not measured again. `act_in` carries out what is to be done in scenes.

    Raises:
        InputError: the lake has no episodes, or there is no such policy.
    """
    planned = planned_policy(lake, policy, configuration, episodes)
    if dry_run:
        return evaluated(planned, {})
    with Progress(f"{planned.policy}: scenes", len(planned.scenes)) as progress:
        for scene in planned.scenes:
            if not scene.is_new:
                progress.advance(scene.task.scene_id)
        runs = {}
        for run in act_in(planned.todo):
            runs[run.scene_id] = run
            progress.advance(run.scene_id)
    lake.commit(note=f"trajectories of {planned.policy}", scenes=planned.batches)
    return evaluated(planned, runs)


def metrics_of(reader: Reader, evaluated: Sequence[Evaluated], configuration: Configuration) -> list[dict[str, Any]]:
    """Rows of the view `navigation_metrics` for these policies and runs, at the success distance that is set."""
    with reader.connect(names=asked_by("navigation_metrics")) as connection:
        rows = connection.sql("SELECT * FROM navigation_metrics").to_arrow_table().to_pylist()
    wanted = {(policy_run.policy, policy_run.run_name) for policy_run in evaluated}
    success_m = evaluation_config(configuration).success_m
    return [row for row in rows if (row["policy"], row["run_name"]) in wanted and row["success_distance_m"] == success_m]


@dataclasses.dataclass(frozen=True)
class _Held:
    """A batch as the lake has it, committed or staged. content: Hash of its trajectories. success_m: That it was measured at [m]."""

    content: str
    success_m: float


def _held(history: Mapping[Key, StageState], batch_id: str) -> _Held | None:
    """A batch of the lake; None when there is none of that name."""
    state = history.get((batch_id, STAGE.name))
    if state is None or state.done is None:
        return None
    reasons = dict(part.split("=", 1) for part in state.done.reasons)
    return _Held(reasons["trajectory_batch"], float(json_value(state.done.config)["success_m"]))


def _advancing(progress: Progress) -> Spread:
    """A map in turn that moves a bar on after every item."""

    def spread(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        results = []
        for item in items:
            results.append(function(item))
            progress.advance(item.attempts[0].scene_id)
        return results

    return spread
