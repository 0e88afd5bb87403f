"""`metascenes compare`: which dataset of the lake is worth most to those who learn from it."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import (
    existing_lake,
    grouped,
    json_option,
    lake_option,
    seed_option,
    settings_options,
    snapshot_options,
    workers_option,
)
from schemas.wording import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from flows.comparison.comparing import Compared
    from flows.comparison.planning import PlannedComparison
    from warehouse.lake import Lake


_size_options = grouped(
    click.option("--steps", type=click.IntRange(1), help="Steps of each training; as --set training.system.fitting.steps."),
    click.option("--trajectories", type=click.IntRange(1), help="Episodes in each test scene, 10 by default as in the paper."),
    click.option("--scenes", type=click.IntRange(1), help="Scenes of each test dataset, 10 by default as in the paper."),
    click.option("--seeds", type=click.IntRange(1), help="Trainings on each choice of datasets, 3 by default: --seed, and those after it."),
)
"""How much is compared: what the stages `comparison` and `training` are told most often."""


@click.group("compare", short_help="Compare datasets of the lake by what is learned from them.")
def command() -> None:
    """Compare datasets of the lake by what is learned from them.

    Example: metascenes compare navigation --train replicas --train generated --test house --lake ./lake
    """


@command.command("navigation")
@click.option("--train", "train", multiple=True, required=True, metavar="A[+B]",
              help="Datasets to learn from, the first part of their scenes' names; + takes several together. Twice or more.")  # fmt: skip
@click.option("--test", "test", multiple=True, required=True, metavar="C", help="Dataset to be tested in; may be repeated.")
@_size_options
@lake_option
@snapshot_options
@settings_options
@seed_option
@workers_option
@click.option("--dry-run", is_flag=True, help="Say what would be trained and measured, and in which scenes; write nothing.")
@json_option
def navigation(
    train: tuple[str, ...], test: tuple[str, ...], seeds: int | None, scenes: int | None, trajectories: int | None, steps: int | None,
    address: str, release: str | None, snapshot_id: int | None, config_file: Path | None, settings: tuple[str, ...], seed: int | None,
    workers: int, dry_run: bool, as_json: bool,
) -> None:  # fmt: skip
    """Train the same policy on several datasets, and test all of them in the same episodes of another (supplementary, Table A4).

    Architecture, budget and seeds are the same for all; settings are those of the stages training, comparison and evaluation. Rooms that
    a policy learned from are left out of the test, whatever dataset they are in. Models go into `models`, what they did into
    `trajectories`, who was compared into `compared_runs`, tests of pairs into `paired_tests`; the views `navigation_comparison` and
    `navigation_comparison_tests` say how it comes out. It is a Prefect run, if there is anything to do; killed, the same command goes on.

    Exit code 1 says that a scene had to be left out since a policy could not be run in it; it is named.

    Example: metascenes compare navigation --train replicas --train generated --train replicas+generated --test house --lake ./lake
    """
    from flows.comparison.planning import SYSTEM, asked_comparison, planned_comparison
    from flows.training.training import system_configuration
    from tasks.training.devices import check_installed

    short = {"comparison.seeds": seeds, "comparison.scenes": scenes, "comparison.trajectories": trajectories,
             "training.system.fitting.steps": steps}  # fmt: skip
    values = [*settings, *(f"{name}={value}" for name, value in short.items() if value is not None)]
    lake = existing_lake(address)
    configuration = system_configuration(SYSTEM, config_file, values, seed)
    planned = planned_comparison(lake, asked_comparison(train, test), configuration, snapshot_id=snapshot_id, release=release)
    if dry_run:
        _tell_plan(lake, planned, as_json)
        return
    if any(training.planned.held is None for training in planned.trainings):
        check_installed()
    done = _carried_out(
        lake, planned, lake=lake.address, train=list(train), test=list(test), snapshot=snapshot_id, release=release, workers=workers,
        seed=seed, config_file=str(config_file) if config_file else None, settings=values,
    )  # fmt: skip
    if as_json:
        print(json.dumps(dataclasses.asdict(done)))
    else:
        _tell(done)
    for line in done.failed:
        print(f"failed: {line}", file=sys.stderr)
    if done.failed:
        raise click.exceptions.Exit(1)


def _carried_out(store: Lake, planned: PlannedComparison, **parameters: Any) -> Compared:
    """Run `flows.comparison.flow.compare` in this process; Prefect starts only when there is something to do."""
    from flows.comparison.comparing import Compared, answers_of_comparison, left_to_do
    from flows.progress import Progress
    from flows.server.here import result_or_raise
    from flows.training.progress import TrainingBars

    def load() -> Any:
        from flows.comparison.flow import compare

        return compare

    if left_to_do(store, planned) == (0, 0, False):
        store.commit(note="comparison", scenes=[planned.comparison_id])  # what an interrupted run had staged
        rows, tests = answers_of_comparison(store, planned.comparison_id)
        return Compared(planned.comparison_id, 0, 0, rows, tests, planned.notes)
    with TrainingBars():
        done: Compared = result_or_raise(load, Progress("scenes", 0), parameters)
    return done


def _tell_plan(store: Lake, planned: PlannedComparison, as_json: bool) -> None:
    """What would be done."""
    from flows.comparison.comparing import left_to_do

    to_train, to_measure, _ = left_to_do(store, planned)
    trainings = [
        {"trained_on": each.trained_on, "seed": each.seed, "training_id": each.planned.training_id, "state": each.planned.why}
        for each in planned.trainings
    ]  # fmt: skip
    if as_json:
        facts = {"comparison_id": planned.comparison_id, "trainings": trainings, "episodes": dict(planned.episodes)}
        print(json.dumps({**facts, "to_train": to_train, "to_measure": to_measure, "notes": list(planned.notes)}))
        return
    for each in trainings:
        print(f"{each['training_id']}  {each['trained_on']}, seed {each['seed']}: {each['state']}")
    for scene, names in sorted(planned.episodes.items()):
        print(f"{scene}: {counted(len(names), 'episode')}")
    print(
        f"{planned.comparison_id}: {counted(to_train, 'model')} would be "
        f"trained, {counted(to_measure, 'trajectory', 'trajectories')} measured"
    )
    for note in planned.notes:
        print(f"note: {note}", file=sys.stderr)


def _tell(done: Compared) -> None:
    """The comparison, for people."""
    for note in done.notes:
        print(f"note: {note}", file=sys.stderr)
    print(
        f"{done.comparison_id}: {counted(done.trained, 'model')} trained, {counted(done.measured, 'trajectory', 'trajectories')} measured"
    )
    table = [("trained on", "tested on", "seeds", "n", "SR", "95 % interval", "EL", "curvature", "SEL", "SPL", "at 1 m in view")]
    for row in done.rows:
        seen = "" if row["found_share"] is None else f"{row['found_share']:.3f}"
        table.append(
            (row["trained_on"], row["tested_on"], f"{row['seeds']}", f"{row['n']}", f"{row['sr']:.3f}",
             f"{row['sr_low']:.3f} to {row['sr_high']:.3f}", f"{row['el']:.1f}", _number(row["curvature_turning_angle_per_m"]),
             f"{row['sel']:.3f}", f"{row['spl']:.3f}", seen)
        )  # fmt: skip
    tests = [("first", "second", "tested on", "measure", "pairs", "difference", "only first", "only second", "p", "p by scene",
              "p by seed")]  # fmt: skip
    tests += [
        (test["first"], test["second"], test["tested_on"], test["measure"], f"{test['pairs']}", f"{test['difference']:+.3f}",
         f"{test['only_first']}", f"{test['only_second']}", _p_value(test["p_value"]), _p_value(test["p_value_by_scene"]),
         _p_value(test["p_value_by_seed"]))
        for test in done.tests
    ]  # fmt: skip
    for rows in (table, tests):
        print()
        _print_columns(rows)
    if done.tests:
        print()
        print("p: these models in such episodes; by scene: these models in other scenes; by seed: other trainings on the same datasets")
        seeds = max(test["seeds"] or 1 for test in done.tests)
        print(f"by {seeds} seeds p is {2 / 2**seeds:.2g} at least" if seeds > 1 else "by one seed there is no p: give --seeds")


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _p_value(value: float | None) -> str:
    """None where there is one scene, or one seed."""
    return "n/a" if value is None else f"{value:.4f}"


def _print_columns(rows: Sequence[tuple[str, ...]]) -> None:
    """Lines of columns, each as wide as its widest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
