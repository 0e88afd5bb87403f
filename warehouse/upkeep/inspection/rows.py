"""Whether stored rows obey their schemas: constraints, keys, and references between tables, asked in SQL."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from schemas.record import Column, Table
from schemas.tables import TABLES
from schemas.wording import counted, noun
from warehouse.questions.documentation import sql_type
from warehouse.questions.quoting import listed, literal, quoted
from warehouse.questions.renames import former_columns
from warehouse.storage.files import Storage
from warehouse.tables.snapshot import relation
from warehouse.upkeep.inspection.finding import Fault, in_short
from warehouse.upkeep.references import columns_of, parquet

if TYPE_CHECKING:
    import duckdb

_RERUN = "run the stage again for what it names, or restore the table"

# What names a row of another table: columns here, table there, columns there.
_REFERENCES: tuple[tuple[tuple[str, ...], str, tuple[str, ...]], ...] = (
    (("scene_id",), "scenes", ("scene_id",)),
    (("scene_id", "instance_id"), "instances", ("scene_id", "instance_id")),
    (("scene_id", "parent_id"), "instances", ("scene_id", "instance_id")),
    (("scene_id", "instance_a"), "instances", ("scene_id", "instance_id")),
    (("scene_id", "room_index"), "rooms", ("scene_id", "room_index")),
    (("scene_id", "frame_id"), "frames", ("scene_id", "frame_id")),
    (("asset_id",), "assets", ("asset_id",)),
    (("scene_id", "agent"), "navmeshes", ("scene_id", "agent")),
)


class RowChecks:
    """Checks of the rows of one snapshot, whose data files are given by table."""

    def __init__(self, connection: duckdb.DuckDBPyConnection, storage: Storage, files: Mapping[str, Sequence[str]]) -> None:
        self._connection, self._storage = connection, storage
        self._relations = {table: _relation(table, parquet(storage, paths)) for table, paths in files.items() if paths and table in TABLES}
        self._columns: dict[str, dict[str, str]] = {}

    def constraints(self, name: str, thorough: bool) -> Iterator[Fault]:
        """Rows that break a rule of a column. With `thorough`, every value of every column is decoded."""
        table = TABLES[name]
        known = self._known(name)
        rules = [
            (column, rule, sql)
            for column in table.columns
            if known.get(column.name) == sql_type(column.type)
            for rule, sql in broken(column)
        ]
        counts = [f"count(*) FILTER (WHERE {sql})" for _, _, sql in rules]
        counts += [f"count({quoted(column)})" for column in known] if thorough else []
        if not counts:
            return
        broken_rows = self._connection.execute(f"SELECT {', '.join(counts)} FROM {self._relations[name]}").fetchall()[0]
        for (column, rule, sql), count in zip(rules, broken_rows, strict=False):
            if count:
                problem = f"{counted(count, 'row')}: {rule}, {self._first(table, sql)} first"
                yield Fault("rule", f"tables/{name}", column.name, problem, _RERUN)

    def keys(self, name: str) -> Iterator[Fault]:
        """Keys that more than one row has."""
        table = TABLES[name]
        if not set(table.key) <= set(self._known(name)):
            return
        key = ", ".join(quoted(column) for column in table.key)
        groups = f"SELECT {key}, count(*) AS n FROM {self._relations[name]} GROUP BY {key} HAVING count(*) > 1"
        doubled = self._connection.execute(f"SELECT count(*), any_value(concat_ws(' ', {key})) FROM ({groups})").fetchall()[0]
        if doubled[0]:
            yield Fault(
                "key",
                f"tables/{name}",
                ", ".join(table.key),
                f"{counted(doubled[0], 'key has', 'keys have')} several rows, {doubled[1]} first",
                _RERUN,
            )

    def references(self, name: str) -> Iterator[Fault]:
        """Rows that name a row of another table that is not there. History (annotations, trajectories) may name what is gone."""
        table = TABLES[name]
        if table.rule != "replace" or table.grain != "scene":  # models of a library are assets once they are candidates
            return
        for columns, other, theirs in _REFERENCES:
            if other == name or not set(columns) <= set(self._known(name)):
                continue
            matched = " AND ".join(f"o.{quoted(b)} = r.{quoted(a)}" for a, b in zip(columns, theirs, strict=True))
            there = f"FROM {self._relations[other]} o WHERE {matched}" if other in self._relations else "WHERE false"
            sql = f"r.{quoted(columns[-1])} IS NOT NULL AND NOT EXISTS (SELECT 1 {there})"
            shown = ", ".join(f"r.{quoted(column)}" for column in columns)
            query = f"SELECT count(*), any_value(concat_ws(' ', {shown})) FROM {self._relations[name]} r WHERE {sql}"
            count, first = self._connection.execute(query).fetchall()[0]
            if count:
                problem = f"{counted(count, 'row names', 'rows name')} what is not in {other}, {first} first"
                yield Fault("reference", f"tables/{name}", ", ".join(columns), problem, _RERUN)

    def shared(self, name: str) -> Iterator[Fault]:
        """Shared rows that nobody names."""
        table = TABLES[name]
        if table.rule != "share":
            return
        key = quoted(table.key[0])
        named = f"SELECT {key} FROM {self._relations[table.shared_by]}" if table.shared_by in self._relations else "SELECT NULL"
        unnamed = f"NOT EXISTS (FROM ({named}) s({key}) WHERE s.{key} = r.{key})"
        query = f"SELECT count(*), any_value({key}) FROM {self._relations[name]} r WHERE {unnamed}"
        count, first = self._connection.execute(query).fetchall()[0]
        if count:
            problem = f"{counted(count, 'row')} that no row of {table.shared_by} names, {first} first"
            yield Fault("unnamed row", f"tables/{name}", table.key[0], problem, _RERUN)

    def accounts(self) -> Iterator[Fault]:
        """Tables whose rows of a scene are not as many as the run says that made them."""
        if not self._known("stage_runs"):
            return
        newest = "ROW(snapshot_id, started_at, fingerprint, attempt)"
        self._connection.execute(
            f"""CREATE OR REPLACE TEMP TABLE said AS
            WITH last AS (
                SELECT scene_id, stage, arg_max(outcome, {newest}) AS outcome, arg_max(row_counts, {newest}) AS row_counts
                FROM {self._relations["stage_runs"]} WHERE outcome IN ('done', 'withdrawn') GROUP BY scene_id, stage
            ), entries AS (SELECT scene_id, stage, unnest(row_counts) AS entry FROM last WHERE outcome = 'done')
            SELECT scene_id, split_part(entry, '=', 1) AS name, try_cast(split_part(entry, '=', 2) AS BIGINT) AS n FROM entries"""
        )
        for name, table in TABLES.items():
            if table.rule != "replace" or table.grain != "scene":
                continue
            there = f"SELECT scene_id, count(*) AS n FROM {self._relations[name]} GROUP BY scene_id" if self._known(name) else None
            there = there or "SELECT NULL::VARCHAR AS scene_id, 0 AS n WHERE false"
            differing = f"""SELECT count(*), arg_min(scene_id, scene_id), arg_min(n, scene_id), arg_min(m, scene_id) FROM (
                SELECT scene_id, coalesce(a.n, 0) AS n, coalesce(b.n, 0) AS m
                FROM ({there}) a FULL JOIN (SELECT scene_id, n FROM said WHERE name = ?) b USING (scene_id)) WHERE n <> m"""
            count, scene, actual, expected = self._connection.execute(differing, [name]).fetchall()[0]
            if count:
                whose = noun(count, "scene has other rows than its runs say", "scenes have other rows than their runs say")
                problem = f"{count} {whose}, {scene} first: {actual} instead of {expected}"
                yield Fault("row count", f"tables/{name}", "scene_id", problem, _RERUN)

    def _known(self, name: str) -> dict[str, str]:
        """Columns that the files of a table have."""
        if name not in self._columns:
            self._columns[name] = columns_of(self._connection, self._relations[name]) if name in self._relations else {}
        return self._columns[name]

    def _first(self, table: Table, sql: str) -> str:
        """Key of a row of which `sql` is true."""
        key = ", ".join(quoted(column) for column in table.key if column in self._known(table.name))
        # In a FILTER, not in a WHERE: there Parquet's statistics, which know no NaN, would let DuckDB skip the row.
        query = f"SELECT any_value(concat_ws(' ', {key})) FILTER (WHERE {sql}) FROM {self._relations[table.name]}"
        return str(self._connection.execute(query).fetchall()[0][0])


def _relation(name: str, source: str) -> str:
    """The rows of a table as its files have them; under its schema where they may have a column under an old name, or be older."""
    is_older = former_columns(name) or TABLES[name].earlier
    return f"({relation(TABLES[name], f'SELECT * FROM {source}')})" if is_older else source


def checked(checks: Iterator[Fault], name: str) -> Iterator[Fault]:
    """Findings of a check; one more where the files cannot be read to the end."""
    import duckdb

    try:
        yield from checks
    except duckdb.Error as error:
        yield Fault("unreadable", f"tables/{name}", "", f"cannot be read ({in_short(error)})", "restore the file")


def broken(column: Column) -> Iterator[tuple[str, str]]:
    """The rules of a column in words, with SQL that is true where a value breaks them."""
    name = quoted(column.name)
    if not column.nullable:
        yield "must not be missing", f"{name} IS NULL"
    if column.values:
        yield f"must be one of {', '.join(column.values)}", f"{name} NOT IN ({listed(column.values)})"
    if column.pattern:
        yield f"must match {column.pattern}", f"NOT regexp_full_match({name}, {literal(column.pattern)})"
    if column.length is not None:
        yield f"must have {column.length} values", f"len({name}) <> {column.length}"
    numbers, element = name, column.type
    while pa.types.is_list(element):
        element = element.value_type
        numbers = f"flatten({numbers})" if pa.types.is_list(element) else numbers
    if not (pa.types.is_floating(element) or pa.types.is_integer(element)):
        return
    low, high = (numbers, numbers) if element is column.type else (f"list_min({numbers})", f"list_max({numbers})")
    if pa.types.is_floating(element):
        yield "must be finite", f"NOT isfinite({low}) OR NOT isfinite({high})"
    if column.minimum is not None:
        yield f"must be at least {column.minimum:g}", f"{low} < {column.minimum!r}"
    if column.maximum is not None:
        yield f"must be at most {column.maximum:g}", f"{high} > {column.maximum!r} AND ({high})::DOUBLE < 'inf'::DOUBLE"


def type_findings(name: str, path: str, schema: Any) -> Iterator[Fault]:
    """Columns of a data file that have another type than the schema says."""
    for column in TABLES[name].columns:
        if column.name in schema.names:
            stored, declared = _type(schema.field(column.name).type), sql_type(column.type)
            if stored != declared:
                yield Fault("type", path, column.name, f"is {stored} where the schema says {declared}", "restore the file")


def _type(arrow: pa.DataType) -> str:
    try:
        return sql_type(arrow)
    except KeyError:
        return str(arrow)
