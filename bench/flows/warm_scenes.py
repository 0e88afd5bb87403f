"""What one scanned room takes through all stages in a process that has done another: on one core, and spread over two.

Seconds are of the clock, since spreading is what is asked about: work beside it on the machine makes them longer. Each figure is of a
process with caches of its own, so that nothing of a room was there before.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.flows.runs import surroundings
from bench.goals import goal
from flows.run.child import ONE_THREAD
from schemas.errors import LakeError

GOALS = {25: 7.0, 45: 14.0}
"""Seconds that a room with so many objects may take on two cores."""

CORES = (1, 2)
"""Cores that a stage may use; on a machine with one, one."""

_FIRST = 15
"""Objects of the room that comes before, for imports and kernels."""


@dataclasses.dataclass(frozen=True)
class WarmScene:
    """A room of `objects` objects and the seconds of its stages on `cores` cores."""

    objects: int
    cores: int
    seconds: Mapping[str, float]


def warm_scenes(folder: Path, seed: int, advance: Callable[[str], None], sizes: Sequence[int] = tuple(GOALS)) -> list[WarmScene]:
    """Measure rooms of so many objects, on one core and on two. Works below `folder`; `advance` is told each.

    Raises:
        LakeError: a room did not go through, with the last line that was said.
    """
    first = _scan(folder / "first", _FIRST, seed)
    measured = []
    for objects in sizes:
        scans = _scan(folder / f"room{objects}", objects, seed)
        for cores in CORES[: os.cpu_count()]:
            place = folder / f"room{objects}-{cores}"
            command = [sys.executable, "-m", "bench.flows.warm_scenes", str(first), str(scans), str(place), str(cores)]
            done = subprocess.run(command, env=surroundings(place) | ONE_THREAD, capture_output=True, text=True, check=False)
            if done.returncode:
                raise LakeError(f"{objects} objects: {(done.stderr.strip().splitlines() or ['it said nothing'])[-1]}")
            measured.append(WarmScene(objects, cores, json.loads(done.stdout.strip().splitlines()[-1])))
            advance(f"{objects} objects on {cores}")
    return measured


def warm_goals(scenes: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rooms that have a goal, on two cores, held against it; where there is one core, nothing was found."""
    two = max(CORES)
    rooms = {scene["objects"]: None for scene in scenes}
    rooms |= {scene["objects"]: sum(scene["seconds"].values()) for scene in scenes if scene["cores"] == two}
    return [
        goal(f"a scanned room of {objects} objects on two cores [s]", seconds, "<=", GOALS[objects])
        for objects, seconds in rooms.items()
        if objects in GOALS
    ]


def _scan(folder: Path, objects: int, seed: int) -> Path:
    """A folder with the scan of one furnished room, as the demo's are."""
    import numpy as np

    from tasks.furniture.rooms import furnish
    from tasks.scanner import ScannerConfig, scan_scene

    rng = np.random.default_rng([seed, objects])
    folder.mkdir(parents=True)
    scan_scene(furnish("living room", rng, object_count=objects, clutter=0.2), folder, "scene0000_00", ScannerConfig(frames="sens"), rng)
    for truth in folder.glob("*.json"):
        truth.unlink()
    return folder


def main(first: Path, scans: Path, place: Path, cores: int) -> None:
    """Print the seconds of each stage of a scan, after another scan went through them, as JSON."""
    from bench.stages import run_stages
    from tasks.pipeline import SCENE_STAGES
    from warehouse.lake import Lake

    names = [stage.name for stage in SCENE_STAGES]
    for scan, lake in ((first, "first"), (scans, "lake")):
        staged = run_stages(Lake.open(str(place / lake)), scan, names, cores)
        if staged.error is not None:
            raise LakeError(f"{scan.name}: {staged.stage}: {staged.error}")
    print(json.dumps(staged.seconds))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]))
