"""`metascenes run`: scans in, replica scenes out."""

from __future__ import annotations

import dataclasses
import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import configuration_options, json_option, lake_option, scans_options, workers_option
from flows.run.fanout.runners import RUNNERS
from schemas.wording import counted
from schemas.wording.notes import condensed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from flows.run.configuration import Configuration
    from flows.run.plan import Plan
    from flows.run.report import RunReport
    from warehouse.lake import Lake


@click.command("run", short_help="Turn a folder of scans into replica scenes in a lake.")
@scans_options
@lake_option
@configuration_options
@workers_option
@click.option("--scene", "scenes", multiple=True, metavar="ID", help="Only this scene; shell patterns match several; may be repeated.")
@click.option("--first", metavar="ID", help="Only scenes from this id on.")
@click.option("--last", metavar="ID", help="Only scenes up to this id.")
@click.option("--since", metavar="DATE", help="Only scans that arrived on this date or later.")
@click.option("--until", metavar="DATE", help="Only scans that arrived on this date or earlier.")
@click.option("--runner", type=click.Choice(RUNNERS), default="pool", show_default=True, help="What computes.")
@click.option("--dask-address", metavar="ADDRESS", help="Scheduler of a Dask cluster, with --runner dask; by default one is started here.")
@click.option("--batch", type=click.IntRange(1), help="Scenes per Prefect task; by default it follows from how long they take.")
@click.option(
    "--keep-free", "keep_free_gb", type=click.FloatRange(0), metavar="GB", help="Stop before less is free on the disk; 2 by default."
)
@click.option(
    "--quota",
    "quota_gb",
    type=click.FloatRange(0, min_open=True),
    metavar="GB",
    help="Stop before the lake holds more, as far as the scenes so far tell.",
)
@click.option("--budget", "budget_usd", type=click.FloatRange(0), metavar="USD", help="Stop before calls to models cost more.")
@click.option("--most-calls", type=click.IntRange(0), metavar="N", help="Stop before more calls to models are made.")
@click.option("--replay", metavar="LAKE", help="Take replies of models from the ledger of this lake; none is asked.")
@click.option(
    "--stage-seconds", type=click.FloatRange(0, min_open=True), metavar="S",
    help="Time limit of one stage of one scene, in which calls to slow models count; 3600 by default.",
)  # fmt: skip
@click.option("--retry-failed", is_flag=True, help="Compute again what failed on unchanged input.")
@click.option("--again", is_flag=True, help="Compute scans that the lake has under another name again, under their names here.")
@click.option("--dry-run", is_flag=True, help="Say what would be done and why; do nothing.")
@json_option
def command(scans: str, links_into: tuple[str, ...], scan_format: str, dataset: str | None, address: str,
            config_file: Path | None, settings: tuple[str, ...],
            library: Path | None, seed: int | None, workers: int, scenes: tuple[str, ...], first: str | None, last: str | None,
            since: str | None, until: str | None, runner: str, dask_address: str | None, batch: int | None, keep_free_gb: float | None,
            quota_gb: float | None, budget_usd: float | None, most_calls: int | None, replay: str | None,
            stage_seconds: float | None, retry_failed: bool,
            again: bool, dry_run: bool, as_json: bool) -> None:  # fmt: skip
    """Turn a folder of scans into replica scenes in a lake.

    Only what is missing, changed or stale is computed. A scan that the lake has under another name (another dataset, a
    renamed folder, a copy) is that scene, by content, and is said to be. Several runs on one lake share the work. Exit code 1
    says that some scenes failed, that an export did not pass a check, that there was no room for all on the disk or below --quota,
    or that --budget or --most-calls was reached; each is named.

    Example: metascenes run --scans ./scans --format auto --lake ./lake
    """
    from flows.run.configuration import configure
    from flows.run.plan import make_plan
    from flows.scans.choice import found_scans
    from warehouse.lake import Lake

    configuration = configure(config_file, settings, library, seed)
    lake = Lake.open(address)
    if replay:
        Lake.existing(replay, "--replay")
    scan_list, unusable = found_scans(
        scans, scan_format, dataset, scenes=scenes, first=first, last=last, since=since, until=until, links_into=links_into
    )
    plan = make_plan(lake, scan_list, unusable, configuration, retry_failed, again=again)
    if dry_run:
        from flows.run.rescans import foreseen_rescans

        rescans = foreseen_rescans(lake, plan, configuration, retry_failed)
        print(json.dumps(_plan_json(plan, rescans)) if as_json else _plan_text(plan, rescans))
        return
    report = carry_out(
        plan, lake, configuration, scans=scans, lake=address, format=scan_format, dataset=dataset, workers=workers,
        library=str(library) if library else None, seed=seed, config_file=str(config_file) if config_file else None,
        settings=list(settings), retry_failed=retry_failed, again=again, scenes=list(scenes), first=first, last=last, since=since,
        until=until, links_into=list(links_into), runner=runner, dask_address=dask_address, batch=batch, keep_free_gb=keep_free_gb,
        quota_gb=quota_gb, budget_usd=budget_usd, most_calls=most_calls, replay=replay,
        **({"stage_seconds": stage_seconds} if stage_seconds is not None else {}),
    )  # fmt: skip
    print(json.dumps(dataclasses.asdict(report)) if as_json else report_line(report))
    tell(report)
    if report.failures or report.postponed or report.stopped:
        raise click.exceptions.Exit(1)


