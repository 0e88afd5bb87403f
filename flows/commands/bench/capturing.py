"""How well instances of scans without labels are found, measured."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from flows.commands.bench.measurement import chosen_words, run_measurement
from flows.commands.options import json_option


@click.command("capture")
@click.option("--frames", type=click.IntRange(1, 10_000), default=30, show_default=True, help="Generated frames of tables.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same frames.")
@click.option(
    "--realdata", type=click.Path(path_type=Path, file_okay=False), envvar="METASCENES_REALDATA",
    help="Folder with the real frames over which masks were drawn.",
)  # fmt: skip
@click.option("--parts", default="", help="Measure only these, with commas between: frames.")
@json_option
def capture(frames: int, seed: int, realdata: Path | None, parts: str, as_json: bool) -> None:
    """Measure what is found in scans that name no instances.

    `frames`: single depth frames of generated tables, seen at 20 to 70 degrees, with things that touch, are stacked and lie in one another;
    and, with --realdata, real frames over which masks were drawn by hand. Beside it what the code before made of the same frames, which is
    taken out of the checkout's history; without history it is left out. Seconds are of a processor.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench capture --parts frames --frames 4
    """
    from bench.capture.report import PARTS, CaptureBench, run_capture_bench
    from bench.capture.tables import print_capture

    config = CaptureBench(frames, seed, realdata, chosen_words(parts, PARTS, "--parts"))
    run_measurement("measured", config.advances, partial(run_capture_bench, config), print_capture, as_json)
