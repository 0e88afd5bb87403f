"""How well instances of scans without labels, poses and storeys are found, measured."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from flows.commands.bench.measurement import chosen_words, run_measurement
from flows.commands.options import json_option


@click.command("capture")
@click.option("--frames", type=click.IntRange(1, 10_000), default=30, show_default=True, help="Generated frames of tables.")
@click.option("--walks", type=click.IntRange(1, 100), default=3, show_default=True, help="Films of generated rooms.")
@click.option("--walk-frames", type=click.IntRange(2, 5_000), default=300, show_default=True, help="Frames of each film.")
@click.option("--open3d", metavar="PYTHON", default="", help="An interpreter that has open3d; else this one.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same frames.")
@click.option(
    "--rooms",
    type=click.IntRange(1, 10_000),
    default=10,
    show_default=True,
    help="Generated rooms, scanned as bare meshes; and as many as frames.",
)
@click.option(
    "--realdata",
    type=click.Path(path_type=Path, file_okay=False),
    envvar="METASCENES_REALDATA",
    help="Folder with real frames and scans by others.",
)
@click.option("--houses", type=click.IntRange(1, 10_000), default=16, show_default=True, help="Generated houses of up to three storeys.")
@click.option("--parts", default="", help="Measure only these, with commas between: frames, meshes, rooms, poses, storeys.")
@json_option
def capture(
    frames: int, rooms: int, realdata: Path | None, walks: int, walk_frames: int, open3d: str, seed: int, houses: int, parts: str,
    as_json: bool,
) -> None:  # fmt: skip
    """Measure what is found in scans that name no instances.

    `frames`: single depth frames of generated tables, seen at 20 to 70 degrees, with things that touch, are stacked and lie in one another;
    and, with --realdata, real frames over which masks were drawn.
    `meshes`: hard rooms as bare meshes, their labels withheld, and a house that somebody drew, without its names (`--realdata`).
    `rooms`: hard rooms as posed frames, their labels and meshes withheld, by whether the floor is level and objects are instances.
    Beside these what the code before made of the same scans, which is taken out of the checkout's history; without history it is left out.
    Seconds are of a processor.

    `poses`: films of a slow walk through a room whose poses are withheld, or drift by 3 % of the way, and what `capture.poses` with Open3D
    (`make open3d`) makes of them: places of the camera, and the surface that the frames fuse to, beside that of true poses.

    `storeys`: houses of one to three generated dwellings above one another, halls with galleries among them, as they are seen on a walk,
    and every eighth of hard rooms: whether they are divided where they should be, and what of their surface is lost or on the wrong floor.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench capture --parts frames --frames 4
    """
    from bench.capture.report import PARTS, CaptureBench, run_capture_bench
    from bench.capture.tables import print_capture

    config = CaptureBench(
        frames=frames, rooms=rooms, realdata=realdata, walks=walks, walk_frames=walk_frames, open3d=open3d, seed=seed, houses=houses,
        parts=chosen_words(parts, PARTS, "--parts"),
    )  # fmt: skip
    run_measurement("measured", config.advances, partial(run_capture_bench, config), print_capture, as_json)
