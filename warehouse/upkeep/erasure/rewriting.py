"""Which rows of which data files go, and the files without them."""

from __future__ import annotations

import io
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc

from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.questions.quoting import listed, literal, quoted
from warehouse.tables.adoption import SCENE_STAGES, WHOLE_STAGES
from warehouse.tables.datafiles import data_files, write_files
from warehouse.upkeep.erasure.traces import Traces
from warehouse.upkeep.references import columns_of, parquet

if TYPE_CHECKING:
    import duckdb

_BATCH_ROWS = 32_768

NO_BATCH_STAGES = (*SCENE_STAGES, *sorted(WHOLE_STAGES))
"""Stages whose runs are of no batch: a scene, or a library, may be called as one is."""


class SceneRows:
    """The rows about a scene in a lake's data files.

    Those that name it, those of batches that are about it alone, and shared rows that only it names.
    """

    def __init__(self, lake: Lake, scene_id: str, connection: duckdb.DuckDBPyConnection) -> None:
        self._lake, self._scene, self._connection = lake, scene_id, connection
        self.files = {table: [entry.path for entry in data_files(lake.storage, table)] for table in lake.storage.folders("tables")}
        """All data files that lie in the tables' folders, whether a version names them or not."""
        self._relations = {table: parquet(lake.storage, files) for table, files in self.files.items() if files and table != "snapshots"}
        self._columns = {table: columns_of(connection, relation) for table, relation in self._relations.items()}
        self.batches = self._own_batches()

    def rooms(self) -> tuple[set[str], set[str]]:
        """Rooms that the scene alone shows, and rooms that others show."""
        if "room_id" not in self._columns.get("scenes", {}):
            return set(), set()
        rooms = self._rows("scenes", "SELECT DISTINCT room_id, scene_id = ? FROM {}", [self._scene])
        shared = {room for room, own in rooms if not own}
        return {room for room, own in rooms if own} - shared, shared

    def other_scenes(self) -> set[str]:
        """Ids of the other scenes that any row names."""
        scenes: set[str] = set()
        for table in self._columns:
            if "scene_id" in self._columns[table]:
                only = f" AND stage IN {SCENE_STAGES!r}" if table == "stage_runs" else ""
                rows = self._rows(table, f"SELECT DISTINCT scene_id FROM {{}} WHERE scene_id <> ?{only}", [self._scene])
                scenes.update(name for (name,) in rows)
        return scenes

    def condition(self, table: str, shared: Collection[str] = ()) -> str:
        """SQL that is true of the rows of a table that go; `shared` are the keys that go of a shared table."""
        columns = self._columns.get(table, {})
        parts = ["false"]
        if "scene_id" in columns:
            parts.append(f"scene_id = {literal(self._scene)}")
        if "reference_scene_id" in columns:
            parts.append(f"reference_scene_id = {literal(self._scene)}")
        if self.batches and "batch_id" in columns:
            parts.append(f"batch_id IN {_list(self.batches)}")
        if self.batches and table == "stage_runs":
            parts.append(f"(scene_id IN {_list(self.batches)} AND stage NOT IN {NO_BATCH_STAGES!r})")
        if shared:
            parts.append(f"{quoted(TABLES[table].key[0])} IN {_list(shared)}")
        return " OR ".join(parts)

    def count(self, table: str, files: Sequence[str], shared: Collection[str] = ()) -> int:
        """Rows of these files that go."""
        if not files or table not in self._columns:
            return 0
        sql = f"SELECT count(*) FROM {parquet(self._lake.storage, files)} WHERE {self.condition(table, shared)}"
        return int(self._connection.execute(sql).fetchall()[0][0])

    def shared_keys(self, table: str, files: Sequence[str] | None = None, alone: bool = True) -> set[str]:
        """Keys of a shared table that the scene's rows name, in these files of the table that shares it (all by default).

        With `alone`, those that no other scene names there.
        """
        declared = TABLES.get(table)
        sharing = declared.shared_by if declared else ""
        chosen = files if files is not None else self.files.get(sharing, [])
        if declared is None or declared.rule != "share" or not chosen or declared.key[0] not in self._columns.get(sharing, {}):
            return set()
        relation, key = parquet(self._lake.storage, chosen), quoted(declared.key[0])
        sql = f"SELECT DISTINCT {key} FROM {relation} WHERE scene_id = ? AND {key} IS NOT NULL"
        own = {name for (name,) in self._connection.execute(sql, [self._scene]).fetchall()}
        if not own or not alone:
            return own
        sql = f"SELECT DISTINCT {key} FROM {relation} WHERE scene_id <> ? AND {key} IN {_list(own)}"
        return own - {name for (name,) in self._connection.execute(sql, [self._scene]).fetchall()}

    def blobs(self) -> set[str]:
        """Names of the blobs that rows about the scene name in any data file, others' or not."""
        names: set[str] = set()
        for table, columns in self._columns.items():
            shared = self.shared_keys(table, alone=False)
            for column in TABLES[table].blob_columns if table in TABLES else ():
                if column in columns:
                    name = quoted(column)
                    sql = f"SELECT DISTINCT {name} FROM {{}} WHERE ({self.condition(table, shared)}) AND {name} IS NOT NULL"
                    names.update(value for (value,) in self._rows(table, sql, []))
        return names

    def blobs_of_others(self, table: str, files: Sequence[str], names: Collection[str], shared: Collection[str] = ()) -> set[str]:
        """Those of these blobs that rows of the files name that stay."""
        blobs: set[str] = set()
        if files and names and table in TABLES:
            relation = parquet(self._lake.storage, files)
            for column in set(TABLES[table].blob_columns) & set(columns_of(self._connection, relation)):
                name = quoted(column)
                self._connection.register("wanted", pa.table({"name": pa.array(sorted(names), pa.string())}))
                stays = f"NOT coalesce({self.condition(table, shared)}, false) AND {name} IN (SELECT name FROM wanted)"
                sql = f"SELECT DISTINCT {name} FROM {relation} WHERE {stays}"
                blobs.update(value for (value,) in self._connection.execute(sql).fetchall())
                self._connection.unregister("wanted")
        return blobs

    def affected(self, table: str, files: Sequence[str], traces: Traces, shared: Collection[str] = ()) -> list[str]:
        """Those of these files that hold a row that goes, or a text that may have to be redacted."""
        if not files or table not in self._columns:
            return []
        relation = parquet(self._lake.storage, files, ", filename = true")
        known = columns_of(self._connection, relation)  # of these files: others may have younger columns
        texts = [
            _holds(quoted(name), kind, traces.cores) for name, kind in known.items() if kind.startswith("VARCHAR") and name != "filename"
        ]
        where = " OR ".join([self.condition(table, shared), *texts])
        names = {name for (name,) in self._connection.execute(f"SELECT DISTINCT filename FROM {relation} WHERE {where}").fetchall()}
        last = {name.rpartition("/")[2] for name in names}
        return [file for file in files if file.rpartition("/")[2] in last]

    def rewritten(self, table: str, file: str, traces: Traces, shared: Collection[str], check: Callable[[], None]) -> tuple[list[str], int]:
        """A data file without the rows that go and with the others' texts redacted; the new paths, and how many rows it lost."""
        import pyarrow.parquet as pq

        read = pq.ParquetFile(io.BytesIO(self._lake.storage.read(file)))
        before, after = read.metadata.num_rows, 0

        def kept() -> Iterator[pa.RecordBatch]:
            nonlocal after
            for batch in read.iter_batches(_BATCH_ROWS):
                batch = batch.filter(pc.invert(self._goes(table, batch, shared)))
                if table == "refused_scans":  # a redacted path would be the key of several rows
                    paths = batch.column("path").to_pylist()
                    batch = batch.filter(pa.array([not traces.in_text(path) for path in paths], pa.bool_()))
                after += batch.num_rows
                yield redacted_batch(batch, traces)

        paths = write_files(self._lake.storage, table, kept(), read.schema_arrow, check, most=2**62)
        return paths, before - after

    def _goes(self, table: str, batch: pa.RecordBatch, shared: Collection[str]) -> pa.Array:
        """What `condition` says, of the rows of a batch."""
        gone = pa.array([False] * batch.num_rows, pa.bool_())

        def also(column: str, values: Collection[str]) -> pa.Array:
            if column not in batch.schema.names or not values:
                return pa.array([False] * batch.num_rows, pa.bool_())
            return pc.is_in(batch.column(column), value_set=pa.array(sorted(values), pa.string()))

        gone = pc.or_(also("scene_id", [self._scene]), also("batch_id", self.batches))
        gone = pc.or_(gone, also("reference_scene_id", [self._scene]))
        if table == "stage_runs":
            gone = pc.or_(gone, pc.and_(also("scene_id", self.batches), pc.invert(also("stage", NO_BATCH_STAGES))))
        return pc.or_(gone, also(TABLES[table].key[0], shared)) if shared else gone

    def _own_batches(self) -> set[str]:
        """Batches whose rows are all about the scene."""
        own: set[str] = set()
        mixed: set[str] = set()
        for table, columns in self._columns.items():
            if {"scene_id", "batch_id"} <= set(columns):
                sql = "SELECT batch_id, bool_and(scene_id = $1) FROM {} GROUP BY batch_id HAVING bool_or(scene_id = $1)"
                for batch, alone in self._rows(table, sql, [self._scene]):
                    (own if alone else mixed).add(batch)
        return own - mixed

    def _rows(self, table: str, sql: str, parameters: Sequence[Any]) -> list[tuple[Any, ...]]:
        return list(self._connection.execute(sql.replace("{}", self._relations[table]), list(parameters)).fetchall())


def redacted_batch(batch: pa.RecordBatch, traces: Traces) -> pa.RecordBatch:
    """A batch with every name of the scene replaced in its texts."""
    columns = []
    for field, column in zip(batch.schema, batch.columns, strict=True):
        flat = column.flatten() if pa.types.is_list(field.type) else column
        if pa.types.is_string(flat.type) and any(pc.any(pc.match_substring(flat, core)).as_py() for core in traces.cores):
            column = pa.array([_redacted(value, traces) for value in column.to_pylist()], field.type)
        columns.append(column)
    return pa.RecordBatch.from_arrays(columns, schema=batch.schema)


def _redacted(value: Any, traces: Traces) -> Any:
    if isinstance(value, str):
        return traces.redacted(value)
    return [_redacted(item, traces) for item in value] if isinstance(value, list) else value


def _holds(column: str, kind: str, cores: Iterable[str]) -> str:
    """SQL that is true where a column of texts or of lists of texts holds one of some words."""
    text = column if kind == "VARCHAR" else f"{column}::VARCHAR"
    return "(" + " OR ".join(f"contains({text}, {literal(core)})" for core in cores) + ")"


def _list(values: Iterable[str]) -> str:
    return "(" + listed(sorted(values)) + ")"
