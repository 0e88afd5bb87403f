"""Vacuum: what no retained snapshot names is removed. Kept are releases, recent snapshots, and always the last one."""

from __future__ import annotations

import dataclasses
import re
import time
from collections.abc import Callable, Sequence
from datetime import timedelta

from schemas.record import BLOB_PATTERN
from schemas.runs import Snapshot
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.release import releases
from warehouse.sharing.lease import Lease
from warehouse.tables.adoption import now_utc
from warehouse.tables.commit import Commit, versions_of
from warehouse.tables.datafiles import files_of, forget_before, remove_unnamed
from warehouse.upkeep.references import BlobReferences, workspace

# A reader keeps its snapshot for as long as a long query or an export takes, not for days.
RECENT_DAYS = 7.0

# Blobs are put before the rows that name them are staged; a stage that takes a day hangs.
BLOB_SECONDS = 86_400.0


@dataclasses.dataclass(frozen=True)
class Vacuumed:
    """What a vacuum removed, or would remove: snapshots by id, data files, blobs, and their sizes [B].

    `young_blobs` are named by no row either, but somebody put them within a day and may be about to name them.
    """

    snapshots: tuple[int, ...]
    files: int
    blobs: int
    file_bytes: int = 0
    blob_bytes: int = 0
    log_bytes: int = 0
    young_blobs: int = 0

    @property
    def bytes(self) -> int:
        """How much room that makes [B]."""
        return self.file_bytes + self.blob_bytes + self.log_bytes


def vacuum(lake: Lake, *, days: float = RECENT_DAYS, dry_run: bool = False) -> Vacuumed:
    """Remove snapshots that are not released and that others replaced over `days` ago, and what only they named: files, logs, blobs.

    Blobs that somebody put within the last day stay. With `dry_run`, says what would go and changes nothing.

    Raises:
        LeaseError: another process holds the lake's lease.
    """
    if not lake.exists:
        return Vacuumed((), 0, 0)
    with lake.leased() as lease:
        commit = Commit(lake.tables, lake.staging, lease)
        if not dry_run:
            commit.remove_adopted()
            lake.sweep_temporary()
        every = lake.snapshot().snapshots
        kept = _kept(every, {release.snapshot_id for release in releases(lake)}, days)
        gone = tuple(row.snapshot_id for row in every if row not in kept)
        if not every:
            return Vacuumed(gone, 0, 0)
        if gone and not dry_run:
            commit.rewrite_snapshots(kept)  # first: nobody is to find a snapshot whose files are gone
        lease.check()
        return forget(lake, lease, kept, gone, dry_run)


def forget(
    lake: Lake,
    lease: Lease,
    kept: Sequence[Snapshot],
    gone: Sequence[int] = (),
    dry_run: bool = False,
    goes: Callable[[str], bool] = lambda path: False,
) -> Vacuumed:
    """Remove whatever none of the snapshots `kept` needs. Snapshots `gone` are no longer listed, and the lease is held.

    goes: Which blobs that no row names go, however young they are.
    """
    count = size = logs = 0
    with workspace(lake.storage) as connection:
        references = BlobReferences(connection, lake.storage)
        for table in lake.storage.folders("tables"):
            lease.check()
            versions = {versions_of(row)[table] for row in kept if table in versions_of(row)}
            head = lake.tables.open(table)
            if head is None or (not versions and table != "snapshots"):
                continue  # left by a commit that died; the next one overwrites it
            # The head may be ahead of every snapshot. The next commit restores it, for which its files must be there.
            by_version = files_of(lake.tables, table, {*versions, int(head.version())})
            named = {file for files in by_version.values() for file in files}
            oldest = min(versions or {int(head.version())})
            if table == "snapshots" and gone and dry_run:  # it would be written anew
                named, oldest = set(), oldest + 1
            removed, freed = remove_unnamed(lake.storage, table, named, dry_run)
            count, size = count + removed, size + freed
            logs += forget_before(lake.tables, lake.storage, table, oldest, lease.check, dry_run)
            if table in TABLES and TABLES[table].blob_columns:
                references.add_files(table, sorted({file for version in versions for file in by_version[version]}))
        references.add(lake.staging.blob_names() | lake.calls.blob_names())
        references.finish()
        blobs, blob_bytes, young = _remove_blobs(lake, references, lease, dry_run, goes)
    return Vacuumed(tuple(gone), count, blobs, size, blob_bytes, logs, young)


def _remove_blobs(lake: Lake, references: BlobReferences, lease: Lease, dry_run: bool, goes: Callable[[str], bool]) -> tuple[int, int, int]:
    """Remove blobs that `references` do not name and nobody put within a day; how many, their size [B], and how many are younger."""
    count = size = young = 0
    oldest = time.time() - BLOB_SECONDS
    for unnamed, _ in references.compared():
        lease.check()
        for entry in unnamed:
            if not re.fullmatch(BLOB_PATTERN, entry.path.rpartition("/")[2]):
                continue
            if entry.modified >= oldest and not goes(entry.path):
                young += 1
                continue
            if not dry_run:
                lake.blobs.remove(entry.path)
            count, size = count + 1, size + entry.size
    return count, size, young


def _kept(every: Sequence[Snapshot], released: set[int], days: float) -> list[Snapshot]:
    """Released snapshots, the last one, and those that were the last one at any time within `days`: somebody may read them yet."""
    oldest = now_utc() - timedelta(days=days)
    replaced = [row.created_at for row in every[1:]]
    recent = {row.snapshot_id for row, at in zip(every, replaced, strict=False) if at >= oldest}
    return [row for row in every if row is every[-1] or row.snapshot_id in released | recent]
