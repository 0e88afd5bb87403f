"""Backup and restore: a copy of a lake's snapshots, with all that they name, at another address.

A backup is itself a lake, which opens and can be asked. Files are copied before what names them, the log of `snapshots`
last, so that whoever is killed leaves the backup that was there before, and the same command again finishes the job.
What is there already is not copied again: blobs are named by their hashes, and data files never change.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow as pa

from schemas.errors import InputError
from schemas.parsing import json_value
from schemas.tables import TABLES
from warehouse.lake import MARKER, Lake
from warehouse.sharing.writer import writer_of
from warehouse.storage.blobs import FOLDER as BLOB_FOLDER
from warehouse.storage.files import TEMPORARY, Storage, storage_at
from warehouse.tables.adoption import now_utc
from warehouse.tables.commit import versions_of
from warehouse.tables.datafiles import files_of, log_files
from warehouse.tables.released import FOLDER as RELEASE_FOLDER
from warehouse.tables.released import RECORD, folder_of, released
from warehouse.tables.staging import is_left_over
from warehouse.upkeep.references import BlobReferences, workspace

SUMMARY = "backup.json"
MANIFEST = "backup.parquet"
UNFINISHED = "restore.json"

_THREADS = 8
_ATTEMPTS = 3

Advance = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Copied:
    """A backup or a restore: the last snapshot, files and bytes in all, those copied now, and files that went."""

    snapshot_id: int
    files: int
    bytes: int
    copied_files: int
    copied_bytes: int
    removed_files: int


@dataclasses.dataclass(frozen=True, slots=True)
class _File:
    path: str
    size: int
    sha256: str


def backup(lake: Lake, address: str | Path, *, advance: Advance = lambda path: None) -> Copied:
    """Copy all snapshots and releases of a lake to an address, or what is new since the last time. Nobody has to wait.

    What is staged and not committed is not part of it. What the lake has no more (vacuumed, erased) leaves the backup, too.

    Raises:
        InputError: the address holds other files or another lake's backup, a blob or file of the lake is missing, or an
            erasure is not finished.
    """
    target = storage_at(address)
    if target.address == lake.address or target.address.startswith(f"{lake.address}/"):
        raise InputError(target.address, "", "lies in the lake itself", "choose another folder")
    if not lake.exists or lake.snapshot().snapshot is None:
        raise InputError(lake.address, "", "the lake has no snapshot yet", "run something first")
    if lake.storage.exists("erasure.json"):
        raise InputError(lake.address, "erasure.json", "an erasure is not finished", "give `metascenes lake erase` again")
    for attempt in range(_ATTEMPTS):
        try:
            return _Backup(lake, target, advance).carry_out()
        except FileNotFoundError as error:
            # A vacuum ran meanwhile, and the next look shows what is left; or the file is really gone.
            if attempt == _ATTEMPTS - 1:
                missing = str(error.filename or error)
                raise InputError(lake.address, missing, "is missing", "see `metascenes doctor lake`") from error
    raise AssertionError("the last attempt returns or raises")


def restore(address: str | Path, lake_address: str | Path, *, advance: Advance = lambda path: None) -> Copied:
    """Make a lake at a new, empty address out of a backup; every file is held against its hash.

    Raises:
        InputError: the address is not empty, there is no whole backup, or a file of it is damaged.
    """
    source, target = storage_at(address), storage_at(lake_address)
    summary = _summary(source)
    if summary is None or not summary.get("complete"):
        raise InputError(source.address, SUMMARY, "there is no whole backup", "name the folder of a backup that was finished")
    own = json.dumps({"backup": summary["created_at"], "lake": summary["lake"]}).encode()
    begun = target.read(UNFINISHED) if target.exists(UNFINISHED) else None
    present = [name for name in (*target.names(""), *target.folders("")) if name not in (UNFINISHED, TEMPORARY)]
    if begun != own and (present or begun is not None):
        name = UNFINISHED if begun is not None else present[0]
        raise InputError(target.address, name, "the address is not empty", "give a new or empty one")
    _sweep(target)
    target.write(UNFINISHED, own)
    files = _manifest(source)
    there = {entry.path: entry.size for entry in target.walk("")} if begun is not None else {}
    done = _copy_all(source, target, [file for file in files if file.path != MARKER], there, advance)
    _sync(target)
    done += _copy_all(source, target, [file for file in files if file.path == MARKER], {}, advance)
    target.remove(UNFINISHED)
    size = sum(file.size for file in files)
    return Copied(int(str(summary["snapshot_id"])), len(files), size, len(done), sum(file.size for file in done), 0)


class _Backup:
    """One backup, of the snapshots that the lake has when it begins."""

    def __init__(self, lake: Lake, target: Storage, advance: Advance) -> None:
        self._lake, self._source, self._target, self._advance = lake, lake.storage, target, advance
        self._snapshots = lake.snapshot().snapshots
        opened = lake.tables.open("snapshots")
        if opened is None:
            raise FileNotFoundError("tables/snapshots")
        # A snapshot that is committed from here on is left to the next backup.
        self._head = int(opened.version())
        self._identity = str(opened.metadata().id)
        self._known = {file.path: file for file in _manifest(target)} if target.exists(MANIFEST) else {}
        self._files: list[_File] = []
        self._copied: list[_File] = []

    def carry_out(self) -> Copied:
        """Copy everything, what names others after these."""
        self._claim()
        logs = self._logs()
        for paths in (self._data_files(), self._blobs(), self._release_files()):
            self._copy(paths)
        _sync(self._target)
        self._copy([path for table, path in logs if table != "snapshots"])
        self._copy([path for table, path in logs if table == "snapshots"])
        self._copy([MARKER])
        removed = self._finish()
        sizes = [sum(file.size for file in files) for files in (self._files, self._copied)]
        return Copied(self._snapshots[-1].snapshot_id, len(self._files), sizes[0], len(self._copied), sizes[1], removed)

    def _claim(self) -> None:
        """Take the address for this lake's backups.

        Raises:
            InputError: it holds something else.
        """
        summary = _summary(self._target)
        present = [name for name in (*self._target.names(""), *self._target.folders("")) if name != TEMPORARY]
        if summary is None and present:
            raise InputError(self._target.address, present[0], "the address holds other files", "give a new or empty one")
        if summary is not None and summary.get("lake") != self._identity:
            raise InputError(self._target.address, SUMMARY, "this is the backup of another lake", "give a new or empty address")
        for version, entry in log_files(self._target, "snapshots"):
            same = version <= self._head and (not entry.path.endswith(".json") or self._is_same(entry.path))
            if not same:
                problem = "the backup's history is not that of the lake: one of them was restored from an older state"
                raise InputError(self._target.address, entry.path, problem, "give a new or empty address")
        _sweep(self._target)
        if summary is None:
            self._target.write(SUMMARY, json.dumps({"complete": False, "lake": self._identity}).encode())

    def _is_same(self, path: str) -> bool:
        """Whether a file of the backup is what the lake has; True where the lake has none (its log was shortened)."""
        try:
            return self._source.read(path) == self._target.read(path)
        except FileNotFoundError:
            return True

    def _logs(self) -> list[tuple[str, str]]:
        """Tables and paths of the Delta logs, up to the versions that the snapshots name."""
        last = {"snapshots": self._head}
        for row in self._snapshots:
            for table, version in versions_of(row).items():
                last[table] = max(last.get(table, 0), version)
        logs = []
        for table, newest in last.items():
            logs += [(table, entry.path) for version, entry in log_files(self._source, table) if version <= newest]
        return logs

    def _data_files(self) -> list[str]:
        paths = set(files_of(self._lake.tables, "snapshots", [self._head]).get(self._head, []))
        for table, version in sorted({pair for row in self._snapshots for pair in versions_of(row).items()}):
            files = files_of(self._lake.tables, table, [version])
            if version not in files:
                raise InputError(self._lake.address, table, f"version {version} is missing", "see `metascenes doctor lake`")
            paths |= set(files[version])
        self._tables = sorted(paths)
        return self._tables

    def _blobs(self) -> Iterator[str]:
        """Blobs that rows of any snapshot name."""
        with workspace(self._source) as connection:
            references = BlobReferences(connection, self._source)
            for table in TABLES:
                references.add_files(table, [path for path in self._tables if path.split("/")[1] == table])
            references.finish()
            for folder in references.folders():
                for name in references.names(folder):
                    yield f"{BLOB_FOLDER}/{name[:2]}/{name[2:4]}/{name}"

    def _release_files(self) -> list[str]:
        """Files of the releases, each one's record last."""
        known = {row.snapshot_id for row in self._snapshots}
        paths: list[str] = []
        for release in released(self._source):
            if release.snapshot_id in known:
                folder = folder_of(release.name)
                record = f"{folder}/{RECORD}"
                if self._target.exists(record) and not self._is_same(record):  # something was erased from it
                    self._known = {path: file for path, file in self._known.items() if not path.startswith(f"{folder}/")}
                paths += sorted(entry.path for entry in self._source.walk(folder) if entry.path != record)
                paths.append(record)
        return paths

    def _copy(self, paths: Iterable[str]) -> None:
        """Copy what the backup has not; note everything."""
        chunk: list[str] = []
        for path in paths:
            chunk.append(path)
            if len(chunk) >= 4096:
                self._copy_chunk(chunk)
                chunk = []
        self._copy_chunk(chunk)

    def _copy_chunk(self, paths: Sequence[str]) -> None:
        folders = {path.rpartition("/")[0] for path in paths}
        if paths and paths[0].startswith(f"{BLOB_FOLDER}/"):
            listed = [entry for folder in sorted({path[: len(BLOB_FOLDER) + 3] for path in paths}) for entry in self._target.walk(folder)]
        else:
            listed = [entry for folder in sorted(folders) for entry in self._target.entries(folder)]
        there = {entry.path: entry.size for entry in listed}

        def copied(path: str) -> tuple[_File, bool]:
            known = self._known.get(path)
            is_log = "/_delta_log/" in path
            if path in there and path.startswith(f"{BLOB_FOLDER}/"):  # written whole or not at all, and hashed before
                return _File(path, there[path], path.rpartition("/")[2].partition(".")[0]), False
            if path in there and known is not None and there[path] == known.size and not is_log and path != MARKER:
                return known, False
            data = self._source.read(path)
            file = _File(path, len(data), hashlib.sha256(data).hexdigest())
            if path.startswith(f"{BLOB_FOLDER}/") and file.sha256 != path.rpartition("/")[2].partition(".")[0]:
                raise InputError(self._lake.address, path, "the content differs from the name", "see `metascenes doctor lake`")
            if is_log and known == file and there.get(path) == file.size:
                return file, False
            self._target.write(path, data, lasting=False)
            self._advance(path)
            return file, True

        with ThreadPoolExecutor(_THREADS) as threads:
            for file, is_new in threads.map(copied, paths):
                self._files.append(file)
                if is_new:
                    self._copied.append(file)

    def _finish(self) -> int:
        """Note what the backup holds, and remove what it does not hold any more; how many files."""
        _sync(self._target)
        sink = io.BytesIO()
        import pyarrow.parquet as pq

        columns = {name: [getattr(file, name) for file in self._files] for name in ("path", "size", "sha256")}
        pq.write_table(pa.table(columns), sink, compression="zstd")
        self._target.write(MANIFEST, sink.getvalue())
        summary = {
            "complete": True, "lake": self._identity, "created_at": now_utc().isoformat(), "snapshot_id": self._snapshots[-1].snapshot_id,
            "files": len(self._files), "bytes": sum(file.size for file in self._files),
        }  # fmt: skip
        self._target.write(SUMMARY, json.dumps(summary, indent=1).encode())
        held = {file.path for file in self._files}
        gone = [e.path for folder in ("tables", BLOB_FOLDER, RELEASE_FOLDER) for e in self._target.walk(folder) if e.path not in held]
        # Logs before data files: a version whose log is gone is not opened any more.
        for path in sorted(gone, key=lambda path: "/_delta_log/" not in path):
            self._target.remove(path)
        return len(gone)


