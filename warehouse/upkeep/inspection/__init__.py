"""The lake's inspection: is everything there that it names, is it what it should be, and does nothing lie about?"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

from schemas.errors import InputError
from schemas.runs import Snapshot
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.tables.released import released
from warehouse.upkeep.inspection.finding import Fault, in_short
from warehouse.upkeep.inspection.folders import (
    Counted,
    blob_findings,
    call_findings,
    files_by_table,
    readable,
    release_findings,
    root_findings,
    snapshot_findings,
    staged_findings,
)
from warehouse.upkeep.inspection.rows import RowChecks, checked
from warehouse.upkeep.inspection.tables import TableChecks
from warehouse.upkeep.references import BlobReferences, workspace


@dataclasses.dataclass(frozen=True)
class Inspection:
    """What was found, and how much was looked at. `reclaimable_bytes` is what a vacuum would free of data files now."""

    findings: tuple[Fault, ...]
    snapshots: int
    files: int
    file_bytes: int
    blobs: int
    blob_bytes: int
    young_blobs: int
    reclaimable_bytes: int

    @property
    def errors(self) -> tuple[Fault, ...]:
        """Findings that say that something is lost or wrong."""
        return tuple(finding for finding in self.findings if finding.is_error)

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """Findings that say that something lies about."""
        return tuple(finding for finding in self.findings if not finding.is_error)


def inspect(
    lake: Lake, snapshot_id: int | None = None, *, release: str | None = None, quick: bool = False,
    advance: Callable[[str], None] = lambda what: None,
) -> Inspection:  # fmt: skip
    """Hold a lake against what it says of itself. Changes nothing.

    With `snapshot_id`, only that snapshot, and of the releases only `release`; else all snapshots, and whatever lies about.
    The rows are checked of the newest and of every released snapshot. With `quick`, contents are not hashed and only
    constrained columns are read.

    Raises:
        InputError: there is no such snapshot.
    """
    findings: list[Fault] = []
    counted = Counted()
    is_whole = snapshot_id is None
    try:
        every = lake.snapshot(snapshot_id).snapshots
    except InputError:
        raise
    except Exception as error:  # delta-rs and Arrow have many
        problem = f"cannot be read ({in_short(error)})"
        # All else would look unnamed.
        return Inspection((Fault("log", "tables/snapshots", "", problem, "restore the folder from a backup"),), 0, 0, 0, 0, 0, 0, 0)
    if not is_whole:
        every = every[-1:]
    findings += snapshot_findings(every)
    every = tuple(readable(every))
    tables = TableChecks(lake, every)
    findings += tables.versions()
    advance("versions")
    with workspace(lake.storage) as connection:
        thorough = _chosen(lake, every) if is_whole else [row.snapshot_id for row in every]
        done: set[tuple[str, tuple[str, ...]]] = set()
        for number in thorough:
            files = tables.files.at[number]
            checks = RowChecks(connection, lake.storage, files)
            for table in sorted(name for name in files if name in TABLES and files[name]):
                fresh = (table, tuple(files[table])) not in done
                done.add((table, tuple(files[table])))
                looks: list[Iterator[Fault]] = [checks.constraints(table, not quick), checks.keys(table)] if fresh else []
                for check in (*looks, checks.references(table), checks.shared(table)):
                    findings += checked(check, table)
                advance(table)
            findings += checked(checks.accounts(), "stage_runs")
        references = BlobReferences(connection, lake.storage)
        for table, paths in files_by_table(tables.files.at).items():
            if table in TABLES:
                try:
                    references.add_files(table, paths)
                except Exception as error:  # a page that cannot be decoded
                    findings.append(Fault("unreadable", f"tables/{table}", "", f"cannot be read ({in_short(error)})", "restore the file"))
        references.finish()
        staged = list(staged_findings(lake)) if is_whole else []
        if is_whole:
            called = list(call_findings(lake))
            is_sound = not any(fault.kind in ("staged run", "recorded call") for fault in (*staged, *called))
            references.spare(lake.staging.blob_names() | lake.calls.blob_names() if is_sound else ())
            staged += called
        findings += blob_findings(lake, references, counted, quick, is_whole, advance)
    if is_whole:
        findings += [*tables.strangers(), *staged, *root_findings(lake)]
    if is_whole or release is not None:
        known = every if is_whole else lake.snapshot().snapshots
        findings += release_findings(lake, known, release, quick)
    return Inspection(
        findings=tuple(dict.fromkeys(findings)),
        snapshots=len(every),
        files=len(tables.files.named),
        file_bytes=tables.files.size,
        blobs=counted.blobs,
        blob_bytes=counted.blob_bytes,
        young_blobs=counted.young_blobs,
        reclaimable_bytes=tables.files.reclaimable,
    )


def _chosen(lake: Lake, every: Sequence[Snapshot]) -> list[int]:
    """Snapshots whose rows are checked: the last, and those that are released."""
    numbers = [row.snapshot_id for row in every]
    try:
        named = {release.snapshot_id for release in released(lake.storage)}
    except InputError:  # `release_findings` says so
        named = set(numbers)
    return [number for number in numbers if number in named or number == numbers[-1]]


__all__ = ["Fault", "Inspection", "inspect"]
