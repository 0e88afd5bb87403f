"""`metascenes run`: scans in, replica scenes out."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import configuration_options, json_option, lake_option, workers_option

if TYPE_CHECKING:
    from flows.plan import Plan
    from flows.report import RunReport
    from warehouse.lake import Lake


@click.command("run", short_help="Turn a folder of scans into replica scenes in a lake.")
@click.option("--scans", required=True, type=click.Path(path_type=Path), help="Folder of scans, or one scan.")
@click.option(
    "--format",
    "scan_format",
    type=click.Choice(["auto", "scannet", "posed_rgbd", "glb"]),
    default="auto",
    show_default=True,
    help="Scan format.",
)
@click.option("--dataset", help="Name of the dataset; by default what the format says.")
@lake_option
@configuration_options
@workers_option
@click.option("--retry-failed", is_flag=True, help="Compute again what failed on unchanged input.")
@click.option("--dry-run", is_flag=True, help="Say what would be done and why; do nothing.")
@json_option
def command(scans: Path, scan_format: str, dataset: str | None, address: str, config_file: Path | None, settings: tuple[str, ...],
            library: Path | None, seed: int | None, workers: int, retry_failed: bool, dry_run: bool, as_json: bool) -> None:  # fmt: skip
    """Turn a folder of scans into replica scenes in a lake.

    Only what is missing, changed or stale is computed. Exit code 1 says that some scenes failed; each is named.

    Example: metascenes run --scans ./scans --format auto --lake ./lake
    """
    from flows.configuration import configure
    from flows.plan import make_plan
    from tasks.capture.formats import find_scans
    from warehouse.lake import Lake

    configuration = configure(config_file, settings, library, seed)
    lake = Lake.open(address)
    found, unusable = find_scans(scans, scan_format, dataset)
    plan = make_plan(lake, found, unusable, configuration, retry_failed)
    if dry_run:
        print(json.dumps(_plan_json(plan)) if as_json else _plan_text(plan))
        return
    report = carry_out(plan, lake, threads=workers, scans=str(scans), lake=address, format=scan_format, dataset=dataset, workers=workers,
                       library=str(library) if library else None, seed=seed, config_file=str(config_file) if config_file else None,
                       settings=list(settings), retry_failed=retry_failed)  # fmt: skip
    print(json.dumps(dataclasses.asdict(report)) if as_json else summary(report))
    tell(report)
    if report.failures:
        raise click.exceptions.Exit(1)


def carry_out(plan: Plan, store: Lake, *, threads: int, **parameters: Any) -> RunReport:
    """Run `flows.pipeline.replicate` on this machine; Prefect and its server start only when there is something to compute."""
    from flows.report import report_of

    if not plan.todo:
        from flows.scene import settle

        settle(store, plan)  # what an interrupted run had finished and not yet committed
        return report_of(plan, [])
    from flows.progress import Progress, listen
    from flows.server import prefect_server

    steps = sum(len(scene.todo) for scene in plan.scenes)
    with Progress("stages", steps) as progress, prefect_server():
        listen(progress)
        try:
            from prefect.task_runners import ThreadPoolTaskRunner

            from flows.pipeline import replicate

            runner: Any = ThreadPoolTaskRunner(max_workers=threads + 1)
            local = replicate.with_options(task_runner=runner)
            report: RunReport = local(**parameters)
        finally:
            listen(None)
    return report


MAX_NOTES = 20
"""Degradations that are printed; all of them are in the table `stage_runs`."""


def tell(report: RunReport) -> None:
    """Failures and degradations on standard error, a line each."""
    for line in report.degradations[:MAX_NOTES]:
        print(f"note: {line}", file=sys.stderr)
    if len(report.degradations) > MAX_NOTES:
        print(f"note: and {len(report.degradations) - MAX_NOTES} more in stage_runs.degradations", file=sys.stderr)
    for line in report.failures:
        print(f"failed: {line}", file=sys.stderr)


def summary(report: RunReport) -> str:
    """A run's report in a line."""
    if not report.done and not report.failed and not report.failures:
        return f"nothing to do: {len(report.unchanged)} scenes are up to date"
    parts = [f"{len(report.done)} scenes done"]
    if report.failures:
        parts.append(f"{len(report.failures)} failed")
    parts.append(f"{len(report.unchanged)} unchanged")
    parts.append(f"{report.steps} stage runs")
    if report.degradations:
        parts.append(f"{len(report.degradations)} degradations (in the table stage_runs)")
    return ", ".join(parts)


def _plan_text(plan: Plan) -> str:
    lines = []
    for scene in plan.scenes:
        for step in scene.steps:
            lines.append(f"{scene.scan.scene_id:<32} {step.stage:<13} {step.action:<7} {step.why}")
    lines += [f"unusable: {error}" for error in plan.unusable]
    counts = plan.counts()
    lines.append(f"{len(plan.scenes)} scenes: {counts['run']} stage runs to do, {counts['reuse']} up to date, "
                 f"{counts['report']} failed before, {counts['wait']} waiting for those; {len(plan.unusable)} scans unusable")  # fmt: skip
    return "\n".join(lines)


def _plan_json(plan: Plan) -> dict[str, Any]:
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
    return {"steps": steps, "unusable": [str(error) for error in plan.unusable], "counts": dict(plan.counts())}
