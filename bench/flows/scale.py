"""What grows with a scene's objects and with the number of scenes: crowded halls and many near-empty rooms through all stages.

Each size is a process of its own that has done a small room before, so that nothing of it is the first import or the first
compilation. Seconds are of the processor: neighbors on the machine do not count. What grows as the n-th power of the size is told by
a line fitted to the logarithms of three sizes or more.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.flows.projection import Prices, projection
from bench.flows.requests import Requests, counting_store
from bench.flows.runs import surroundings
from bench.flows.small_scenes import SETTINGS, write_crowded_scan, write_small_scans
from bench.goals import goal
from bench.machine import machine
from flows.run.child import ONE_THREAD
from schemas.errors import LakeError
from warehouse.storage.blobs import FOLDER as BLOBS

if TYPE_CHECKING:
    from warehouse.lake import Lake

STEEP = 1.25
"""An exponent above this is told as growing faster than linearly: a logarithm and what is left of fixed costs stay below it."""

BESIDE = 25
"""Near-empty scenes that are added to a lake which holds others: a commit's worth."""

_LEAST_SECONDS = 0.5
"""Of the largest size: what takes less is not worth an exponent."""


@dataclasses.dataclass(frozen=True)
class ScaleBench:
    """What is measured. objects: of one scene. scenes: near-empty ones, of one object each. requests: numbers of such scenes whose lake
    is in a store of objects, which counts what it is asked. held: numbers of generated scenes that a lake holds already when `BESIDE`
    near-empty ones are added. projected: number of scenes that the report goes on to, at `prices`."""

    objects: tuple[int, ...] = (100, 300, 1000)
    scenes: tuple[int, ...] = (30, 100, 300)
    requests: tuple[int, ...] = ()
    held: tuple[int, ...] = ()
    seed: int = 0
    projected: int | None = None
    prices: Prices = dataclasses.field(default_factory=Prices)


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
                measured.append({"size": size} | _measured(Path(work), what, size, config.seed))
                advance(f"{size:,} {what}")
            report[what] = {"sizes": measured, "exponents": exponents(measured)}
        report["requests"] = []
        for size in config.requests:
            report["requests"].append({"size": size} | _measured(Path(work), "requests", size, config.seed))
            advance(f"requests of {size:,} scenes")
        report["held"] = []
        for size in config.held:
            report["held"].append({"size": size} | _beside(Path(work), size, config.seed))
            advance(f"{BESIDE} scenes beside {size:,}")
    if config.projected is not None:
        report["projection"] = {"scenes": config.projected} | projection(report, config.projected, config.prices)
    steep = [f"{what}: {name}" for what in ("objects", "scenes") for name, power in report[what]["exponents"].items() if power > STEEP]
    report["steep"] = steep
    tried = max(len(config.objects), len(config.scenes)) > 2  # two sizes make any line, and have no exponents
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
    scans = folder / f"{what}{size}"
    if what == "objects":
        write_crowded_scan(scans, size, seed)
    else:
        write_small_scans(scans, size, seed)
    return _measured_apart(folder, scans, "" if what == "requests" else str(folder / f"lake-{what}{size}"), seed)


def _beside(folder: Path, held_scenes: int, seed: int) -> dict[str, Any]:
    """Figures of every stage of `BESIDE` near-empty scenes, in a copy of a generated lake that holds so many of 40 objects."""
    from bench.warehouse.generator import copied_lake, generated_lake

    scans, original = folder / "beside", generated_lake(held_scenes, seed)
    if not scans.exists():
        write_small_scans(scans, BESIDE, seed)
    with tempfile.TemporaryDirectory(prefix="scale-", dir=Path(original.address).parent) as copies:
        return _measured_apart(folder, scans, copied_lake(original, Path(copies) / "lake").address, seed)


def _measured_apart(folder: Path, scans: Path, lake: str, seed: int) -> dict[str, Any]:
    """Figures of every stage of these scans, by a process of its own."""
    first = folder / "first"
    if not first.exists():
        write_crowded_scan(first, 5, seed)
    command = [sys.executable, "-m", "bench.flows.scale", str(first), str(scans), lake]
    done = subprocess.run(command, env=surroundings(folder) | ONE_THREAD, capture_output=True, text=True, check=False)
    if done.returncode:
        raise LakeError(f"{scans.name}: {(done.stderr.strip().splitlines() or ['it said nothing'])[-1]}")
    figures: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return figures