def _copy_all(source: Storage, target: Storage, files: Sequence[_File], there: dict[str, int], advance: Advance) -> list[_File]:
    """Copy files, holding each against its hash; those that were not there yet."""

    def restored(file: _File) -> _File | None:
        if there.get(file.path) == file.size and hashlib.sha256(target.read(file.path)).hexdigest() == file.sha256:
            return None
        try:
            data = source.read(file.path)
        except FileNotFoundError:
            raise InputError(source.address, file.path, "is missing from the backup", "use another backup") from None
        if hashlib.sha256(data).hexdigest() != file.sha256:
            raise InputError(source.address, file.path, "is damaged: its hash is not what the backup noted", "use another backup")
        target.write(file.path, data, lasting=False)
        advance(file.path)
        return file

    with ThreadPoolExecutor(_THREADS) as threads:
        return [file for file in threads.map(restored, files) if file is not None]


def _manifest(storage: Storage) -> list[_File]:
    """The files of a backup.

    Raises:
        InputError: the list cannot be read.
    """
    import pyarrow.parquet as pq

    try:
        rows = pq.read_table(io.BytesIO(storage.read(MANIFEST)), columns=["path", "size", "sha256"]).to_pylist()
    except FileNotFoundError:
        raise InputError(storage.address, MANIFEST, "is missing", "use another backup") from None
    except pa.ArrowException as error:
        raise InputError(storage.address, MANIFEST, "cannot be read", "use another backup") from error
    for row in rows:
        # Whoever wrote the list must not choose where on this machine a restore writes.
        parts = str(row["path"]).split("/")
        if not parts[0] or ".." in parts or "\\" in str(row["path"]):
            raise InputError(storage.address, MANIFEST, f"names {row['path']!r}, which is no file of a lake", "use another backup")
    return [_File(row["path"], row["size"], row["sha256"]) for row in rows]


def _summary(storage: Storage) -> dict[str, object] | None:
    """What a backup says of itself; None where there is none.

    Raises:
        InputError: it cannot be read.
    """
    try:
        record = json_value(storage.read(SUMMARY))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise InputError(storage.address, SUMMARY, "cannot be read", "use another backup") from error
    if not isinstance(record, dict):
        raise InputError(storage.address, SUMMARY, "cannot be read", "use another backup")
    return record


def _sweep(storage: Storage) -> None:
    """Remove what a backup or restore that was killed left half-written."""
    for entry in storage.entries(TEMPORARY):
        if is_left_over(writer_of(entry.path.rpartition("/")[2]), entry.modified):
            storage.remove(entry.path)


def _sync(storage: Storage) -> None:
    """Make the names of all files last that were written in a local folder."""
    if storage.local_path("") is not None:
        os.sync()
