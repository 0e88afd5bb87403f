"""`metascenes drive`: a cart on the ways of policies, through replicas."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import configuration_options, existing_lake, json_option, lake_option, workers_option
from schemas.families.policies import POLICIES

if TYPE_CHECKING:
    from flows.outputs.films import Filmed
    from flows.robot.driving import Driven
    from flows.run.configuration import Configuration
    from warehouse.lake import Lake

_WAYS = ("policy", "run_name", "setup", "body")
"""Columns that say which runs belong together."""

MAX_NOTES = 20
"""Notes that are printed; all of them are in the column `robot_runs.problem`."""


@click.command("drive", short_help="Let a simulated cart drive the ways that policies take.")
@click.argument("file", required=False, type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--policy", "policies", multiple=True,
    help=f"Whose ways: {', '.join(POLICIES)}, a model by its id, `navigation`, the newest policy of the lake, or `objectnav`, which "
    "ships; may be repeated. It acts first where the lake does not have its trajectories.",
)  # fmt: skip
@click.option("--batch", "batches", multiple=True, help="Trajectory batch of the lake; may be repeated.")
@lake_option
@configuration_options
@click.option(
    "--films", type=click.Path(path_type=Path, file_okay=False),
    help="Write films of runs that arrived and that did not into this folder, as animated WebP: the room with the cart, and its plan.",
)  # fmt: skip
@click.option(
    "--per-outcome", type=click.IntRange(1), default=3, show_default=True,
    help="With --films: so many that arrived and so many that did not of each policy.",
)  # fmt: skip
@workers_option
@click.option("--dry-run", is_flag=True, help="Say what would be driven; write nothing.")
@json_option
def command(file: Path | None, policies: tuple[str, ...], batches: tuple[str, ...], address: str, config_file: Path | None,
            settings: tuple[str, ...], library: Path | None, seed: int | None, films: Path | None, per_outcome: int, workers: int,
            dry_run: bool, as_json: bool) -> None:  # fmt: skip
    """Let a cart with two wheels, encoders, a gyro and a lidar drive ways through replicas, simulated with noise, slip and delay.

    FILE holds the trajectories of one policy, as `metascenes evaluate` takes them; they are imported first. Of every scene
    `robot.routes` ways are driven, spread over its episodes. The cart knows the replica as its map; with `--set
    robot.displacement.share=0.1` a tenth of the small furniture stands elsewhere, and `--set robot.body=mujoco` puts wheels on
    the floor of the exported scene. What it did becomes rows of the table `robot_runs`; the view `robot_metrics` says how well.

    A Prefect run, a task for each scene, if there is anything to drive; killed, the same command goes on.

    Exit code 1 says that some scenes could not be driven through; each is named.

    Example: metascenes drive --policy expert --lake ./lake
    """
    from flows.inputs.evaluation import import_trajectories
    from flows.run.configuration import configure

    if not (file or policies or batches):
        raise click.UsageError("give a file of trajectories, --policy or --batch")
    if films is not None and dry_run:
        raise click.UsageError("--dry-run writes nothing, films neither: leave one of them out")
    lake = existing_lake(address)
    configuration = configure(config_file, settings, library, seed)
    named = list(batches)
    if file is not None:
        imported = import_trajectories(lake, file, configuration, dry_run)
        if not dry_run:
            named += imported.batches
    done = _carried_out(
        lake, configuration, dry_run=dry_run, lake=lake.address, policies=list(dict.fromkeys(policies)), batches=named, workers=workers,
        library=str(library) if library else None, seed=seed, config_file=str(config_file) if config_file else None,
        settings=list(settings),
    )  # fmt: skip
    metrics = _metrics(lake, done)
    filmed = _filmed(lake, done, films, per_outcome) if films is not None else None
    if as_json:
        files = {} if filmed is None else {"films": [str(file) for file in filmed.files]}
        print(json.dumps({**dataclasses.asdict(done), "metrics": metrics, **files}))
    else:
        _tell(done, metrics, dry_run)
        if filmed is not None:
            print("", *filmed.files, sep="\n")
    for line in filmed.missing if filmed is not None else ():
        print(f"note: {line}", file=sys.stderr)
    for line in done.failed:
        print(f"failed: {line}", file=sys.stderr)
    if done.failed:
        raise click.exceptions.Exit(1)


def _carried_out(store: Lake, configuration: Configuration, *, dry_run: bool, **parameters: Any) -> Driven:
    """Run `flows.robot.flow.drive` in this process; Prefect starts only when there is something to drive."""
    from flows.evaluation.acting import planned_policy
    from flows.progress import Progress
    from flows.robot.driving import batches_of, driven, planned_drives
    from flows.server.here import result_or_raise

    def load() -> Any:
        from flows.robot.flow import drive

        return drive

    acting = [planned_policy(store, policy, configuration) for policy in parameters["policies"]]  # before any of them acts
    unmade = sum(len(each.todo) for each in acting)
    acted = [scene.batch_id for each in acting for scene in each.scenes if not scene.is_new]
    if not dry_run:  # what an interrupted run had done and not yet committed
        store.commit(note="trajectories", scenes=acted)
    planned = planned_drives(store, [*batches_of(store, acted), *parameters["batches"]], configuration)
    todo = sum(drive.is_new for drive in planned)
    if dry_run or not unmade + todo:
        if not dry_run:
            store.commit(note="robot runs", scenes=[drive.batch_id for drive in planned])
        first = tuple(f"{each.policy} would act first, scenes: {len(each.todo)}" for each in acting if each.todo)
        return dataclasses.replace(driven(planned, {}), notes=first)
    done: Driven = result_or_raise(load, Progress("scenes", unmade * 2 + todo), parameters)
    return done


def _filmed(lake: Lake, done: Driven, folder: Path, per_outcome: int) -> Filmed:
    """Films of these drives."""
    from flows.outputs.drives import write_drive_films
    from flows.progress import Progress

    with Progress("films", 2 * per_outcome) as progress:
        return write_drive_films(lake, done.batches, folder, per_outcome, advance=progress.advance)


def _metrics(lake: Lake, done: Driven) -> list[dict[str, Any]]:
    """Rows of the view `robot_metrics` of these drives' policies."""
    from warehouse.questions.views import asked_by

    reader = lake.snapshot()
    rows = reader.matching("robot_runs", {"batch_id": done.batches}, [*_WAYS]).to_pylist() if done.batches else []
    wanted = {tuple(row[name] for name in _WAYS) for row in rows}
    with reader.connect(names=asked_by("robot_metrics")) as connection:
        metrics = connection.sql("SELECT * FROM robot_metrics").to_arrow_table().to_pylist()
    return [row for row in metrics if tuple(row[name] for name in _WAYS) in wanted]


