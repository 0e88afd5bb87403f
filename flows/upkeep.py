"""The flow that keeps a lake small: `flows.upkeep.upkeep`, weekly."""

from __future__ import annotations

from typing import Any

from prefect import flow
from prefect.states import Completed

from flows.run.parameters import Address
from flows.run.patience import patiently
from flows.server.artifacts import run_log, short_name
from schemas.errors import InputError
from schemas.wording import counted
from warehouse.lake import Lake
from warehouse.upkeep.compaction import compact
from warehouse.upkeep.vacuum import vacuum

HOURS = 12
"""Compaction rewrites what is scattered; on a lake of 10,000 scenes that is most of it, once."""


def _name() -> str:
    from prefect.runtime import flow_run

    return f"upkeep of {short_name(flow_run.parameters['lake'])}"


@flow(name="upkeep", flow_run_name=_name, persist_result=False, timeout_seconds=HOURS * 3600)
def upkeep(lake: Address, days: float = 7.0, compacts: bool = True, dry_run: bool = False) -> Any:
    """Put small files of the tables together, then remove old snapshots and what only they name. Releases stay.

    Args:
        lake: Address of the lake: a folder or s3://bucket/prefix.
        days: Keep snapshots that were replaced within so many days.
        compacts: Put small files together first.
        dry_run: Say what would be done; change nothing.
    """
    store = Lake.existing(lake)
    if days < 0:
        raise InputError("days", "", f"must be at least 0, is {days:g}", "7 keeps a week")
    would = "would be " if dry_run else ""
    parts = []
    if compacts:
        done = patiently(lambda: compact(store, dry_run=dry_run))
        parts.append(
            f"{counted(sum(table.files_rewritten for table in done.tables), 'file')} "
            f"of {counted(len(done.tables), 'table')} {would}put together"
        )
    gone = patiently(lambda: vacuum(store, days=days, dry_run=dry_run))
    parts.append(
        f"{counted(len(gone.snapshots), 'snapshot')}, {counted(gone.files, 'data file')}, "
        f"{counted(gone.blobs, 'blob')} {would}removed: {gone.bytes / 1e6:.1f} MB"
    )
    text = "; ".join(parts)
    run_log(text)
    return Completed(message=text)
