"""Whether what lies beside the tables is sound: blobs, releases, staged and temporary files, and strangers."""

from __future__ import annotations

import dataclasses
import hashlib
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import pyarrow as pa

from schemas.errors import InputError
from schemas.parsing import json_value
from schemas.record import BLOB_PATTERN
from schemas.runs import Release, Snapshot
from schemas.tables import TABLES
from schemas.wording import noun
from warehouse.lake import DRAFT_FOLDER, MARKER, Lake
from warehouse.sharing.claims import FOLDER as CLAIM_FOLDER
from warehouse.sharing.claims import claims_of, dead_claims, path_of
from warehouse.sharing.lease import PATH as LEASE_PATH
from warehouse.sharing.lease import holder_of
from warehouse.sharing.looks import FOLDER as LOOK_FOLDER
from warehouse.sharing.presence import FOLDER as RUN_FOLDER
from warehouse.sharing.presence import dead_runs, runs_of
from warehouse.sharing.presence import path_of as path_of_run
from warehouse.sharing.writer import writer_of
from warehouse.storage.blobs import FOLDER as BLOB_FOLDER
from warehouse.storage.files import TEMPORARY
from warehouse.tables.calls import FOLDER as CALL_FOLDER
from warehouse.tables.released import FOLDER as RELEASE_FOLDER
from warehouse.tables.released import RECORD, folder_of, released
from warehouse.tables.staging import FOLDER as STAGED_FOLDER
from warehouse.tables.staging import is_left_over
from warehouse.upkeep.inspection.finding import Fault, in_short
from warehouse.upkeep.references import BlobReferences
from warehouse.upkeep.vacuum import BLOB_SECONDS

CHECKSUMS = "SHA256SUMS"

_ROOT_FOLDERS = {
    BLOB_FOLDER, CALL_FOLDER, CLAIM_FOLDER, DRAFT_FOLDER, LOOK_FOLDER, RELEASE_FOLDER, RUN_FOLDER, STAGED_FOLDER, TEMPORARY, "tables"
}  # fmt: skip
_ROOT_FILES = {MARKER, LEASE_PATH, "erasure.json", "backup.json", "backup.parquet"}
# A lake whose blobs are somewhere else misses millions.
_MOST_NAMED = 100

_NEXT_RUN = "the next run removes it"
_VACUUM = "`metascenes lake vacuum` removes it"
_RESTORE = "restore the file from a backup"


@dataclasses.dataclass
class Counted:
    """How much was looked at."""

    blobs: int = 0
    blob_bytes: int = 0
    young_blobs: int = 0


def blob_findings(
    lake: Lake, references: BlobReferences, counted: Counted, quick: bool, with_others: bool, advance: Callable[[str], None]
) -> Iterator[Fault]:
    """Blobs that rows name and that are missing or hold something else; with `others`, blobs that nobody names."""
    orphans: list[str] = []
    size = lost = 0
    for unnamed, missing in references.compared():
        lost += len(missing)
        for name in missing[: max(0, _MOST_NAMED - lost + len(missing))]:
            path = f"{BLOB_FOLDER}/{name[:2]}/{name[2:4]}/{name}"
            yield Fault("blob", path, "", "is missing, which rows name", "restore the file, or run the stage again that makes it")
        for entry in unnamed if with_others else ():
            name = entry.path.rpartition("/")[2]
            if not re.fullmatch(BLOB_PATTERN, name) or entry.path != f"{BLOB_FOLDER}/{name[:2]}/{name[2:4]}/{name}":
                yield Fault("foreign file", entry.path, "", "is none of the lake's", "move it away", False)
            elif entry.modified > time.time() - BLOB_SECONDS:
                counted.young_blobs += 1  # somebody may be about to name it
            else:
                orphans.append(entry.path)
                size += entry.size
        for name in references.present():
            counted.blobs += 1
            if not quick:
                try:
                    data = lake.storage.read(f"{BLOB_FOLDER}/{name[:2]}/{name[2:4]}/{name}")
                except FileNotFoundError:
                    continue
                counted.blob_bytes += len(data)
                if hashlib.sha256(data).hexdigest() != name.partition(".")[0]:
                    path = f"{BLOB_FOLDER}/{name[:2]}/{name[2:4]}/{name}"
                    yield Fault("content", path, "", "the content differs from the name", _RESTORE)
            advance("blobs")
    if lost > _MOST_NAMED:
        more = lost - _MOST_NAMED
        yield Fault("blob", BLOB_FOLDER, "", f"{more} {noun(more, 'more blob is', 'more blobs are')} missing, which rows name", _RESTORE)
    if orphans:
        more = len(orphans) - 1
        problem = f"nobody names it, nor {more} {noun(more, 'more blob')} ({size} B)"
        yield Fault("unnamed blob", orphans[0], "", problem, _VACUUM, False)


