"""Runs of small scenes as a person starts them, each a process of its own, and what the lake and the clock say of them.

A run's time has three parts. Start-up: from the command to the first stage begun, with Python, Prefect, its server, the plan
and the workers. Work: from there to the last commit. Ending: from there until the process is gone.

Orchestration overhead is what the workers did not spend in stages while there was work: work seconds times workers, less
the sum of `stage_runs.seconds`. It holds everything but the stages: staging and committing rows, hand-over, Prefect, workers
without work at the end. Its share is that of work seconds times workers. What a stage loses to a busy neighbor on the same
core counts as the stage's; so does a worker's first import of what a stage needs.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from bench.flows.small_scenes import SETTINGS
from schemas.errors import LakeError
from schemas.runs import StageRun
from warehouse.lake import Lake

PLAIN = "none"
"""The runner that is none: a plain loop over the pool, without Prefect."""

SAMPLE_SECONDS = 0.25
"""How often memory is looked at. Short against a commit, the one step that needs much of it for a moment."""


@dataclasses.dataclass(frozen=True)
class MemorySample:
    """Resident memory of a run's coordinator, and of its workers and server together [MB], `seconds` after its start."""

    seconds: float
    memory_mb: float
    others_mb: float


@dataclasses.dataclass(frozen=True)
class Figures:
    """What a run took. load: The machine's load average of the last minute when it began. cpu_seconds: The coordinator's.

    between_seconds, edge_seconds: What its workers spent between two stages, on staging rows and waiting for work, and before their
    first and after their last; of a worker of Dask's and others by the process that it computes in. others_cpu_seconds: Processor
    time of its workers and server.
    """

    runner: str
    scenes: int
    workers: int
    stage_runs: int
    seconds: float
    startup_seconds: float
    work_seconds: float
    ending_seconds: float
    stage_seconds: float
    cpu_seconds: float
    load: float
    samples: tuple[MemorySample, ...] = dataclasses.field(repr=False, default=())
    between_seconds: float = 0.0
    edge_seconds: float = 0.0
    others_cpu_seconds: float = 0.0

    @property
    def overhead_seconds(self) -> float:
        """Orchestration overhead per stage run, as the module defines it [s]."""
        return (self.work_seconds * self.workers - self.stage_seconds) / max(self.stage_runs, 1)

    @property
    def share(self) -> float:
        """Share of the overhead in the time of the workers, within 0..1."""
        return 1.0 - self.stage_seconds / (self.work_seconds * self.workers) if self.work_seconds else 0.0

    @property
    def peak_memory_mb(self) -> float:
        """Most resident memory of the coordinator [MB]."""
        return max((sample.memory_mb for sample in self.samples), default=0.0)

    @property
    def growth_mb(self) -> float | None:
        """How much the coordinator grows in the second half of its work [MB per 1,000 scenes], by a line fitted to all samples.

        None with fewer than twenty samples: a commit is no growth.
        """
        import numpy as np

        until = self.startup_seconds + self.work_seconds
        late = [sample for sample in self.samples if self.startup_seconds + self.work_seconds / 2 <= sample.seconds <= until]
        if len(late) < 20:
            return None
        slope = float(np.polyfit([sample.seconds for sample in late], [sample.memory_mb for sample in late], 1)[0])
        return slope * self.work_seconds / self.scenes * 1000


def command_of(runner: str, scans: Path, lake: Path, workers: int, settings: Sequence[str] = SETTINGS) -> list[str]:
    """What is typed for a run of the scans with a runner."""
    given = [part for setting in settings for part in ("--set", setting)]
    if runner == PLAIN:
        return [sys.executable, "-m", "bench.flows.plain", str(scans), str(lake), str(workers), *settings]
    return [sys.executable, "-m", "flows.cli", "run", "--scans", str(scans), "--lake", str(lake), "--workers", str(workers),
            "--runner", runner, *given]  # fmt: skip


