"""Replicas that carts drive in: of scans of generated rooms, half of them hard, and of a house that others furnished; kept in a folder."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from bench.dwellings import make_scan
from bench.dwellings.by_others import BY_OTHERS, scan_of
from bench.policy.datasets import check_house, furnished_room
from bench.policy.rooms import ROOMS_PER_COMMIT
from bench.realdata import HOUSE
from bench.selection.rooms import LIGHT
from bench.selection.trainings import mapped
from bench.stages import StagedScan, run_stages
from flows.run.fingerprints import code_fingerprint, digest
from tasks.scanner import scan_scene
from warehouse.lake import Lake

PLAIN, HARD, HOME = "plain", "hard", "house"
"""Datasets: rooms that were scanned well, dwellings that were scanned badly, the AWS small house."""

OTHERS_HOUSE = next(scan for scan in BY_OTHERS if scan.needs == HOUSE)

STAGES = ("capture", "captions", "candidates", "selection", "optimization", "navigation")
"""Of a scan that are run: what carts need."""

NOTE = "replicas that carts drive in"
"""Of commits."""


@dataclasses.dataclass(frozen=True)
class RobotReplicas:
    """Replicas in a folder. count: Of generated rooms, every other one of them hard. realdata: Folder with the AWS small house, which is
    one more; None for none. episodes: Of each."""

    folder: Path
    count: int = 20
    seed: int = 0
    realdata: Path | None = None
    episodes: int = 30

    @cached_property
    def mark(self) -> str:
        """What replicas follow from, code, house and all. It goes with what is sent to workers, so that all of them are at one lake."""
        bench = Path(__file__).parents[1]
        own = (
            "robot/replicas",
            "policy/datasets",
            "rooms",
            "stages",
            "realdata",
            "dwellings/by_others",
            "dwellings/__init__",
            "selection/rooms",
        )
        tasks = ("furniture.rooms", "scanner", "scanner.dwellings", "capture.scenes", *STAGES[1:])
        code = (*((bench / f"{name}.py").read_text() for name in own), *(code_fingerprint(f"tasks.{name}") for name in tasks))
        house = "" if self.realdata is None else OTHERS_HOUSE.digest(self.realdata)
        return digest(*code, house, str(self.count), str(self.seed), str(self.episodes))

    @property
    def place(self) -> Path:
        """Where scans and the lake are."""
        return self.folder / f"replicas-{self.mark[:16]}"

    @property
    def lake(self) -> Lake:
        """The lake of all replicas, where carts drive."""
        return Lake.open(self.place / "lake")

    @property
    def jobs(self) -> list[tuple[str, int]]:
        """Datasets and numbers of what is made; the house, which takes longest, first."""
        rooms = [((PLAIN, HARD)[number % 2], number) for number in range(self.count)]
        return [(HOME, 0), *rooms] if self.realdata is not None else rooms


def scene_of(dataset: str, number: int) -> str:
    """Name of a scene."""
    return f"{dataset}/{HOUSE.stem if dataset == HOME else f'scene{number:04d}_00'}"


def make_replicas(data: RobotReplicas, processes: int, advance: Callable[[str], None]) -> list[str]:
    """Make what the folder lacks, by so many processes; each replica stays where it is once it is made. Returns a line for each scan that a
    stage failed on; the same command tries it again.

    Raises:
        InputError: the house is not there.
    """
    if data.realdata is not None:
        check_house(data.realdata)
    lake = data.lake
    lake.commit(NOTE)  # what an interrupted run had staged
    known = {scene for (scene, stage), state in lake.history().items() if stage == STAGES[-1] and state.done}
    lacking = [job for job in data.jobs if scene_of(*job) not in known]
    for job in data.jobs:
        if job not in lacking:
            advance(scene_of(*job))
    failed = []
    with mapped(processes) as spread:
        for done, (job, made) in enumerate(zip(lacking, spread(partial(make_replica, data), lacking), strict=True), start=1):
            advance(scene_of(*job))
            if made.error is not None:
                failed.append(f"{scene_of(*job)}: {made.stage}: {made.error}")
            if done % ROOMS_PER_COMMIT == 0:
                lake.commit(NOTE)
    lake.commit(NOTE)
    return failed


def make_replica(data: RobotReplicas, job: tuple[str, int]) -> StagedScan:
    """The stages of a scan. The scan goes, once nothing failed on it."""
    dataset, number = job
    place = data.place / "scans" / scene_of(*job)
    shutil.rmtree(place, ignore_errors=True)  # of a command that was killed
    settings = [f"navigation.{split}_episodes={data.episodes}" for split in ("train", "test")]
    library = None
    scans = place
    if dataset == HOME:
        assert data.realdata is not None
        scans, _ = scan_of(OTHERS_HOUSE, data.realdata, place)
        library = data.realdata / (OTHERS_HOUSE.library or "")
    elif dataset == HARD:
        make_scan(place, number, data.seed)
    else:
        rng = np.random.default_rng([data.seed, number, 2])
        scan_scene(furnished_room(number, data.seed), place, scene_of(*job).partition("/")[2], LIGHT, rng)
    done = run_stages(data.lake, scans, STAGES, 1, settings, library, dataset)
    if done.error is None:
        shutil.rmtree(place)
    return done
