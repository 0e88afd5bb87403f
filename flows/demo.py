"""The demo's raw scans: made by the virtual scanner in parallel, each folder whole or not there at all."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from flows.fingerprints import code_fingerprint
from flows.pool import WorkerPool
from flows.progress import Progress

MARK = "made.json"
"""Beside the scans: which code and seed made them. A demo that finds the same again keeps its scans."""


def make_scans(folder: Path, count: int, seed: int, workers: int) -> int:
    """Make `count` raw scans of furnished rooms in `folder`. Returns how many had to be made; 0 when all were there."""
    mark = {"code": code_fingerprint("tasks.scanner.demo"), "seed": seed, "count": count}
    path = folder / MARK
    if path.is_file() and json.loads(path.read_text()) == mark:
        return 0
    folder.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    for old in folder.iterdir():
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    with Progress("scans", count) as progress, WorkerPool(min(workers, count)) as pool, ThreadPoolExecutor(count) as threads:

        def make(index: int) -> None:
            pool.call(make_scan, folder, index, seed)
            progress.advance()

        list(threads.map(make, range(count)))
    path.write_text(json.dumps(mark))
    return count


def make_scan(folder: Path, index: int, seed: int) -> None:
    """Make one scan beside the others, then move it into place. Runs in a worker."""
    from tasks.scanner.demo import demo_scan

    making = folder / f".making-{index}"
    shutil.rmtree(making, ignore_errors=True)
    making.mkdir()
    demo_scan(making, index, seed)
    truth = folder.parent / "truth"
    truth.mkdir(exist_ok=True)
    for made in sorted(making.iterdir()):
        made.rename((truth if made.suffix == ".json" else folder) / made.name)
    making.rmdir()
