"""`metascenes bench rooms`: the pipeline on generated rooms that are scanned badly."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Literal

import click

from flows.commands.bench.measurement import processes_option, run_measurement
from flows.commands.options import json_option, set_option


@click.command("rooms")
@click.option("--kind", type=click.Choice(["hard", "wild"]), default="hard", show_default=True, help="Kind of room.")
@click.option("--rooms", type=click.IntRange(0, 10_000), help="Rooms; every other one with frames.  [default: 30 hard, 20 wild]")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms and scans.")
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False), help="Where finished rooms are remembered: the same command goes on."
)
@click.option(
    "--realdata",
    type=click.Path(path_type=Path, file_okay=False),
    envvar="METASCENES_REALDATA",
    help="Folder with the AWS small house, its models and the synthetic living room: measured with hard rooms, models for wild ones.",
)
@set_option
@processes_option
@json_option
def rooms(
    kind: Literal["hard", "wild"],
    rooms: int | None,
    seed: int,
    folder: Path | None,
    realdata: Path | None,
    settings: tuple[str, ...],
    processes: int,
    as_json: bool,
) -> None:
    """Measure the pipeline on hard or wild rooms, scanned badly, from capture to optimization, held against the truth.

    Hard rooms are dwellings with 40 to 80 objects in several rooms, fitted kitchens, seats round tables, slopes and steps; a third of
    what could be seen is missing in their scans, segments are merged and split, labels misspelled. Scans by others stand next to them.

    Wild rooms fail as real scans do: sofas round a bend under cushions, walls of shelves, heaps of cloth, instruments, chairs tucked in,
    openings without a door, cut corners, labels that bleed over seams. Their furniture is of templates that candidates then leave out
    (`candidates.withheld`), and of models by others if --realdata has them.

    A free object that was left out, or fixed, counts as unstable, and so do all of a room in which a stage failed.
    One more room goes first and is not in the table: seconds are those of code that is compiled.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench rooms --rooms 2 --folder rooms
    """
    from bench.dwellings import ROOMS, DwellingsBench, run_dwellings_bench
    from bench.dwellings.tables import print_dwellings

    count = ROOMS[kind] if rooms is None else rooms
    if not (count or (realdata and kind == "hard")):
        raise click.UsageError("--rooms 0 without --realdata: nothing is left to measure; give one of them")
    config = DwellingsBench(count, seed, processes, folder, realdata, settings=settings, kind=kind)
    run_measurement("measured", config.steps, partial(run_dwellings_bench, config), print_dwellings, as_json)
