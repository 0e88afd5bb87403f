"""The flow that makes a release: `flows.releases.release`."""

from __future__ import annotations

from typing import Any

from prefect import flow
from prefect.states import Completed, State

from flows.run.parameters import Address
from flows.run.patience import patiently
from flows.server.artifacts import run_log, short_name
from schemas.wording import noun
from warehouse.lake import Lake
from warehouse.release import make_release, planned_release
from warehouse.tables.released import folder_of

HOURS = 6
"""A release of 10,000 scenes copies some hundred GB."""


def _name() -> str:
    from prefect.runtime import flow_run

    return f"release {flow_run.parameters.get('name') or 'by date'} of {short_name(flow_run.parameters['lake'])}"


@flow(name="release", flow_run_name=_name, persist_result=False, timeout_seconds=HOURS * 3600)
def release(lake: Address, name: str | None = None, notes: str = "", snapshot: int | None = None, dry_run: bool = False) -> Any:
    """Freeze a snapshot of all tables as a release: plain Parquet, data card, attribution, checksums, a DuckDB file.

    Args:
        lake: Address of the lake: a folder or s3://bucket/prefix.
        name: Name of the release, which is new; by default the day for which the run was scheduled, as in 'v2026-01-31'.
        notes: What it is released for; the data card begins with it.
        snapshot: Snapshot to release; the newest by default.
        dry_run: Say what would be released; write nothing.
    """
    store = Lake.existing(lake)
    name = name or _dated()
    if dry_run:
        snapshot_id, counts = planned_release(store, name, snapshot, notes)
        return _completed(f"would release snapshot {snapshot_id} as {name}: {counts['scenes']:,} {noun(counts['scenes'], 'scene')}")
    made = patiently(lambda: make_release(store, name, snapshot, notes))
    return _completed(
        f"released snapshot {made.snapshot_id} as {name}: {made.scenes:,} {noun(made.scenes, 'scene')} in {store.address}/{folder_of(name)}"
    )


def _dated() -> str:
    from prefect.runtime import flow_run

    return f"v{flow_run.scheduled_start_time:%Y-%m-%d}"


def _completed(text: str) -> State[Any]:
    run_log(text)
    return Completed(message=text)
