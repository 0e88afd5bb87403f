"""What differs between two snapshots: rows per table, and the scenes and objects that they are about.

Asked in SQL over both. Data files that both snapshots have hold the same rows of both and are not read. Rows of one key
are compared by a hash of 64 bits over all columns that are not volatile.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from schemas.errors import InputError
from schemas.record import Column, Table
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.questions.quoting import quoted
from warehouse.release import releases
from warehouse.tables.snapshot import Reader, read_files, relation
from warehouse.upkeep.references import workspace

if TYPE_CHECKING:
    import duckdb

LATEST = "latest"
"""The word for the newest snapshot."""

_ABOUT_THE_LAKE = ("snapshots", "releases")
_MEMORY = "2GB"


@dataclasses.dataclass(frozen=True)
class Names:
    """Objects of one kind: how many, and the first of their names in order."""

    count: int
    names: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Changes:
    """What was added, changed and removed on the way from one snapshot to another."""

    added: Names
    changed: Names
    removed: Names


@dataclasses.dataclass(frozen=True)
class TableChanges:
    """Rows of a table by what became of them."""

    table: str
    added: int
    changed: int
    removed: int


@dataclasses.dataclass(frozen=True)
class Difference:
    """From one snapshot to another: rows by table, scenes (`scannet/scene0001_00`) and objects (`scannet/scene0001_00/0007`).

    A scene or object that both have is changed when any row about it was added, changed or removed in a table that a stage
    writes. Walls, floors and ceilings are no objects.
    """

    before: int
    after: int
    tables: tuple[TableChanges, ...]
    scenes: Changes
    objects: Changes


def named_snapshot(lake: Lake, text: str) -> Reader:
    """The snapshot that a text means: the name of a release, a number, or `latest`.

    Raises:
        InputError: there is none.
    """
    known = {release.name: release.snapshot_id for release in releases(lake)}
    if text in known:
        return lake.snapshot(known[text])
    if text == LATEST:
        return lake.snapshot()
    if text.isdigit():
        return lake.snapshot(int(text))
    remedy = f"releases are {', '.join(known) or 'none'}; a number is a snapshot, {LATEST} the newest"
    raise InputError(lake.address, "release", f"no release {text!r}", remedy)


def difference(lake: Lake, before: Reader, after: Reader, most: int | None = 20) -> Difference:
    """What differs between two snapshots; at most `most` names of each kind of object, None for all."""
    with workspace(lake.storage, _MEMORY) as connection:
        connection.execute("CREATE TABLE differing (about VARCHAR, kind VARCHAR, scene_id VARCHAR, instance_id VARCHAR, rows BIGINT)")
        tables = [_compare(connection, lake, table, before, after) for name, table in TABLES.items() if name not in _ABOUT_THE_LAKE]
        return Difference(
            before.snapshot_id,
            after.snapshot_id,
            tuple(tables),
            _scenes(connection, most),
            _objects(connection, lake, before, after, most),
        )


def _compare(connection: duckdb.DuckDBPyConnection, lake: Lake, table: Table, before: Reader, after: Reader) -> TableChanges:
    """Take the differing rows of one table into `differing`, summed up by what they are about."""
    old, new = set(before.files(table.name)), set(after.files(table.name))
    if old != new:
        sides = [
            _side(table, [lake.storage.duckdb_path(file) for file in sorted(files)], mark)
            for files, mark in ((old - new, "b"), (new - old, "a"))
        ]
        scene = "scene_id" if "scene_id" in table.key else "NULL"
        instance = "instance_id" if {"scene_id", "instance_id"} <= set(table.key) else "NULL"
        connection.execute(
            f"INSERT INTO differing SELECT '{table.name}', CASE WHEN b_hash IS NULL THEN 'added' WHEN a_hash IS NULL THEN 'removed'"
            f" ELSE 'changed' END AS kind, {scene}, {instance}, count(*) FROM ({sides[0]}) FULL JOIN ({sides[1]})"
            f" USING ({', '.join(quoted(name) for name in table.key)}) WHERE b_hash IS DISTINCT FROM a_hash GROUP BY ALL"
        )
    rows = connection.execute(
        "SELECT kind, CAST(sum(rows) AS BIGINT) FROM differing WHERE about = ? GROUP BY kind", [table.name]
    ).fetchall()
    counts = dict(rows)
    return TableChanges(table.name, *(counts.get(kind, 0) for kind in ("added", "changed", "removed")))


def _side(table: Table, paths: list[str], mark: str) -> str:
    """Key and hash of the rows in some data files."""
    keys = ", ".join(quoted(name) for name in table.key)
    values = [part for column in table.columns if not column.key and not column.volatile for part in _hashed(column)]
    return f"SELECT {keys}, hash({', '.join(values or ['true'])}) AS {mark}_hash FROM ({relation(table, read_files(paths))})"


def _hashed(column: Column) -> list[str]:
    """Expressions to hash: DuckDB's hash of a list ignores where inner lists end, and takes [] and NULL for equal."""
    name = quoted(column.name)
    if not pa.types.is_list(column.type):
        return [name]
    inner = [f"list_transform({name}, lambda item: len(item))"] if pa.types.is_list(column.type.value_type) else []
    return [name, f"len({name})", *inner]


