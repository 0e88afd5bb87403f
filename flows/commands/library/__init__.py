"""`metascenes library`: folders of models that candidates are taken from, indexed into the lake."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flows.commands.options import existing_lake, json_option, lake_option, settings_options
from schemas.text import shown
from schemas.wording import counted

if TYPE_CHECKING:
    from flows.library.adding import LibraryContents
    from schemas.indexing import LibraryModel

FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
FILE = click.Path(path_type=Path, exists=True, dir_okay=False)


@click.group("library", short_help="Index, list and remove libraries of models that candidates are taken from.")
def command() -> None:
    """Libraries: folders of models in GLB, OBJ and USD that are indexed into the lake, so that runs take candidates from them.

    Example: metascenes library add ./assets --lake ./lake
    """


@command.command("add")
@click.argument("folder", type=FOLDER)
@click.option("--name", default="", metavar="NAME", help="What the library is called; the folder's name by default.")
@click.option(
    "--metadata", multiple=True, type=FILE,
    help="What is known of the models: a list as index.json, Objaverse's annotations and LVIS categories, ABO's 3dmodels.csv and listings; "
    "may be repeated.",
)  # fmt: skip
@click.option("--weights", type=FOLDER, help="Folder of a CLIP or SigLIP: models get vectors of their pictures and words.")
@click.option(
    "--processes", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default="one per core", help="Processes that index."
)
@settings_options
@click.option("--dry-run", is_flag=True, help="Say what is new; index nothing.")
@lake_option
@json_option
def add(folder: Path, name: str, metadata: tuple[Path, ...], weights: Path | None, processes: int, config_file: Path | None,
        settings: tuple[str, ...], dry_run: bool, address: str, as_json: bool) -> None:  # fmt: skip
    """Index a folder of models into the lake, in one commit.

    Every model is read, refused with a reason or brought to metres, +Z up, and described; the lake keeps all that a run needs of it, so
    the folder may go. Files are remembered by content on this machine: an indexing that was killed goes on, and the same folder again
    takes in what changed. Settings are those of the stage `indexing`, as in --set indexing.views=12.

    Example: metascenes library add ./objaverse --metadata ./annotations.json.gz --lake ./lake
    """
    from flows.library.adding import add_library, planned_library
    from flows.run.configuration import configure
    from flows.training.progress import StepBar
    from warehouse.lake import Lake

    config = configure(config_file, settings).stages["indexing"]
    config = dataclasses.replace(config, weights=str(weights)) if weights is not None else config
    lake = Lake.open(address)
    planned = planned_library(lake, folder, name, metadata, config, processes)
    if dry_run:
        facts = {"library": planned.name, "state": planned.why or "unchanged"}
        print(json.dumps(facts) if as_json else f"{planned.name}: {planned.why or 'unchanged, nothing to do'}")
        return
    with StepBar(f"library {planned.name}", "files") as bar:
        contents = add_library(lake, planned, bar.report)
    if as_json:
        print(json.dumps({"state": planned.why or "unchanged", **_plain(contents)}))
        return
    for line in (*_refusals(contents), *(f"note: {note}" for note in contents.library.notes)):
        print(shown(line), file=sys.stderr)
    for model in contents.models:
        if model.duplicate_of is not None:
            print(shown(f"{model.file}: the same {model.duplicate_by} as {model.duplicate_of}"))
    print(f"library {planned.name}: {_counts(contents)}{'' if planned.why else '; unchanged'}")


@command.command("list")
@click.argument("name", metavar="[NAME]", required=False)
@click.option("--pictures", type=click.Path(path_type=Path, dir_okay=False), help="File for a contact sheet: .png or .html.")
@lake_option
@json_option
def list_(name: str | None, pictures: Path | None, address: str, as_json: bool) -> None:
    """List the libraries of the lake; of one that is named, its models.

    Example: metascenes library list assets --pictures ./assets.html --lake ./lake
    """
    from flows.library.adding import contents_of, listed_libraries
    from flows.library.sheets import write_sheet

    lake = existing_lake(address)
    reader = lake.snapshot()
    names = [name] if name else [row.library for row in listed_libraries(reader)]
    contents = [contents_of(reader, each) for each in names]
    if pictures is not None:
        write_sheet(pictures, [model for each in contents for model in each.models], lake.blobs)
    if as_json:
        print(json.dumps({"libraries": [_plain(each) if name else dataclasses.asdict(each.library) for each in contents]}))
    elif name:
        _print_models(contents[0])
    elif contents:
        _print_columns([("library", "models", "duplicates", "refused", "vectors", "licenses"), *map(_library_line, contents)])
    else:
        print("no library yet; `metascenes library add` makes one")


@command.command("remove")
@click.argument("name", metavar="NAME")
@click.option("--dry-run", is_flag=True, help="Say what would be removed; remove nothing.")
@lake_option
@json_option
def remove(name: str, dry_run: bool, address: str, as_json: bool) -> None:
    """Take a library out of the lake. Candidates that were taken from it stay, and so do their assets.

    The next vacuum removes the other files that nothing names any more.

    Example: metascenes library remove assets --lake ./lake
    """
    from flows.library.adding import remove_library

    row = remove_library(existing_lake(address), name, dry_run)
    state = "would be removed" if dry_run else "removed"
    print(
        json.dumps({"state": state, **dataclasses.asdict(row)})
        if as_json
        else f"library {name}: {counted(row.model_count, 'model')} {state}"
    )


def _plain(contents: LibraryContents) -> dict[str, object]:
    """A library as JSON."""
    return {
        **dataclasses.asdict(contents.library),
        "models": [dataclasses.asdict(row) for row in contents.models],
        "refused": [dataclasses.asdict(row) for row in contents.refused],
    }


def _refusals(contents: LibraryContents) -> list[str]:
    """Refused files, a line each."""
    return [f"{row.file}: refused: {row.field}: {row.reason}" for row in contents.refused]


def _counts(contents: LibraryContents) -> str:
    row = contents.library
    return f"{counted(row.model_count, 'model')}, {row.duplicate_count} of them duplicates, {counted(row.refused_count, 'file')} refused"


def _library_line(contents: LibraryContents) -> tuple[str, ...]:
    row = contents.library
    numbers = (str(row.model_count), str(row.duplicate_count), str(row.refused_count))
    return (row.library, *numbers, (row.weights or "")[:12], _licenses(contents.models))


def _licenses(models: Sequence[LibraryModel]) -> str:
    """Licenses with how many models have them, the most frequent first."""
    counts = Counter(model.license for model in models)
    listed = [f"{license_} {count}" for license_, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))]
    return ", ".join([*listed[:MOST_SHOWN], *([f"{len(listed) - MOST_SHOWN} more"] if len(listed) > MOST_SHOWN else [])])


MOST_SHOWN = 4
"""Licenses of a line; `library list --json` has all."""


def _print_models(contents: LibraryContents) -> None:
    rows: list[tuple[str, ...]] = [("file", "category", "size in m", "license", "what is odd")]
    for model in contents.models:
        size = " x ".join(f"{side:.2f}" for side in model.extents)
        odd = [f"the same {model.duplicate_by} as {model.duplicate_of}"] if model.duplicate_of is not None else []
        rows.append((model.file, model.category, size, model.license, "; ".join([*odd, *model.notes])))
    _print_columns(rows)
    for line in (*_refusals(contents), _counts(contents)):
        print(shown(line))


def _print_columns(rows: Sequence[tuple[str, ...]]) -> None:
    cells = [[shown(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