def release_findings(lake: Lake, snapshots: Sequence[Snapshot], only: str | None, quick: bool) -> Iterator[Fault]:
    """Releases whose record cannot be read, whose snapshot or files are gone, or whose files are not what they were."""
    known = {row.snapshot_id for row in snapshots}
    for name in lake.storage.folders(RELEASE_FOLDER):
        if only is not None and name != only:
            continue
        folder = folder_of(name)
        if not lake.storage.exists(f"{folder}/{RECORD}"):
            yield Fault("unfinished release", folder, RECORD, "is missing: it was never finished", "release it again or remove it", False)
            continue
        try:
            release = next(other for other in released(lake.storage) if other.name == name)
        except (InputError, StopIteration) as error:
            problem = error.problem if isinstance(error, InputError) else "cannot be read"
            yield Fault("release record", f"{folder}/{RECORD}", "", problem, _RESTORE)
            continue
        if release.snapshot_id not in known:
            problem = f"names snapshot {release.snapshot_id}, which the lake has not"
            yield Fault("release snapshot", f"{folder}/{RECORD}", "snapshot_id", problem, "restore the lake from a backup")
        if not quick:
            yield from _checksum_findings(lake, folder, json_value(lake.storage.read(f"{folder}/{RECORD}")))
        yield from _count_findings(lake, release, folder)


def _checksum_findings(lake: Lake, folder: str, record: Mapping[str, Any]) -> Iterator[Fault]:
    """Files of a release that are not what its checksums say."""
    try:
        lines = lake.storage.read(f"{folder}/{CHECKSUMS}").decode().splitlines()
    except (FileNotFoundError, UnicodeDecodeError):
        yield Fault("checksums", f"{folder}/{CHECKSUMS}", "", "is missing or cannot be read", _RESTORE)
        return
    sums = {path: digest for digest, _, path in (line.partition("  ") for line in lines) if path}
    sums |= {file["path"]: file["sha256"] for file in record.get("files", ()) if file["path"] == CHECKSUMS}
    there = {entry.path.removeprefix(f"{folder}/") for entry in lake.storage.walk(folder)}
    for path in sorted(sums.keys() - there):
        yield Fault("release file", f"{folder}/{path}", "", "is missing", _RESTORE)
    for path in sorted(there - sums.keys() - {CHECKSUMS, RECORD}):
        yield Fault("foreign file", f"{folder}/{path}", "", f"is not in {CHECKSUMS}", "move it away", False)
    for path in sorted(sums.keys() & there):
        if hashlib.sha256(lake.storage.read(f"{folder}/{path}")).hexdigest() != sums[path]:
            yield Fault("checksum", f"{folder}/{path}", "", "the content differs from its checksum", _RESTORE)


def _count_findings(lake: Lake, release: Release, folder: str) -> Iterator[Fault]:
    """Tables of a release's folder with other rows than its record says."""
    import pyarrow.parquet as pq

    filesystem = lake.storage.arrow_filesystem()
    stated = {name: int(count) for name, _, count in (entry.partition("=") for entry in release.row_counts)}
    for name in sorted(stated.keys() & TABLES.keys()):
        files = [entry.path for entry in lake.storage.entries(f"{folder}/{name}")] or [f"{folder}/{name}.parquet"]
        try:
            rows = sum(pq.read_metadata(lake.storage.arrow_path(file), filesystem=filesystem).num_rows for file in files)
        except FileNotFoundError:
            yield Fault("release file", files[0], "", "is missing", _RESTORE)
            continue
        except (pa.ArrowException, OSError) as error:
            yield Fault("release file", files[0], "", f"cannot be read ({in_short(error)})", _RESTORE)
            continue
        if rows != stated[name]:
            yield Fault("release rows", files[0], "rows", f"has {rows} where {RECORD} says {stated[name]}", _RESTORE)


def staged_findings(lake: Lake) -> Iterator[Fault]:
    """Staged runs that are damaged or without an owner, and files among them that are none."""
    complete: set[str] = set()
    try:
        runs = lake.staging.runs()
    except InputError as error:
        yield Fault("staged run", error.file.removeprefix(f"{lake.address}/"), error.field, error.problem, error.remedy)
        return
    except (pa.ArrowException, KeyError, TypeError, IndexError) as error:
        yield Fault("staged run", STAGED_FOLDER, "", f"a run cannot be read ({in_short(error)})", "remove it and run again")
        return
    for staged_run in runs:
        complete |= {staged_run.run_file, *staged_run.files.values()}
        fault = lake.staging.fault(staged_run) if staged_run.run.outcome == "done" else None
        if fault is not None:
            yield Fault("staged run", staged_run.run_file, "", fault, "the next commit reports it, and the next run does it again")
    for entry in lake.storage.entries(STAGED_FOLDER):
        if entry.path not in complete:
            parts = entry.path.split("@")
            writer = writer_of(parts[3]) if len(parts) == 5 else None
            if writer is None:
                yield Fault("foreign file", entry.path, "", "is none of the lake's", "move it away", False)
            elif is_left_over(writer, entry.modified):
                yield Fault("unfinished run", entry.path, "", "was left by a run that was killed", _NEXT_RUN, False)


