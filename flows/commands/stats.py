"""`metascenes stats`: the report, or the table of stage times."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from flows.commands.options import chosen_snapshot, existing_lake, json_option, lake_option, snapshot_options


@click.command("stats", short_help="Draw the statistics and write the report.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default="report.html", show_default=True, help="Report to write.")
@click.option("--pictures", type=click.Path(path_type=Path, file_okay=False), help="Also write every picture there, as SVG and PNG.")
@click.option(
    "--pages", type=click.Path(path_type=Path, file_okay=False), help="Also write every pictured scene there as a page in 3D, and link it."
)
@click.option("--stages", is_flag=True, help="Only print the table of stage times.")
@click.option("--artifacts", is_flag=True, help="Run as a Prefect flow that leaves pictures and tables as artifacts in its UI.")
@click.option("--dry-run", is_flag=True, help="Say what would be written; write nothing.")
@json_option
@snapshot_options
@lake_option
def command(
    out: Path,
    pictures: Path | None,
    pages: Path | None,
    stages: bool,
    artifacts: bool,
    dry_run: bool,
    as_json: bool,
    snapshot_id: int | None,
    release: str | None,
    address: str,
) -> None:
    """Draw the statistics of a lake and write the report: one HTML file that works offline.

    Example: metascenes stats --lake ./lake --release v1 --out report.html --pictures pictures
    """
    from flows.stats import stage_table, write_report
    from flows.stats.report import report_path, stage_rows

    lake = existing_lake(address)
    snapshot_id = chosen_snapshot(lake, snapshot_id, release)
    reader = lake.snapshot(snapshot_id)
    if stages:
        print(json.dumps(stage_rows(reader)) if as_json else stage_table(reader))
        return
    if dry_run:
        from warehouse.questions.views import asked_by

        with reader.connect(names=asked_by("headline")) as connection:
            scenes = connection.sql("SELECT scenes FROM headline").fetchall()[0][0]
        answer = {"dry_run": True, "snapshot_id": reader.snapshot_id, "scenes": scenes, "report": str(report_path(out))}
        answer |= {"pictures_folder": str(pictures)} if pictures else {}
        words = f"would write {report_path(out)} on snapshot {reader.snapshot_id} with {scenes} scene{'' if scenes == 1 else 's'}"
        print(json.dumps(answer) if as_json else words + (f", and pictures into {pictures}" if pictures else ""))
        return
    if artifacts:
        from flows.server.process import prefect_server

        with prefect_server() as api:
            from flows.stats import statistics

            statistics(address, reader.snapshot_id or None, None, str(out), str(pictures) if pictures else None)
            if not as_json:
                print(f"artifacts are at {api.removesuffix('/api')}/artifacts", file=sys.stderr)
        path, files = report_path(out), sorted(pictures.iterdir()) if pictures else []
    else:
        written = write_report(lake, out, snapshot_id, pictures=pictures, pages=pages)
        path, files = written.path, list(written.files)
    if as_json:
        print(json.dumps({"snapshot_id": reader.snapshot_id, "report": str(path), "pictures": [str(file) for file in files]}))
    else:
        print(path)
