"""The demo's raw scans: made by the virtual scanner in parallel, each folder whole or not there at all."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from flows.progress import Progress
from flows.run.fingerprints import code_fingerprint
from flows.run.pool import WorkerPool
from schemas.errors import InputError
from schemas.parsing import json_value

MARK = "made.json"
"""Beside the scans: which code and seed made them. A demo that finds the same again keeps its scans."""


def make_scans(folder: Path, count: int, seed: int, workers: int) -> int:
    """Make `count` raw scans of furnished rooms in `folder`. Returns how many had to be made; 0 when all were there."""
    mark = {"code": code_fingerprint("tasks.scanner.demo"), "seed": seed, "count": count}
    path = folder / MARK
    names = [f"scene{index:04d}_00" for index in range(count)]
    known = _mark(path)
    if known == mark and all((folder / name).is_dir() for name in names):
        return 0
    present = sorted(p.name for p in folder.iterdir()) if folder.is_dir() else []
    if present and known is None:
        raise InputError(str(folder), "folder", f"holds {present[0]}, which the demo did not make", "give another --out")
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"making": mark}))  # from here on, what lies here is the demo's
    for old in folder.glob("*scene*"):
        shutil.rmtree(old)
    with Progress("scans", count) as progress, WorkerPool(min(workers, count)) as pool, ThreadPoolExecutor(count) as threads:

        def make(index: int) -> None:
            pool.call(make_scan, folder, index, seed)
            progress.advance()

        list(threads.map(make, range(count)))
    path.write_text(json.dumps(mark))
    return count


def _mark(path: Path) -> object:
    """What the mark says; None where there is none, or none that can be read."""
    try:
        return json_value(path.read_text())
    except (OSError, ValueError):
        return None


def make_scan(folder: Path, index: int, seed: int) -> None:
    """Make one scan beside the others, then move it into place. Runs in a worker."""
    from tasks.scanner.demo import demo_scan

    making = folder / f".making-scene{index}"
    shutil.rmtree(making, ignore_errors=True)
    making.mkdir()
    demo_scan(making, index, seed)
    truth = folder.parent / "truth"
    truth.mkdir(exist_ok=True)
    for made in sorted(making.iterdir()):
        made.rename((truth if made.suffix == ".json" else folder) / made.name)
    making.rmdir()
