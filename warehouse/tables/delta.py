"""The lake's tables as Delta tables under `tables/<table>/`, flat, written by one committer at a time.

Every write starts from the version that the last snapshot names. A head that ran ahead of it (a commit that died
half-way) is restored first. Nothing is retried on a conflict: a conflict means that the lease was lost.
"""

from __future__ import annotations

import bisect
import itertools
import re
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from schemas.errors import InputError, LakeError
from schemas.record import Table
from schemas.text import one_line
from warehouse.questions.quoting import listed
from warehouse.questions.renames import former_columns
from warehouse.storage.files import Storage
from warehouse.storage.refusals import in_words, named
from warehouse.upkeep.references import parquet, workspace

if TYPE_CHECKING:
    from deltalake import DeltaTable

FOLDER = "tables"

# A file is rewritten when one of its scenes is replaced, so it holds no more bytes, and no more rows, than take a fraction of a
# second. Smaller files would cost every query more than they save: half a millisecond each.
FILE_BYTES = 12 * 2**20
_FILE_ROWS = 200_000
_LEAST_FILE_BYTES = 64 * 2**10

# Enough rows to tell how many bytes a row of a new table takes.
_SAMPLED_ROWS = 20_000

# Rows of a few scenes are found without decoding the rest of the file: readers skip row groups by their smallest and largest key.
ROW_GROUP_ROWS = 16_384

# Beyond this many, small files are put together.
SMALL_FILES_BEFORE_COMPACTION = 48

# A vacuum or an erasure may shorten a log between listing and reading it. Readers do not wait for it, they look again.
LOOK_AGAIN_SECONDS = (0.02, 0.1, 0.5)

# Columns that rows are looked up by.
_LOOKED_UP = ("scene_id", "asset_id", "room_id", "batch_id")

# Time travel must outlive delta-rs' thirty days of log, and files go only when no retained snapshot names them. Who opens a table reads
# every entry since the last checkpoint: of a hundred, which is delta-rs' own, they took 25 ms, and a request each to a store.
_CONFIGURATION = {"delta.enableExpiredLogCleanup": "false", "delta.deletedFileRetentionDuration": "interval 0 hours"}
_CONFIGURATION["delta.checkpointInterval"] = "10"


class LogError(LakeError):
    """A table's log that cannot be read, its folder, and the reason that delta-rs gives."""

    def __init__(self, folder: str, reason: str) -> None:
        self.folder = one_line(folder)
        self.reason = one_line((reason.strip().splitlines() or ["no reason is given"])[0])  # delta-rs adds its own stack
        super().__init__(folder, reason)

    def __str__(self) -> str:
        return f"{self.folder}: cannot be read ({self.reason}); `metascenes doctor lake` says what is damaged"


