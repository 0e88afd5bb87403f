"""How well models of others, and what stands in for them, do their part, measured."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from flows.commands.bench.measurement import chosen_words, run_measurement
from flows.commands.options import json_option


@click.command("models")
@click.option("--scenes", type=click.IntRange(1, 10_000), default=20, show_default=True, help="Desks and shelves of each kind.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same objects and replies.")
@click.option(
    "--realdata", type=click.Path(path_type=Path, file_okay=False), envvar="METASCENES_REALDATA",
    help="Folder with real models, which are laid out, scanned and looked up.",
)  # fmt: skip
@click.option("--blender", default="", metavar="PROGRAM", help="Interpreter with bpy, or blender itself; without one xatlas stands alone.")
@click.option(
    "--parts",
    default="",
    help="Measure only these, with commas between: replies, lifting, withheld, textures, retrieval, devices; or trained.",
)
@json_option
def models(scenes: int, seed: int, realdata: Path | None, blender: str, parts: str, as_json: bool) -> None:
    """Measure what stands around models of others: replies, small objects, textures, retrieval, devices.

    `replies`: what is read of corrupted replies, and whether anything is that was not meant. `lifting`: objects on desks and shelves,
    found without a network, by views that agree on masks of which a tenth were split or merged, and by networks in whose place some stand
    that blur the truth. `withheld`: rooms that are scanned as people walk, whose files do not name what is small, and what is found where
    they name everything. `textures`: layouts by xatlas and by Blender's Smart UV, and colors baked from a scan's frames. `retrieval`:
    real models that were scanned, looked up among 400 others.
    `devices`: networks that see, with weights drawn at random: what they take of a graphics card at published shape, where there is one,
    and how far the processor is from it, or from its own double precision.
    `trained`, if asked for: a small network that parts small objects, trained on renders first, and the classical member on the same
    frames of desks and shelves, in the same rooms, and on real tables below --realdata whose objects were drawn by hand.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench models --parts replies,lifting --scenes 4
    """
    from bench.models.report import PARTS, USUAL, ModelsBench, run_models_bench
    from bench.models.tables import print_models

    config = ModelsBench(scenes, seed, realdata, blender, chosen_words(parts, PARTS, "--parts") if parts else USUAL)
    run_measurement("measured", config.advances, partial(run_models_bench, config), print_models, as_json)
