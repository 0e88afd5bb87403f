"""Replicas that carts drive in: of scans of generated rooms, half of them hard, and of a house that others furnished; kept in a folder."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from bench.dwellings import make_scan
from bench.dwellings.by_others import scan_of
from bench.policy.datasets import HOME, OTHERS_HOUSE, STAGES, Job, check_house, furnished_room, make_lacking
from bench.realdata import HOUSE
from bench.selection.rooms import LIGHT
from bench.stages import run_stages
from flows.run.fingerprints import code_fingerprint, digest
from tasks.scanner import scan_scene
from warehouse.lake import Lake

PLAIN, HARD = "plain", "hard"
"""Datasets beside the house: rooms that were scanned well, and dwellings that were scanned badly."""

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
    def jobs(self) -> list[Job]:
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
    return make_lacking(data.lake, data.jobs, lambda job: scene_of(*job), partial(make_replica, data), processes, NOTE, advance)


def make_replica(data: RobotReplicas, job: Job) -> str | None:
    """The stages of a scan; the stage that failed, and why, if one did. The scan goes, once nothing failed on it."""
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
    if done.error is not None:
        return f"{done.stage}: {done.error}"
    shutil.rmtree(place)
    return None