class DeltaTables:
    """The Delta tables of a lake, by name of the table."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        # Smallest and largest value of the columns that rows are looked up by. Files never change, so this holds for good.
        self._bounds: dict[str, dict[str, tuple[str, str]]] = {}

    def open(self, table: str, version: int | None = None) -> DeltaTable | None:
        """A table at a version (default: its head); None when it was never written.

        Raises:
            LogError: its log cannot be read.
        """
        from deltalake import DeltaTable
        from deltalake.exceptions import DeltaError, TableNotFoundError

        folder = f"{FOLDER}/{table}"
        # Asking the storage is ten times cheaper than letting delta-rs fail.
        if version is None and not self._storage.names(f"{folder}/_delta_log"):
            return None
        for pause in (*LOOK_AGAIN_SECONDS, None):
            try:
                return DeltaTable(self._storage.delta_address(folder), version=version, storage_options=self._storage.delta_options())
            except TableNotFoundError:
                return None
            except DeltaError as error:
                if pause is None:
                    raise LogError(f"{self._storage.address}/{folder}/_delta_log", str(error)) from error
                time.sleep(pause)
        raise AssertionError("the last look returns or raises")

    def files(self, table: str, opened: DeltaTable) -> list[str]:
        """Paths of a version's Parquet files, relative to the lake, sorted.

        Only the last part of delta-rs' addresses is used: the rest comes percent-encoded.
        """
        paths = sorted(f"{FOLDER}/{table}/{uri.rpartition('/')[2]}" for uri in opened.file_uris())
        if len(paths) > 1 and not self._bounds.keys() >= set(paths):
            self._bounds.update(_bounds(f"{FOLDER}/{table}", opened))
        return paths

    def read(
        self, table: Table, files: Sequence[str], columns: Sequence[str] | None = None, only: Mapping[str, Collection[Any]] | None = None
    ) -> pa.Table:
        """Rows of Parquet files under the schema of `table`; columns that a file lacks are null.

        ``only={"scene_id": ["a/b"]}`` keeps the rows whose scene is one of these; files and row groups that can hold none
        of them are not read.
        """
        schema = nullable(table.arrow_schema)
        names = list(columns) if columns is not None else schema.names
        wanted = {name: sorted(values) for name, values in (only or {}).items()}
        files = [file for file in files if all(self._may_hold(file, name, values) for name, values in wanted.items())]
        if not files or not all(wanted.values()):
            return pa.schema([schema.field(name) for name in names]).empty_table()
        with named(self._storage):
            return self._rows(table, files, names, wanted)

    def _rows(self, table: Table, files: Sequence[str], names: Sequence[str], wanted: Mapping[str, Sequence[str]]) -> pa.Table:
        import pyarrow.dataset as ds

        schema = nullable(table.arrow_schema)
        paths = [self._storage.arrow_path(file) for file in files]
        former, earlier = {after: before for before, after in former_columns(table.name).items()}, table.earlier
        for after, before in former.items():
            schema = schema.append(schema.field(after).with_name(before))
        taken = {name: _value(name, former.get(name), earlier.get(name)) for name in names} if former or earlier else names
        data = ds.dataset(paths, schema=schema, format="parquet", filesystem=self._storage.arrow_filesystem())
        if not wanted:
            return data.to_table(columns=taken)
        # Arrow prunes row groups by ranges, but not by lists of values.
        known = {name: values for name, values in wanted.items() if name not in former}
        parts = [part for fragment in data.get_fragments() if (part := _row_groups(fragment, known)) is not None]
        keep: Any = None
        for name, values in wanted.items():
            condition = _value(name, former.get(name)).isin(pa.array(values, schema.field(name).type))
            keep = condition if keep is None else keep & condition
        if len(parts) > 1 and not set(names) <= set(wanted):
            # Ids of content lie anywhere: look for them alone first, and read the rest of the files that hold them.
            held = ds.FileSystemDataset(parts, schema, data.format, data.filesystem).to_table(columns=["__filename"], filter=keep)
            holding = set(held.column(0).unique().to_pylist())
            parts = [part for part in parts if part.path in holding]
        return ds.FileSystemDataset(parts, schema, data.format, data.filesystem).to_table(columns=taken, filter=keep)

    def naming(self, files: Sequence[str], column: str, keys: Collection[str], but: Collection[str]) -> pa.Table:
        """The distinct pairs of scene and key of rows whose `column` is one of `keys`, of all scenes `but` these.

        Keys of content lie anywhere in a table, so all of the column is looked at; DuckDB does that six times as fast as Arrow.
        """
        schema = pa.schema([("scene_id", pa.string()), (column, pa.string())])
        if not files or not keys:
            return schema.empty_table()
        with workspace(self._storage) as connection:
            connection.register("sought", pa.table({column: pa.array(sorted(keys), pa.string())}))
            connection.register("known", pa.table({"scene_id": pa.array(sorted(but), pa.string())}))
            sql = f"SELECT DISTINCT scene_id, {column} FROM {parquet(self._storage, files)} SEMI JOIN sought USING ({column})"
            return connection.sql(f"{sql} ANTI JOIN known USING (scene_id)").to_arrow_table().cast(schema)

    def _may_hold(self, file: str, column: str, values: Sequence[str]) -> bool:
        """Whether a file can hold rows whose `column` is one of the sorted `values`, from what its table's log says."""
        bounds = self._bounds.get(file, {}).get(column)
        return bounds is None or _overlaps(values, *bounds)

    def sweep(self) -> None:
        """Remove the temporary files of writes that were killed. Only while the lease is held: nobody else writes here."""
        for name in self._storage.folders(FOLDER):
            for folder in (f"{FOLDER}/{name}", f"{FOLDER}/{name}/_delta_log"):
                for file in self._storage.names(folder):
                    # delta-rs writes `<file>#<number>` and `_commit_<id>.json.tmp`, and renames them.
                    if re.search(r"#[0-9]+$|^_commit_.*\.json\.tmp$", file):
                        self._storage.remove(f"{folder}/{file}")

    def writer(self, table: Table, version: int | None, check: Callable[[], None]) -> TableWriter:
        """A writer that starts from `version`, None for a table that no snapshot names. A head that is ahead of it is restored first."""
        writer = self.writer_from(table, self.open(table.name), check)
        writer.start_from(version)
        return writer

    def writer_from(self, table: Table, opened: DeltaTable | None, check: Callable[[], None]) -> TableWriter:
        """A writer that starts from a table as it was opened, and fails when anybody wrote to it since. `check`: before every change."""
        return TableWriter(self, self._storage, table, opened, check)


