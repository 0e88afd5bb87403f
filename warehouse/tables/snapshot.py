"""Reading a snapshot: all tables of one moment, as records, as Arrow tables, and in SQL."""

from __future__ import annotations

import bisect
import time
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import pyarrow as pa

from schemas.errors import InputError
from schemas.record import Table, arrow_to_rows, rows_to_arrow, table_of
from schemas.runs import Release, Snapshot
from schemas.tables import TABLES
from warehouse.questions import views
from warehouse.questions.documentation import comment_statements, sql_type
from warehouse.questions.quoting import listed, parquet_files, quoted
from warehouse.questions.renames import former_columns, merged, move_into, with_former
from warehouse.storage.files import Storage
from warehouse.storage.refusals import MissingFile
from warehouse.tables.commit import versions_of
from warehouse.tables.delta import LOOK_AGAIN_SECONDS, DeltaTables
from warehouse.tables.released import released

if TYPE_CHECKING:
    import duckdb

    from warehouse.questions.attached import Attached

R = TypeVar("R")


class Reader:
    """One snapshot of a lake. A lake without a snapshot reads as empty tables.

    `snapshot_id` is 0 and `snapshot` None where there is none.
    """

    def __init__(self, storage: Storage, tables: DeltaTables, snapshot_id: int | None = None) -> None:
        self._storage, self._tables = storage, tables
        self._files: dict[str, list[str]] = {}
        known = self._listed().sort_by("snapshot_id")
        ids = known.column("snapshot_id").to_pylist()
        count = len(ids) if snapshot_id is None else bisect.bisect_right(ids, snapshot_id)
        if snapshot_id is not None and snapshot_id != (ids[count - 1] if count else 0):
            remedy = f"the lake has snapshots {_ranges(ids)}" if ids else "the lake has no snapshot yet"
            raise InputError(storage.address, "snapshot", f"there is no snapshot {snapshot_id}", remedy)
        self._known = known.slice(0, count)
        # A lake of many commits has many, and most readers want no more than this one.
        self.snapshot: Snapshot | None = next(iter(arrow_to_rows(known.slice(max(count - 1, 0), min(count, 1)), Snapshot)), None)

    @cached_property
    def snapshots(self) -> tuple[Snapshot, ...]:
        """This snapshot and those before it, the oldest first."""
        return tuple(arrow_to_rows(self._known, Snapshot))

    def _listed(self) -> pa.Table:
        """Rows of all snapshots, and note the file that they are in. A vacuum may have put another in its place before it is read."""
        for pause in (*LOOK_AGAIN_SECONDS, None):
            opened = self._tables.open("snapshots")
            self._files["snapshots"] = self._tables.files("snapshots", opened) if opened is not None else []
            try:
                return self._tables.read(TABLES["snapshots"], self._files["snapshots"])
            except MissingFile:
                if pause is None:
                    raise
                time.sleep(pause)
        raise AssertionError("the last look returns or raises")

    @property
    def snapshot_id(self) -> int:
        """The snapshot that is read, 0 for a lake that has none."""
        return self.snapshot.snapshot_id if self.snapshot else 0

    @cached_property
    def versions(self) -> Mapping[str, int]:
        """Version of every table that the snapshot holds."""
        return versions_of(self.snapshot) if self.snapshot else {}

    @cached_property
    def releases(self) -> tuple[Release, ...]:
        """Releases of this snapshot and of those before it, by name."""
        return tuple(release for release in released(self._storage) if release.snapshot_id <= self.snapshot_id)

    def files(self, table: str) -> list[str]:
        """Paths of a table's Parquet files, relative to the lake."""
        if table not in TABLES:
            raise InputError(self._storage.address, table, "there is no such table", f"the tables are {', '.join(TABLES)}")
        if table not in self._files:
            version = self.versions.get(table)
            opened = self._tables.open(table, version) if version is not None else None
            if version is not None and opened is None:
                problem = f"version {version} is missing, which the snapshot names"
                raise InputError(self._storage.address, table, problem, "restore the folder")
            self._files[table] = self._tables.files(table, opened) if opened is not None else []
        return self._files[table]

    def arrow(self, table: str, scene_id: str | None = None) -> pa.Table:
        """Rows of a table under its schema, sorted by key; of one scene when `scene_id` is given."""
        files = self.files(table)  # refuses a table that is not declared
        declared = TABLES[table]
        if table == "snapshots":
            return rows_to_arrow(self.snapshots, Snapshot)
        if table == "releases":
            return rows_to_arrow(self.releases, Release)
        only = None if scene_id is None else {"scene_id": [scene_id]}
        return self._read(declared, files, only=only)

    def rows(self, record_type: type[R], scene_id: str | None = None) -> list[R]:
        """Rows of a record type, sorted by key; of one scene when `scene_id` is given."""
        name = table_of(record_type).name
        return arrow_to_rows(self.arrow(name, scene_id), record_type)

    def rows_by_key(self, record_type: type[R], keys: Collection[str]) -> list[R]:
        """Rows of a record type whose key (the first column of it) is one of `keys`, sorted by key."""
        declared = table_of(record_type)
        files = self.files(declared.name) if keys else []
        return arrow_to_rows(self._read(declared, files, only={declared.key[0]: set(keys)}), record_type)

    def matching(self, table: str, only: Mapping[str, Collection[Any]], columns: Collection[str] | None = None) -> pa.Table:
        """Rows of a table whose columns of text or truth hold one of the given values each, sorted by key; all columns, or those named.

        Columns of the key are always among them. Quick by scene and asset; other columns are read through.
        """
        declared = TABLES[table]
        names = None if columns is None else [c.name for c in declared.columns if c.name in columns or c.name in declared.key]
        return self._read(declared, self.files(table), names, only)

    def _read(
        self, table: Table, files: Sequence[str], names: Sequence[str] | None = None, only: Mapping[str, Collection[Any]] | None = None
    ) -> pa.Table:
        """Rows of a table's files, sorted by key, with those that files of the table have that it took columns from."""
        rows, move = self._tables.read(table, files, names, only), move_into(table.name)
        if move is not None:
            wanted, mark = list(names if names is not None else rows.column_names), move.columns[0]
            former = self._tables.read(table, self.files(move.before), [*wanted, *({mark} - set(wanted))], only)
            rows = pa.concat_tables([rows, former.filter(former.column(mark).is_valid()).select(wanted)])
        return rows.sort_by([(name, "ascending") for name in table.key])

    def connect(
        self,
        settings: Mapping[str, str | int] | None = None,
        names: frozenset[str] | None = None,
        attached: Sequence[Attached] = (),
    ) -> duckdb.DuckDBPyConnection:
        """A DuckDB connection with one view per table and per question, comments included, and one for each attached file.

        With `names`, of the questions only these, and no comments of tables: made in a third of the time.

        It can read this snapshot's files, those that are attached and nothing else, and its settings are locked; `settings` are
        DuckDB's, such as `memory_limit`, `threads` and `temp_directory`.

        It can still write over those very files when asked to: run other people's SQL through `warehouse.questions.sql.query`.

        Raises:
            InputError: a data file of the snapshot is missing or damaged, or an attached file cannot be read any more.
        """
        import duckdb

        connection = duckdb.connect(":memory:", config=dict(settings or {}))
        self._storage.register(connection)
        paths = {table: [self._storage.duckdb_path(file) for file in self.files(table)] for table in TABLES}
        allowed = listed([*(path for files in paths.values() for path in files), *(each.link for each in attached)])
        connection.execute(f"SET allowed_paths = [{allowed}]")
        connection.execute("SET enable_external_access = false")
        connection.execute("SET TimeZone = 'UTC'")
        # Every view reads the footers of its tables' files when it is made, and again when it is asked; files never change.
        connection.execute("SET parquet_metadata_cache = true")
        # In one transaction, which is nearly twice as fast as 260 of them.
        connection.execute("BEGIN")
        try:
            statements = [self._view(table, paths[table]) for table in TABLES]
            if names is None:
                statements += [statement for table in TABLES.values() for statement in comment_statements(table)]
            connection.execute(";\n".join(statements))
        except duckdb.Error as error:
            connection.close()
            self._check_files()
            raise error
        views.install(connection, names)
        for each in attached:
            try:
                connection.execute(each.statement)
            except duckdb.Error as error:
                connection.close()
                raise each.refusal(error) from error
        connection.execute("COMMIT")
        connection.execute("SET lock_configuration = true")
        return connection

    def _check_files(self) -> None:
        """Raise an error that names the data file when one is missing or damaged: DuckDB speaks of permissions and patterns."""
        import pyarrow.parquet as pq

        for file in (file for table in TABLES for file in self.files(table)):
            try:
                pq.read_metadata(self._storage.arrow_path(file), filesystem=self._storage.arrow_filesystem())
            except FileNotFoundError as error:
                problem = f"is missing, which snapshot {self.snapshot_id} names"
                remedy = "ask again if a vacuum or an erasure ran; else `metascenes doctor lake` says what is damaged"
                raise InputError(self._storage.address, file, problem, remedy) from error
            except (pa.ArrowException, OSError) as error:
                problem = f"cannot be read ({error})"
                raise InputError(self._storage.address, file, problem, "`metascenes doctor lake` says what is damaged") from error

    def _view(self, name: str, paths: list[str]) -> str:
        """The statement that makes the view of a table."""
        table = TABLES[name]
        move = move_into(name)
        former = read_files([self._storage.duckdb_path(file) for file in self.files(move.before)]) if move is not None else None
        body = relation(table, read_files(paths), former)
        if name == "snapshots" and paths:
            body += f" WHERE snapshot_id <= {self.snapshot_id}"
        elif name == "releases" and self.releases:
            rows = ", ".join(f"({listed(getattr(release, c.name) for c in table.columns)})" for release in self.releases)
            named = ", ".join(quoted(column.name) for column in table.columns)
            body = f"{body} UNION ALL BY NAME SELECT * FROM (VALUES {rows}) AS known({named})"
        return f"CREATE VIEW {quoted(name)} AS {with_former(name, body)}"