def call_findings(lake: Lake) -> Iterator[Fault]:
    """Recorded calls that are damaged, and files among them that are none."""
    try:
        lake.calls.all()
    except InputError as error:
        yield Fault("recorded call", error.file.removeprefix(f"{lake.address}/"), error.field, error.problem, error.remedy)
    for path in lake.calls.strangers():
        yield Fault("foreign file", path, "", "is none of the lake's", "move it away", False)


def root_findings(lake: Lake) -> Iterator[Fault]:
    """What lies in the lake's own folder, temporary files of the dead, and an erasure that was not finished."""
    for name in lake.storage.names(""):
        if name == "erasure.json":
            problem = "the erasure of a scene was not finished"
            yield Fault("erasure", name, "", problem, "give `metascenes lake erase` again; the file names the scene")
        elif name not in _ROOT_FILES:
            yield Fault("foreign file", name, "", "is none of the lake's", "move it away", False)
    for name in lake.storage.folders(""):
        if name not in _ROOT_FOLDERS:
            yield Fault("foreign file", name, "", "is none of the lake's", "move it away", False)
    for entry in lake.storage.walk(TEMPORARY):
        if is_left_over(writer_of(entry.path.split("/")[1]), entry.modified):
            yield Fault("temporary file", entry.path, "", "was left by a process that died", _NEXT_RUN, False)
    holder = holder_of(lake.storage)
    if holder is not None and holder.is_gone:
        problem = f"{holder.host} ({holder.token}) died while it held the lease"
        yield Fault("lease", LEASE_PATH, "", problem, "the next commit takes it over", False)
    yield from _run_findings(lake)


def _run_findings(lake: Lake) -> Iterator[Fault]:
    """Claims and presences of runs that died, and files among them that are none."""
    there = [entry.path for folder in (CLAIM_FOLDER, RUN_FOLDER) for entry in lake.storage.walk(folder)]
    known = {path_of(scene) for scene in claims_of(lake.storage)} | {path_of_run(run.token) for run in runs_of(lake.storage)}
    for path, claim in dead_claims(lake.storage).items():
        known.add(path)
        yield Fault("claim", path, "", f"{claim.host} ({claim.token}) died while it computed {claim.scene_id}", _NEXT_RUN, False)
    for path, run in dead_runs(lake.storage).items():
        known.add(path)
        yield Fault("run", path, "", f"{run.host} ({run.token}) died at work", _NEXT_RUN, False)
    for path in sorted(set(there) - known):
        if lake.storage.exists(path):  # not given back meanwhile
            yield Fault("foreign file", path, "", "is none of the lake's", "move it away", False)


def snapshot_findings(snapshots: Sequence[Snapshot]) -> Iterator[Fault]:
    """Snapshots with one number, or with a list of tables that cannot be read."""
    seen: dict[int, Any] = {}
    for row in snapshots:
        if row.snapshot_id in seen:
            yield Fault("snapshot", "tables/snapshots", "snapshot_id", f"{row.snapshot_id} is there twice", "restore the folder")
        seen[row.snapshot_id] = row
        wrong = [entry for entry in row.tables if not re.fullmatch(r"[a-z_]+=[0-9]+", entry)]
        if wrong:
            yield Fault("snapshot", "tables/snapshots", "tables", f"{row.snapshot_id} has {wrong[0]!r}", "restore the folder")


def readable(snapshots: Sequence[Snapshot]) -> list[Snapshot]:
    """The snapshots whose lists of tables can be read."""
    return [row for row in snapshots if all(re.fullmatch(r"[a-z_]+=[0-9]+", entry) for entry in row.tables)]


def files_by_table(at: Mapping[int, Mapping[str, Sequence[str]]]) -> dict[str, list[str]]:
    """All data files of some snapshots, by table."""
    by_table: dict[str, set[str]] = {}
    for files in at.values():
        for table, paths in files.items():
            by_table.setdefault(table, set()).update(paths)
    return {table: sorted(paths) for table, paths in by_table.items()}
