"""The data files under a Delta table: writing sorted ones, exchanging some for others, and forgetting old versions.

A version of a table is a set of Parquet files. Whoever exchanges files makes a new version that shares all others with
the one before; nothing that an older version names is touched until that version is forgotten.
"""

from __future__ import annotations

import io
import json
import re
import time
import uuid
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from warehouse.storage.files import Entry, Storage
from warehouse.tables.delta import FILE_BYTES, FOLDER, ROW_GROUP_ROWS, DeltaTables

if TYPE_CHECKING:
    from deltalake import DeltaTable

# As delta-rs names them and as they are named here; a file with another name is none of the lake's.
DATA_FILE = re.compile(r"part-[0-9]{5}-[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}-c[0-9]{3}(\.[a-z0-9]+)?\.parquet")

_LOG_FILE = re.compile(r"([0-9]{20})(\.[0-9a-f-]+)?\.(json|checkpoint(\.[0-9]+\.[0-9]+)?\.parquet)")

# Longer texts say nothing that would let a reader skip a file.
_STATISTIC_BYTES = 64


def log_version(name: str) -> int | None:
    """The version that a file of a Delta log belongs to; None for other files."""
    match = _LOG_FILE.fullmatch(name)
    return int(match[1]) if match else None


def data_files(storage: Storage, table: str) -> Iterator[Entry]:
    """The data files that lie in a table's folder, whether a version names them or not."""
    for entry in storage.entries(f"{FOLDER}/{table}"):
        if DATA_FILE.fullmatch(entry.path.rpartition("/")[2]):
            yield entry


def log_files(storage: Storage, table: str) -> Iterator[tuple[int, Entry]]:
    """The files of a table's Delta log with their versions."""
    for entry in storage.entries(f"{FOLDER}/{table}/_delta_log"):
        version = log_version(entry.path.rpartition("/")[2])
        if version is not None:
            yield version, entry


def files_of(tables: DeltaTables, table: str, versions: Collection[int]) -> dict[int, list[str]]:
    """Paths of the data files of these versions of a table, relative to the lake."""
    files = {}
    for version in sorted(versions):
        opened = tables.open(table, version)
        if opened is not None:
            files[version] = tables.files(table, opened)
    return files


def write_files(
    storage: Storage, table: str, batches: Iterable[pa.RecordBatch], schema: pa.Schema, check: Callable[[], None], most: int = FILE_BYTES
) -> list[str]:
    """Write rows into new data files of about `most` bytes each, in their order; the paths. No version names them yet."""
    import pyarrow.parquet as pq

    paths: list[str] = []
    sink = io.BytesIO()
    writer: Any = None

    def finish() -> None:
        nonlocal sink, writer
        if writer is not None:
            writer.close()
            check()
            paths.append(f"{FOLDER}/{table}/part-{len(paths):05d}-{uuid.uuid4()}-c000.zstd.parquet")
            storage.write(paths[-1], sink.getvalue(), lasting=False)
            sink, writer = io.BytesIO(), None

    for group in _row_groups(batches, most):
        if writer is None:
            writer = pq.ParquetWriter(sink, schema, compression="zstd", compression_level=1)
        writer.write_table(group.cast(schema), row_group_size=group.num_rows)
        if sink.tell() >= most:
            finish()
    finish()
    return paths


