"""Stages of one scan, one after another in this process: what the flow does with a scene, without Prefect."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path

import psutil

from flows.run.configuration import configure
from flows.run.plan import make_plan
from flows.run.scene import job_of
from flows.worker import execute
from tasks.capture.formats import find_scans
from warehouse.lake import Lake


@dataclasses.dataclass(frozen=True)
class StagedScan:
    """What came of a scan. seconds: By stage. cpu_seconds: By stage, of this process and of
    those that it started. stage, error: What failed, and why; empty and None where nothing did."""

    seconds: dict[str, float]
    stage: str = ""
    error: str | None = None
    cpu_seconds: dict[str, float] = dataclasses.field(default_factory=dict)


def run_stages(
    lake: Lake, scans: Path, stages: Collection[str], cores: int, settings: Sequence[str] = (), library: Path | None = None,
    dataset: str | None = None,
) -> StagedScan:  # fmt: skip
    """Stage what is missing of some stages of the one scan of a folder; what failed is tried again, and nothing is committed.

    cores: That a stage may use. dataset: What the scan is of; by default what its format says.
    """
    configuration = configure(settings=settings, library=library)
    scan_list, unusable = find_scans(scans, dataset=dataset)
    plan = make_plan(lake, scan_list, unusable, configuration, retry_failed=True)
    seconds: dict[str, float] = {}
    cpu: dict[str, float] = {}
    if plan.unusable:
        return StagedScan(seconds, "capture", str(plan.unusable[0]))
    if not scan_list:
        return StagedScan(seconds, "capture", "no scan was found")
    for planned, step in ((scene, step) for scene in plan.todo for step in scene.todo if step.stage in stages):
        before = cpu_clock()
        run = execute(dataclasses.replace(job_of(lake, planned, step, configuration), processes=cores))
        seconds[step.stage], cpu[step.stage] = run.seconds, cpu_clock() - before
        if run.outcome != "done":
            return StagedScan(seconds, step.stage, run.error or run.outcome, cpu)
    return StagedScan(seconds, cpu_seconds=cpu)


def cpu_clock() -> float:
    """CPU time of this process, of the processes that it started, and of those that have ended [s]."""
    own = psutil.Process()
    times = own.cpu_times()
    total = times.user + times.system + times.children_user + times.children_system
    for child in own.children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            spent = child.cpu_times()
            total += spent.user + spent.system
    return float(total)
