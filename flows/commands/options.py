"""Options that several commands share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from schemas.families.scan_formats import SCAN_FORMATS

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from warehouse.lake import Lake

F = TypeVar("F", bound=Callable[..., Any])


def grouped(*options: Callable[[F], F]) -> Callable[[F], F]:
    """Several options as one decorator; `--help` lists them from the last to the first."""
    return lambda function: reduce(lambda made, option: option(made), options, function)


def _folders(_context: click.Context, _option: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Let the shell complete folders, which addresses are but for stores of objects."""
    from click.shell_completion import CompletionItem

    return [CompletionItem(incomplete, type="dir")]


lake_option = click.option(
    "--lake", "address", envvar="METASCENES_LAKE", show_envvar=True, default="lake", show_default=True, metavar="ADDRESS",
    help="Folder of the lake, or s3://bucket/prefix.", shell_complete=_folders,
)  # fmt: skip
"""`--lake ADDRESS`: a folder or s3://bucket/prefix; METASCENES_LAKE, else ./lake."""

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object, for scripts.")
"""`--json`: one JSON object on standard output instead of text."""

links_option = click.option(
    "--links-into", multiple=True, metavar="FOLDER", envvar="METASCENES_LINKS_INTO", type=click.Path(file_okay=False),
    help="Links out of --scans may lead into this folder, such as a store of DVC or git-annex; may be repeated.",
)  # fmt: skip
"""`--links-into FOLDER`, as `links_into`."""

scans_options = grouped(
    click.option("--dataset", help="Name of the dataset; by default what the format says."),
    click.option(
        "--format", "scan_format", type=click.Choice(["auto", *SCAN_FORMATS]), default="auto", show_default=True, help="Scan format."
    ),
    links_option,
    click.option(
        "--scans", required=True, metavar="ADDRESS", help="Folder of scans, one scan, or s3://bucket/prefix.", shell_complete=_folders
    ),
)
"""`--scans ADDRESS`, `--links-into`, `--format` (as `scan_format`), `--dataset`: where scans lie and how they are read."""

snapshot_options = grouped(
    click.option("--release", metavar="NAME", help="Release to read; see `metascenes release list`."),
    click.option("--snapshot", "snapshot_id", type=int, help="Snapshot to read; the newest by default."),
)
"""`--snapshot N` and `--release NAME`, as `snapshot_id` and `release`; `chosen_snapshot` says which snapshot is meant."""

listening_options = grouped(
    click.option("--port", type=click.IntRange(0, 65535), default=0, show_default="a free one", help="Port to listen at."),
    click.option(
        "--host", default="127.0.0.1", show_default=True, metavar="ADDRESS",
        help="Address to listen at; others than loopback let other machines ask, without encryption.",
    ),
)  # fmt: skip
"""`--host`, `--port`: where a server of pages listens."""

workers_option = click.option(
    "--workers", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default="one per core", help="Worker processes."
)
"""`--workers N`: worker processes."""

set_option = click.option(
    "--set", "settings", multiple=True, metavar="STAGE.FIELD=VALUE", help="One value of a stage's config; may be repeated."
)
"""`--set STAGE.FIELD=VALUE`, as `settings`."""

settings_options = grouped(
    set_option,
    click.option("--config", "config_file", type=click.Path(path_type=Path, dir_okay=False), help="TOML file with a table per stage."),
)
"""`--config` and `--set`, as `config_file` and `settings`."""

seed_option = click.option("--seed", type=int, help="Run seed, 0 by default; the same input and seed give the same result.")
"""`--seed N`."""


def _library(_context: click.Context, _option: click.Parameter, given: str | None) -> Path | None:
    from flows.run.libraries import given_library

    return None if given is None else given_library(given)


configuration_options = grouped(
    seed_option,
    click.option("--library", callback=_library, help="Library of the lake to take candidates from, else a folder."),
    settings_options,
)
"""`--config`, `--set`, `--library`, `--seed`: what the stages are told."""


def existing_lake(address: str) -> Lake:
    """The lake at an address, for commands that only read.

    Raises:
        InputError: there is none.
    """
    from warehouse.lake import Lake

    return Lake.existing(address, "--lake")


def chosen_snapshot(lake: Lake, snapshot_id: int | None, release: str | None) -> int | None:
    """The snapshot that `snapshot_options` name; None is the newest. That it exists is checked when it is read.

    Raises:
        InputError: there is no such release, or both are given.
    """
    from warehouse.release import snapshot_of

    return snapshot_of(lake, release, snapshot_id)


def end_with_failures(errors: Mapping[str, object], has_failed: bool) -> None:
    """A line on standard error for each scene that failed, by scene id, and exit code 1 where one did."""
    for scene_id, error in errors.items():
        print(f"{scene_id}: {error}", file=sys.stderr)
    if has_failed:
        raise click.exceptions.Exit(1)
