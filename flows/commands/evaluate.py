"""`metascenes evaluate`: how well agents navigate the episodes of a lake."""

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
from schemas.wording import counted

if TYPE_CHECKING:
    from flows.evaluation.acting import PlannedPolicy
    from flows.evaluation.measuring import Evaluated
    from flows.outputs.films import Filmed
    from warehouse.lake import Lake

MAX_NOTES = 20
"""Notes that are printed; all of them are in the column `trajectories.problem`."""


@click.command("evaluate", short_help="Measure how well agents navigate the episodes.")
@click.argument("file", required=False, type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--policy", "policies", multiple=True,
    help=f"Run {', '.join(POLICIES)}, a model by its id, `navigation`, the newest policy of the lake, or `objectnav`, which "
    "ships; may be repeated.",
)  # fmt: skip
@lake_option
@configuration_options
@click.option(
    "--films", type=click.Path(path_type=Path, file_okay=False),
    help="Write films of successes and failures into this folder, as animated WebP: the room with the agent, and what it sees.",
)  # fmt: skip
@click.option(
    "--per-outcome", type=click.IntRange(min=1), default=1, show_default=True,
    help="With --films: so many successes and so many failures of each policy.",
)  # fmt: skip
@workers_option
@click.option("--dry-run", is_flag=True, help="Check the batch against the lake and say what would be measured; write nothing.")
@json_option
def command(file: Path | None, policies: tuple[str, ...], address: str, config_file: Path | None, settings: tuple[str, ...],
            library: Path | None, seed: int | None, films: Path | None, per_outcome: int, workers: int,
            dry_run: bool, as_json: bool) -> None:  # fmt: skip
    """Measure how well agents navigate the episodes of a lake.

    FILE holds the trajectories of one policy, as JSON or JSON Lines (schema: tasks/evaluation/batch.schema.json). The
    built-in policies act in all episodes: `expert` takes the actions that come with each, `random` moves by chance, and a
    model that `metascenes train navigation` made sees what a camera sees from where it got. What
    was done becomes rows of the table `trajectories`; the views `navigation_metrics`, `navigation_metrics_by_scene`,
    `navigation_metrics_by_category` and `trajectory_metrics` say how well. The same batch twice changes nothing.
    With --films, some of what the lake has of these policies is filmed; which, a hash of the episodes says.

    Policies are a Prefect run, a task for each scene, if there is anything to measure; killed, the same command goes on.

    Exit code 1 says that the episodes of some scenes could not be run; each is named.

    Example: metascenes evaluate --policy expert --policy random --lake ./lake
    """
    from flows.evaluation.acting import planned_policy
    from flows.inputs.evaluation import import_trajectories, metrics_of
    from flows.run.configuration import configure

    if (file is None) == (not policies):
        raise click.UsageError("give either a file of trajectories or --policy")
    if films is not None and dry_run:
        raise click.UsageError("--dry-run writes nothing, films neither: leave one of them out")
    lake = existing_lake(address)
    configuration = configure(config_file, settings, library, seed)
    if file is not None:
        evaluated = [import_trajectories(lake, file, configuration, dry_run)]
    else:
        planned = [planned_policy(lake, name, configuration) for name in dict.fromkeys(policies)]  # before any of them acts
        evaluated = _carried_out(
            lake, planned, dry_run=dry_run, lake=lake.address, policies=list(policies), workers=workers,
            library=str(library) if library else None, seed=seed, config_file=str(config_file) if config_file else None,
            settings=list(settings),
        )  # fmt: skip
    metrics = metrics_of(lake.snapshot(), evaluated, configuration)
    if not as_json:
        _tell(evaluated, metrics, dry_run)
    filmed = _filmed(lake, evaluated, films, per_outcome) if films is not None else None
    if as_json:
        files = {} if filmed is None else {"films": [str(file) for file in filmed.files]}
        print(json.dumps({"policies": [dataclasses.asdict(policy_run) for policy_run in evaluated], "metrics": metrics, **files}))
    elif filmed is not None:
        print("", *filmed.files, sep="\n")
    for line in filmed.missing if filmed is not None else ():
        print(f"note: {line}", file=sys.stderr)
    failed = [f"{policy_run.policy}: {line}" for policy_run in evaluated for line in policy_run.failed]
    for line in failed:
        print(f"failed: {line}", file=sys.stderr)
    if failed:
        raise click.exceptions.Exit(1)


