"""`metascenes storeys`: a scan of each floor, of scans of several."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flows.commands.options import end_with_failures, json_option, scans_options, settings_options
from schemas.wording import counted
from tasks.capture.scan import PassedOver

if TYPE_CHECKING:
    from flows.scans.storeys import ScanStoreys


@click.command("storeys", short_help="Divide scans of several floors into a scan of each.")
@scans_options
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder that the storeys' scans are made in.")
@settings_options
@click.option("--dry-run", is_flag=True, help="Say which scans have several storeys; write nothing.")
@json_option
def command(
    scans: str, links_into: tuple[str, ...], scan_format: str, dataset: str | None, out: Path, config_file: Path | None,
    settings: tuple[str, ...], dry_run: bool, as_json: bool,
) -> None:  # fmt: skip
    """Divide scans of several floors into a scan of each, since a scene is of one floor.

    A scan `house` becomes OUT/house/house_floor0, house_floor1 and so on, from the lowest up, in a format that is read, in the coordinates
    that it had; OUT/house/storeys.json says how they are joined again. Scans of one storey stay where they are. What was divided before
    and has not changed is left alone. What makes a storey are settings (`--set capture.storeys.min_cover=0.5`). Exit code 1 says that a
    scan could not be read.

    Example: metascenes storeys --scans ./scans --out ./storeys
    """
    from flows.progress import Progress
    from flows.run.configuration import configure
    from flows.scans.choice import found_scans
    from flows.scans.storeys import divide_scans

    config = configure(config_file, settings).stages["capture"]
    chosen, unusable = found_scans(scans, scan_format, dataset, links_into=links_into)
    unusable = [error for error in unusable if not isinstance(error, PassedOver)]
    with Progress("scans", len(chosen)) as progress:
        done = divide_scans(chosen, out, config, dry_run, progress.advance)
    failed = {row.scene_id: row.error for row in done if row.error is not None} | {error.file: error for error in unusable}
    if as_json:
        errors = [str(error) for error in unusable]
        print(json.dumps({"dry_run": dry_run, "out": str(out), "scans": [dataclasses.asdict(row) for row in done], "unusable": errors}))
    else:
        print("\n".join([*(line for row in done for line in _lines(row, dry_run)), _summary(done, len(unusable), dry_run)]))
    end_with_failures({} if as_json else failed, bool(failed))


def _lines(row: ScanStoreys, dry_run: bool) -> list[str]:
    """What became of a scan, and a line for each note."""
    if row.action == "whole":
        lines = [f"{row.scene_id:<40} one storey"]
    elif row.error is not None:
        lines = [f"{row.scene_id:<40} failed"]
    else:
        verb = "would be divided" if dry_run and row.action == "divided" else row.action
        lines = [
            (
                f"{row.scene_id:<40} {counted(len(row.floors), 'storey')}, floors "
                f"at {', '.join(f'{high:.2f}' for high in row.floors)} m: {verb}"
            )
        ]
    return [*lines, *(f"  {note}" for note in row.notes)]


def _summary(done: list[ScanStoreys], unusable: int, dry_run: bool) -> str:
    counts = {action: sum(row.action == action for row in done) for action in ("divided", "unchanged", "whole", "failed")}
    divided = f"{counted(counts['divided'], 'scan')} {'would be divided' if dry_run else 'divided'}"
    return f"{divided}, {counts['unchanged']} unchanged, {counts['whole']} of one storey, {counts['failed'] + unusable} failed"
