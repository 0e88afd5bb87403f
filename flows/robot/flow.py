"""The flow that lets carts drive: `flows.robot.flow.drive`, fanned out over scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from prefect.states import Completed, Failed, State

from flows.evaluation.acting import evaluated, planned_policy
from flows.evaluation.flow import ACTING
from flows.robot.driving import STAGE, Driven, PlannedDrive, batches_of, drive_scene, driven, planned_drives
from flows.run.configuration import configure
from flows.run.parameters import Address, StageTables, stages_flow
from flows.run.patience import patiently
from flows.run.scene import STAGE_SECONDS
from flows.server.artifacts import run_log, short_name
from flows.server.here import keep
from flows.server.scene_tasks import SceneWay, fanned_out, workers_for
from schemas.families.policies import POLICIES
from schemas.wording import counted
from warehouse.lake import Lake

SIMULATED = 10.0
"""How much longer than simulated time a run may take: wheels that touch the floor take about as long, arcs a tenth."""


def seconds_for(drive: PlannedDrive) -> float:
    """How long a cart may be in a scene before it passes for hung [s]: every way may take all its time."""
    config = drive.task.configuration.stages[STAGE.name]
    return STAGE_SECONDS + SIMULATED * float(config.seconds) * drive.ways


DRIVING: SceneWay[PlannedDrive] = SceneWay("cart in a scene", drive_scene, seconds_for)
"""What lets carts drive in scenes."""


def _name() -> str:
    from prefect.runtime import flow_run

    parameters = flow_run.parameters
    return f"cart on {', '.join([*parameters['policies'], *parameters['batches']])} in {short_name(parameters['lake'])}"


@stages_flow(name="drive", flow_run_name=_name, persist_result=False, validate_parameters=True)
def drive(
    lake: Address,
    policies: list[str] = [POLICIES[0]],  # noqa: B006  # a default that Prefect's form shows; it is never changed
    batches: list[str] = [],  # noqa: B006
    workers: int | None = None,
    library: str | None = None,
    seed: int | None = None,
    config_file: str | None = None,
    settings: list[str] = [],  # noqa: B006
    stages: StageTables = {},  # noqa: B006
) -> Any:
    """Let a cart drive ways that policies take in episodes of a lake. What the lake has is not driven again.

    Policies act first where the lake does not have their trajectories. The run fails where a scene could not be driven through.

    Args:
        lake: Address of the lake: a folder or s3://bucket/prefix.
        policies: Built-in policies, ids of models, or `navigation`, the newest model.
        batches: Trajectory batches of the lake, driven besides.
        workers: Worker processes; by default one for every core of the machine that runs this.
        library: Library of the lake, or a folder; it changes nothing here.
        seed: Run seed.
        config_file: TOML file with a table per stage.
        settings: Single values, `robot.field=value`.
        stages: What stages are told, a table each.
    """
    store = Lake.existing(lake)
    configuration = configure(
        Path(config_file) if config_file else None, settings, Path(library) if library else None, seed, tables=stages or None
    )

    def once() -> Driven:
        acting = [planned_policy(store, policy, configuration) for policy in dict.fromkeys(policies)]
        todo = [scene for each in acting for scene in each.todo]
        acted = {}
        if todo:
            with fanned_out(workers_for(workers, len(todo)), ACTING) as act_in:
                acted = {run.scene_id: run for run in act_in(todo)}
        for each in acting:
            store.commit(note=f"trajectories of {each.policy}", scenes=each.batches)
        named = [batch for each in acting for batch in each.batches if batch not in acted or not acted[batch].error]
        present = batches_of(store, named)
        drives = planned_drives(store, [*present, *batches], configuration)
        todrive = [each for each in drives if each.is_new]
        with fanned_out(workers_for(workers, len(todrive)), DRIVING) as drive_in:
            runs = {run.scene_id: run for run in drive_in(todrive)}
        store.commit(note="robot runs", scenes=[each.batch_id for each in drives])
        unacted = [f"{each.policy}: {line}" for each in acting for line in evaluated(each, acted).failed]
        unacted += [f"{batch}: its trajectories are not in the lake; drive again" for batch in named if batch not in present]
        return driven(drives, runs, unacted)

    done = patiently(once)
    keep(done)
    return _state(done)


def _state(done: Driven) -> State[Any]:
    """How the run ends: failed where a scene did."""
    for line in done.failed:
        run_log(line, warning=True)
    summary = f"{done.new} of {counted(done.runs, 'run')} in {counted(done.scenes, 'scene')} driven"
    run_log(summary)
    return Failed(message=f"{summary}; {done.failed[0]}", data=done) if done.failed else Completed(message=summary, data=done)