def _filmed(lake: Lake, evaluated: Sequence[Evaluated], folder: Path, per_outcome: int) -> Filmed:
    """Films of what the lake has of these policies and runs."""
    from flows.outputs.films import write_films
    from flows.progress import Progress

    runs = list(dict.fromkeys((policy_run.policy, policy_run.run_name) for policy_run in evaluated))
    with Progress("films", 2 * per_outcome * len(runs)) as progress:
        return write_films(lake, runs, folder, per_outcome, advance=progress.advance)


def _carried_out(store: Lake, planned: Sequence[PlannedPolicy], *, dry_run: bool, **parameters: Any) -> list[Evaluated]:
    """Run `flows.evaluation.flow.evaluate` in this process; Prefect starts only when there is something to measure."""
    from flows.evaluation.acting import evaluated
    from flows.progress import Progress
    from flows.server.here import result_or_raise

    def load() -> Any:
        from flows.evaluation.flow import evaluate

        return evaluate

    todo = sum(len(each.todo) for each in planned)
    if not todo or dry_run:
        if not dry_run:  # what an interrupted run had measured and not yet committed
            for each in planned:
                store.commit(note=f"trajectories of {each.policy}", scenes=each.batches)
        return [evaluated(each, {}) for each in planned]
    done: list[Evaluated] = result_or_raise(load, Progress("scenes", todo), parameters)
    return done


def _tell(evaluated: list[Evaluated], metrics: list[dict[str, Any]], dry_run: bool) -> None:
    """What was done, and the metrics, for people."""
    for policy_run in evaluated:
        counts = (
            f"{policy_run.policy}, {policy_run.run_name}: "
            f"{counted(policy_run.trajectories, 'trajectory', 'trajectories')} in {counted(policy_run.scenes, 'scene')}"
        )
        old = f", {policy_run.trajectories - policy_run.new} are in the lake already" if policy_run.new < policy_run.trajectories else ""
        print(f"{counts}: {policy_run.new} {'would be measured' if dry_run else 'measured'}{old}")
        for note in policy_run.notes[:MAX_NOTES]:
            print(f"note: {note}", file=sys.stderr)
        if len(policy_run.notes) > MAX_NOTES:
            print(f"note: and {len(policy_run.notes) - MAX_NOTES} more in trajectories.problem", file=sys.stderr)
    if metrics:
        width = max(len("run"), *(len(row["run_name"]) for row in metrics))
        long = max(len("policy"), *(len(row["policy"]) for row in metrics))
        head = f"{'policy':<{long}}  {'run':<{width}}  split      n     SR      95 % interval    SPL    SEL      EL"
        print(f"\n{head}")
    for row in metrics:
        print(
            f"{row['policy']:<{long}}  {row['run_name']:<{width}}  {row['split']:<5} {row['n']:>6}  {row['sr']:.3f}  "
            f"{row['sr_low']:.3f} to {row['sr_high']:.3f}  {row['spl']:.3f}  {row['sel']:.3f}  {row['el']:>6.1f}"
        )
    _tell_found([row for row in metrics if row["found_share"] is not None])


def _tell_found(metrics: list[dict[str, Any]]) -> None:
    """Who had the target in view within a meter when it stopped, and who stopped within Habitat's 0.1 m."""
    if not metrics:
        return
    width, long = (max(len(head), *(len(row[name]) for row in metrics)) for head, name in (("run", "run_name"), ("policy", "policy")))
    print(f"\n{'policy':<{long}}  {'run':<{width}}  split  stopped at 0.1 m  at 1 m in view  95 % interval    SPL")
    for row in metrics:
        interval = f"{row['found_share_low']:.3f} to {row['found_share_high']:.3f}"
        print(
            f"{row['policy']:<{long}}  {row['run_name']:<{width}}  {row['split']:<5} {row['arrived_share']:>17.3f} "
            f"{row['found_share']:>15.3f}  {interval}  {row['found_spl']:.3f}"
        )
