"""`metascenes explain`: what something was made from."""

from __future__ import annotations

import json
from pathlib import Path

import click

from flows.commands.options import chosen_snapshot, existing_lake, json_option, lake_option, snapshot_options


@click.command("explain", short_help="Say what an object, a scene, an asset, a model or a file was made from.")
@click.argument("asked", metavar="WHAT")
@click.option(
    "--picture", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE", help="Also draw the graph: FILE.svg or FILE.png."
)
@snapshot_options
@lake_option
@json_option
@click.pass_context
def command(
    context: click.Context, asked: str, picture: Path | None, snapshot_id: int | None, release: str | None, address: str, as_json: bool
) -> None:
    """Say what WHAT was made from, link by link, with the stage runs behind it. Every id on the way is followed.

    WHAT is an object (<scene>/<instance>), a scene, the hash of an asset or of a model, the name of a blob, the path of an exported
    file, or <path>:<name> of an object in one (in USD its prim path). The exit code is 1 when anything that is named is not
    there, or does not fit what names it.

    Example: metascenes explain scannet/scene0001_00/0007 --picture lineage.svg
    """
    from flows.outputs.explain import explain, settings_of
    from schemas.errors import InputError
    from schemas.files import write_whole
    from tasks.lineage.outline import outline
    from tasks.lineage.pictures import FORMATS, draw_lineage

    if picture is not None and picture.suffix.lower() not in FORMATS:
        raise InputError(str(picture), "--picture", f"{picture.suffix or 'no ending'} is no picture", f"give one of {', '.join(FORMATS)}")
    lake = existing_lake(address)
    lineage = explain(lake, asked, chosen_snapshot(lake, snapshot_id, release))
    print(json.dumps(lineage.document(), ensure_ascii=False, allow_nan=False) if as_json else outline(lineage, settings_of), end="")
    if as_json:
        print()
    if picture is not None:
        write_whole(picture, draw_lineage(lineage, picture.suffix.lower()))
        if not as_json:
            print(f"picture {picture}")
    context.exit(1 if lineage.problems else 0)
