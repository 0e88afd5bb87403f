"""`metascenes demo`: raw scans made here, through the whole data path, to files that a simulator loads."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flows.commands.options import json_option, workers_option
from schemas.families.policies import POLICIES
from schemas.wording import counted

if TYPE_CHECKING:
    from flows.outputs.export import WrittenExports
    from warehouse.lake import Lake


@click.command("demo", short_help="Make raw scans of furnished rooms and turn them into replica scenes.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default="demo", show_default=True, help="Folder for everything.")
@click.option("--scenes", type=click.IntRange(1, 100), default=3, show_default=True, help="Rooms to scan.")
@click.option("--seed", type=int, default=0, show_default=True, help="Run seed.")
@workers_option
@json_option
def command(out: Path, scenes: int, seed: int, workers: int, as_json: bool) -> None:
    """Make raw scans of furnished rooms with the virtual scanner and turn them into replica scenes.

    Needs no download, no server and no GPU. A second demo redoes only what has changed.

    Example: metascenes demo --out demo
    """
    from flows.commands.run import carry_out, report_line, tell
    from flows.inputs.demo import make_scans
    from flows.inputs.evaluation import run_policy
    from flows.outputs.export import WrittenExports
    from flows.run.configuration import configure
    from flows.run.plan import make_plan
    from flows.stats import stage_table, write_report
    from flows.view.bundle import is_built
    from tasks.capture.formats import find_scans
    from warehouse.lake import Lake

    clock = time.perf_counter()
    made = make_scans(out / "scans", scenes, seed, workers)
    scanned = time.perf_counter() - clock
    lake = Lake.open(str(out / "lake"))
    scan_list, unusable = find_scans(out / "scans", "auto", "demo")
    configuration = configure(seed=seed)
    plan = make_plan(lake, scan_list, unusable, configuration)
    report = carry_out(
        plan, lake, configuration, scans=str(out / "scans"), lake=str(out / "lake"), dataset="demo", workers=workers, seed=seed
    )
    replicated = time.perf_counter() - clock - scanned
    policies = POLICIES if lake.snapshot().arrow("episodes").num_rows else ()
    has_exports = lake.snapshot().arrow("export_files").num_rows > 0  # else the run says what failed
    places = places_in(out)
    is_viewed = is_built() and lake.snapshot().arrow("scenes").num_rows > 0  # else there is nothing to show, or nothing to show it with
    with exporting(lake, out, workers) if has_exports else nullcontext(lambda: WrittenExports(0, (), ())) as finish:
        unmeasured = [line for policy in policies for line in run_policy(lake, policy, configuration).failed]
        write_report(lake, places["report"], pages=out / "view" if is_viewed else None, workers=workers)
        written = finish()
    if as_json:
        print(json.dumps({"failures": report.failures, "seconds": time.perf_counter() - clock, **{k: str(v) for k, v in places.items()}}))
    else:
        print(stage_table(lake.snapshot()))
        print()
        scans = f"{counted(made, 'scan')} made in {scanned:.1f} s" if made else "scans are up to date"
        exported = f"{counted(written.files, 'file')} exported, {counted(written.failed_checks, 'check')} failed"
        print(f"{scans}; {report_line(report)} in {replicated:.1f} s; {exported}; {time.perf_counter() - clock:.1f} s in all")
        print()
        for name, place in places.items():
            print(f"{name:<16} {place}")
        if is_viewed:
            print(f"{'scenes in 3D':<16} {out / 'view'}")
        for name, line in next_commands(out / "lake", is_viewed).items():
            print(f"{name:<16} {line}")
    tell(report)
    for line in (*written.problems, *unmeasured):
        click.echo(f"failed: {line}", err=True)
    if report.failures or written.problems or unmeasured:
        raise click.exceptions.Exit(1)


@contextmanager
def exporting(lake: Lake, out: Path, workers: int) -> Iterator[Callable[[], WrittenExports]]:
    """``with exporting(lake, out, 2) as finish: ...; written = finish()``: exports of the newest snapshot are written and checked
    meanwhile, in a process of their own where there is more than one worker."""
    from flows.outputs.export import write_exports
    from flows.run.pool import WorkerLost, WorkerPool

    here = partial(write_exports, lake, out, snapshot_id=lake.snapshot().snapshot_id)
    if workers < 2:
        yield here
        return
    with ThreadPoolExecutor(1) as threads, WorkerPool(1) as pool:
        there = threads.submit(pool.call, here)

        def finish() -> WrittenExports:
            try:
                return there.result()
            except WorkerLost:
                return here()

        yield finish


def places_in(out: Path) -> dict[str, Path]:
    """What a demo makes, and where."""
    from tasks.exports.formats import FORMATS

    exports = {format_.title: out / format_.name for format_ in FORMATS}
    return {"raw scans": out / "scans", **exports, "report": out / "report.html", "lake": out / "lake"}


def next_commands(lake: Path, is_viewed: bool) -> dict[str, str]:
    """What to type next, for a shell, by what it is good for."""
    looked = {"look at it": f"metascenes view --lake {shlex.quote(str(lake))}"} if is_viewed else {}
    asked = f'metascenes sql --lake {shlex.quote(str(lake))} "SELECT * FROM objects_per_scene"'
    return {**looked, "ask the lake": asked, "name it once": f"export METASCENES_LAKE={shlex.quote(str(lake.resolve()))}"}
