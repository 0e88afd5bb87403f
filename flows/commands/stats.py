"""`metascenes stats`: the report, or the table of stage times."""

from __future__ import annotations

from pathlib import Path

import click

from flows.commands.options import existing_lake, lake_option


@click.command("stats", short_help="Draw the statistics and write the report.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default="report.html", show_default=True, help="Report to write.")
@click.option("--pictures", type=click.Path(path_type=Path, file_okay=False), help="Also write every chart there, as SVG and PNG.")
@click.option("--stages", is_flag=True, help="Only print the table of stage times.")
@click.option("--snapshot", "snapshot_id", type=int, help="Snapshot to report on; the newest by default.")
@lake_option
def command(out: Path, pictures: Path | None, stages: bool, snapshot_id: int | None, address: str) -> None:
    """Draw the statistics of a lake and write the report: one HTML file that works offline.

    Example: metascenes stats --lake ./lake --out report.html
    """
    from flows.stats import stage_table, write_report

    lake = existing_lake(address)
    if stages:
        print(stage_table(lake.snapshot(snapshot_id)))
        return
    print(write_report(lake, out, snapshot_id, pictures=pictures))
