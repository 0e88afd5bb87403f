"""The flow that measures policies: `flows.evaluation.flow.evaluate`, fanned out over scenes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from prefect.states import Completed, Failed, State

from flows.evaluation.acting import PlannedScene, act, evaluated, planned_policy
from flows.evaluation.measuring import Evaluated, evaluation_config
from flows.run.configuration import configure
from flows.run.parameters import Address, StageTables, stages_flow
from flows.run.patience import patiently
from flows.run.scene import STAGE_SECONDS
from flows.server.artifacts import run_log, short_name
from flows.server.here import keep
from flows.server.scene_tasks import SceneWay, fanned_out, workers_for
from schemas.wording import counted
from warehouse.lake import Lake

ACTION_SECONDS = 4.0
"""Time for one action, on top of `STAGE_SECONDS`. The slowest eyes, SigLIP's of 86 million numbers on 336 patches, are 6e10 operations for
a picture: 1 to 3 s at what one core does, 2e10 to 6e10 in a second."""


def seconds_for(scene: PlannedScene) -> float:
    """How long a policy may be at a scene before it passes for hung [s]: every episode may take all its steps."""
    config = evaluation_config(scene.task.configuration)
    return STAGE_SECONDS + ACTION_SECONDS * scene.episodes * config.max_steps


ACTING: SceneWay[PlannedScene] = SceneWay("policy in a scene", act, seconds_for)
"""What lets policies act in scenes."""


def _name() -> str:
    from prefect.runtime import flow_run

    parameters = flow_run.parameters
    return f"{', '.join(parameters['policies'])} in {short_name(parameters['lake'])}"


@stages_flow(name="evaluate", flow_run_name=_name, persist_result=False, validate_parameters=True)
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
        library: Library of the lake, or a folder; it changes nothing here.
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
        with fanned_out(workers_for(workers, len(todo)), ACTING) as act_in:
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
    summary = "; ".join(
        f"{each.policy}, {each.run_name}: {each.new} of {counted(each.trajectories, 'trajectory', 'trajectories')} measured"
        for each in done
    )
    run_log(summary)
    return Failed(message=f"{summary}; {failed[0]}", data=done) if failed else Completed(message=summary, data=done)