class _Meter:
    """Adds up what parts of the work take, and the requests of each where a store counts them."""

    def __init__(self, requests: Requests | None = None) -> None:
        self.parts: dict[str, dict[str, Any]] = {}
        self._requests = requests

    def of(self, name: str, work: Callable[[], Any]) -> Any:
        """Do it, and add it to a part: seconds, those of the processor, and the most memory [MB]."""
        _forget_peak()
        if self._requests is not None:
            self._requests.part = name
        wall, cpu = time.perf_counter(), time.process_time()
        result = work()
        part = self.parts.setdefault(name, {"seconds": 0.0, "cpu_seconds": 0.0, "memory_mb": 0.0})
        part["seconds"] += time.perf_counter() - wall
        part["cpu_seconds"] += time.process_time() - cpu
        part["memory_mb"] = max(part["memory_mb"], _peak_mb())
        if self._requests is not None:
            part["requests"] = self._requests.of(name)
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


def through(scans: Path, address: str | Path, meter: _Meter) -> dict[str, Any]:
    """All stages of all scans, one after another in this process, the plan, and commits of as many scenes as a run lets wait at most;
    what the lake holds.

    Raises:
        LakeError: a stage failed.
    """
    from flows.run.configuration import configure
    from flows.run.fanout.committer import MANY_SCENES
    from flows.run.plan import make_plan
    from flows.run.scene import job_of
    from flows.worker import execute
    from tasks.capture.formats import find_scans
    from warehouse.lake import Lake

    lake, configuration = Lake.open(address), configure(None, SETTINGS)
    scan_list, unusable = find_scans(scans)
    plan = meter.of("plan", lambda: make_plan(lake, scan_list, unusable, configuration))
    for number, scene in enumerate(plan.todo, start=1):
        for step in scene.todo:
            run = meter.of(step.stage, lambda scene=scene, step=step: execute(job_of(lake, scene, step, configuration)))  # type: ignore[misc]
            if run.outcome != "done":
                raise LakeError(f"{run.scene_id}: {run.stage}: {run.error}")
        if number % MANY_SCENES == 0:
            meter.of("commit", lambda: lake.commit("scale"))
    if len(plan.todo) % MANY_SCENES:
        meter.of("commit", lambda: lake.commit("scale"))
    meter.of("plan again", lambda: make_plan(lake, scan_list, unusable, configuration))
    return held(lake)


def held(lake: Lake) -> dict[str, Any]:
    """What a lake holds: files, bytes of the rows and blobs of each stage, and bytes of everything else, such as logs.

    A blob is of the first table that names it, in the order of the data path.
    """
    from schemas.tables import TABLES

    sizes = {entry.path: entry.size for entry in lake.storage.walk("")}
    reader, rest = lake.snapshot(), dict(sizes)
    stages: dict[str, int] = {}
    for table in TABLES.values():
        paths = set(reader.files(table.name))
        for column in table.blob_columns:
            names = reader.arrow(table.name).column(column).unique().drop_null().to_pylist()
            paths |= {f"{BLOBS}/{name[:2]}/{name[2:4]}/{name}" for name in names}
        stage = table.stage or table.name
        stages[stage] = stages.get(stage, 0) + sum(rest.pop(path, 0) for path in paths)
    return {"files": len(sizes), "bytes": stages | {"other": sum(rest.values())}}


def main(first: Path, scans: Path, lake: str) -> None:
    """Measure one size, after a small room; in a store of objects that counts requests where no folder is named for the lake."""
    with tempfile.TemporaryDirectory() as warm:
        through(first, Path(warm) / "lake", _Meter())
    requests = None if lake else Requests()
    meter = _Meter(requests)
    with contextlib.nullcontext(lake) if requests is None else counting_store(requests) as address:
        holds = through(scans, address, meter)
    print(json.dumps({"stages": meter.parts, "holds": holds}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
