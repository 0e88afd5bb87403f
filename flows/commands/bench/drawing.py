"""How good learned synthesis is, measured: layouts that models draw, against rooms by rules that are stated."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from flows.commands.bench.measurement import chosen_words, processes_option, run_measurement
from flows.commands.options import json_option


@click.command("synthesis")
@click.option("--rooms", type=click.IntRange(10, 100_000), default=3000, show_default=True, help="Generated rooms; a fifth is held out.")
@click.option("--seeds", type=click.IntRange(1, 100), default=3, show_default=True, help="Seeds of every training.")
@click.option("--steps", type=click.IntRange(0), default=0, help="Steps of every training; those of the system where left out.")
@click.option("--models", default="", help="Train only these, with commas between: atiss, diffuscene, physcene; `none` trains nothing.")
@click.option("--scenes", type=click.IntRange(10, 100_000), default=1000, show_default=True, help="Held-out layouts that figures are of.")
@click.option("--per-room", type=click.IntRange(2, 100_000), default=1000, show_default=True, help="Layouts of one table per kind of room.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms and layouts.")
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("synthesis"),
    show_default=True,
    help="Where models, figures and pictures are kept: the same command goes on.",
)
@click.option(
    "--realdata",
    type=click.Path(path_type=Path, file_okay=False),
    envvar="METASCENES_REALDATA",
    help="Folder with the AWS small house, which is measured, too.",
)
@click.option(
    "--inception",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="TorchScript file of a feature network for KID and FID; without, figures are of an own one, and not comparable.",
)
@click.option("--parts", default="", help="Measure only these, with commas between: layouts, scenes.")
@click.option("--made", type=click.IntRange(1, 10_000), default=100, show_default=True, help="Scenes made of layouts, up to exports.")
@processes_option
@json_option
def synthesis(rooms: int, seeds: int, steps: int, models: str, scenes: int, per_room: int, seed: int, folder: Path, realdata: Path | None,
              inception: Path | None, parts: str, made: int, processes: int, as_json: bool) -> None:  # fmt: skip
    """Measure learned synthesis: layouts of tops that models draw, held against rooms whose rules are stated.

    Rooms are generated, models are trained on four fifths of them, and draw on the large objects of others. Beside them stand the rules
    themselves, independent draws, and the nearest layout that was learned from. Scenes are made of some layouts and put through all
    stages, to the exports.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench synthesis --rooms 300 --seeds 1 --steps 1000 --models physcene
    """
    from bench.synthesis.report import PARTS, SynthesisBench, run_synthesis_bench
    from bench.synthesis.tables import print_synthesis
    from bench.synthesis.trainings import PRESETS

    chosen = () if models.strip() == "none" else chosen_words(models, PRESETS, "--models")
    config = SynthesisBench(
        folder.resolve(), rooms, seeds, steps, chosen, scenes, per_room, seed, processes, realdata, inception,
        chosen_words(parts, PARTS, "--parts"), made,
    )  # fmt: skip
    run_measurement("measured", config.advances, partial(run_synthesis_bench, config), print_synthesis, as_json)
