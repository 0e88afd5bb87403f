"""Refused scans: rows of the lake, written by each run over their folder."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from schemas.errors import InputError
from schemas.runs import RefusedScan
from tasks.capture.scan import Scan, UnusableScan
from warehouse.lake import Lake

if TYPE_CHECKING:
    from flows.run.plan import Plan


def keep_refusals(
    lake: Lake, scans: str, plan: Plan, began: datetime, *, is_whole: bool = True, waiting: Sequence[Scan] = ()
) -> frozenset[str]:
    """Write which scans of a folder a run refused; the lines of those that an earlier run refused for the same reason.

    Args:
        lake: the lake, which is only written if a row changes.
        scans: folder of scans, or address in a store.
        plan: the run's plan.
        began: start of the run.
        is_whole: True if the run looked at all scans there. Otherwise only rows of its own scans change.
        waiting: scans that the run left to a later one. Their rows stay.
    """
    from flows.scans.mirror import FetchError

    address = scans if "://" in scans else str(Path(scans).resolve())
    before = {row.path: row for row in refused_scans(lake) if row.scans == address}
    errors = {_path(error, address): error for error in plan.unusable if not isinstance(error, FetchError)}
    rows = []
    for path, error in sorted(errors.items()):
        reason = f"{error.problem}; {error.remedy}" if error.remedy else error.problem
        row = before.get(path)
        is_known = row is not None and (row.field, row.reason) == (error.field, reason)
        first = row.first_seen_at if row is not None and is_known else began
        format = getattr(error, "format", "") or None
        rows.append(RefusedScan(scans=address, path=path, format=format, field=error.field, reason=reason,
                                first_seen_at=first, last_seen_at=began))  # fmt: skip
    kept = _untouched(before, plan, address, is_whole, waiting) - errors.keys()
    if rows or before.keys() - kept:
        lake.refuse_scans(address, [*rows, *(before[path] for path in sorted(kept))], f"{len(rows)} refused")
    return frozenset(str(errors[row.path]) for row in rows if row.first_seen_at < began)


def refused_scans(lake: Lake) -> list[RefusedScan]:
    """The refused scans of all folders, by folder and path."""
    return list(lake.snapshot().rows(RefusedScan)) if lake.exists else []


def refusal_line(row: RefusedScan) -> str:
    """A refused scan in a line."""
    return ": ".join(part for part in (row.path, row.field, row.reason) if part)


def _untouched(before: Collection[str], plan: Plan, address: str, is_whole: bool, waiting: Sequence[Scan]) -> set[str]:
    """Paths of rows of scans that a run did not look at."""
    if is_whole:
        return {_place(scan.path, address) for scan in waiting} & set(before)
    seen = {_place((scene.given or scene.scan).path, address) for scene in plan.scenes}
    return set(before) - seen


def _path(error: InputError, address: str) -> str:
    return _place(error.path, address) if isinstance(error, UnusableScan) else error.file


def _place(path: Path, address: str) -> str:
    """A path from the folder of scans. Of a store, names in a listing begin with the folder's, and fetched files lie elsewhere."""
    if not isinstance(path, Path):
        place = "/".join(path.parts[1:])
    else:
        place = path.relative_to(address).as_posix() if path.is_relative_to(address) else path.name
    return (path.name if place in ("", ".") else place).encode("utf-8", "backslashreplace").decode()