class TableWriter:
    """Writes one table, from one version on."""

    def __init__(self, tables: DeltaTables, storage: Storage, table: Table, opened: DeltaTable | None, check: Callable[[], None]) -> None:
        self._tables, self._storage, self._table, self._opened, self._check = tables, storage, table, opened, check
        self._is_leftover = False

    def start_from(self, version: int | None) -> None:
        """Bring the table to what it was at a version, None for a table that no snapshot names."""
        # A table that no snapshot names but that exists was left by a commit that died: all of it goes.
        self._is_leftover = version is None and self._opened is not None
        if version is None:
            return
        if self._opened is None or self._opened.version() < version:
            problem = f"version {version} is missing, which the snapshot names"
            raise InputError(self._address, "", problem, "restore the folder")
        if self._opened.version() > version:
            self._check()
            with in_words(self._address):
                self._opened.restore(version, commit_properties=self._unretried())
                self._opened.update_incremental()

    @property
    def _address(self) -> str:
        return f"{self._storage.address}/{FOLDER}/{self._table.name}"

    @property
    def version(self) -> int | None:
        """The version after the last write; None when nothing was written yet."""
        return None if self._opened is None or self._is_leftover else int(self._opened.version())

    @property
    def files(self) -> list[str]:
        """Paths of the current Parquet files, relative to the lake."""
        return [] if self._opened is None or self._is_leftover else self._tables.files(self._table.name, self._opened)

    def append(self, data: pa.Table | pa.RecordBatchReader) -> None:
        """Add rows."""
        self._write(data, mode="append", schema_mode="merge")

    def replace(self, data: pa.Table, column: str, values: Iterable[str]) -> None:
        """Put `data` in the place of all rows whose `column` is one of `values`."""
        if self.files and (chosen := listed(sorted(values))):
            self._write(data, mode="overwrite", schema_mode="merge", predicate=f"{column} IN ({chosen})")
        elif data.num_rows:
            self.append(data)

    def rewrite(self, data: pa.Table, facts: dict[str, str] | None = None) -> None:
        """Put `data` in the place of all rows, with `facts` kept beside the commit."""
        self._write(data, mode="overwrite", schema_mode="overwrite", facts=facts)

    def compact(self) -> None:
        """Put small files together when there are many."""
        if self._opened is None or len(self.files) <= SMALL_FILES_BEFORE_COMPACTION:
            return
        sizes, target = pa.table(self._opened.get_add_actions(flatten=True)).column("size_bytes").to_pylist(), file_bytes(self._opened)
        if sum(size < target // 2 for size in sizes) > SMALL_FILES_BEFORE_COMPACTION:
            self._check()
            with in_words(self._address):
                self._opened.optimize.compact(
                    target_size=target, writer_properties=writer_properties(), commit_properties=self._unretried()
                )

    def _write(
        self,
        data: pa.Table | pa.RecordBatchReader,
        *,
        mode: Any,
        schema_mode: Any,
        predicate: str | None = None,
        facts: dict[str, str] | None = None,
    ) -> None:
        from deltalake import DeltaTable, write_deltalake

        self._check()
        if self._is_leftover:
            mode, schema_mode, predicate, self._is_leftover = "overwrite", "overwrite", None, False
        is_new = self._opened is None
        if is_new:
            mode, schema_mode, predicate = "error", None, None
        options = self._storage.delta_options()
        address = self._storage.delta_address(f"{FOLDER}/{self._table.name}")
        data, target = _sampled(data, self._opened)
        with in_words(self._address):
            write_deltalake(
                address if self._opened is None else self._opened,
                data.cast(self._described(nullable(data.schema), schema_mode)),
                mode=mode,
                schema_mode=schema_mode,
                predicate=predicate,
                configuration=_CONFIGURATION if is_new else None,
                name=self._table.name if is_new else None,
                description=self._table.description if is_new else None,
                storage_options=options,
                target_file_size=target,
                writer_properties=writer_properties(),
                commit_properties=self._unretried(facts),
            )
        if self._opened is None:
            self._opened = DeltaTable(address, version=0, storage_options=options)

    def _described(self, schema: pa.Schema, schema_mode: Any) -> pa.Schema:
        """The schema with the stored descriptions of the columns that are stored already: Delta merges no two of them."""
        if self._opened is None or schema_mode != "merge":
            return schema
        stored = {field.name: {key: str(value) for key, value in field.metadata.items()} for field in self._opened.schema().fields}
        fields = [field.with_metadata(stored[field.name]) if field.name in stored else field for field in schema]
        return pa.schema(fields, metadata=schema.metadata)

    @staticmethod
    def _unretried(facts: dict[str, str] | None = None) -> Any:
        from deltalake import CommitProperties

        return CommitProperties(custom_metadata=dict(facts or {}), max_commit_retries=0)


def file_bytes(opened: DeltaTable) -> int:
    """How large a table's files are to be, from what its rows take now [B]."""
    actions = pa.table(opened.get_add_actions(flatten=True))
    size, rows = (sum(value or 0 for value in actions.column(name).to_pylist()) for name in ("size_bytes", "num_records"))
    return _bounded(size / rows) if rows else FILE_BYTES


def _bounded(bytes_per_row: float) -> int:
    return min(FILE_BYTES, max(_LEAST_FILE_BYTES, int(_FILE_ROWS * bytes_per_row)))


def _sampled(data: pa.Table | pa.RecordBatchReader, opened: DeltaTable | None) -> tuple[pa.Table | pa.RecordBatchReader, int]:
    """The rows, and how large their files are to be [B]."""
    import pyarrow.parquet as pq

    if isinstance(data, pa.Table) and data.num_rows <= _FILE_ROWS:
        return data, FILE_BYTES
    if opened is not None and opened.file_uris():
        return data, file_bytes(opened)
    if isinstance(data, pa.RecordBatchReader):
        first = next(iter(data), None)
        if first is None:
            return data.schema.empty_table(), FILE_BYTES
        sample = pa.Table.from_batches([first])
        data = pa.RecordBatchReader.from_batches(data.schema, itertools.chain([first], data))
    else:
        sample = data
    sample, sink = sample.slice(0, _SAMPLED_ROWS), pa.BufferOutputStream()
    pq.write_table(sample, sink, compression="zstd", row_group_size=ROW_GROUP_ROWS)
    return data, _bounded(sink.tell() / max(1, sample.num_rows))


def writer_properties() -> Any:
    """How delta-rs writes the lake's Parquet."""
    from deltalake import WriterProperties

    return WriterProperties(compression="ZSTD", max_row_group_size=ROW_GROUP_ROWS)


def _bounds(folder: str, opened: DeltaTable) -> dict[str, dict[str, tuple[str, str]]]:
    """Smallest and largest value per file and column of text, as the log has them.

    The log may cut long values off: what it says is then a bound, which is all that is asked of it.
    """
    actions = pa.table(opened.get_add_actions(flatten=True))
    bounds: dict[str, dict[str, tuple[str, str]]] = {f"{folder}/{path}": {} for path in actions.column("path").to_pylist()}
    names = set(actions.schema.names)
    for name in _LOOKED_UP:
        if {f"min.{name}", f"max.{name}"} <= names and pa.types.is_string(actions.schema.field(f"min.{name}").type):
            lows, highs = (actions.column(f"{end}.{name}").to_pylist() for end in ("min", "max"))
            for columns, low, high in zip(bounds.values(), lows, highs, strict=True):
                if low is not None and high is not None:
                    columns[name] = (low, high)
    return bounds


def _value(name: str, before: str | None, earlier: int | bool | None = None) -> Any:
    """A column of data files, some of which may have it under an old name, or be `earlier` than it, as Arrow's expression."""
    from pyarrow.compute import coalesce, field, scalar

    instead = [*([] if before is None else [field(before)]), *([] if earlier is None else [scalar(earlier)])]
    return coalesce(field(name), *instead) if instead else field(name)


def _row_groups(fragment: Any, wanted: Mapping[str, Sequence[str]]) -> Any:
    """The part of a Parquet file whose row groups can hold the sorted values; None when none can."""
    groups = []
    for group in fragment.row_groups:
        facts = group.statistics or {}
        known = {name: facts[name] for name in wanted if name in facts}
        if all(_overlaps(wanted[name], range_["min"], range_["max"]) for name, range_ in known.items()):
            groups.append(group.id)
    return fragment.subset(row_group_ids=groups) if groups else None


def _overlaps(values: Sequence[str], low: str, high: str) -> bool:
    """Whether one of the sorted `values` lies between two bounds, these included."""
    at = bisect.bisect_left(values, low)
    return at < len(values) and values[at] <= high


def nullable(schema: pa.Schema) -> pa.Schema:
    """The schema with every column nullable.

    Rows are checked before they are staged. In a stored table a column may be younger than a row, whatever the
    schema says of new rows, and a Delta table could not take such a column in otherwise.
    """
    return pa.schema([field.with_nullable(True) for field in schema], metadata=schema.metadata)
