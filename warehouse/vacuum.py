"""Vacuum: what no retained snapshot names is removed. Kept are releases, recent snapshots, and always the last one."""

from __future__ import annotations

import dataclasses
from datetime import timedelta

from schemas.runs import Snapshot
from warehouse.adoption import now_utc
from warehouse.commit import Commit, versions_of
from warehouse.digest import blob_names
from warehouse.lake import Lake
from warehouse.release import releases

# A reader keeps its snapshot for as long as a long query or an export takes, not for days.
RECENT_DAYS = 7.0

# Blobs are put before the rows that name them are staged; a stage that takes a day hangs.
_BLOB_SECONDS = 86_400.0


@dataclasses.dataclass(frozen=True)
class Vacuumed:
    """What a vacuum removed: snapshots by id, and how many data files and blobs."""

    snapshots: tuple[int, ...]
    files: int
    blobs: int


def vacuum(lake: Lake, *, days: float = RECENT_DAYS, dry_run: bool = False) -> Vacuumed:
    """Remove snapshots older than `days` that are not released, and the data files and blobs that only they named.

    With `dry_run`, says only which snapshots would go.
    """
    if not lake.exists:
        return Vacuumed((), 0, 0)
    with lake.leased() as lease:
        commit = Commit(lake.tables, lake.staging, lease)
        commit.remove_adopted()
        every = lake.snapshot().snapshots
        kept = _kept(every, {release.snapshot_id for release in releases(lake)}, days)
        gone = tuple(row.snapshot_id for row in every if row not in kept)
        if dry_run or not every:
            return Vacuumed(gone, 0, 0)
        if gone:
            commit.rewrite_snapshots(kept)  # first: nobody is to find a snapshot whose files are gone
        lease.check()
        named = set(lake.staging.blob_names())
        for row in kept:
            named |= blob_names(lake.snapshot(row.snapshot_id))
        files = 0
        tables = {name for row in kept for name in versions_of(row)}
        for name in sorted(tables):
            lease.check()
            files += lake.tables.vacuum(name, {versions_of(row)[name] for row in kept if name in versions_of(row)})
        files += lake.tables.vacuum("snapshots", ())
        return Vacuumed(gone, files, lake.blobs.remove_garbage(named, _BLOB_SECONDS))


def _kept(every: tuple[Snapshot, ...], released: set[int], days: float) -> list[Snapshot]:
    oldest = now_utc() - timedelta(days=days)
    return [row for row in every if row is every[-1] or row.snapshot_id in released or row.created_at >= oldest]
