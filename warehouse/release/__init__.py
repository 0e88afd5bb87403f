"""Releases: named snapshots that are kept for good, each with a folder that anybody can read.

`releases/<name>/` has the tables as plain Parquet (`<table>.parquet`), `tables.md` (what the columns mean), `README.md`
(the data card, with a head for the Hugging Face Hub), `ATTRIBUTION.md`, `croissant.json`, `<name>.duckdb` (views and macros over
the tables), `SHA256SUMS` and `release.json`. The last one is written last: a folder without it is no release.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from schemas.errors import InputError
from schemas.runs import RELEASE_PATTERN, Release
from warehouse.lake import Lake
from warehouse.questions.documentation import tables_page
from warehouse.release.attribution import attribution_of
from warehouse.release.card import ReleaseFile, cited, data_card
from warehouse.release.catalog import open_catalog, write_catalog
from warehouse.release.croissant import NAME, croissant
from warehouse.release.tables import settings, sha256_of, write_releases, write_tables
from warehouse.storage.refusals import named
from warehouse.tables.adoption import now_utc
from warehouse.tables.released import FOLDER, RECORD, folder_of, record_fields, released
from warehouse.tables.snapshot import Reader

__all__ = ["FOLDER", "SUMS", "Release", "make_release", "planned_release", "releases", "rewrite_release", "snapshot_of"]

SUMS = "SHA256SUMS"

_COUNTS = {
    "scenes": "count(*) FROM scenes",
    "rooms": "count(DISTINCT room_id) FROM scenes",
    "objects": "count(*) FROM instances WHERE NOT is_structure",
    "categories": "count(DISTINCT category) FROM instances WHERE NOT is_structure",
    "assets": "count(*) FROM assets",
    "placed_objects": "count(*) FROM placements",
    "episodes": "count(*) FROM episodes",
}


def make_release(
    lake: Lake, name: str, snapshot_id: int | None = None, notes: str = "", *, advance: Callable[[str], None] | None = None
) -> Release:
    """Release a snapshot, the last one by default, under a name that is new.

    The folder is made beside the lake's tables and put in its place at the end, under the lake's lease. `advance` is told
    each table that is written. The same snapshot gives the same bytes, but for times and the DuckDB file.

    Raises:
        InputError: the name cannot be used or is taken, there is no such snapshot, or it was removed meanwhile.
        LeaseError: another process holds the lake's lease.
    """
    import duckdb

    reader = _checked(lake, name, snapshot_id, notes)
    release = Release(
        name=name, snapshot_id=reader.snapshot_id, created_at=now_utc(), notes=notes, code_version=_code(), row_counts=(), erased_at=(),
        **dict.fromkeys(_COUNTS, 0),
    )  # fmt: skip
    with named(lake.storage), lake.storage.workplace() as folder:
        try:
            release = _build(lake, reader, release, folder, advance)
        except (OSError, duckdb.Error) as error:
            _check_kept(lake, reader, error)
            raise
        with lake.leased() as lease:
            _check_free(lake, name)
            _check_kept(lake, reader)
            _move_in(lake, name, folder, lease.check)
            # Only if nobody was faster.
            if not lake.storage.create(f"{folder_of(name)}/{RECORD}", (folder / RECORD).read_bytes()):
                raise _taken(lake, name)
    return release


def planned_release(lake: Lake, name: str, snapshot_id: int | None = None, notes: str = "") -> tuple[int, dict[str, Any]]:
    """What `make_release` would release: the snapshot, and the counts that the record would state. Writes nothing.

    Raises:
        InputError: as `make_release`.
    """
    reader = _checked(lake, name, snapshot_id, notes)
    with reader.connect() as connection:
        return reader.snapshot_id, _counted(connection)


def rewrite_release(lake: Lake, release: Release, check: Callable[[], None] = lambda: None) -> Release:
    """Make the folder of a release anew from its snapshot, counts included, after something was erased from that.

    For who holds the lake's lease; `check` raises when that is lost.
    """
    with named(lake.storage), lake.storage.workplace() as folder:
        made = _build(lake, lake.snapshot(release.snapshot_id), release, folder, None)
        _move_in(lake, release.name, folder, check)
        lake.storage.write(f"{folder_of(release.name)}/{RECORD}", (folder / RECORD).read_bytes())
    return made


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
    return release_of(lake, name).snapshot_id


def release_of(lake: Lake, name: str) -> Release:
    """The release of a name.

    Raises:
        InputError: there is none.
    """
    known = {release.name: release for release in releases(lake)}
    if name not in known:
        raise InputError(lake.address, "release", f"no release {name!r}", f"there are: {', '.join(sorted(known)) or 'none'}")
    return known[name]


def _checked(lake: Lake, name: str, snapshot_id: int | None, notes: str) -> Reader:
    """The snapshot to release under a name."""
    if not re.fullmatch(RELEASE_PATTERN, name) or len(name) > 100:
        raise InputError(lake.address, "release", f"{name!r} cannot be a name", "use up to 100 letters, digits, and _ . -")
    if name.isdigit() or name == "latest":
        raise InputError(lake.address, "release", f"{name!r} cannot be a name", "it would be taken for a snapshot; give it a letter")
    if re.search(r"[\x00-\x08\x0b-\x1f\x7f]", notes):
        raise InputError("--notes", "", "hold control characters", "write plain text")
    reader = lake.snapshot(snapshot_id)
    if reader.snapshot is None:
        raise InputError(lake.address, "release", "the lake has no snapshot yet", "run something first")
    _check_free(lake, name)
    return reader


def _check_free(lake: Lake, name: str) -> None:
    # Where file names ignore case, v1 and V1 are one folder.
    if any(release.name.lower() == name.lower() for release in releases(lake)):
        raise _taken(lake, name)


def _taken(lake: Lake, name: str) -> InputError:
    return InputError(lake.address, "release", f"{name} is released already", "choose another name")


def _check_kept(lake: Lake, reader: Reader, cause: Exception | None = None) -> None:
    # An erasure keeps the number of a snapshot and gives it other versions.
    if reader.snapshot not in lake.snapshot().snapshots:
        problem = f"snapshot {reader.snapshot_id} was removed or rewritten while it was released"
        raise InputError(lake.address, "release", problem, "release it again, or a newer one") from cause


def _build(lake: Lake, reader: Reader, release: Release, folder: Path, advance: Callable[[str], None] | None) -> Release:
    """Write all files of a release into `folder`, a local one; the release with its counts."""
    rows = write_tables(reader, folder, advance)
    other_releases = [other for other in reader.releases if other.name != release.name]
    rows["releases"] = len(other_releases) + 1
    write_releases([], folder)  # so that the views that ask for it can be made
    final, catalog = lake.storage.duckdb_path(folder_of(release.name)), folder / f"{release.name}.duckdb"
    write_catalog(catalog, release.name, final, folder)
    with open_catalog(catalog, release.name, folder, settings(folder)) as connection:
        counts = _counted(connection)
    release = dataclasses.replace(release, **counts, row_counts=tuple(f"{name}={count}" for name, count in sorted(rows.items())))
    write_releases([*other_releases, release], folder)
    (folder / "tables.md").write_text(tables_page(), encoding="utf-8")
    tables = [_described(folder / f"{name}.parquet", count) for name, count in sorted(rows.items())]
    with open_catalog(catalog, release.name, folder, settings(folder)) as connection:
        attribution = attribution_of(connection)
        card = data_card(release, connection, attribution, tables)
    (folder / "ATTRIBUTION.md").write_text(attribution.page(f"Attribution: release {release.name}"), encoding="utf-8")
    (folder / "README.md").write_text(card, encoding="utf-8")
    further = [_described(folder / name) for name in ("ATTRIBUTION.md", "README.md", "tables.md", catalog.name)]
    about = croissant(release, attribution, [*tables, *further], " ".join(cited(release, tables)))
    (folder / NAME).write_text(about, encoding="utf-8")
    _write_sums(folder, release, [*tables, *further, _described(folder / NAME)])
    return release


def _write_sums(folder: Path, release: Release, written: Sequence[ReleaseFile]) -> None:
    """`SHA256SUMS` of all files, and `release.json` with the same of these and of `SHA256SUMS`."""
    files = sorted(written, key=lambda file: file.path)
    (folder / SUMS).write_text("".join(f"{file.sha256}  {file.path}\n" for file in files), encoding="utf-8")
    listed = [dataclasses.asdict(file) for file in (*files, _described(folder / SUMS))]
    (folder / RECORD).write_text(json.dumps(record_fields(release) | {"files": listed}, indent=1) + "\n", encoding="utf-8")


def _described(file: Path, rows: int | None = None) -> ReleaseFile:
    return ReleaseFile(file.name, file.stat().st_size, sha256_of(file), rows)


def _move_in(lake: Lake, name: str, folder: Path, check: Callable[[], None]) -> None:
    """Put the files of a release in their place, all but its record; what else is there was left by who was interrupted."""
    place = folder_of(name)
    made = sorted(file.name for file in folder.iterdir() if file.is_file() and file.name != RECORD)
    for entry in lake.storage.entries(place):
        if entry.path.rpartition("/")[2] not in (*made, RECORD):
            check()
            lake.storage.remove(entry.path)
    for file in made:
        check()
        lake.storage.move_in(folder / file, f"{place}/{file}")
    check()


def _counted(connection: Any) -> dict[str, Any]:
    """How much there is, as a release says it."""
    return {name: connection.execute(f"SELECT {sql}").fetchall()[0][0] for name, sql in _COUNTS.items()}


def _code() -> str:
    """Version of the project."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("metascenes")
    except PackageNotFoundError:
        return "unknown"
