"""`metascenes view`: scenes in the browser."""

from __future__ import annotations

import contextlib
import json
import threading
from pathlib import Path

import click

from flows.commands.options import chosen_snapshot, existing_lake, json_option, lake_option, listening_options, snapshot_options


@click.command("view", short_help="Show scenes in the browser: scan, replica, and all that is known of each object.")
@click.argument("place", metavar="[SCENE[/OBJECT]]", required=False)
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.html",
    help="Write one scene as a file that opens without a server, instead of serving the lake.",
)  # fmt: skip
@click.option(
    "--rerun", "recording", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.rrd",
    help="Write one scene as a recording for the Rerun viewer, instead of serving the lake.",
)  # fmt: skip
@click.option("--browser/--no-browser", default=True, help="Open the page in a browser, where there is a screen.")
@listening_options
@snapshot_options
@lake_option
@json_option
def command(
    place: str | None,
    out: Path | None,
    recording: Path | None,
    browser: bool,
    host: str,
    port: int,
    snapshot_id: int | None,
    release: str | None,
    address: str,
    as_json: bool,
) -> None:
    """Show the scenes of a lake in the browser, SCENE first, with OBJECT of it selected: the scan beside its replica, what is known
    of each object, its candidates in place, what touches, how it settles, where an agent goes.

    Prints an address with a token, which lets in whoever has it, and serves until it is interrupted.

    Example: metascenes view demo/scene0000_00 --lake demo/lake
    """
    from flows.view.application import application, scene_routes
    from flows.view.bundle import client_file
    from flows.view.scene import Scenes
    from flows.view.serving import serve

    if out is not None and recording is not None:
        raise click.UsageError("--out and --rerun write one file each: give one of them")
    if recording is None:
        client_file("view.html")  # before anything is read: it may not have been built
    lake = existing_lake(address)
    scenes = Scenes(lake, chosen_snapshot(lake, snapshot_id, release), release=release)
    first, instance = scenes.place(place) if place else (scenes.first(), None)
    file = out or recording
    if file is not None:
        if instance is not None:
            raise click.UsageError(f"--{'out' if out else 'rerun'} writes a whole scene: leave /{instance} away")
        from flows.view.recording import write_recording
        from flows.view.standalone import write_page

        size = write_page(scenes, first, file) if out else write_recording(scenes, first, file)
        words = json.dumps({"file": str(file), "scene_id": first, "snapshot_id": scenes.reader.snapshot_id, "bytes": size})
        click.echo(words if as_json else f"{file} ({size / 1e6:.1f} MB)")
        return

    def prepare() -> None:
        with contextlib.suppress(Exception):  # the page will say it
            scenes.shown(first)

    def announce(page: str) -> None:
        # ready before the browser is; waited for at the end, since native code must not run on while the process ends
        threading.Thread(target=prepare).start()
        words = json.dumps({"address": page, "scene_id": first, "snapshot_id": scenes.reader.snapshot_id})
        click.echo(words if as_json else f"{page}\nthe token lets in whoever has it; Ctrl-C ends")

    serve(application([scene_routes(scenes)]), host, port, announce, browser and not as_json, place or "")