def surroundings(folder: Path) -> dict[str, str]:
    """An environment with homes and caches of its own below `folder`, so that runs neither find nor leave anything elsewhere."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "METASCENES_"))}
    return {**kept, "PREFECT_HOME": str(folder / "prefect"), "METASCENES_CACHE": str(folder / "cache"), "DO_NOT_TRACK": "1"}


def measured_run(
    runner: str,
    scans: Path,
    lake: Path,
    workers: int,
    home: Path,
    settings: Sequence[str] = SETTINGS,
    cores: int | None = None,
) -> Figures:
    """Run all scans into a new lake, and measure it. The caches of `home` are emptied first: nothing is remembered.

    cores: That all processes of the run are kept to; None for those of the machine.

    Raises:
        LakeError: the run failed; with the last line that it said.
    """
    shutil.rmtree(home / "cache", ignore_errors=True)
    load, begun, clock = os.getloadavg()[0], time.time(), time.perf_counter()
    log_file = lake.parent / f"{lake.name}.log"
    with log_file.open("wb") as log:
        process = subprocess.Popen(
            command_of(runner, scans, lake, workers, settings), env=surroundings(home),
            stdin=subprocess.DEVNULL, stdout=log, stderr=log, preexec_fn=_keeping_to(cores),
        )  # fmt: skip
        with sampled(process.pid) as watched:
            code = process.wait()
    seconds = time.perf_counter() - clock
    if code:
        last = (log_file.read_text(errors="replace").strip().splitlines() or ["it said nothing"])[-1]
        raise LakeError(f"the run with {runner} ended with {code}: {last}")
    return figures_of(Lake.open(lake), runner, workers, begun, seconds, load, watched)


def _keeping_to(cores: int | None) -> Callable[[], None] | None:
    """What keeps a process and its children to so many of the cores that this one may use."""
    if cores is None:
        return None
    chosen = sorted(os.sched_getaffinity(0))[:cores]
    return lambda: os.sched_setaffinity(0, chosen)


def figures_of(lake: Lake, runner: str, workers: int, begun: float, seconds: float, load: float, watched: Samples) -> Figures:
    """The figures of a run that began at `begun` [s since the epoch] and took `seconds`."""
    reader = lake.snapshot()
    runs = reader.rows(StageRun)
    first = min(run.started_at for run in runs).timestamp()
    last = max(snapshot.created_at for snapshot in reader.snapshots).timestamp()
    between, edge = gaps_of(runs)
    return Figures(
        runner=runner, scenes=len({run.scene_id for run in runs}), workers=workers, stage_runs=len(runs), seconds=seconds,
        startup_seconds=first - begun, work_seconds=last - first, ending_seconds=begun + seconds - last,
        stage_seconds=sum(run.seconds for run in runs), cpu_seconds=watched.cpu_seconds, load=load, samples=tuple(watched.samples),
        between_seconds=between, edge_seconds=edge, others_cpu_seconds=sum(watched.others.values()),
    )  # fmt: skip


def gaps_of(runs: Sequence[StageRun]) -> tuple[float, float]:
    """Seconds of all workers of a run between two stages, and before their first and after their last stage, while others had one."""
    spans: dict[str, list[tuple[float, float]]] = {}
    for run in sorted(runs, key=lambda run: run.started_at):
        begun = run.started_at.timestamp()
        spans.setdefault(run.host, []).append((begun, begun + run.seconds))
    first = min(taken[0][0] for taken in spans.values())
    last = max(taken[-1][1] for taken in spans.values())
    between = sum(later[0] - earlier[1] for taken in spans.values() for earlier, later in pairwise(taken))
    edge = sum(taken[0][0] - first + last - taken[-1][1] for taken in spans.values())
    return between, edge


class Samples:
    """What was seen of a process while it ran."""

    def __init__(self) -> None:
        self.samples: list[MemorySample] = []
        self.cpu_seconds = 0.0
        self.others: dict[int, float] = {}
        """Processor seconds of its children by process."""


@contextmanager
def sampled(pid: int) -> Iterator[Samples]:
    """Look at a process's memory and processor time until this ends."""
    import psutil

    watched, stopped, begun = Samples(), threading.Event(), time.perf_counter()

    def look() -> None:
        try:
            process = psutil.Process(pid)
            while not stopped.wait(SAMPLE_SECONDS):
                own, cpu = process.memory_info().rss, process.cpu_times()
                offspring = process.children(recursive=True)
                children = sum(_memory_of(child) for child in offspring)
                watched.others |= {child.pid: seconds for child in offspring if (seconds := _cpu_of(child)) is not None}
                watched.samples.append(MemorySample(time.perf_counter() - begun, own / 1e6, children / 1e6))
                watched.cpu_seconds = cpu.user + cpu.system
        except psutil.Error:  # it is over
            return

    thread = threading.Thread(target=look, name="samples", daemon=True)
    thread.start()
    try:
        yield watched
    finally:
        stopped.set()
        thread.join()


def _memory_of(process: Any) -> int:
    import psutil

    try:
        return int(process.memory_info().rss)
    except psutil.Error:
        return 0


def _cpu_of(process: Any) -> float | None:
    import psutil

    try:
        cpu = process.cpu_times()
    except psutil.Error:
        return None
    return float(cpu.user + cpu.system)
