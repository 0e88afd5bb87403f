"""Staged runs: what a worker left for the committer, one Parquet file per table, the run's own row last.

Files lie flat in `staged/`, so that one listing shows all of them, and are named
`<scene>@<stage>@<fingerprint>@<token>@<table>.parquet`. A staged run counts only when its `stage_runs` file is there.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import re
import time
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import pyarrow as pa

from schemas.errors import InputError, LakeError, RecordError
from schemas.record import Table, arrow_to_rows, rows_to_arrow
from schemas.runs import StageRun
from schemas.tables import TABLES
from warehouse.sharing.writer import Writer, new_token, writer_of
from warehouse.storage.files import Storage

FOLDER = "staged"
_RUNS = "stage_runs"

HELD_BYTES = 64 * 2**20
"""Of staged files whose rows a commit holds from its first look at them on. What is beyond is read again in its turn."""


@dataclasses.dataclass(frozen=True)
class StagedRun:
    """A complete staged run: its row, its token (unique for ever), and the file of every table with rows."""

    run: StageRun
    token: str
    files: Mapping[str, str]
    run_file: str

    @property
    def is_abandoned(self) -> bool:
        """Whether the writer is dead, or cannot be asked and was done with this a day ago (see `is_left_over`)."""
        return is_left_over(writer_of(self.token), self.run.started_at.timestamp() + self.run.seconds)


class _Looked(NamedTuple):
    """Rows of a staged run's files by path, the size of these [B], and what is wrong with them, in a few words."""

    rows: dict[str, pa.Table]
    size: int
    fault: str | None


