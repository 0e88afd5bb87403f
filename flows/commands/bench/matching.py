"""How well assets are matched to scanned objects, measured: their poses, and the choice among ten."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import click

from flows.commands.bench.measurement import chosen_words, processes_option, run_measurement
from flows.commands.options import json_option


@click.command("alignment")
@click.option("--objects", type=click.IntRange(1, 100_000), default=240, show_default=True, help="Models of the generator, all categories.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same models, poses and scans.")
@click.option(
    "--realdata",
    type=click.Path(path_type=Path, file_okay=False),
    envvar="METASCENES_REALDATA",
    help="Folder with models by others, which are measured, too.",
)
@processes_option
@json_option
def alignment(objects: int, seed: int, realdata: Path | None, processes: int, as_json: bool) -> None:
    """Measure the alignment: every method on objects in known poses, seen from one side with a depth sensor's noise.

    Yaws are right modulo turns after which an object is the same, as far as a scan could tell. Milliseconds are processor time.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench alignment --objects 20
    """
    from bench.alignment.report import AlignmentBench, run_alignment_bench
    from bench.alignment.tables import print_alignment

    config = AlignmentBench(objects, seed, processes, realdata)
    run_measurement("aligned", config.steps, partial(run_alignment_bench, config), print_alignment, as_json)


@click.command("selection")
@click.option("--rooms", type=click.IntRange(1, 10_000), default=130, show_default=True, help="Generated rooms; a fifth is held out.")
@click.option("--seeds", type=click.IntRange(1, 100), default=3, show_default=True, help="Seeds of every training but ablations.")
@click.option("--steps", type=click.IntRange(0), default=0, help="Steps of every training; those of the system where left out.")
@click.option("--variants", default="", help="Train only these presets, with commas between; `none` trains nothing.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms and lineups.")
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("selection"),
    show_default=True,
    help="Where rooms, models and figures are kept: the same command goes on.",
)
@click.option(
    "--realdata",
    type=click.Path(path_type=Path, file_okay=False),
    envvar="METASCENES_REALDATA",
    help="Folder with the AWS small house and its models, which is measured, too.",
)
@click.option(
    "--method",
    "methods",
    multiple=True,
    metavar="PROVIDER",
    help="Measure this method, too, given as selection.provider takes it: by weights, an endpoint or a model. May be repeated.",
)
@processes_option
@json_option
def selection(rooms: int, seeds: int, steps: int, variants: str, seed: int, folder: Path, realdata: Path | None,
              methods: tuple[str, ...], processes: int, as_json: bool) -> None:  # fmt: skip
    """Measure asset selection where the scanned model is known: ten candidates for each object, of which nine are hard to tell from it.

    Rooms are generated, scanned and answered for by simulated annotators; models are trained on four fifths of them, and every method is
    measured on the others. A fifth of the generator's categories is never trained on. Intervals are over rooms, 95 %.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench selection --rooms 20 --seeds 1 --steps 200 --variants small
    """
    from bench.selection.report import SelectionBench, run_selection_bench
    from bench.selection.tables import print_selection

    known = SelectionBench(folder).variants
    chosen = () if variants.strip() == "none" else chosen_words(variants, known, "--variants")
    config = SelectionBench(folder, rooms, seeds, steps, seed, processes, chosen, realdata, tuple(_named_methods(methods)))
    run_measurement("measured", config.steps_of_progress, partial(run_selection_bench, config), print_selection, as_json)


def _named_methods(texts: Iterable[str]) -> Iterator[Any]:
    """Settings of methods that need something from elsewhere, or a model that is there, each once."""
    from bench.selection.report import ELSEWHERE, TAUGHT
    from flows.run.configuration import configure
    from schemas.errors import InputError
    from tasks.selection.methods.members import method_of

    methods: dict[str, Any] = {}
    for text in texts:
        try:
            method = configure(settings=[f"selection.provider={text}"]).stages["selection"].provider
        except InputError as error:
            raise InputError("--method", error.field, error.problem, error.remedy) from error
        if method.kind not in (*ELSEWHERE, TAUGHT) or method.kind in methods:
            problem = "is named twice" if method.kind in methods else f"is none of {', '.join((*ELSEWHERE, TAUGHT))}"
            raise click.BadParameter(f"{method.kind} {problem}", param_hint="--method")
        methods[method.kind] = method
    for method in methods.values():  # hours before it is asked
        if (check := method_of(method).check) is not None:
            check(method)
        yield method
