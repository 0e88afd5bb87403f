"""`metascenes watch`: new scans become replica scenes by themselves, without a server."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import configuration_options, json_option, lake_option, scans_options, workers_option

if TYPE_CHECKING:
    from flows.scans.arrivals import Look, WatchReport
    from warehouse.lake import Lake


@click.command("watch", short_help="Turn new and changed scans into replica scenes as they arrive.")
@scans_options
@lake_option
@click.option("--settle", type=click.FloatRange(0), default=120.0, show_default=True, metavar="SECONDS",
              help="A scan counts when nobody has written to it for so long.")  # fmt: skip
@click.option("--every", type=click.FloatRange(0, min_open=True), default=300.0, show_default=True, metavar="SECONDS",
              help="Time between two looks.")  # fmt: skip
@click.option("--once", is_flag=True, help="Look once; what this look sees counts from the next one on.")
@click.option("--deployment", metavar="FLOW/NAME", help="Ask this deployment on your Prefect server instead of computing here.")
@configuration_options
@workers_option
@click.option("--dry-run", is_flag=True, help="Say what was found; remember and do nothing.")
@json_option
def command(scans: str, links_into: tuple[str, ...], scan_format: str, dataset: str | None, address: str, settle: float,
            every: float, once: bool,
            deployment: str | None, config_file: Path | None, settings: tuple[str, ...], library: Path | None, seed: int | None,
            workers: int, dry_run: bool, as_json: bool) -> None:  # fmt: skip
    """Turn new and changed scans into replica scenes as they arrive. Scans that are still being copied wait.

    New means content that the lake does not have; times do not count. With --once, exit code 1 says that scenes failed, or
    that a scan has been incomplete for more than a day; without, it looks until it is interrupted. --json prints an object
    per look.

    Example: metascenes watch --scans ./incoming --lake ./lake --every 60
    """
    from flows.run.configuration import configure
    from schemas.errors import InputError, LakeError

    configure(config_file, settings, library, seed)  # a mistake in it is told now, not when the first scan arrives
    if deployment is not None and not os.environ.get("PREFECT_API_URL"):
        raise InputError("--deployment", deployment, "no Prefect server is named", "set PREFECT_API_URL")
    parameters = {"workers": workers, "library": str(library) if library else None, "seed": seed, "settings": list(settings),
                  "config_file": str(config_file) if config_file else None, "links_into": list(links_into)}  # fmt: skip
    watcher = _Watcher(scans, address, settle, scan_format, dataset, deployment, parameters, dry_run)
    while True:
        try:
            report, is_news = watcher.look()
        except (LakeError, OSError) as error:
            if once:
                raise
            print(f"metascenes: {' '.join(str(error).split())}; looking again in {every:g} s", file=sys.stderr, flush=True)
        else:
            if as_json or once or is_news:
                print(json.dumps(dataclasses.asdict(report)) if as_json else _text(report), flush=True)
            for head, lines in (("incomplete for more than a day", report.overdue), ("failed", report.failures)):
                for line in lines:
                    print(f"{head}: {line}", file=sys.stderr, flush=True)
            if once and (report.failures or report.overdue):
                raise click.exceptions.Exit(1)
        if once:
            return
        time.sleep(every)


@dataclasses.dataclass(frozen=True)
class _Watcher:
    """What is looked at, and what follows from it. Prefect is imported only when there is something to do."""

    scans: str
    address: str
    settle: float
    format: str
    dataset: str | None
    deployment: str | None
    parameters: dict[str, Any]
    dry_run: bool

    def look(self) -> tuple[WatchReport, bool]:
        """One look with all that follows from it; and whether it has news."""
        from flows.scans.arrivals import look, remember, watch_report
        from warehouse.lake import Lake

        lake = Lake.open(self.address)
        latest = look(self.scans, lake, self.settle, self.format, self.dataset, links_into=self.parameters["links_into"])
        report = watch_report(latest)
        if (report.new or report.changed) and not self.dry_run:
            report = self._computed(latest, lake) if self.deployment is None else self._asked(latest, lake, self.deployment)
        is_news = latest.is_news or bool(report.run)
        if not self.dry_run:
            remember(latest, self.scans, lake)
        return report, is_news

    def _asked(self, latest: Look, lake: Lake, deployment: str) -> WatchReport:
        """Ask a deployment for what is due."""
        from flows.scans.arrivals import request_key, watch_report
        from flows.server.access import take_token
        from flows.server.process import QUIET, check_server

        for name, value in QUIET.items():
            if "LOGGING" not in name:
                os.environ.setdefault(name, value)
        api = os.environ["PREFECT_API_URL"]
        take_token(api)
        check_server(api)
        from flows.watch import MAX_SCANS, ask, is_over, request

        due = latest.due(is_over)[:MAX_SCANS]
        if not due:
            return watch_report(latest)
        asked = request(self.scans, lake.address, self.format, self.dataset, due, self.parameters["links_into"])
        run = ask(deployment, asked, request_key(self.scans, lake.address, due))
        latest.asked(due, run)
        return watch_report(latest, due, run)

    def _computed(self, latest: Look, lake: Lake) -> WatchReport:
        """Run the pipeline on what is due, in this process."""
        from flows.commands.run import carry_out
        from flows.run.configuration import configure
        from flows.run.plan import make_plan
        from flows.scans.arrivals import HERE, remember, watch_report
        from flows.scans.choice import found_scans

        due = latest.due(lambda run: True)
        if not due:
            return watch_report(latest)
        latest.asked(due, HERE)
        remember(latest, self.scans, lake)  # before it is begun: a scan that kills its run is soon tried only once a day
        parameters = self.parameters
        config_file, library = (Path(parameters[name]) if parameters[name] else None for name in ("config_file", "library"))
        configuration = configure(config_file, parameters["settings"], library, parameters["seed"])
        scenes = [arrival.scan for arrival in due]
        ready = found_scans(self.scans, self.format, self.dataset, scenes=scenes, links_into=parameters["links_into"])
        plan = make_plan(lake, *ready, configuration)
        report = carry_out(
            plan,
            lake,
            configuration,
            scans=self.scans,
            lake=lake.address,
            format=self.format,
            dataset=self.dataset,
            scenes=scenes,
            **parameters,
        )
        return watch_report(
            latest,
            due,
            HERE,
            (*report.failures, *(f"{scene}: {report.stopped}" for scene in report.postponed or ["the run"] if report.stopped)),
        )


def _text(report: WatchReport) -> str:
    """A line per scan that is not known, and their numbers."""
    lines = [f"{scan:<32} {state}" for state, scans in (("new", report.new), ("changed", report.changed)) for scan in scans]
    lines += [f"{scan:<32} waiting: {why}" for scan, why in report.waiting.items()]
    lines += [f"{scan:<32} failed before: {why}" for scan, why in report.failed_before.items()]
    lines += [f"{scan:<32} left out: {what}" for scan, what in report.left_out.items()]
    lines += [f"{scan:<32} known as {scene}" for scan, scene in report.same.items()]
    return "\n".join([*lines, str(report)])
