"""The proof of an erasure: every byte of every file of the lake is searched, compressed ones unpacked.

Files outside of the lake (those of Prefect, temporary ones) are searched by the same functions.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gzip
import io
import os
import sqlite3
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from schemas.machine.scratch import temporary_folder
from warehouse.questions.quoting import quoted
from warehouse.storage.files import Storage
from warehouse.upkeep.erasure.traces import Traces

_SHOWN = 3

_CHUNK_BYTES = 2**24
"""Bytes of a large file that are searched at a time."""

_OVERLAP_BYTES = 4096
"""Bytes that are searched again with the next chunk: no spelling of a name is longer."""


@dataclasses.dataclass(frozen=True)
class Hit:
    """A file that still tells of the scene: where in it, how often, and what was found first."""

    path: str
    place: str
    count: int
    traces: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Proof:
    """What was searched, and what was found: nothing, where the erasure is complete."""

    files: int
    bytes: int
    rows: int
    hits: tuple[Hit, ...]

    def __or__(self, other: Proof) -> Proof:
        """Both searches as one."""
        return Proof(self.files + other.files, self.bytes + other.bytes, self.rows + other.rows, self.hits + other.hits)


def search(storage: Storage, traces: Traces, advance: Callable[[str], None] = lambda path: None, folder: str = "") -> Proof:
    """Look for traces in the names and the contents of all files (below `folder`).

    Parquet files are decoded as well (their pages are compressed), and so are gzip and zip files, the tables and
    views of `.duckdb` files, and the tables of SQLite files.
    """
    files = size = rows = 0
    hits: list[Hit] = []
    for entry in storage.walk(folder):
        try:
            data = storage.read(entry.path)
        except FileNotFoundError:  # a writer's temporary file, renamed or removed meanwhile
            continue
        decoded, traced = _looked_through(entry.path, data, traces)
        files, size, rows = files + 1, size + len(data), rows + decoded
        hits += traced
        advance(entry.path)
    return Proof(files, size, rows, tuple(hits))


def tells(path: str, data: bytes, traces: Traces) -> bool:
    """Whether a file's name or content tells of the scene."""
    return bool(_looked_through(path, data, traces)[1])


def hits_in(path: str, data: bytes, traces: Traces, place: str = "contents") -> list[Hit]:
    """Hits in a file of this machine, by its path and content."""
    hits = _looked_through(path, data, traces)[1]
    return [dataclasses.replace(hit, place=place) if hit.place == "contents" else hit for hit in hits]


def paths_below(folder: Path) -> Iterator[Path]:
    """Paths below a folder, those of links included. Folders that are removed meanwhile are left out."""
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            yield Path(place, name)


def unreadable_hits(path: Path, error: OSError) -> list[Hit]:
    """A hit for a file that cannot be read; none if its owner removed it meanwhile."""
    is_gone = isinstance(error, FileNotFoundError | NotADirectoryError)
    return [] if is_gone else [Hit(_shown(str(path)), "cannot be read", 1, ())]


def search_file(path: Path, traces: Traces) -> list[Hit]:
    """Hits in the bytes of a file of any size, without unpacking it; none if there is no such file."""
    traced: list[str] = []
    try:
        with path.open("rb") as file:
            before = b""
            while chunk := file.read(_CHUNK_BYTES):
                traced += traces.in_bytes(before + chunk)
                before = chunk[-_OVERLAP_BYTES:]
    except FileNotFoundError:
        return []
    return [_hit(str(path), "contents", traced)] if traced else []


def _looked_through(path: str, data: bytes, traces: Traces) -> tuple[int, list[Hit]]:
    """Rows that were decoded, and what was found."""
    hits: list[Hit] = []
    rows = 0
    places = [("name", os.fsencode(path)), ("contents", data)]
    for place, content in (*places, *_unpacked(path, data)):
        if traced := list(traces.in_bytes(content)):
            hits.append(_hit(path, place, traced))
    if data[:4] == b"PAR1":
        rows, traced = _in_parquet(data, traces)
        if traced:
            hits.append(_hit(path, "rows", traced))
    return rows, hits


