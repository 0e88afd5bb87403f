"""Batches by kind. `python -m bench.kills.batches KIND SEED KILLS FOLDER PEACE` works one in a process of its own and prints what
came of it as JSON.
"""

from __future__ import annotations

import importlib
import json
import select
import sys
import time
from pathlib import Path
from typing import Any

from bench.kills.stories import KillBatch, crashing, crowded

_NEEDED = (
    "deltalake.table", "duckdb", "pyarrow.dataset", "pyarrow.fs", "pyarrow.parquet", "flows.inputs.annotation", "flows.worker",
    "tasks.pipeline", "warehouse.lake", "warehouse.release", "warehouse.upkeep.backup", "warehouse.upkeep.compaction",
    "warehouse.upkeep.erasure", "warehouse.upkeep.inspection", "warehouse.upkeep.vacuum",
)  # fmt: skip


def main(kind: str, seed: int, kills: int, folder: Path, peace: Path) -> KillBatch:
    """One batch of a kind. In `peace` lies what runs are held against; it is made when it is not there.

    Raises:
        ValueError: there is no such kind.
    """
    if kind in ("runs", "configs"):
        from bench.kills.runs import of_one_run, of_two_configs

        return (of_one_run if kind == "runs" else of_two_configs)(seed, kills, folder, peace)
    _preload()
    if kind.startswith("clock"):
        # libfaketime takes the monotonic times that time.sleep gives to clock_nanosleep for times of day, and refuses them.
        time.sleep = _slept
    begun = time.monotonic()
    if kind in ("lake", "clock"):
        batch = crashing(seed, kills, folder, kind == "clock")
    elif kind in ("writers", "clock writers"):
        batch = crowded(seed, kills, folder, kind == "clock writers")
    elif kind == "disk":
        from bench.kills.disk import filled

        batch = filled(seed, kills, folder)
    else:
        raise ValueError(f"{kind!r} is no kind of batch")
    batch.seconds = time.monotonic() - begun
    return batch


def _slept(seconds: Any) -> None:
    select.select([], [], [], max(0.0, seconds))


def _preload() -> None:
    """Import what the children need, once. Nothing of it may start a thread: see `death`."""
    for name in _NEEDED:
        importlib.import_module(name)


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]), Path(sys.argv[5])).as_json()))
