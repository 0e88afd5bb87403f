"""`metascenes export`: files for simulators, in a folder."""

from __future__ import annotations

import json
from pathlib import Path

import click

from flows.commands.options import chosen_snapshot, existing_lake, json_option, lake_option, snapshot_options, workers_option
from schemas.exports import FORMATS


@click.command("export", short_help="Write scenes as USD, Habitat dataset, MJCF, URDF and GLB into a folder.")
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder to write into.")
@click.option("--format", "formats", multiple=True, type=click.Choice(FORMATS), help="Format; all by default; may be repeated.")
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
    """Write scenes as USD, as a Habitat dataset, as MJCF, URDF and GLB into a folder, and check what was written.

    With --release, every USD scene says which release it is from.

    With --license-allow, scenes whose scan has another license are left out, and so are objects whose asset has: their
    scenes are made again without them and checked again. What has no known license passes only where `unknown` is
    allowed. What was left out is printed, and written to LEFT_OUT.md beside ATTRIBUTION.md in every format's folder.

    Exit code 1 says that a check did not pass; each is named.

    Example: metascenes export --lake ./lake --out ./replicas --release v1 --license-allow CC0-1.0 --license-allow MIT-0
    """
    from flows.export import write_exports
    from flows.shipment import shipment, summary
    from schemas.exports import ExportFile
    from warehouse.licenses import Allowed

    lake = existing_lake(address)
    chosen = formats or FORMATS
    allowed = Allowed.parse(licenses) if licenses else None
    if dry_run:
        reader = lake.snapshot(chosen_snapshot(lake, snapshot_id, release))
        rows = [row for row in reader.rows(ExportFile) if row.format in chosen and (not scenes or row.scene_id in scenes)]
        sent = shipment(reader, sorted({row.scene_id for row in rows}), allowed) if allowed is not None else None
        count = sum(sent is None or row.scene_id in sent.scenes for row in rows)
        if as_json:
            print(json.dumps({"files": count} | ({"left_out": sent.told()} if sent is not None else {})))
            return
        print(f"{'at most ' if sent is not None and sent.kept else ''}{count} files would be written below {out}")
        for line in summary(sent) if sent is not None else ():
            print(line)
        return
    written = write_exports(lake, out, chosen, scenes, snapshot_id, release=release, usdz=usdz, allowed=allowed, workers=workers)
    if as_json:
        packages = [str(path) for path in written.usd_packages]
        scenes_written = [str(path) for path in written.usd_scenes]
        said = {"files": written.files, "usd_scenes": scenes_written, "usd_packages": packages, "findings": written.findings}
        print(json.dumps(said | ({"left_out": written.shipment.told()} if written.shipment is not None else {})))
    else:
        print(f"{written.files} files below {out}; {written.failed_checks} checks failed")
        for scene in (*written.usd_scenes, *written.usd_packages):
            print(scene)
        for line in summary(written.shipment) if written.shipment is not None else ():
            print(line)
    for line in written.findings:
        click.echo(f"failed: {line}", err=True)
    if written.findings:
        raise click.exceptions.Exit(1)
