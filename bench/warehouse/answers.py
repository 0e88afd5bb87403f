"""How long a lake takes to answer: every question of the report, timed in a process of its own that may use two cores."""

from __future__ import annotations

import dataclasses
import os
import statistics
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from warehouse.lake import Lake

CORES = 2
"""Cores that a query may use."""

MEMORY = "3GB"
"""What DuckDB may take for itself: the process takes more, and its limit is 4 GB."""

_PATIENCE_SECONDS = 10.0
"""A query that takes long is run less often, but never only once."""


@dataclasses.dataclass(frozen=True)
class QueryTimes:
    """Times of a query [s]: the first after the files' pages were dropped from the system's cache, then the median of `runs` more.

    cpu_seconds: Processor time of the median run, of all cores together; it tells a slow query from a busy machine.
    """

    name: str
    first_seconds: float
    seconds: float
    cpu_seconds: float
    runs: int
    rows: int


def time_answers(address: str, queries: Mapping[str, str], runs: int, when: Mapping[str, tuple[str, int]] | None = None) -> dict[str, Any]:
    """Time queries on the newest snapshot of a lake, one after the other on one connection. Runs in a worker that did nothing else.

    `when` names queries that are asked only after another one gave more rows than a number, as the report does.

    Gives `answers` (a list of `QueryTimes`), `connect_seconds` (opening the snapshot and making all its views) and
    `peak_memory_mb` of the whole process.
    """
    keep_to_cores(CORES)
    with tempfile.TemporaryDirectory(prefix="bench-") as spill:
        clock = time.perf_counter()
        reader = Lake.open(address).snapshot()
        with reader.connect({"memory_limit": MEMORY, "temp_directory": spill}) as connection:
            connected = time.perf_counter() - clock
            answers: list[QueryTimes] = []
            for name, sql in queries.items():
                first, limit = (when or {}).get(name, ("", 0))
                if not first or any(answer.name == first and answer.rows > limit for answer in answers):
                    answers.append(time_query(connection, name, sql, runs, address))
    return {"answers": answers, "connect_seconds": connected, "peak_memory_mb": peak_memory_mb()}


def time_query(connection: Any, name: str, sql: str, runs: int, address: str | None = None) -> QueryTimes:
    """Run a query once on cold files (when `address` names the lake), then `runs` times."""
    if address is not None:
        drop_pages(Path(address))
    first, _, rows = _run(connection, sql)
    times = [_run(connection, sql) for _ in range(max(2, min(runs, int(_PATIENCE_SECONDS / max(first, 1e-3)))))]
    middle = sorted(times)[len(times) // 2]
    return QueryTimes(name, first, statistics.median(sample[0] for sample in times), middle[1], len(times), rows)


def keep_to_cores(count: int) -> None:
    """Use no more than `count` of the cores that this process may use."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:count])


def drop_pages(folder: Path) -> None:
    """Ask the system to forget what it cached of the files below a folder."""
    if not hasattr(os, "posix_fadvise"):
        return
    for path in folder.rglob("*.parquet"):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
        finally:
            os.close(descriptor)


def peak_memory_mb() -> float:
    """Greatest resident memory of this process so far [MB]."""
    status = Path("/proc/self/status")
    if status.exists():  # resource counts the parent's memory too when a process was spawned
        lines = [line.split() for line in status.read_text().splitlines() if line.startswith("VmHWM")]
        return int(lines[0][1]) * 1024 / 1e6
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def _run(connection: Any, sql: str) -> tuple[float, float, int]:
    """Wall time [s], processor time [s] and rows of a query whose rows are all taken out."""
    clock, spent = time.perf_counter(), time.process_time()
    rows = connection.sql(sql).to_arrow_table().num_rows
    return time.perf_counter() - clock, time.process_time() - spent, rows