def carry_out(plan: Plan, store: Lake, configuration: Configuration, **parameters: Any) -> RunReport:
    """Run `flows.pipeline.replicate` in this process; Prefect and its server start only when there is something to compute."""
    from flows.run.report import broken_checks, report_of

    if not plan.todo:
        from flows.run.rescans import with_rescans
        from flows.run.scene import settle
        from flows.scans.refusals import keep_refusals

        settle(store, plan)  # what an interrupted run had finished and not yet committed
        is_whole = not any(parameters.get(name) for name in ("scenes", "first", "last", "since", "until"))
        refused = keep_refusals(store, str(parameters["scans"]), plan, datetime.now(UTC), is_whole=is_whole)
        broken = broken_checks(store, {scene.scan.scene_id for scene in plan.scenes})
        unchanged = report_of(plan, broken=broken, refused_before=refused)
        return with_rescans(unchanged, store, plan, configuration, parameters.get("workers") or 1, bool(parameters.get("retry_failed")))
    from flows.progress import Progress
    from flows.run.report import RunReport, kept
    from flows.server.here import result_here

    def load() -> Any:
        from flows.pipeline import replicate

        return replicate

    steps = sum(len(scene.todo) for scene in plan.scenes)
    kept()
    result, blamed = result_here(load, Progress("stages", steps), parameters)
    report = kept()  # what was done is done, whatever Prefect's server has to say
    if report is not None:
        if not isinstance(result, RunReport):
            print(f"note: Prefect's server does not know how the run ended ({type(result).__name__}); the lake does", file=sys.stderr)
        return report
    assert isinstance(result, BaseException)
    error = blamed()
    if error is not None:
        raise error from result
    raise result


MAX_NOTES = 20
"""Notes that are printed, at most ten of them on a scan; all degradations are in the table `stage_runs`."""


def tell(report: RunReport) -> None:
    """Failures and notes on standard error, a line each; degradations of one kind are one note."""
    notes = condensed(report.degradations)
    for line in notes[:MAX_NOTES]:
        print(f"note: {line}", file=sys.stderr)
    if len(notes) > MAX_NOTES:
        print(f"note: and {len(notes) - MAX_NOTES} more in stage_runs.degradations", file=sys.stderr)
    for line in _same(report.same):
        print(f"note: {line}", file=sys.stderr)
    for line in report.failures:
        print(f"{'refused' if line in report.refused else 'failed'}: {line}", file=sys.stderr)
    if report.postponed:
        print(
            (
                f"stopped: {report.stopped}; {counted(len(report.postponed), 'scene was', 'scenes were')} "
                f"not begun, {report.postponed[0]} first"
            ),
            file=sys.stderr,
        )
    elif report.stopped:
        print(f"failed: {report.stopped}", file=sys.stderr)