class Staging:
    """The staged runs of a lake."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self._known: dict[str, StageRun] = {}  # by path of the run's file: files never change once they are there
        # What was staged under a fingerprint, by how its names begin: whoever asks for one table asks for others, and a folder on a disk
        # is listed as a whole. Looked for again once it is gone.
        self._found: dict[str, dict[str, dict[str, str]]] = {}

    def stage(self, run: StageRun, rows: Mapping[str, Sequence[Any]]) -> None:
        """Leave a run and its rows for the committer.

        `row_counts` of the run is filled in here, for every table that the stage writes.

        Raises:
            RecordError: a row breaks its schema or belongs to another scene.
            LakeError: a table belongs to another stage, or a run that is not done has rows.
        """
        own = [table for table in TABLES.values() if run.stage and table.stage == run.stage]
        wrong = sorted(set(rows) - {table.name for table in own})
        if wrong:
            raise LakeError(f"stage {run.stage} does not write {', '.join(wrong)}")
        if run.outcome != "done" and any(rows.values()):
            raise LakeError(f"{run.scene_id}: stage {run.stage} is {run.outcome} and must not leave rows")
        stem = f"{FOLDER}/{quoted_scene(run.scene_id)}@{run.stage}@{run.fingerprint}@{new_token()}"
        tables = {table.name: rows_to_arrow(rows.get(table.name, ()), table.record) for table in own}
        for table in own:
            if table.rule == "replace":
                _check_owner(rows.get(table.name, ()), table, run.scene_id)
        if run.outcome == "done":
            run = dataclasses.replace(run, row_counts=tuple(f"{name}={data.num_rows}" for name, data in tables.items()))
        files = {f"{stem}@{name}.parquet": _parquet(data) for name, data in tables.items() if data.num_rows}
        self._storage.write_together(files | {f"{stem}@{_RUNS}.parquet": _parquet(rows_to_arrow([run], StageRun))})

    def runs(self) -> list[StagedRun]:
        """All complete staged runs, sorted by scene, stage, start and token."""
        complete = {stem: files for stem, files in self._by_stem().items() if _RUNS in files}
        rows = self._run_rows([files[_RUNS] for files in complete.values()])
        self._known = dict(rows)
        runs = [
            StagedRun(
                run=rows[files[_RUNS]],
                token=stem.split("@")[3],
                files={table: path for table, path in files.items() if table != _RUNS},
                run_file=files[_RUNS],
            )
            for stem, files in complete.items()
            if files[_RUNS] in rows
        ]
        return sorted(runs, key=lambda staged: (staged.run.scene_id, staged.run.stage, staged.run.started_at, staged.token))

    def has(self, scene_id: str) -> bool:
        """Whether any file is staged for a scene."""
        return bool(self._storage.names(FOLDER, f"{quoted_scene(scene_id)}@"))

    def rows(self, table: str, scene_id: str, fingerprint: str) -> list[Any] | None:
        """Rows that the newest complete staged run of a fingerprint left in a table; None when there is no such run.

        Which one that is, is looked for once, and again when it is gone.
        """
        head = f"{quoted_scene(scene_id)}@{TABLES[table].stage}@{fingerprint}@"
        former = self._found.get(head)
        if former is not None:
            rows = self._newest_rows(former, table)
            if rows is not None:
                return rows
            self._found.pop(head, None)
        stems = {stem: files for stem, files in self._by_stem(head).items() if _RUNS in files}
        rows = self._newest_rows(stems, table)
        if rows is not None:
            self._found[head] = stems
        return rows

    def _newest_rows(self, stems: Mapping[str, Mapping[str, str]], table: str) -> list[Any] | None:
        """Rows of a table that the newest of some staged runs left; None where none is done, or it was committed meanwhile."""
        read = self._run_rows([files[_RUNS] for files in stems.values()])
        self._known.update(read)
        runs = [(read[files[_RUNS]], stem) for stem, files in stems.items() if files[_RUNS] in read]
        done = sorted(((run.started_at, run.attempt, stem) for run, stem in runs if run.outcome == "done"), reverse=True)
        if not done:
            return None
        files = stems[done[0][2]]
        if table not in files:
            return [] if self._storage.exists(files[_RUNS]) else None
        try:
            return arrow_to_rows(self.read(files[table]), TABLES[table].record)
        except FileNotFoundError:
            return None

    def blob_names(self) -> set[str]:
        """Names of the blobs that staged rows name, complete runs or not."""
        names: set[str] = set()
        for files in self._by_stem().values():
            for table, path in files.items():
                columns = TABLES[table].blob_columns if table in TABLES else ()
                rows = self.read(path) if columns else None
                for column in columns if rows is not None else ():
                    names.update(name for name in rows.column(column).to_pylist() if name is not None)  # type: ignore[union-attr]
        return names

    def read(self, path: str) -> pa.Table:
        """Rows of a staged file.

        Raises:
            FileNotFoundError: it is gone, since its run was committed.
            InputError: it is damaged.
        """
        try:
            return _rows_in(self._storage.read(path))
        except pa.ArrowException as error:
            raise InputError(f"{self._storage.address}/{path}", "", f"cannot be read ({error})", "remove it and rerun") from error

    def taken(self, runs: Sequence[StagedRun]) -> tuple[dict[str, pa.Table], dict[str, str]]:
        """Rows of the files of staged runs by path, of files of `HELD_BYTES`, and what is wrong with some of the runs, by token."""
        rows: dict[str, pa.Table] = {}
        faults: dict[str, str] = {}
        held = 0
        for staged, looked in zip(runs, self._storage.each(self._looked_at, runs), strict=True):
            if looked.fault is not None:
                faults[staged.token] = looked.fault
            elif held + looked.size <= HELD_BYTES:
                rows |= looked.rows
                held += looked.size
        return rows, faults

    def fault(self, staged: StagedRun) -> str | None:
        """What is wrong with a staged run's files, in a few words; None when they hold what its row says."""
        return self._looked_at(staged).fault

    def _looked_at(self, staged: StagedRun) -> _Looked:
        rows: dict[str, pa.Table] = {}
        size = 0
        for name, _, count in (entry.partition("=") for entry in staged.run.row_counts):
            if name not in TABLES:
                return _Looked({}, 0, f"{name} is no table of this version")
            if int(count) == 0:
                continue
            try:
                content = self._storage.read(staged.files[name])  # a store that is away says nothing of the run: the commit waits
            except (KeyError, FileNotFoundError):
                return _Looked({}, 0, f"the staged file of {name} is missing")
            try:
                data = _rows_in(content)
            except (pa.ArrowException, OSError) as error:
                if isinstance(error, MemoryError):
                    raise
                return _Looked({}, 0, f"the staged file of {name} cannot be read ({' '.join(str(error).split())})")
            if data.num_rows != int(count):
                return _Looked({}, 0, f"the staged file of {name} has {data.num_rows} rows instead of {count}")
            if not data.schema.equals(TABLES[name].arrow_schema):
                return _Looked({}, 0, f"the staged file of {name} was written under another schema")
            rows[staged.files[name]] = data
            size += data.nbytes
        return _Looked(rows, size, None)

    def remove(self, runs: Sequence[StagedRun]) -> None:
        """Remove staged runs; the runs' own rows first, so that what is left never counts."""
        self._storage.remove_all([staged.run_file for staged in runs])
        self._storage.remove_all([path for staged in runs for path in staged.files.values()])

    def remove_tokens(self, tokens: Collection[str]) -> None:
        """Remove every file of the staged runs with these tokens, complete or not."""
        ours = [files for stem, files in self._by_stem().items() if stem.split("@")[3] in tokens]
        self._storage.remove_all([files[_RUNS] for files in ours if _RUNS in files])
        self._storage.remove_all([path for files in ours for table, path in files.items() if table != _RUNS])

    def remove_incomplete(self) -> None:
        """Remove what dead writers left without the run's own row."""
        incomplete = {path for files in self._by_stem().values() if _RUNS not in files for path in files.values()}
        for entry in self._storage.entries(FOLDER) if incomplete else ():
            if entry.path in incomplete and is_left_over(writer_of(entry.path.split("@")[3]), entry.modified):
                self._storage.remove(entry.path)

    def _by_stem(self, head: str = "") -> dict[str, dict[str, str]]:
        """Paths by stem and table. Only names of the right shape: anything else is not ours to touch."""
        by_stem: dict[str, dict[str, str]] = {}
        for name in self._storage.names(FOLDER, head):
            stem, at, last = name.rpartition("@")
            if at and last.endswith(".parquet") and stem.count("@") == 3:
                by_stem.setdefault(stem, {})[last.removesuffix(".parquet")] = f"{FOLDER}/{name}"
        return by_stem

    def _run_rows(self, paths: Sequence[str]) -> dict[str, StageRun]:
        """Run rows by path; those that were read before are not read again, those that are gone were committed meanwhile."""
        known = self._known
        rows = {path: known[path] for path in paths if path in known}
        new = [path for path in paths if path not in rows]
        is_local = self._storage.local_path(FOLDER) is not None  # a store would be asked four times for each
        if is_local and len(new) > 1 and (together := self._run_rows_together(new)) is not None:
            return rows | together
        for path, data in zip(new, self._storage.each(self._read_if_there, new), strict=True):
            if data is None:
                continue
            if data.num_rows != 1 or not _are_runs(data):
                raise InputError(f"{self._storage.address}/{path}", "", "is no staged run: its columns are others", "remove it")
            rows[path] = arrow_to_rows(data, StageRun)[0]
        return rows

    def _read_if_there(self, path: str) -> pa.Table | None:
        with contextlib.suppress(FileNotFoundError):
            return self.read(path)
        return None

    def _run_rows_together(self, paths: Sequence[str]) -> dict[str, StageRun] | None:
        """The same of several, in several threads and one pass; None where one of them is gone or damaged: file by file shows which."""
        import pyarrow.dataset as ds

        places = [self._storage.arrow_path(path) for path in paths]
        filesystem, schema = self._storage.arrow_filesystem(), TABLES[_RUNS].arrow_schema
        try:
            data = ds.dataset(places, format="parquet", filesystem=filesystem, schema=schema).to_table()
        except (pa.ArrowException, OSError):
            return None
        is_whole = data.num_rows == len(paths) and _are_runs(data)
        return dict(zip(paths, arrow_to_rows(data, StageRun), strict=True)) if is_whole else None


