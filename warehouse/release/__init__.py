"""Releases: named snapshots that are kept for good, each with a folder of plain Parquet that anybody can read."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

from schemas.errors import InputError
from schemas.releases import NAME_PATTERN, Release
from schemas.tables import TABLES
from warehouse.adoption import now_utc
from warehouse.documentation import quoted, tables_page
from warehouse.lake import Lake
from warehouse.released import RECORD, folder_of, record_fields, released
from warehouse.snapshot import Reader
from warehouse.storage import Storage, storage_at


def make_release(lake: Lake, name: str, snapshot_id: int | None = None, notes: str = "") -> Release:
    """Release a snapshot, the last one by default, under a name that is new.

    Raises:
        InputError: the name cannot be used or is taken, or there is no such snapshot.
    """
    if not re.fullmatch(NAME_PATTERN, name):
        raise InputError(lake.address, "release", f"{name!r} cannot be a name", "use letters, digits, and _ . -")
    reader = lake.snapshot(snapshot_id)
    if reader.snapshot is None:
        raise InputError(lake.address, "release", "the lake has no snapshot yet", "run something first")
    if any(release.name == name for release in releases(lake)):
        raise InputError(lake.address, "release", f"{name} is released already", "choose another name")
    release = Release(name=name, snapshot_id=reader.snapshot_id, created_at=now_utc(), notes=notes, code_version=_code(), **_counts(reader))
    with lake.leased():  # or a vacuum could take the snapshot away meanwhile
        write_tables(lake, reader.snapshot_id, lake.storage, folder_of(name))
        # Last, and only if nobody was faster: a folder without it is no release.
        if not lake.storage.create(f"{folder_of(name)}/{RECORD}", json.dumps(record_fields(release), indent=1).encode()):
            raise InputError(lake.address, "release", f"{name} is released already", "choose another name")
    return release


def releases(lake: Lake) -> list[Release]:
    """All releases, by name.

    Raises:
        InputError: a `release.json` cannot be read.
    """
    return released(lake.storage)


def snapshot_of(lake: Lake, name: str | None, snapshot_id: int | None = None) -> int | None:
    """The snapshot of a release, or the one given when none is named.

    Raises:
        InputError: there is no such release, or a snapshot is given beside it.
    """
    if name is None:
        return snapshot_id
    if snapshot_id is not None:
        raise InputError("--snapshot", "release", f"is given beside --release {name}, which is a snapshot", "give one of them")
    known = {release.name: release.snapshot_id for release in releases(lake)}
    if name not in known:
        raise InputError(lake.address, "release", f"no release {name!r}", f"there are: {', '.join(sorted(known)) or 'none'}")
    return known[name]


def export_tables(lake: Lake, folder: Path, snapshot_id: int | None = None) -> list[Path]:
    """Write a snapshot's tables into a local folder as plain Parquet, one file per table; the files."""
    target = storage_at(folder)
    return [folder / path for path in write_tables(lake, lake.snapshot(snapshot_id).snapshot_id, target, "")]


def write_tables(lake: Lake, snapshot_id: int, target: Storage, folder: str) -> list[str]:
    """Write a snapshot's tables and what their columns mean below a folder of `target`; the paths."""
    import pyarrow.parquet as pq

    reader = lake.snapshot(snapshot_id)
    paths = []
    for name in TABLES:
        sink = io.BytesIO()
        pq.write_table(reader.arrow(name), sink, compression="zstd")
        paths.append(f"{folder}/{name}.parquet".lstrip("/"))
        target.write(paths[-1], sink.getvalue())
    paths.append(f"{folder}/tables.md".lstrip("/"))
    target.write(paths[-1], tables_page().encode())
    return paths


def _counts(reader: Reader) -> dict[str, Any]:
    """How much a snapshot holds, as a release says it."""
    numbers = {
        "scenes": "count(*) FROM scenes",
        "rooms": "count(DISTINCT room_id) FROM scenes",
        "objects": "count(*) FROM instances WHERE NOT is_structure",
        "categories": "count(DISTINCT category) FROM instances WHERE NOT is_structure",
        "assets": "count(*) FROM assets",
        "placed_objects": "count(*) FROM placements",
        "episodes": "count(*) FROM episodes",
    }
    with reader.connect() as connection:
        found: dict[str, Any] = {name: connection.sql(f"SELECT {sql}").fetchall()[0][0] for name, sql in numbers.items()}
        rows = tuple(f"{name}={connection.sql(f'SELECT count(*) FROM {quoted(name)}').fetchall()[0][0]}" for name in TABLES)
    return found | {"row_counts": rows}


def _code() -> str:
    """Version of the project."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("metascenes")
    except PackageNotFoundError:
        return "unknown"
