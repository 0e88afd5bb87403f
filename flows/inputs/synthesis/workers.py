"""Scenes made in worker processes: what takes a worker along takes its scene along, no other one and not the command."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from flows.inputs.synthesis.jobs import SceneDone, SynthesisJob, left_behind, make_scene
from flows.run.pool import WorkerLost, WorkerPool, WorkerTimeout
from flows.run.scene import STAGE_SECONDS

Make = Callable[[Sequence[SynthesisJob]], Iterable[SceneDone]]
"""Makes scenes; what came of them, in the order of the jobs."""


@contextlib.contextmanager
def makers(workers: int, timeout: float = STAGE_SECONDS) -> Iterator[Make]:
    """``with makers(2) as make: ...``: so many processes that make scenes, each within `timeout` seconds; with 0 this process does."""
    if workers < 1:
        yield lambda jobs: map(make_scene, jobs)
        return
    with ThreadPoolExecutor(workers) as threads, WorkerPool(workers) as pool:
        yield lambda jobs: threads.map(partial(_made_by, pool, timeout), jobs)


def _made_by(pool: WorkerPool, timeout: float, job: SynthesisJob) -> SceneDone:
    """A scene made by a worker. One that died is lost, and made again by the next command; one that hangs has failed."""
    clock = time.perf_counter()
    try:
        return pool.call(make_scene, job, timeout=timeout)
    except WorkerLost as error:
        kind, text = "lost", str(error)
    except WorkerTimeout as error:
        kind, text = "timeout", str(error)
    return left_behind(job, kind, text, time.perf_counter() - clock)
