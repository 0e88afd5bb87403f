"""Compaction: a table's small files are put together, sorted by key, so that a scene's rows lie side by side.

Rows stay what they are. Files that are large enough and in order already are left alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Sequence

import pyarrow as pa

from schemas.errors import InputError
from schemas.record import Table
from schemas.runs import Snapshot
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.questions.quoting import quoted
from warehouse.tables.adoption import now_utc
from warehouse.tables.commit import Commit, versions_of
from warehouse.tables.datafiles import exchange, ranges, write_files
from warehouse.tables.delta import FILE_BYTES, FOLDER, file_bytes
from warehouse.upkeep.references import parquet, workspace

NOTE = "compaction"

_BATCH_ROWS = 32_768


@dataclasses.dataclass(frozen=True)
class Compacted:
    """What a compaction did, or would do, to a table: files and bytes that were read, and what took their place."""

    table: str
    files_before: int
    files_rewritten: int
    files_after: int
    bytes_rewritten: int
    bytes_after: int


@dataclasses.dataclass(frozen=True)
class Compaction:
    """A compaction: the snapshot that it made (None where there was nothing to do, or on a dry run), and its tables."""

    snapshot_id: int | None
    tables: tuple[Compacted, ...]


def compact(
    lake: Lake,
    only: Collection[str] = (),
    *,
    dry_run: bool = False,
    target_bytes: int = FILE_BYTES,
    timeout: float = 300.0,
    advance: Callable[[str], None] = lambda table: None,
) -> Compaction:
    """Put small and overlapping files of the tables (`only` these) together, as a new snapshot with the same rows.

    Tables that need nothing are not among the result. `advance` is told each table that is over.

    Raises:
        InputError: there is no such table.
        LeaseError: another process holds the lake's lease for more than `timeout` seconds.
    """
    for name in only:
        if name not in TABLES:
            raise InputError(lake.address, name, "there is no such table", f"the tables are {', '.join(TABLES)}")
    if not lake.exists:
        return Compaction(None, ())
    with lake.leased(timeout) as lease:
        commit = Commit(lake.tables, lake.staging, lease)
        if not dry_run:
            commit.remove_adopted()
        every = lake.snapshot().snapshots
        if not every:
            return Compaction(None, ())
        versions = versions_of(every[-1])
        done = []
        for name in sorted(set(only) & set(versions) if only else versions):
            if name in TABLES:
                result = _compact_table(lake, TABLES[name], versions, lease.check, dry_run, target_bytes)
                if result is not None:
                    done.append(result)
            advance(name)
        if dry_run or not done:
            return Compaction(None, tuple(done))
        tables = tuple(f"{name}={versions[name]}" for name in sorted(versions))
        snapshot = Snapshot(snapshot_id=every[-1].snapshot_id + 1, created_at=now_utc(), tables=tables, note=NOTE)
        commit.rewrite_snapshots([*every, snapshot])
        return Compaction(snapshot.snapshot_id, tuple(done))


def _compact_table(
    lake: Lake, table: Table, versions: dict[str, int], check: Callable[[], None], dry_run: bool, target: int
) -> Compacted | None:
    """Rewrite what is small or out of order, and note the new version in `versions`; None where there is nothing to do."""
    opened = lake.tables.open(table.name, versions[table.name])
    if opened is None:
        raise InputError(lake.address, table.name, f"version {versions[table.name]} is missing", "restore the folder")
    target = min(target, file_bytes(opened))
    files = ranges(opened, table.key[0])
    chosen = _worth_rewriting(files, target)
    if not chosen:
        return None
    size = sum(bytes_ for name, bytes_, *_ in files if name in chosen)
    old = [f"{FOLDER}/{table.name}/{name}" for name in sorted(chosen)]
    if dry_run:
        likely = max(1, round(size / target))
        return Compacted(table.name, len(files), len(old), len(files) - len(old) + likely, size, size)
    writer = lake.tables.writer(table, versions[table.name], check)  # restores a head that ran ahead
    new = _rewritten(lake, table, old, pa.schema(opened.schema().to_arrow()), check, target)
    versions[table.name] = exchange(lake.tables, lake.storage, table.name, old, new, check)
    sizes = {entry.path: entry.size for entry in lake.storage.entries(f"{FOLDER}/{table.name}")}
    written = sum(sizes[path] for path in new)
    return Compacted(table.name, len(writer.files), len(old), len(files) - len(old) + len(new), size, written)


def _rewritten(lake: Lake, table: Table, files: Sequence[str], schema: pa.Schema, check: Callable[[], None], target: int) -> list[str]:
    """Write the rows of these files into new ones, sorted by key; the paths. Rows pass by in batches, sorted on disk."""
    with workspace(lake.storage) as connection:
        # The empty relation gives columns that no file has yet, and the stored types.
        connection.register("stored", schema.empty_table())
        relation = f"(SELECT * FROM stored UNION ALL BY NAME SELECT * FROM {parquet(lake.storage, files)})"
        columns = ", ".join(quoted(name) for name in schema.names)
        order = ", ".join(quoted(name) for name in table.key if name in schema.names)  # it may be older than a column
        batches = connection.sql(f"SELECT {columns} FROM {relation} ORDER BY {order}").to_arrow_reader(_BATCH_ROWS)
        return write_files(lake.storage, table.name, batches, schema, check, target)


def _worth_rewriting(files: Sequence[tuple[str, int, str | None, str | None]], target: int) -> set[str]:
    """Names of the files to rewrite: those whose key ranges overlap, and neighbors of which one is small."""
    if any(low is None or high is None for _, _, low, high in files):
        return {name for name, *_ in files} if len(files) > 1 else set()
    groups: list[list[tuple[str, int]]] = []
    end = ""
    for name, size, low, high in sorted(files, key=lambda file: (file[2] or "", file[3] or "", file[0])):
        if groups and str(low) < end:  # touching is well: a scene may go on in the next file
            groups[-1].append((name, size))
        else:
            groups.append([(name, size)])
        end = max(end, str(high))
    chosen: set[str] = set()
    run: list[tuple[str, int]] = []

    def close() -> None:
        nonlocal run
        if len(run) > 1:
            chosen.update(name for name, _ in run)
        run = []

    for group in groups:
        is_fine = len(group) == 1 and group[0][1] >= target / 2
        if is_fine:
            close()
        else:
            run.extend(group)
    close()
    # A file on its own is rewritten where it is far too large: replacing one of its scenes rewrites all of it.
    chosen.update(name for name, size, *_ in files if size > 3 * target)
    return chosen
