"""Scenes through their stages without Prefect: threads over the same pool, the same staging and commits, and nothing else.

``python -m bench.flows.plain SCANS LAKE WORKERS [SETTING ...]``: what a run of `metascenes run` is held against.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from flows.run.configuration import Configuration, configure
from flows.run.fanout.committer import Committer
from flows.run.plan import ScenePlan, make_plan
from flows.run.pool import WorkerPool
from flows.run.scene import job_of
from flows.worker import execute
from tasks.capture.formats import find_scans
from warehouse.lake import Lake


def run_plainly(scans: Path, lake: Lake, workers: int, settings: Sequence[str]) -> None:
    """Compute and commit what is missing.

    Raises:
        RuntimeError: a stage failed.
    """
    configuration = configure(None, settings)
    scan_list, unusable = find_scans(scans)
    plan = make_plan(lake, scan_list, unusable, configuration)
    with WorkerPool(workers) as pool, ThreadPoolExecutor(workers + 1) as threads, Committer(lake) as committer:
        for future in as_completed([threads.submit(_walk, lake, scene, configuration, pool) for scene in plan.todo]):
            committer.add(future.result())
    lake.commit()


def _walk(lake: Lake, scene: ScenePlan, configuration: Configuration, pool: WorkerPool) -> str:
    """All stages of a scene, one after another; its id."""
    for step in scene.todo:
        run = pool.call(execute, job_of(lake, scene, step, configuration))
        if run.outcome != "done":
            raise RuntimeError(f"{run.scene_id}: {run.stage}: {run.error}")
    return scene.scan.scene_id


if __name__ == "__main__":
    run_plainly(Path(sys.argv[1]), Lake.open(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