def _row_groups(batches: Iterable[pa.RecordBatch], most: int) -> Iterator[pa.Table]:
    """Batches put together, or cut, to row groups: as many rows as delta-rs is told, fewer where they are large."""
    kept: list[pa.RecordBatch] = []
    rows = size = 0
    for batch in batches:
        step = max(1, min(ROW_GROUP_ROWS, batch.num_rows * most // max(batch.nbytes, 1)))
        for start in range(0, batch.num_rows, step):
            kept.append(batch.slice(start, step))
            rows, size = rows + kept[-1].num_rows, size + kept[-1].nbytes
            if rows >= ROW_GROUP_ROWS or size >= most:
                yield pa.Table.from_batches(kept)
                kept, rows, size = [], 0, 0
    if kept:
        yield pa.Table.from_batches(kept)


def exchange(
    tables: DeltaTables,
    storage: Storage,
    table: str,
    removed: Collection[str],
    added: Collection[str],
    check: Callable[[], None],
    forced: bool = False,
) -> int:
    """A new version of a table with some data files (paths) in the place of others; its number. Holds the lake's lease.

    Without any, the version stays, unless a new one is `forced`.

    Raises:
        DeltaError: somebody else wrote to the table meanwhile, who must have taken the lease over.
    """
    from deltalake import CommitProperties
    from deltalake.transaction import AddAction, RemoveAction

    opened = tables.open(table)
    if opened is None:
        raise ValueError(f"{table} was never written")
    now = int(time.time() * 1000)
    actions: list[Any] = [RemoveAction(path.rpartition("/")[2], True, now) for path in sorted(removed)]
    for path in sorted(added):
        size, statistics = _statistics(storage, path)
        actions.append(AddAction(path.rpartition("/")[2], size, {}, now, True, json.dumps(statistics)))
    if actions or forced:
        check()
        opened.create_write_transaction(actions, "append", opened.schema(), commit_properties=CommitProperties(max_commit_retries=0))
        opened.update_incremental()
    return int(opened.version())


def forget_before(tables: DeltaTables, storage: Storage, table: str, oldest: int, check: Callable[[], None], dry_run: bool = False) -> int:
    """Remove the part of a table's log that only versions before `oldest` need; its size [B]. Holds the lake's lease.

    A checkpoint takes its place, so that every later version opens as before. Data files stay.
    """
    old = [entry for version, entry in log_files(storage, table) if version < oldest]
    if not old or dry_run:
        return sum(entry.size for entry in old)
    opened = tables.open(table, oldest)
    if opened is None:
        return 0
    check()
    opened.create_checkpoint()
    # The newest go last: whoever is killed here leaves a log without a hole in front of the checkpoint.
    for entry in old:
        storage.remove(entry.path)
    return sum(entry.size for entry in old)


def remove_unnamed(storage: Storage, table: str, named: Collection[str], dry_run: bool = False) -> tuple[int, int]:
    """Remove the data files of a table that are not `named` (paths); how many and their size [B]. Holds the lake's lease."""
    count = size = 0
    for entry in data_files(storage, table):
        if entry.path not in named:
            if not dry_run:
                storage.remove(entry.path)
            count, size = count + 1, size + entry.size
    return count, size


def ranges(opened: DeltaTable, column: str) -> list[tuple[str, int, str | None, str | None]]:
    """Every data file's name, size [B], least and greatest value of a column (None where nobody noted them)."""
    actions = pa.table(opened.get_add_actions(flatten=True))
    names, sizes = actions.column("path").to_pylist(), actions.column("size_bytes").to_pylist()
    low, high = (
        actions.column(f"{side}.{column}").to_pylist() if f"{side}.{column}" in actions.column_names else [None] * len(names)
        for side in ("min", "max")
    )
    return list(zip(names, sizes, low, high, strict=True))


def _statistics(storage: Storage, path: str) -> tuple[int, Mapping[str, Any]]:
    """Size [B] of a data file, and what Delta notes of its columns: least and greatest values, and how many are missing."""
    import pyarrow.parquet as pq

    filesystem = storage.arrow_filesystem()
    place = storage.arrow_path(path)
    footer = pq.read_metadata(place, filesystem=filesystem)
    low: dict[str, Any] = {}
    high: dict[str, Any] = {}
    missing: dict[str, int] = {}
    unknown: set[str] = set()
    for group in range(footer.num_row_groups):
        for index in range(footer.num_columns):
            chunk = footer.row_group(group).column(index)
            name, noted = chunk.path_in_schema, chunk.statistics
            if "." in name or noted is None or not noted.has_null_count:
                unknown.add(name)
                continue
            missing[name] = missing.get(name, 0) + noted.null_count
            if noted.num_values == 0:
                continue
            if not noted.has_min_max or not all(_is_telling(value) for value in (noted.min, noted.max)):
                unknown.add(name)
                continue
            low[name] = min(low.get(name, noted.min), noted.min)
            high[name] = max(high.get(name, noted.max), noted.max)
    kept = [{name: value for name, value in values.items() if name not in unknown} for values in (low, high, missing)]
    return filesystem.get_file_info(place).size, {
        "numRecords": footer.num_rows, "minValues": kept[0], "maxValues": kept[1], "nullCount": kept[2],
    }  # fmt: skip


def _is_telling(value: Any) -> bool:
    """Whether Delta can note a value: a whole number, or a text of a few words."""
    if isinstance(value, str):
        return len(value.encode()) <= _STATISTIC_BYTES
    return isinstance(value, int) and not isinstance(value, bool)


def changing() -> list[tuple[Any, str]]:
    """Functions of delta-rs that change a table, by owner and name: for code that intercepts each of them."""
    import deltalake
    from deltalake.table import TableOptimizer

    names = ("restore", "create_write_transaction", "create_checkpoint", "cleanup_metadata")
    return [(deltalake, "write_deltalake"), *((deltalake.DeltaTable, name) for name in names), (TableOptimizer, "compact")]