def _hit(path: str, place: str, traced: list[str]) -> Hit:
    return Hit(_shown(path), place, len(traced), tuple(sorted(set(traced)))[:_SHOWN])


def _shown(path: str) -> str:
    """A path that can be printed, although names of files need not be UTF-8."""
    return os.fsencode(path).decode(errors="backslashreplace")


def _unpacked(path: str, data: bytes) -> Iterator[tuple[str, bytes]]:
    """What lies packed in a file, by the place that it has there."""
    if data[:2] == b"\x1f\x8b":
        try:
            yield "gzip", gzip.decompress(data)
        except (OSError, EOFError, zlib.error):
            return  # only begins like one
    elif data[:4] == b"PK\x03\x04":
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as packed:
                for name in packed.namelist():
                    yield f"zip: {name}", packed.read(name)
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError):
            return
    elif data[8:12] == b"DUCK":
        yield from _from_duckdb(data)
    elif data[:16] == b"SQLite format 3\0":
        yield from _from_sqlite(data)


def _from_sqlite(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Rows of an SQLite file: a long text is spread over pages that need not follow each other."""
    with contextlib.closing(sqlite3.connect(":memory:")) as connection:
        connection.text_factory = bytes
        try:
            # A copy in memory has no write-ahead log, which bytes 18 and 19 of the header would ask for.
            connection.deserialize(data[:18] + b"\x01\x01" + data[20:])
            for (name,) in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'").fetchall():
                for row in connection.execute(f"SELECT * FROM {quoted(name.decode())}"):
                    yield f"table {name.decode()}", b"\n".join(value for value in row if isinstance(value, bytes))
        except (sqlite3.Error, UnicodeDecodeError):
            return  # damaged; its bytes were searched


def _from_duckdb(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Texts of a database: its tables' rows, and the SQL of its views."""
    import duckdb

    with temporary_folder() as folder:
        copy = folder / "copy.duckdb"
        copy.write_bytes(data)
        with duckdb.connect(str(copy), read_only=True, config={"enable_external_access": "false"}) as connection:
            for (sql,) in connection.execute("SELECT sql FROM duckdb_views() WHERE NOT internal").fetchall():
                yield "views", str(sql).encode()
            for schema, name in connection.execute("SELECT schema_name, table_name FROM duckdb_tables()").fetchall():
                for row in connection.execute(f"SELECT * FROM {quoted(schema)}.{quoted(name)}").fetchall():
                    yield f"table {name}", repr(row).encode()


def _in_parquet(data: bytes, traces: Traces) -> tuple[int, list[str]]:
    """Rows of a Parquet file, and the traces in all texts that its columns hold."""
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(io.BytesIO(data))
    except pa.ArrowException:
        return 0, []  # damaged; its bytes were searched
    traced: list[str] = []
    for group in range(file.num_row_groups):
        for column in file.read_row_group(group).columns:
            for chunk in column.chunks:
                traced += _in_texts(chunk, traces)
    return file.metadata.num_rows, traced


def _in_texts(values: Any, traces: Traces) -> list[str]:
    """Traces in the texts of an Arrow array, however deep these lie."""
    kind = values.type
    if pa.types.is_dictionary(kind):
        return _in_texts(values.dictionary, traces)
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        return _in_texts(values.flatten(), traces)
    if pa.types.is_struct(kind):
        return [trace for field in values.flatten() for trace in _in_texts(field, traces)]
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return []
    texts = pc.unique(values).drop_null()
    suspect = pc.is_in(texts, value_set=pa.array(sorted(traces.hashes), kind))
    for core in traces.cores:
        suspect = pc.or_(suspect, pc.match_substring(texts, core))
    longer = pc.greater(pc.binary_length(texts), 64)  # a hash inside of something
    return [trace for text in texts.filter(pc.or_(suspect, longer)).to_pylist() for trace in traces.in_bytes(text.encode())]
