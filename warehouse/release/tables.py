"""The tables of a snapshot as plain Parquet: one file per table, sorted by key, written by streaming."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from schemas.record import Table, rows_to_arrow
from schemas.runs import Release
from schemas.tables import TABLES
from warehouse.questions.quoting import quoted
from warehouse.tables.delta import nullable
from warehouse.tables.snapshot import Reader

if TYPE_CHECKING:
    import duckdb

MEMORY = "1GB"
"""What DuckDB may hold of a table while it sorts it; the rest goes to disk."""

# Rows of one row group, DuckDB's own number: few enough to be held, many enough to be skipped as one.
_GROUP_ROWS = 122_880


def write_tables(reader: Reader, folder: Path, advance: Callable[[str], None] | None = None) -> dict[str, int]:
    """Write every table of a snapshot into `folder` as `<table>.parquet`, but `releases`; rows by table.

    At most `MEMORY` and a few row groups are held. `advance` is told each table that is written.
    """
    counts = {}
    with limited(reader, folder) as connection:
        for table in TABLES.values():
            if table.name != "releases":
                counts[table.name] = _write(_batches(connection, table), table, folder / f"{table.name}.parquet")
                if advance is not None:
                    advance(table.name)
    return counts


def write_releases(known: Sequence[Release], folder: Path) -> None:
    """Write the table `releases` into `folder`."""
    table = TABLES["releases"]
    _write(iter([rows_to_arrow(known, Release)]), table, folder / "releases.parquet")


def limited(reader: Reader, folder: Path) -> duckdb.DuckDBPyConnection:
    """A connection to a snapshot that holds at most `MEMORY` and uses `folder` for the rest."""
    return reader.connect(settings(folder))


def settings(folder: Path) -> dict[str, str | int]:
    """DuckDB's settings to hold at most `MEMORY` and to use `folder` for the rest."""
    return {"memory_limit": MEMORY, "temp_directory": str(folder / "spill")}


def sha256_of(file: Path) -> str:
    """SHA-256 of a file."""
    with open(file, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def _batches(connection: duckdb.DuckDBPyConnection, table: Table) -> Iterator[pa.Table]:
    """Rows of a table in the order of its key, a row group at a time."""
    columns = ", ".join(quoted(column.name) for column in table.columns)
    ordered = ", ".join(quoted(name) for name in table.key)
    reader: Any = connection.sql(f"SELECT {columns} FROM {quoted(table.name)} ORDER BY {ordered}").to_arrow_reader(_GROUP_ROWS)
    for batch in reader:
        yield pa.Table.from_batches([batch])


def _write(batches: Iterator[pa.Table], table: Table, file: Path) -> int:
    """Write row groups into one file under the schema of a table; how many rows."""
    import pyarrow.parquet as pq

    # Rows that are older than a column miss it, whatever the schema says of new ones.
    schema, count = nullable(table.arrow_schema), 0
    with pq.ParquetWriter(file, schema, compression="zstd") as writer:
        for batch in batches:
            if batch.num_rows:
                writer.write_table(batch.cast(schema), row_group_size=_GROUP_ROWS)
                count += batch.num_rows
    return count
