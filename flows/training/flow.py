"""The flow that trains: `flows.training.flow.train`. Its deployment trains when a release appears."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from prefect.states import Completed

from flows.run.parameters import Address, StageTables, stages_flow
from flows.run.patience import patiently
from flows.server.artifacts import run_log, short_name
from flows.training.models import system_names
from flows.training.training import UnderWay, planned_training, system_configuration, trained_on
from flows.training.training import train as carried_out
from schemas.families.learned_systems import LEARNED_SYSTEMS
from warehouse.lake import Lake
from warehouse.release import releases

if TYPE_CHECKING:
    System = str
else:
    System = Literal[LEARNED_SYSTEMS]  # the form of a run offers each

HOURS = 24
"""The paper's sizes take most of a day on one graphics card."""

SAID = 20
"""Times that a run's log says how far a training is."""


def _name() -> str:
    from prefect.runtime import flow_run

    parameters = flow_run.parameters
    on = parameters.get("release") or (f"snapshot {parameters['snapshot']}" if parameters.get("snapshot") else "the newest")
    return f"{', '.join(parameters.get('systems') or ()) or 'all systems'} on {on} of {short_name(parameters['lake'])}"


@stages_flow(name="train", flow_run_name=_name, persist_result=False, timeout_seconds=HOURS * 3600, validate_parameters=True)
def train(
    lake: Address,
    systems: list[System] = [],  # noqa: B006  # a default that Prefect's form shows; it is never changed
    snapshot: int | None = None,
    release: str | None = None,
    newest_release: bool = False,
    start: str | None = None,
    seed: int | None = None,
    config_file: str | None = None,
    settings: list[str] = [],  # noqa: B006
    stages: StageTables = {},  # noqa: B006
) -> Any:
    """Train learned systems on a snapshot or release of a lake. What the lake has the model of is not trained again.

    Args:
        lake: Address of the lake: a folder or s3://bucket/prefix.
        systems: Learned systems; all by default.
        snapshot: Snapshot to learn from; the newest by default.
        release: Release to learn from, instead of a snapshot.
        newest_release: Learn from the newest release, if no model of the system has yet, whatever trained it.
        start: Model whose weights training begins with.
        seed: Run seed.
        config_file: TOML file with a table per stage.
        settings: Single values, `training.system.field=value`.
        stages: What stages are told, a table each.
    """
    store = Lake.existing(lake)
    if newest_release:
        known = sorted(releases(store), key=lambda made: (made.snapshot_id, made.created_at))
        if not known:
            return _completed(f"{short_name(lake)} has no release yet")
        release = known[-1].name
    outcomes: list[str] = []
    for system in systems or system_names():
        if newest_release and trained_on(store, system, str(release)) is not None:
            outcomes.append(f"{system}: a model of release {release} is there")
            continue
        configuration = system_configuration(system, Path(config_file) if config_file else None, settings, seed, stages or None)

        def once(system: str = system, configuration: Any = configuration) -> str:
            planned = planned_training(store, configuration, snapshot_id=snapshot, release=release, start=start)
            try:
                model = carried_out(store, planned, told_now_and_then(system))
            except UnderWay as error:
                return str(error)
            return f"{system}: model {model.model_id[:12]} on {planned.dataset.name}, {planned.why}"

        outcomes.append(patiently(once))
        run_log(outcomes[-1])
    return _completed("; ".join(outcomes) or "there is no learned system")


def told_now_and_then(system: str) -> Any:
    """A report for a run's log on a training, of a system or of another name: now and then a line."""

    def report(done: int, of: int, text: str) -> None:
        if done == of or done % max(of // SAID, 1) == 0:
            run_log(f"{system}: step {done} of {of}, {text}")

    return report


def _completed(text: str) -> Any:
    run_log(text)
    return Completed(message=text)