def _are_runs(data: pa.Table) -> bool:
    """Whether rows have what every run has: a file that somebody dropped here may hold anything."""
    needed = [field for field in TABLES[_RUNS].arrow_schema if not field.nullable]
    if not {field.name for field in needed} <= set(data.column_names):
        return False
    return all(data.schema.field(field.name).type == field.type and not data[field.name].null_count for field in needed)


def is_left_over(writer: Writer | None, modified: float) -> bool:
    """Whether a writer's file can be removed: the writer is dead, or cannot be asked and the file is a day old.

    A file whose name gives no writer is none of the lake's.
    """
    if writer is None:
        return False
    if writer.is_here:
        return not writer.is_alive
    return time.time() - modified > 86_400


def quoted_scene(scene_id: str) -> str:
    """A scene as part of a file name: other characters than [A-Za-z0-9_.-] as ~xx; long ones end in a hash."""
    quoted = re.sub(r"[^A-Za-z0-9_.-]", lambda match: "".join(f"~{byte:02x}" for byte in match[0].encode()), scene_id)
    # A file name holds 255 bytes; the rest of it takes up to 145.
    return quoted if len(quoted) <= 100 else f"{quoted[:80]}~~{hashlib.sha256(scene_id.encode()).hexdigest()[:16]}"


def _check_owner(rows: Sequence[Any], table: Table, owner: str) -> None:
    for index, row in enumerate(rows):
        value = getattr(row, table.owner)
        if value != owner:
            raise RecordError(table.name, str(index), table.owner, f"must be the run's {table.grain} {owner}, got {value}")


def _parquet(data: pa.Table) -> bytes:
    """A staged file: read once and soon, it goes without what serves long-lived ones, half of whose time is reading that."""
    import pyarrow.parquet as pq

    sink = io.BytesIO()
    plain = pa.schema([field.remove_metadata() for field in data.schema])
    pq.write_table(data.cast(plain), sink, use_dictionary=False, write_statistics=False)
    return sink.getvalue()


def _rows_in(content: bytes) -> pa.Table:
    """Rows of a staged file. Such small ones take a third of the time without threads and read-ahead."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(pa.BufferReader(content), pre_buffer=False) as file:
        return file.read(use_threads=False)
