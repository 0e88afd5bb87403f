"""Options that several commands share."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from schemas.families.scan_formats import SCAN_FORMATS

if TYPE_CHECKING:
    from warehouse.lake import Lake

F = TypeVar("F", bound=Callable[..., Any])


def lake_option(function: F) -> F:
    """`--lake ADDRESS`: a folder or s3://bucket/prefix; METASCENES_LAKE, else ./lake."""
    return click.option(
        "--lake", "address", envvar="METASCENES_LAKE", default="lake", show_default=True, metavar="ADDRESS",
        help="Folder of the lake, or s3://bucket/prefix.",
    )(function)  # fmt: skip


def json_option(function: F) -> F:
    """`--json`: one JSON object on standard output instead of text."""
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object, for scripts.")(function)


def links_option(function: F) -> F:
    """`--links-into FOLDER`, as `links_into`."""
    return click.option(
        "--links-into", multiple=True, metavar="FOLDER", envvar="METASCENES_LINKS_INTO", type=click.Path(file_okay=False),
        help="Links out of --scans may lead into this folder, such as a store of DVC or git-annex; may be repeated.",
    )(function)  # fmt: skip


def scans_options(function: F) -> F:
    """`--scans ADDRESS`, `--links-into`, `--format` (as `scan_format`), `--dataset`: where scans lie and how they are read."""
    formats = click.Choice(["auto", *SCAN_FORMATS])
    for option in (
        click.option("--dataset", help="Name of the dataset; by default what the format says."),
        click.option("--format", "scan_format", type=formats, default="auto", show_default=True, help="Scan format."),
        links_option,
        click.option("--scans", required=True, metavar="ADDRESS", help="Folder of scans, one scan, or s3://bucket/prefix."),
    ):
        function = option(function)
    return function


def snapshot_options(function: F) -> F:
    """`--snapshot N` and `--release NAME`, as `snapshot_id` and `release`; `chosen_snapshot` says which snapshot is meant."""
    for option in (
        click.option("--release", metavar="NAME", help="Release to read; see `metascenes release list`."),
        click.option("--snapshot", "snapshot_id", type=int, help="Snapshot to read; the newest by default."),
    ):
        function = option(function)
    return function


def workers_option(function: F) -> F:
    """`--workers N`: worker processes."""
    return click.option(
        "--workers", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default="one per core", help="Worker processes."
    )(function)


def configuration_options(function: F) -> F:
    """`--config`, `--set`, `--library`, `--seed`: what the stages are told."""
    for option in (
        click.option("--seed", type=int, help="Run seed, 0 by default; the same input and seed give the same result."),
        click.option("--library", type=click.Path(path_type=Path), help="Folder of GLB assets to retrieve candidates from."),
        click.option(
            "--set", "settings", multiple=True, metavar="STAGE.FIELD=VALUE", help="One value of a stage's config; may be repeated."
        ),
        click.option("--config", "config_file", type=click.Path(path_type=Path, dir_okay=False), help="TOML file with a table per stage."),
    ):
        function = option(function)
    return function


def existing_lake(address: str) -> Lake:
    """The lake at an address, for commands that only read.

    Raises:
        InputError: there is none; a mistyped address must not look like an empty lake.
    """
    from schemas.errors import InputError
    from warehouse.lake import Lake

    lake = Lake.open(address)
    if not lake.exists:
        raise InputError(address, "--lake", "there is no lake", "name its folder; `metascenes run` makes one")
    return lake


def chosen_snapshot(lake: Lake, snapshot_id: int | None, release: str | None) -> int | None:
    """The snapshot that `snapshot_options` name; None is the newest. That it exists is checked when it is read.

    Raises:
        InputError: there is no such release, or both are given.
    """
    from warehouse.release import snapshot_of

    return snapshot_of(lake, release, snapshot_id)
