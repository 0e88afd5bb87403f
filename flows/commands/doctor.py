"""`metascenes doctor`: is this file, this dataset, this lake sound?"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from flows.commands.options import chosen_snapshot, existing_lake, json_option, lake_option, snapshot_options
from schemas.wording import counted
from tasks.exports.findings import Finding
from tasks.exports.format import ExportFormat
from tasks.exports.formats import FORMATS

budget_option = click.option(
    "--budget", type=click.FloatRange(0.25, 1000), default=1.0, show_default=True,
    help="Give the check this many times the usual time and memory.",
)  # fmt: skip


@click.group("doctor", short_help="Check a USD, MJCF, URDF, SDF or GLB file, a map, a Habitat dataset or the lake.")
def command() -> None:
    """Check a USD, MJCF, URDF, SDF or GLB file, a map, a Habitat dataset or the lake. Exit code 1 says that something is wrong.

    Example: metascenes doctor usd scene.usda
    """


_TAKES = {
    "a file": ("file", click.Path(path_type=Path, exists=True, dir_okay=False)),
    "a folder": ("folder", click.Path(path_type=Path, exists=True, file_okay=False)),
    "either": ("file", click.Path(path_type=Path, exists=True)),
}


def _gate(format_: ExportFormat) -> click.Command:
    """The command that puts anybody's files before the gate of an export format."""
    doctor = format_.doctor
    argument, kind = _TAKES[doctor.takes]

    def check(budget: float, as_json: bool, **given: Any) -> None:
        from flows.run.bounds import RULE, findings_of

        findings: list[Finding] = []
        for check in [format_.check, *(format_.validator(name) for name, _ in doctor.validators if given[name])]:
            findings += findings_of(check, given[argument], budget, names_others=doctor.names_others)
            if any(finding.rule == RULE for finding in findings):  # a file takes its budget once, not again for each validator
                break
        _tell([str(f) for f in findings if f.is_error], [str(f) for f in findings if not f.is_error], as_json)

    made = budget_option(json_option(check))
    for name, text in reversed(doctor.validators):
        made = click.option(f"--{name}", is_flag=True, help=text)(made)
    made = click.argument(argument, type=kind)(made)
    example = f"Example: metascenes doctor {format_.name} {doctor.example}"
    return click.command(format_.name, help=f"{doctor.about}\n\n{example}")(made)


for _format in FORMATS:
    command.add_command(_gate(_format))


@command.command("lake")
@click.option("--quick", is_flag=True, help="Look at what is there; do not read and hash all contents.")
@snapshot_options
@lake_option
@json_option
def lake(quick: bool, snapshot_id: int | None, release: str | None, address: str, as_json: bool) -> None:
    """Check the lake: versions, data files, rows, keys, references, blobs, releases, and what lies about that nobody needs.

    Errors say that something is lost or wrong. Warnings say that something is left over. With --snapshot or --release,
    only that state is checked.

    Example: metascenes doctor lake --release v1 --lake ./lake
    """
    from flows.progress import Progress
    from warehouse.upkeep.inspection import inspect

    opened = existing_lake(address)
    chosen = chosen_snapshot(opened, snapshot_id, release)
    with Progress("checking", sum(1 for _ in opened.storage.walk("")) if sys.stderr.isatty() else 0) as progress:
        inspection = inspect(opened, chosen, release=release, quick=quick, advance=progress.advance)
    looked = f"{counted(inspection.snapshots, 'snapshot')}, {counted(inspection.files, 'data file')}, {counted(inspection.blobs, 'blob')}"
    if inspection.reclaimable_bytes and not as_json:
        print(f"`metascenes lake vacuum` would free {inspection.reclaimable_bytes / 1e6:.1f} MB of data files between snapshots")
    _tell([str(finding) for finding in inspection.errors], [str(finding) for finding in inspection.warnings], as_json, looked)


def _tell(errors: Sequence[str], warnings: Sequence[str], as_json: bool, what: str = "") -> None:
    if as_json:
        print(json.dumps({"errors": errors, "warnings": warnings}))
    else:
        for line in warnings:
            print(f"warning: {line}")
        for line in errors:
            print(f"wrong: {line}")
        print(f"{what + ': ' if what else ''}{counted(len(errors), 'error')}, {counted(len(warnings), 'warning')}")
    if errors:
        raise click.exceptions.Exit(1)
