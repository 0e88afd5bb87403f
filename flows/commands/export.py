"""`metascenes export`: files for simulators, in a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flows.commands.options import chosen_snapshot, existing_lake, json_option, lake_option, snapshot_options, workers_option
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.wording import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warehouse.lake import Lake
    from warehouse.release.licenses import Allowed
    from warehouse.tables.snapshot import Reader


@click.command("export", short_help="Write scenes as USD, Habitat dataset, MJCF, URDF, SDF, GLB and maps into a folder.")
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder to write into.")
@click.option(
    "--format",
    "formats",
    multiple=True,
    type=click.Choice(EXPORT_FORMATS),
    help="Format; all that the lake has by default; may be repeated.",
)
@click.option("--scene", "scenes", multiple=True, metavar="SCENE_ID", help="Scene; all by default; may be repeated.")
@snapshot_options
@click.option(
    "--license-allow",
    "--licence-allow",
    "licenses",
    multiple=True,
    metavar="LICENSE",
    help="Leave out what has another license: CC0-1.0, 'CC-BY-*' (any version), several with commas, @FILE, unknown; may be repeated.",
)
@click.option("--usdz", is_flag=True, help="Also pack every USD scene into one .usdz file, beside its folder.")
@click.option("--dry-run", is_flag=True, help="Say how many files would be written; write nothing.")
@workers_option
@lake_option
@json_option
def command(
    out: Path, formats: tuple[str, ...], scenes: tuple[str, ...], snapshot_id: int | None, release: str | None,
    licenses: tuple[str, ...], usdz: bool, dry_run: bool, workers: int, address: str, as_json: bool,
) -> None:  # fmt: skip
    """Write scenes as USD, as a Habitat dataset, as MJCF, URDF, SDF, GLB and maps into a folder, and check what was written.

    With --release, every USD scene says which release it is from.

    With --license-allow, scenes whose scan has another license are left out, and so are objects whose asset has: their
    scenes are made again without them and checked again. What has no known license passes only where `unknown` is
    allowed. What was left out is printed, and written to LEFT_OUT.md beside ATTRIBUTION.md in every format's folder.

    Exit code 1 says that a check did not pass, or that the allowed licenses leave nothing of a format; each is named. A format
    or a scene that is named and not in the lake is misuse: nothing is written.

    Example: metascenes export --lake ./lake --out ./replicas --release v1 --license-allow CC0-1.0 --license-allow MIT-0
    """
    from flows.outputs.export import write_exports
    from flows.outputs.shipment import left_out_lines
    from warehouse.release.licenses import Allowed

    lake = existing_lake(address)
    allowed = Allowed.parse(licenses) if licenses else None
    if dry_run:
        _plan(lake, lake.snapshot(chosen_snapshot(lake, snapshot_id, release)), out, formats, scenes, allowed, as_json)
        return
    written = write_exports(lake, out, formats, scenes, snapshot_id, release=release, usdz=usdz, allowed=allowed, workers=workers)
    if as_json:
        packages = [str(path) for path in written.usd_packages]
        scenes_written = [str(path) for path in written.usd_scenes]
        answer = {"files": written.files, "usd_scenes": scenes_written, "usd_packages": packages, "findings": written.findings}
        answer |= {"notes": written.notes, "emptied": written.emptied}
        print(json.dumps(answer | ({"left_out": written.shipment.as_json()} if written.shipment is not None else {})))
    else:
        print(f"{counted(written.files, 'file')} below {out}; {counted(written.failed_checks, 'check')} failed")
        for scene in (*written.usd_scenes, *written.usd_packages):
            print(scene)
        for line in left_out_lines(written.shipment) if written.shipment is not None else ():
            print(line)
    _tell(() if as_json else written.notes, written.problems)


def _plan(
    lake: Lake, reader: Reader, out: Path, formats: tuple[str, ...], scenes: tuple[str, ...], allowed: Allowed | None, as_json: bool
) -> None:
    """Say what would be written."""
    from flows.outputs.export import chosen_exports
    from flows.outputs.shipment import left_out_lines, shipment

    chosen = chosen_exports(lake, reader, formats, scenes)
    sent = shipment(reader, sorted({row.scene_id for row in chosen.rows}), allowed) if allowed is not None else None
    rows = [row for row in chosen.rows if sent is None or row.scene_id in sent.scenes]
    emptied = [name for name in chosen.formats if name not in {row.format for row in rows}]
    if as_json:
        answer = {"files": len(rows), "notes": chosen.missing, "emptied": emptied}
        print(json.dumps(answer | ({"left_out": sent.as_json()} if sent is not None else {})))
    else:
        print(f"{'at most ' if sent is not None and sent.kept else ''}{counted(len(rows), 'file')} would be written below {out}")
        for line in left_out_lines(sent) if sent is not None else ():
            print(line)
    _tell(() if as_json else chosen.missing, [f"{name}: the allowed licenses leave nothing of it" for name in emptied])


SHOWN = 20
"""Notes that are printed; the others are counted."""


def _tell(notes: Sequence[str], problems: Sequence[str]) -> None:
    """Say on standard error what is not as was asked; where that is more than a note, end with exit code 1."""
    for line in notes[:SHOWN]:
        click.echo(f"note: {line}", err=True)
    if len(notes) > SHOWN:
        click.echo(f"note: and {len(notes) - SHOWN} more of this kind", err=True)
    for line in problems:
        click.echo(f"failed: {line}", err=True)
    if problems:
        raise click.exceptions.Exit(1)