def _tell(done: Driven, metrics: Sequence[dict[str, Any]], dry_run: bool) -> None:
    """What was done, and the metrics, for people."""
    old = f", {done.runs - done.new} are in the lake already" if done.new < done.runs else ""
    ways, scenes = (f"{count} {noun}{'' if count == 1 else 's'}" for count, noun in ((done.runs, "way"), (done.scenes, "scene")))
    print(f"{ways} in {scenes}: {done.new} {'would be driven' if dry_run else 'driven'}{old}")
    for note in done.notes[:MAX_NOTES]:
        print(f"note: {note}", file=sys.stderr)
    if len(done.notes) > MAX_NOTES:
        print(f"note: and {len(done.notes) - MAX_NOTES} more in robot_runs.problem", file=sys.stderr)
    if not metrics:
        return
    names = [", ".join(row[name] for name in _WAYS if row[name]) for row in metrics]
    width = max(len("ways of"), *map(len, names))
    print(f"\n{'ways of':<{width}}      n  arrived     95 % interval  collisions  error, cm  wheels, cm   NEES")
    for name, row in zip(names, metrics, strict=True):
        errors = _figure(row["error_m"], 100, 2), _figure(row["wheels_error_m"], 100, 1), _figure(row["nees"], 1, 2)
        low, high = row["arrived_share_low"], row["arrived_share_high"]
        print(
            f"{name:<{width}} {row['n']:>6}  {row['arrived_share']:>7.3f}  {low:>6.3f} to {high:.3f} "
            f"{row['collisions']:>11} {errors[0]:>10} {errors[1]:>11} {errors[2]:>6}"
        )


def _figure(value: float | None, scale: float, digits: int) -> str:
    """A mean over carts that moved, where any did."""
    return "-" if value is None else f"{value * scale:.{digits}f}"