def report_line(report: RunReport) -> str:
    """A run's report in a line."""
    if not (report.done or report.failed or report.failures or report.shared or report.postponed or report.rescans):
        return f"nothing to do: {counted(len(report.unchanged), 'scene is', 'scenes are')} up to date{_other_names(report.same)}"
    parts = [f"{counted(len(report.done), 'scene')} done"]
    if failed := len(report.failures) - len(report.broken) - len(report.refused):
        parts.append(f"{failed} failed")
    if report.refused:
        parts.append(f"{counted(len(report.refused), 'scan')} refused")
    if report.broken:
        parts.append(f"{counted(len(report.broken), 'check')} of exports failed")
    parts.append(f"{len(report.unchanged)} unchanged")
    if report.same:
        parts.append(_other_names(report.same).removeprefix(", "))
    if report.shared:
        parts.append(f"{len(report.shared)} computed by another run")
    if report.rescans:
        parts.append(f"{len(report.rescans)} held against earlier scans of their rooms")
    if report.postponed:
        parts.append(f"{len(report.postponed)} postponed")
    parts.append(f"{counted(report.steps, 'stage run')}")
    if report.degradations:
        parts.append(f"{counted(len(report.degradations), 'degradation')} (in the table stage_runs)")
    return ", ".join(parts)


def _other_names(same: Mapping[str, str]) -> str:
    """How many scans are scenes of another name, and the first of them; '' where there are none."""
    if not same:
        return ""
    scan, scene = next(iter(same.items()))
    more = ", ..." if len(same) > 1 else ""
    return f", {len(same)} under another name ({scan} is {scene}{more})"


def _same(same: Mapping[str, str]) -> list[str]:
    """Scans that are scenes of another name, a line each, and what to do about it."""
    from flows.run.identity import sentence

    lines = [sentence(scan, scene) for scan, scene in list(same.items())[:MAX_NOTES]]
    if len(same) > MAX_NOTES:
        lines.append(f"and {counted(len(same) - MAX_NOTES, 'more scan')} known under another name (--json names them)")
    return [*lines, "--again computes them again under their names here"] if lines else []


def _plan_text(plan: Plan, rescans: Mapping[str, Sequence[str]]) -> str:
    lines = _same(plan.same)
    for scene in plan.scenes:
        for step in scene.steps:
            lines.append(f"{scene.scan.scene_id:<32} {step.stage:<13} {step.action:<7} {step.why}")
    lines += [f"{scene:<32} {'rescans':<13} {'run':<7} held against {', '.join(before)}" for scene, before in rescans.items()]
    lines += [f"left out: {line}" for line in plan.left_out]
    lines += [f"unusable: {error}" for error in plan.unusable]
    counts = plan.counts()
    lines.append(
        f"{counted(len(plan.scenes), 'scene')}: {counted(counts['run'], 'stage run')} to do, {counts['reuse']} up to date, "
        f"{counts['report']} failed before, {counts['wait']} waiting for those; {counted(len(plan.unusable), 'scan')} unusable"
    )
    return "\n".join(lines)


def _plan_json(plan: Plan, rescans: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    steps = [
        {
            "scene_id": scene.scan.scene_id,
            "stage": step.stage,
            "action": step.action,
            "why": step.why,
            "fingerprint": step.fingerprint.value,
        }
        for scene in plan.scenes
        for step in scene.steps
    ]
    return {
        "steps": steps,
        "rescans": {scene: list(before) for scene, before in rescans.items()},
        "unusable": [str(error) for error in plan.unusable],
        "left_out": list(plan.left_out),
        "counts": dict(plan.counts()),
        "same": dict(plan.same),
    }
