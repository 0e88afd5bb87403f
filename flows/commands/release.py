"""`metascenes release`: versions of the lake that can be cited."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import existing_lake, json_option, lake_option
from schemas.parsing import json_value
from schemas.wording import noun

if TYPE_CHECKING:
    from warehouse.release.difference import Changes, Difference


@click.group("release", short_help="Make, list, compare and attach releases: versions that can be cited.")
def command() -> None:
    """Make, list, compare and attach releases: named versions of all tables that are kept for good.

    Example: metascenes release create v1 --notes "for the paper"
    """


@command.command("create")
@click.argument("name")
@click.option("--notes", default="", help="What it is released for; the data card begins with it.")
@click.option("--snapshot", "snapshot_id", type=int, help="Snapshot to release; the newest by default.")
@click.option("--dry-run", is_flag=True, help="Say what would be released; write nothing.")
@lake_option
@json_option
def create(name: str, notes: str, snapshot_id: int | None, dry_run: bool, address: str, as_json: bool) -> None:
    """Freeze a snapshot of all tables as release NAME: plain Parquet, data card, attribution, checksums, a DuckDB file.

    A release is never changed. One that was interrupted is no release; the same command makes it.

    Example: metascenes release create v1 --notes "for the paper" --lake ./lake
    """
    from flows.progress import Progress
    from schemas.tables import TABLES
    from warehouse.release import make_release, planned_release
    from warehouse.tables.released import folder_of, record_fields

    lake = existing_lake(address)
    folder = f"{lake.address}/{folder_of(name)}"
    if dry_run:
        snapshot, counts = planned_release(lake, name, snapshot_id, notes)
        totals = ", ".join(f"{count:,} {what.replace('_', ' ')}" for what, count in counts.items())
        print(json.dumps({"name": name, "snapshot_id": snapshot, "folder": folder, **counts}) if as_json else
              f"would release snapshot {snapshot} as {name} in {folder}: {totals}")  # fmt: skip
        return
    with Progress("tables", len(TABLES) - 1) as progress:
        release = make_release(lake, name, snapshot_id, notes, advance=progress.advance)
    if as_json:
        print(json.dumps(record_fields(release) | {"folder": folder}))
    else:
        print(
            f"released snapshot {release.snapshot_id} as {name}: {release.scenes:,} "
            f"{noun(release.scenes, 'scene')}, {release.objects:,} {noun(release.objects, 'object')}"
        )
        print(f"{folder}/README.md")


@command.command("list")
@lake_option
@json_option
def list_(address: str, as_json: bool) -> None:
    """List the releases of a lake, the oldest first.

    Example: metascenes release list --lake ./lake
    """
    from warehouse.release import releases
    from warehouse.tables.released import record_fields

    sorted_releases = sorted(releases(existing_lake(address)), key=lambda release: (release.created_at, release.name))
    if as_json:
        print(json.dumps({"releases": [record_fields(release) for release in sorted_releases]}))
    elif not sorted_releases:
        print("no release yet; `metascenes release create NAME` makes one")
    else:
        rows: list[tuple[str, ...]] = [("release", "snapshot", "released", "scenes", "objects", "episodes", "notes")]
        for row in sorted_releases:
            counts = [f"{number:,}" for number in (row.scenes, row.objects, row.episodes)]
            notes = " ".join(row.notes.split())
            rows.append((row.name, str(row.snapshot_id), f"{row.created_at:%Y-%m-%d %H:%M}", *counts, notes[:60]))
        _print_columns(rows, right=(1, 3, 4, 5))


@command.command("show")
@click.argument("name")
@lake_option
@json_option
def show(name: str, address: str, as_json: bool) -> None:
    """Print the data card of release NAME; with --json its record with all files.

    Example: metascenes release show v1 --lake ./lake
    """
    from warehouse.release import release_of
    from warehouse.release.hub import without_head
    from warehouse.tables.released import RECORD, folder_of

    lake = existing_lake(address)
    release_of(lake, name)
    data = lake.storage.read(f"{folder_of(name)}/{RECORD if as_json else 'README.md'}").decode()
    print(json.dumps(json_value(data)) if as_json else without_head(data), end="\n" if as_json else "")


@command.command("diff")
@click.argument("before")
@click.argument("after")
@click.option("--scenes", "every", is_flag=True, help="Name all scenes and objects, not only the first 20 of each kind.")
@lake_option
@json_option
def diff(before: str, after: str, every: bool, address: str, as_json: bool) -> None:
    """Say what differs between two releases: rows by table, scenes and objects by name. Times and hosts do not count.

    BEFORE and AFTER are releases, numbers of snapshots, or `latest`.

    Example: metascenes release diff v1 latest --lake ./lake
    """
    from warehouse.release.difference import difference, named_snapshot

    lake = existing_lake(address)
    delta = difference(lake, named_snapshot(lake, before), named_snapshot(lake, after), None if every else 20)
    if as_json:
        print(json.dumps(dataclasses.asdict(delta)))
    else:
        _print_difference(delta, before, after)


@command.command("attach")
@click.argument("name")
@click.option("--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="DuckDB file to write.")
@click.option("--force", is_flag=True, help="Replace the file if it is there.")
@lake_option
def attach(name: str, out: Path, force: bool, address: str) -> None:
    """Write a DuckDB file of views over release NAME, or over a folder that one was copied to, for where that is now.

    Example: metascenes release attach ./copied/v1 --out v1.duckdb
    """
    from schemas.errors import InputError
    from warehouse.lake import Lake
    from warehouse.release.catalog import attach_release
    from warehouse.tables.released import RECORD

    if out.exists() and not force:
        raise InputError(str(out), "--out", "is there already", "name a new file, or give --force")
    lake = Lake.open(address) if Path(name, RECORD).is_file() else existing_lake(address)
    attach_release(lake, name, out)
    print(f"ATTACH '{out}' AS r (READ_ONLY);")


def _print_difference(delta: Difference, before: str, after: str) -> None:
    """A difference as text."""
    print(f"from {before} (snapshot {delta.before}) to {after} (snapshot {delta.after})")
    changed = [table for table in delta.tables if table.added or table.changed or table.removed]
    if not changed:
        print("no row differs")
        return
    rows = [("table", "added", "changed", "removed")]
    rows += [(table.table, f"{table.added:,}", f"{table.changed:,}", f"{table.removed:,}") for table in changed]
    _print_columns(rows, right=(1, 2, 3))
    for what, changes in (("scenes", delta.scenes), ("objects", delta.objects)):
        _print_changes(what, changes)


def _print_changes(what: str, changes: Changes) -> None:
    for kind in ("added", "changed", "removed"):
        names: Any = getattr(changes, kind)
        if names.count:
            shown = f", the first {len(names.names)}" if len(names.names) < names.count else ""
            print(f"{what} {kind}: {names.count:,}{shown}")
            for name in names.names:
                print(f"  {name}")


def _print_columns(rows: Sequence[tuple[str, ...]], right: tuple[int, ...]) -> None:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        cells = [cell.rjust(width) if i in right else cell.ljust(width) for i, (cell, width) in enumerate(zip(row, widths, strict=True))]
        print("  ".join(cells).rstrip())