_STAGED = ", ".join(f"'{name}'" for name, table in TABLES.items() if table.stage)


def _scenes(connection: duckdb.DuckDBPyConnection, most: int | None) -> Changes:
    """What became of scenes."""
    connection.execute(
        "CREATE OR REPLACE TABLE object AS SELECT scene_id AS name,"
        " coalesce(max(kind) FILTER (about = 'scenes' AND kind <> 'changed'), 'changed') AS kind"
        f" FROM differing WHERE about IN ({_STAGED}) AND scene_id IS NOT NULL GROUP BY ALL"
    )
    return _changes(connection, most)


def _objects(connection: duckdb.DuckDBPyConnection, lake: Lake, before: Reader, after: Reader, most: int | None) -> Changes:
    """What became of objects: instances that are no part of the room. One that becomes such a part is removed."""
    table = TABLES["instances"]
    for name, reader in (("was", before), ("is_now", after)):
        rows = relation(table, read_files([lake.storage.duckdb_path(file) for file in sorted(reader.files(table.name))]))
        connection.execute(
            f"CREATE OR REPLACE TABLE {name} AS SELECT scene_id, instance_id, NOT is_structure AS is_object FROM ({rows})"
            " SEMI JOIN differing USING (scene_id, instance_id)"
        )
    connection.execute(
        "CREATE OR REPLACE TABLE object AS SELECT scene_id || '/' || instance_id AS name,"
        " CASE WHEN new.is_object AND old.is_object IS DISTINCT FROM true THEN 'added'"
        " WHEN old.is_object AND new.is_object IS DISTINCT FROM true THEN 'removed' ELSE 'changed' END AS kind"
        f" FROM (SELECT DISTINCT scene_id, instance_id FROM differing WHERE about IN ({_STAGED}) AND instance_id IS NOT NULL) AS about"
        " LEFT JOIN was AS old USING (scene_id, instance_id) LEFT JOIN is_now AS new USING (scene_id, instance_id)"
        " WHERE coalesce(old.is_object OR new.is_object, old.is_object, new.is_object, true)"  # nothing is known of what has no row
    )
    return _changes(connection, most)


def _changes(connection: duckdb.DuckDBPyConnection, most: int | None) -> Changes:
    """What became of the objects in the table `object`."""
    limit = f"LIMIT {most}" if most is not None else ""

    def names(kind: str) -> Names:
        count: Any = connection.execute("SELECT count(*) FROM object WHERE kind = ?", [kind]).fetchall()[0][0]
        rows = connection.execute(f"SELECT name FROM object WHERE kind = ? ORDER BY name {limit}", [kind]).fetchall()
        return Names(int(count), tuple(name for (name,) in rows))

    return Changes(names("added"), names("changed"), names("removed"))
