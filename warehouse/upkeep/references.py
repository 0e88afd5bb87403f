"""Which blobs the rows of some snapshots name, and how that compares with the blobs that are there.

Names are kept in a temporary database on disk: a large lake has tens of millions of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from schemas.machine.scratch import temporary_folder
from schemas.tables import TABLES
from warehouse.questions.quoting import literal, parquet_files, quoted
from warehouse.storage.blobs import FOLDER
from warehouse.storage.files import Entry, Storage
from warehouse.storage.refusals import named

if TYPE_CHECKING:
    import duckdb

_MEMORY = "1GB"


@contextmanager
def workspace(storage: Storage, memory: str = _MEMORY) -> Iterator[duckdb.DuckDBPyConnection]:
    """A DuckDB database in a temporary file, which can read the lake's files and spills to disk beyond `memory`."""
    import duckdb

    with named(storage), temporary_folder() as folder:
        connection = duckdb.connect(str(folder / "work.duckdb"))
        try:
            connection.execute("SET TimeZone = 'UTC'")
            connection.execute(f"SET memory_limit = '{memory}'")
            connection.execute(f"SET temp_directory = {literal(str(folder / 'spill'))}")
            storage.register(connection)
            yield connection
        finally:
            connection.close()


def parquet(storage: Storage, files: Iterable[str], extra: str = "") -> str:
    """SQL that reads data files as one relation; `extra` are more options of DuckDB's `read_parquet`."""
    return parquet_files(map(storage.duckdb_path, files), extra)


def columns_of(connection: Any, relation: str) -> dict[str, str]:
    """Columns of a relation with their SQL types."""
    return {name: kind for name, kind, *_ in connection.execute(f"DESCRIBE SELECT * FROM {relation}").fetchall()}


class BlobReferences:
    """Names of the blobs that rows name, in the table `named` of a workspace."""

    def __init__(self, connection: duckdb.DuckDBPyConnection, storage: Storage) -> None:
        self._connection, self._storage = connection, storage
        self._spared: frozenset[str] = frozenset()
        self._present: list[str] = []
        connection.execute("CREATE OR REPLACE TABLE named (name VARCHAR)")

    def add_files(self, table: str, files: Sequence[str], where: str = "true") -> None:
        """Take in what the rows of a table's data files name; `where` is SQL over its columns."""
        if not files:
            return
        relation = parquet(self._storage, files)
        known = columns_of(self._connection, relation)
        for column in TABLES[table].blob_columns:
            if column in known:
                name = quoted(column)
                sql = f"SELECT DISTINCT {name} FROM {relation} WHERE {name} IS NOT NULL AND ({where})"
                self._connection.execute(f"INSERT INTO named {sql}")

    def add(self, names: Collection[str]) -> None:
        """Take in names."""
        for name in sorted(names):
            self._connection.execute("INSERT INTO named VALUES (?)", [name])

    def finish(self) -> int:
        """Leave each name once; how many there are."""
        self._connection.execute("CREATE OR REPLACE TABLE named AS SELECT DISTINCT name FROM named ORDER BY name")
        return int(self._connection.execute("SELECT count(*) FROM named").fetchall()[0][0])

    def folders(self) -> list[str]:
        """Folders of blobs that the names lead to: their first two digits."""
        return [head for (head,) in self._connection.execute("SELECT DISTINCT name[1:2] AS head FROM named ORDER BY head").fetchall()]

    def names(self, folder: str) -> list[str]:
        """Names that lead to a folder, sorted."""
        sql = "SELECT name FROM named WHERE name[1:2] = ? ORDER BY name"
        return [name for (name,) in self._connection.execute(sql, [folder]).fetchall()]

    def spare(self, names: Collection[str]) -> None:
        """Names of files that count as named where they are there, and are not missed where they are not."""
        self._spared = frozenset(names)

    def present(self) -> list[str]:
        """Names that the last step of `compared` found to be there, sorted."""
        return self._present

    def compared(self) -> Iterator[tuple[list[Entry], list[str]]]:
        """For every folder of blobs in turn: files there that nobody names, and names that are not there.

        Files that no blob could be called are among the first.
        """
        for folder in sorted({*self._storage.folders(FOLDER), *self.folders()}):
            named = set(self.names(folder))
            unnamed, seen = [], set()
            for entry in self._storage.walk(f"{FOLDER}/{folder}"):
                name = entry.path.rpartition("/")[2]
                if (name in named or name in self._spared) and entry.path == f"{FOLDER}/{name[:2]}/{name[2:4]}/{name}":
                    seen.add(name)
                else:
                    unnamed.append(entry)
            self._present = sorted(seen & named)
            yield unnamed, sorted(named - seen)
