"""`metascenes train`: train a learned system on what the lake holds."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flows.commands.options import existing_lake, json_option, lake_option, seed_option, settings_options, snapshot_options
from schemas.families.learned_systems import LEARNED_SYSTEMS
from schemas.parsing import json_value

if TYPE_CHECKING:
    from flows.training.training import PlannedTraining


@click.command("train", short_help="Train a learned system on a snapshot or release of the lake.")
@click.argument("system", type=click.Choice(LEARNED_SYSTEMS))
@lake_option
@snapshot_options
@click.option("--from", "start", metavar="MODEL_ID", help="Begin with the weights of this model; see `metascenes models list`.")
@settings_options
@seed_option
@click.option("--dry-run", is_flag=True, help="Say what would be trained, and on what; write nothing.")
@json_option
def command(system: str, address: str, release: str | None, snapshot_id: int | None, start: str | None, config_file: Path | None,
            settings: tuple[str, ...], seed: int | None, dry_run: bool, as_json: bool) -> None:  # fmt: skip
    """Train a learned system on the newest snapshot of the lake, or on the one that is named.

    The model goes into the table `models`, its loss curve into `training_steps`, its figures into `model_evaluations`. The same rows,
    settings, seed and code are one training: where the lake has it, nothing is computed. A training that was killed goes on from its
    last checkpoint, to the same weights. Settings are those of the stage `training`, as in --set training.system.fitting.steps=500.

    On several graphics cards or machines: torchrun --nproc-per-node 4 -m flows.cli train SYSTEM ...

    Example: metascenes train selection --lake ./lake --release v1
    """
    from flows.training.models import evaluations_of_model, figure_lines
    from flows.training.progress import StepBar
    from flows.training.training import planned_training, system_configuration, train
    from tasks.stage import silently
    from tasks.training.devices import rank

    lake = existing_lake(address)
    configuration = system_configuration(system, config_file, settings, seed)
    planned = planned_training(lake, configuration, snapshot_id=snapshot_id, release=release, start=start)
    if dry_run:
        _tell_plan(planned, as_json)
        return
    with StepBar(system) as bar:
        model = train(lake, planned, bar.report if rank() == 0 else silently)
    if rank() > 0:
        return
    figures = evaluations_of_model(lake.snapshot(), model)
    if as_json:
        measures = [dataclasses.asdict(figure) for figure in figures]
        print(json.dumps({"is_new": planned.held is None, **dataclasses.asdict(model), "measures": measures}))
        return
    state = "trained" if planned.held is None else "withdrawn, and left so" if model.is_withdrawn else "in the lake already"
    print(f"model {model.model_id}: {state}")
    print(
        f"{model.kind}, {model.architecture}, {model.parameter_count:,} numbers, on {model.dataset}: {model.seconds:.0f} s, {model.device}"
    )
    for line in figure_lines(figures):
        print(line)
    if model.is_fallback:
        print(f"note: {'; '.join(model.notes) or 'a part of it stands in for one whose weights were not there'}", file=sys.stderr)


def _tell_plan(planned: PlannedTraining, as_json: bool) -> None:
    """What would be trained."""
    facts = {"training_id": planned.training_id, "dataset": planned.dataset.name, "state": planned.why}
    if as_json:
        print(json.dumps(facts | {"config": json_value(planned.job.config_json)}))
    else:
        todo = "nothing to do" if planned.held is not None else "would be trained"
        print(f"{planned.training_id} on {planned.dataset.name}: {planned.why}, {todo}")
