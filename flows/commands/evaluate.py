"""`metascenes evaluate`: how well agents navigate the episodes of a lake."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import configuration_options, existing_lake, json_option, lake_option

if TYPE_CHECKING:
    from flows.evaluation import Imported

MAX_NOTES = 20
"""Notes that are printed; all of them are in the column `trajectories.problem`."""


@click.command("evaluate", short_help="Measure how well agents navigate the episodes.")
@click.argument("file", required=False, type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--policy", "policies", multiple=True, type=click.Choice(["expert", "random"]), help="Run a built-in policy; may be repeated."
)
@lake_option
@configuration_options
@click.option("--dry-run", is_flag=True, help="Check the batch against the lake and say what would be measured; write nothing.")
@json_option
def command(file: Path | None, policies: tuple[str, ...], address: str, config_file: Path | None, settings: tuple[str, ...],
            library: Path | None, seed: int | None, dry_run: bool, as_json: bool) -> None:  # fmt: skip
    """Measure how well agents navigate the episodes of a lake.

    FILE holds the trajectories of one policy, as JSON or JSON Lines (schema: tasks/evaluation/batch.schema.json). The
    built-in policies act in all episodes: `expert` takes the actions that come with each, `random` moves by chance. What
    was done becomes rows of the table `trajectories`; the views `navigation_metrics`, `navigation_metrics_by_scene`,
    `navigation_metrics_by_category` and `trajectory_metrics` say how well. The same batch twice changes nothing.

    Exit code 1 says that the episodes of some scenes could not be run; each is named.

    Example: metascenes evaluate --policy expert --policy random --lake ./lake
    """
    from flows.configuration import configure
    from flows.evaluation import import_trajectories, metrics_of, run_policy

    if (file is None) == (not policies):
        raise click.UsageError("give either a file of trajectories or --policy")
    lake = existing_lake(address)
    configuration = configure(config_file, settings, library, seed)
    batches: list[Imported] = []
    failed: list[str] = []
    if file is not None:
        batches.append(import_trajectories(lake, file, configuration, dry_run))
    for policy in dict.fromkeys(policies):
        batch, left_out = run_policy(lake, policy, configuration, dry_run)
        batches.append(batch)
        failed += [line for line in left_out if line not in failed]
        failed += [f"{batch.batch_id}: {batch.error}"] if batch.error else []
    metrics = metrics_of(lake.snapshot(), batches)
    if as_json:
        print(json.dumps({"batches": [dataclasses.asdict(batch) for batch in batches], "failed": failed, "metrics": metrics}))
    else:
        _tell(batches, metrics, dry_run)
    for line in failed:
        print(f"failed: {line}", file=sys.stderr)
    if failed:
        raise click.exceptions.Exit(1)


def _tell(batches: list[Imported], metrics: list[dict[str, Any]], dry_run: bool) -> None:
    """Batches and their metrics for people."""
    for batch in batches:
        if batch.error:
            continue
        what = f"batch {batch.batch_id}: {batch.trajectories} trajectories of {batch.policy} in {batch.scenes} scenes"
        print(f"{what} {'are in the lake already' if batch.already else 'would be measured' if dry_run else 'measured'}")
        for note in batch.notes[:MAX_NOTES]:
            print(f"note: {note}", file=sys.stderr)
        if len(batch.notes) > MAX_NOTES:
            print(f"note: and {len(batch.notes) - MAX_NOTES} more in trajectories.problem", file=sys.stderr)
    if metrics:
        print(f"\n{'policy':<12} {'run':<16} {'split':<6} {'n':>6} {'SR':>6} {'95 % interval':>15} {'SPL':>6} {'SEL':>6} {'EL':>7}")
    for row in metrics:
        interval = f"{row['sr_low']:.3f} to {row['sr_high']:.3f}"
        print(
            f"{row['policy']:<12} {row['run_name']:<16} {row['split']:<6} {row['n']:>6} {row['sr']:>6.3f} {interval:>15} "
            f"{row['spl']:>6.3f} {row['sel']:>6.3f} {row['el']:>7.1f}"
        )
