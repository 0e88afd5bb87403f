"""`metascenes export`: files for simulators, in a folder."""

from __future__ import annotations

import json
from pathlib import Path

import click

from flows.commands.options import chosen_snapshot, existing_lake, json_option, lake_option, snapshot_options
from schemas.exports import FORMATS


@click.command("export", short_help="Write scenes as USD, Habitat dataset, MJCF, URDF and GLB into a folder.")
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder to write into.")
@click.option("--format", "formats", multiple=True, type=click.Choice(FORMATS), help="Format; all by default; may be repeated.")
@click.option("--scene", "scenes", multiple=True, metavar="SCENE_ID", help="Scene; all by default; may be repeated.")
@snapshot_options
@click.option("--usdz", is_flag=True, help="Also pack every USD scene into one .usdz file, beside its folder.")
@click.option("--dry-run", is_flag=True, help="Say how many files would be written; write nothing.")
@lake_option
@json_option
def command(
    out: Path, formats: tuple[str, ...], scenes: tuple[str, ...], snapshot_id: int | None, release: str | None, usdz: bool,
    dry_run: bool, address: str, as_json: bool,
) -> None:  # fmt: skip
    """Write scenes as USD, as a Habitat dataset, as MJCF, URDF and GLB into a folder, and check what was written.

    With --release, every USD scene says which release it is from.

    Exit code 1 says that a check did not pass; each is named.

    Example: metascenes export --lake ./lake --out ./replicas --format usd
    """
    from flows.export import write_exports
    from schemas.exports import ExportFile

    lake = existing_lake(address)
    chosen = formats or FORMATS
    if dry_run:
        rows = lake.snapshot(chosen_snapshot(lake, snapshot_id, release)).rows(ExportFile)
        count = sum(row.format in chosen and (not scenes or row.scene_id in scenes) for row in rows)
        print(json.dumps({"files": count}) if as_json else f"{count} files would be written below {out}")
        return
    written = write_exports(lake, out, chosen, scenes, snapshot_id, release=release, usdz=usdz)
    if as_json:
        packages = [str(path) for path in written.usd_packages]
        scenes_written = [str(path) for path in written.usd_scenes]
        print(json.dumps({"files": written.files, "usd_scenes": scenes_written, "usd_packages": packages, "findings": written.findings}))
    else:
        print(f"{written.files} files below {out}; {written.failed_checks} checks failed")
        for scene in (*written.usd_scenes, *written.usd_packages):
            print(scene)
    for line in written.findings:
        click.echo(f"failed: {line}", err=True)
    if written.findings:
        raise click.exceptions.Exit(1)
