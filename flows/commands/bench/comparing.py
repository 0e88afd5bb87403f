"""Model files by others, compared with independent readers."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from flows.commands.bench.measurement import run_measurement
from flows.commands.options import json_option


@click.command("files")
@click.option(
    "--corpus",
    type=click.Path(path_type=Path),
    envvar="METASCENES_CORPUS",
    default=Path("../shared/corpus"),
    show_default=True,
    help="Folder with model files by others, at any depth.",
)
@click.option("--part", default="", help="Compare only files whose paths hold this text.")
@json_option
def files(corpus: Path, part: str, as_json: bool) -> None:
    """Compare readers with independent judges on model files by others: triangles, bounds and displayed mean color.

    Judges are assimp, three.js in a browser, and USD itself. A reader may agree, refuse a file, or note the feature that it does not
    read. Any other difference is silent.

    The exit code is 1 when a difference is silent, 2 when nothing could be compared, and else 0.

    Example: metascenes bench files --corpus corpus
    """
    from bench.files.report import FilesBench, run_files_bench
    from bench.files.tables import print_files

    config = FilesBench(corpus.resolve(), part)
    run_measurement("compared", len(config.files), partial(run_files_bench, config), print_files, as_json)
