"""Releases: named snapshots that are kept for good, each with a folder of plain Parquet that anybody can read."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from datetime import datetime
from pathlib import Path

from schemas.errors import InputError
from schemas.tables import TABLES
from warehouse.adoption import now_utc
from warehouse.documentation import tables_page
from warehouse.lake import Lake
from warehouse.storage import Storage, storage_at

FOLDER = "releases"
_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]*"


@dataclasses.dataclass(frozen=True)
class Release:
    """A named snapshot. `folder` is its folder of Parquet files, one per table, relative to the lake."""

    name: str
    snapshot_id: int
    created_at: datetime
    note: str

    @property
    def folder(self) -> str:
        """`releases/<name>`."""
        return f"{FOLDER}/{self.name}"


def make_release(lake: Lake, name: str, snapshot_id: int | None = None, note: str = "") -> Release:
    """Release a snapshot, the last one by default, under a name that is new.

    Raises:
        InputError: the name cannot be used or is taken, or there is no such snapshot.
    """
    if not re.fullmatch(_PATTERN, name):
        raise InputError(lake.address, "release", f"{name!r} cannot be a name", "use letters, digits, and _ . -")
    reader = lake.snapshot(snapshot_id)
    if reader.snapshot is None:
        raise InputError(lake.address, "release", "the lake has no snapshot yet", "run something first")
    if any(release.name == name for release in releases(lake)):
        raise InputError(lake.address, "release", f"{name} is released already", "choose another name")
    release = Release(name, reader.snapshot_id, now_utc(), note)
    with lake.leased():  # or a vacuum could take the snapshot away meanwhile
        write_tables(lake, reader.snapshot_id, lake.storage, release.folder)
        fields = dataclasses.asdict(release) | {"created_at": release.created_at.isoformat()}
        # Last, and only if nobody was faster: a folder without it is no release.
        if not lake.storage.create(f"{release.folder}/release.json", json.dumps(fields, indent=1).encode()):
            raise InputError(lake.address, "release", f"{name} is released already", "choose another name")
    return release


def releases(lake: Lake) -> list[Release]:
    """All releases, by name."""
    found = []
    for name in lake.storage.folders(FOLDER):
        try:
            fields = json.loads(lake.storage.read(f"{FOLDER}/{name}/release.json"))
        except FileNotFoundError:
            continue
        found.append(Release(fields["name"], fields["snapshot_id"], datetime.fromisoformat(fields["created_at"]), fields["note"]))
    return found


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