def relation(table: Table, source: str | None = None, former: str | None = None) -> str:
    """SQL for rows under the columns and types of a table: of the query `source`, or none. Columns that it lacks are null, or what rows
    have that are older than them. `former`: a query for rows of the table that this one took columns from."""
    types = {column.name: sql_type(column.type) for column in table.columns}
    empty = [f"NULL::{kind} AS {quoted(name)}" for name, kind in types.items()]
    move = move_into(table.name)
    if former is not None and move is not None:
        known = f"SELECT {', '.join(empty)} WHERE false UNION ALL BY NAME {former}"
        former = f"SELECT * FROM ({known}) WHERE {quoted(move.columns[0])} IS NOT NULL"
    if source is None and former is None:
        return f"SELECT {', '.join(empty)} WHERE false"
    empty += [f"NULL::{types[after]} AS {quoted(before)}" for before, after in former_columns(table.name).items()]
    body = f"SELECT {', '.join(empty)} WHERE false"
    # The empty relation gives columns that no file has yet, and the schema's types.
    sources = " UNION ALL BY NAME ".join(part for part in (body, source, former) if part is not None)
    names = [
        f"coalesce({quoted(name)}, {table.earlier[name]}) AS {quoted(name)}" if name in table.earlier else sql
        for name, sql in zip(types, merged(table.name, types), strict=True)
    ]
    return f"SELECT {', '.join(names)} FROM ({sources})"


def read_files(paths: Sequence[str]) -> str | None:
    """SQL for the rows in some Parquet files; None for no files."""
    return f"SELECT * FROM {parquet_files(paths)}" if paths else None


def _ranges(numbers: list[int]) -> str:
    """Numbers in words: ``1 to 4, 7``."""
    ranges: list[list[int]] = []
    for number in sorted(numbers):
        if ranges and number == ranges[-1][-1] + 1:
            ranges[-1] = [ranges[-1][0], number]
        else:
            ranges.append([number, number])
    return ", ".join(str(first) if first == last else f"{first} to {last}" for first, last in ranges)
