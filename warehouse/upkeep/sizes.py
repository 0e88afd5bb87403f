"""How large a lake is and what of it is of use: tables, blobs by the columns that name them, and all else, to the last file."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import pyarrow as pa

from schemas.record import Table
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.questions.quoting import quoted
from warehouse.storage.blobs import FOLDER as BLOB_FOLDER
from warehouse.storage.files import Entry, Storage
from warehouse.tables.commit import versions_of
from warehouse.tables.datafiles import files_of
from warehouse.tables.delta import FOLDER as TABLE_FOLDER
from warehouse.tables.snapshot import Reader
from warehouse.upkeep.references import columns_of, parquet, workspace

if TYPE_CHECKING:
    import duckdb

UNNAMED = "no row"
"""Part of the blobs that no row names: what is staged or recorded and not committed (in use), and what a vacuum removes."""


@dataclasses.dataclass(frozen=True)
class Held:
    """Files and their size together [B]."""

    files: int = 0
    bytes: int = 0

    def __add__(self, other: Held) -> Held:
        return Held(self.files + other.files, self.bytes + other.bytes)


@dataclasses.dataclass(frozen=True)
class Size:
    """What a part of a lake comes to.

    name: A table, `<table>.<column>` for the blobs that a column names, or a folder. rows: Of the newest snapshot; None for what is no
    table. live: What the newest snapshot is made of, or what is in use without one. older: What only older snapshots name. unnamed: What
    no snapshot names, for a vacuum to remove once it is old enough. log: The files that say which version of a table has which files.
    """

    name: str
    rows: int | None
    live: Held = Held()
    older: Held = Held()
    unnamed: Held = Held()
    log: Held = Held()

    @property
    def all(self) -> Held:
        """All files of it."""
        return self.live + self.older + self.unnamed + self.log


@dataclasses.dataclass(frozen=True)
class LakeSize:
    """Tables in the order of the catalog, blobs by column in that order, then the other folders. Every file is counted once."""

    snapshot_id: int
    tables: tuple[Size, ...]
    blobs: tuple[Size, ...]
    folders: tuple[Size, ...]

    @property
    def parts(self) -> tuple[Size, ...]:
        """All of them."""
        return (*self.tables, *self.blobs, *self.folders)

    def total(self, parts: Iterable[Size] | None = None) -> Size:
        """Some parts, or all, together. Rows are those of the tables among them."""
        chosen = self.parts if parts is None else tuple(parts)
        kinds = ("live", "older", "unnamed", "log")
        rows = sum(part.rows or 0 for part in chosen)
        return Size("", rows, **{kind: sum((getattr(part, kind) for part in chosen), Held()) for kind in kinds})


def measure(lake: Lake) -> LakeSize:
    """Measure a lake. Changes nothing; what others write meanwhile may count or not.

    A blob that several columns name counts for the first of them, in the order of the catalog, that names it in the newest snapshot, else
    at all.

    Raises:
        InputError: a data file that a snapshot names is missing or damaged.
    """
    reader = lake.snapshot()
    with workspace(lake.storage) as connection:
        connection.execute("CREATE TABLE naming (name VARCHAR, place INTEGER, is_live BOOLEAN)")
        columns = [(table, column) for table in TABLES.values() for column in table.blob_columns]
        rows = _rows(reader)
        there = lake.storage.folders(TABLE_FOLDER)
        listed = [*(name for name in TABLES if name in there or rows[name]), *(name for name in there if name not in TABLES)]
        tables = tuple(_table(lake, reader, name, rows.get(name), connection, columns) for name in listed)
        blobs = _blobs(lake, connection, [f"{table.name}.{column}" for table, column in columns])
    beside = [name for name in lake.storage.folders("") if name not in (TABLE_FOLDER, BLOB_FOLDER)]
    folders = [Size(f"{name}/", None, live=_held(lake.storage.walk(name))) for name in beside]
    folders.append(Size("files beside them", None, live=_held(lake.storage.entries(""))))
    return LakeSize(reader.snapshot_id, tables, blobs, tuple(size for size in folders if size.all.files))


def _rows(reader: Reader) -> dict[str, int]:
    """Rows of every table, as SQL has them."""
    with reader.connect(names=frozenset()) as connection:
        counts = ", ".join(f"(SELECT count(*) FROM {quoted(name)})" for name in TABLES)
        return dict(zip(TABLES, connection.execute(f"SELECT {counts}").fetchall()[0], strict=True))


def _table(
    lake: Lake, reader: Reader, name: str, rows: int | None, connection: duckdb.DuckDBPyConnection, columns: Sequence[tuple[Table, str]]
) -> Size:  # fmt: skip
    """What a table with so many rows comes to; blobs that they name go into `naming`."""
    versions = {versions_of(row)[name] for row in reader.snapshots if name in versions_of(row)}
    by_version = files_of(lake.tables, name, versions)
    live = set(reader.files(name)) if name in TABLES else set()
    older = {file for files in by_version.values() for file in files} - live
    if name in TABLES:
        for files, is_live in ((live, True), (older, False)):
            _note_blobs(connection, lake.storage, TABLES[name], sorted(files), is_live, columns)
    folder = f"{TABLE_FOLDER}/{name}"
    kinds: dict[str, Held] = {}
    for entry in lake.storage.walk(folder):
        inner = entry.path.removeprefix(f"{folder}/")
        kind = "live" if entry.path in live else "older" if entry.path in older else "log" if "/" in inner else "unnamed"
        kinds[kind] = kinds.get(kind, Held()) + Held(1, entry.size)
    return Size(name, rows, **kinds)


def _note_blobs(
    connection: duckdb.DuckDBPyConnection, storage: Storage, table: Table, files: Sequence[str], is_live: bool,
    columns: Sequence[tuple[Table, str]],
) -> None:  # fmt: skip
    """Note which blobs the rows of some data files of a table name, by which column."""
    if not files or not table.blob_columns:
        return
    relation = parquet(storage, files)
    there = columns_of(connection, relation)
    for place, (owner, column) in enumerate(columns):
        if owner is table and column in there:
            named = f"SELECT DISTINCT {quoted(column)}, {place}, {is_live} FROM {relation} WHERE {quoted(column)} IS NOT NULL"
            connection.execute(f"INSERT INTO naming {named}")


def _blobs(lake: Lake, connection: duckdb.DuckDBPyConnection, names: Sequence[str]) -> tuple[Size, ...]:
    """What blobs come to, by the column that names them."""
    waiting = lake.staging.blob_names() | lake.calls.blob_names()
    first = "first(place ORDER BY is_live DESC, place) AS place, bool_or(is_live) AS is_live"
    connection.execute(f"CREATE TABLE owned AS SELECT name, {first} FROM naming GROUP BY name")
    connection.execute("CREATE TABLE there (name VARCHAR, bytes BIGINT, is_waiting BOOLEAN)")
    for folder in lake.storage.folders(BLOB_FOLDER):  # in parts: a large lake has tens of millions
        connection.register("listed", _listing(lake.storage.walk(f"{BLOB_FOLDER}/{folder}"), waiting))
        connection.execute("INSERT INTO there FROM listed")
    connection.register("listed", _listing(lake.storage.entries(BLOB_FOLDER), waiting))
    connection.execute("INSERT INTO there FROM listed")
    counted = "count(*), CAST(coalesce(sum(bytes), 0) AS BIGINT)"
    answer = connection.execute(
        f"SELECT place, is_waiting OR coalesce(is_live, false), {counted} FROM there LEFT JOIN owned USING (name) GROUP BY ALL"
    ).fetchall()
    held = {(place, is_live): Held(files, size) for place, is_live, files, size in answer}
    sizes = [
        Size(name, None, live=held.get((place, True), Held()), older=held.get((place, False), Held())) for place, name in enumerate(names)
    ]
    unnamed = Size(UNNAMED, None, live=held.get((None, True), Held()), unnamed=held.get((None, False), Held()))
    return tuple(size for size in (*sizes, unnamed) if size.all.files)


def _listing(entries: Iterator[Entry] | Sequence[Entry], waiting: Collection[str]) -> pa.Table:
    """Blobs that are there, with their sizes, and whether something that is not committed names them."""
    files = list(entries)
    names = [entry.path.rpartition("/")[2] for entry in files]
    columns = (pa.array(names, pa.string()), pa.array([entry.size for entry in files], pa.int64()))
    return pa.table([*columns, pa.array([name in waiting for name in names], pa.bool_())], ["name", "bytes", "is_waiting"])


def _held(entries: Iterable[Entry]) -> Held:
    """Files and their sizes together."""
    return sum((Held(1, entry.size) for entry in entries), Held())
