"""What grows with a scene's objects and with the number of scenes: crowded halls and many near-empty rooms through all stages.

Each size is a process of its own that has done a small room before, so that nothing of it is the first import or the first
compilation. Seconds are of the processor: neighbors on the machine do not count. What grows as the n-th power of the size is told by
a line fitted to the logarithms of three sizes or more.
"""

from __future__ import annotations

import dataclasses
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.flows.runs import surroundings
from bench.flows.small_scenes import SETTINGS, write_crowded_scan, write_small_scans
from bench.goals import goal
from bench.machine import machine
from flows.run.child import ONE_THREAD
from schemas.errors import LakeError

STEEP = 1.25
"""An exponent above this is told as growing faster than linearly: a logarithm and what is left of fixed costs stay below it."""

_LEAST_SECONDS = 0.5
"""Of the largest size: what takes less is not worth an exponent."""


@dataclasses.dataclass(frozen=True)
class ScaleBench:
    """What is measured. objects: of one scene. scenes: near-empty ones, of one object each."""

    objects: tuple[int, ...] = (100, 300, 1000)
    scenes: tuple[int, ...] = (30, 100, 300)
    seed: int = 0


def run_scale_bench(config: ScaleBench, advance: Callable[[str], None] = lambda what: None, folder: Path | None = None) -> dict[str, Any]:
    """The report: seconds and memory of every stage at every size, and its exponent. Works below `folder`.

    Raises:
        LakeError: a size did not go through; with the last line that was said.
    """
    report: dict[str, Any] = {"machine": machine(), "seed": config.seed}
    with tempfile.TemporaryDirectory(prefix="bench-scale-", dir=folder) as work:
        for what, sizes in (("objects", config.objects), ("scenes", config.scenes)):
            measured = []
            for size in sizes:
                measured.append({"size": size, "stages": _measured(Path(work), what, size, config.seed)})
                advance(f"{size:,} {what}")
            report[what] = {"sizes": measured, "exponents": exponents(measured)}
    steep = [f"{what}: {name}" for what in ("objects", "scenes") for name, power in report[what]["exponents"].items() if power > STEEP]
    report["steep"] = steep
    tried = min(len(config.objects), len(config.scenes)) > 2  # two sizes make any line
    report["goals"] = [goal("stages that grow faster than linearly", len(steep) if tried else None, "==", 0)]
    return report


def exponents(sizes: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """By stage the power of the size that its seconds grow with; of those that take a while at the largest size."""
    import numpy as np

    powers = {}
    for name, last in sizes[-1]["stages"].items() if len(sizes) > 2 else ():
        seconds = [max(size["stages"].get(name, {}).get("cpu_seconds", 0.0), 1e-3) for size in sizes]
        if last["cpu_seconds"] >= _LEAST_SECONDS:
            powers[name] = float(np.polyfit([math.log(size["size"]) for size in sizes], np.log(seconds), 1)[0])
    return powers


def _measured(folder: Path, what: str, size: int, seed: int) -> dict[str, Any]:
    """Figures of every stage at one size."""
    scans, first = folder / f"{what}{size}", folder / "first"
    if what == "objects":
        write_crowded_scan(scans, size, seed)
    else:
        write_small_scans(scans, size, seed)
    if not first.exists():
        write_crowded_scan(first, 5, seed)
    command = [sys.executable, "-m", "bench.flows.scale", str(first), str(scans), str(folder / f"lake-{what}{size}")]
    done = subprocess.run(command, env=surroundings(folder) | ONE_THREAD, capture_output=True, text=True, check=False)
    if done.returncode:
        raise LakeError(f"{size} {what}: {(done.stderr.strip().splitlines() or ['it said nothing'])[-1]}")
    figures: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return figures


class _Meter:
    """Adds up what parts of the work take."""

    def __init__(self) -> None:
        self.parts: dict[str, dict[str, float]] = {}

    def of(self, name: str, work: Callable[[], Any]) -> Any:
        """Do it, and add it to a part: seconds, those of the processor, and the most memory [MB]."""
        _forget_peak()
        wall, cpu = time.perf_counter(), time.process_time()
        result = work()
        part = self.parts.setdefault(name, {"seconds": 0.0, "cpu_seconds": 0.0, "memory_mb": 0.0})
        part["seconds"] += time.perf_counter() - wall
        part["cpu_seconds"] += time.process_time() - cpu
        part["memory_mb"] = max(part["memory_mb"], _peak_mb())
        return result


def _forget_peak() -> None:
    """Let the most memory of this process be what it has now; only Linux can."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def _peak_mb() -> float:
    """The most resident memory since then [MB]."""
    import resource

    status = Path("/proc/self/status")
    if status.exists():
        return next(int(line.split()[1]) / 1024 for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def through(scans: Path, address: Path, meter: _Meter) -> None:
    """All stages of all scans, one after another in this process, and the plan, the commit and a look at the lake.

    Raises:
        LakeError: a stage failed.
    """
    from flows.run.configuration import configure
    from flows.run.plan import make_plan
    from flows.run.scene import job_of
    from flows.worker import execute
    from tasks.capture.formats import find_scans
    from warehouse.lake import Lake

    lake, configuration = Lake.open(address), configure(None, SETTINGS)
    scan_list, unusable = find_scans(scans)
    plan = meter.of("plan", lambda: make_plan(lake, scan_list, unusable, configuration))
    for scene in plan.todo:
        for step in scene.todo:
            run = meter.of(step.stage, lambda scene=scene, step=step: execute(job_of(lake, scene, step, configuration)))  # type: ignore[misc]
            if run.outcome != "done":
                raise LakeError(f"{run.scene_id}: {run.stage}: {run.error}")
    meter.of("commit", lambda: lake.commit("scale"))
    meter.of("plan again", lambda: make_plan(lake, scan_list, unusable, configuration))


def main(first: Path, scans: Path, lake: Path) -> None:
    """Measure one size, after a small room."""
    with tempfile.TemporaryDirectory() as warm:
        through(first, Path(warm) / "lake", _Meter())
    meter = _Meter()
    through(scans, lake, meter)
    print(json.dumps(meter.parts))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
