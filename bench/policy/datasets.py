"""Datasets of one lake to learn from and to be tested in: rooms as they were drawn, replicas of scans of the same rooms, and a house that
others furnished."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from bench.dwellings.by_others import BY_OTHERS, scan_of
from bench.policy.rooms import ROOMS_PER_COMMIT, stage_room, with_episodes
from bench.realdata import HOUSE, MODELS
from bench.replicas import as_drawn
from bench.rooms import disturbed_scene
from bench.selection.rooms import LIGHT
from bench.selection.trainings import mapped
from bench.stages import StagedScan, run_stages
from flows.run.fingerprints import code_fingerprint, digest
from schemas.errors import InputError, LakeError
from schemas.navigation import Episode
from tasks.furniture.rooms import ROOM_TYPES, FurnishedRoom, furnish
from tasks.navigation import NavigationConfig
from tasks.scanner import scan_scene
from warehouse.lake import Lake

GENERATED, REPLICAS, HOME = "generated", "replicas", "house"

STAGES = ("capture", "captions", "candidates", "selection", "optimization", "navigation")
"""Of a scan that are run: what agents need."""

NOTE = "rooms to compare datasets by"
"""Of commits."""


@dataclasses.dataclass(frozen=True)
class ComparedDatasets:
    """Datasets in a folder. realdata: Folder with the AWS small house. rooms: Of `generated`, and of `replicas`. episodes: At most, of each
    room to learn from, and in the house."""

    folder: Path
    realdata: Path
    rooms: int = 24
    seed: int = 0
    episodes: int = 100

    @property
    def mark(self) -> str:
        """What rows follow from, code and all."""
        bench = Path(__file__).parents[1]
        makers = (Path(__file__), *(bench / f"{name}.py" for name in ("replicas", "rooms", "stages", "dwellings/by_others")))
        tasks = ("furniture.rooms", "scanner", "capture.scenes", *STAGES[1:])
        code = (*(path.read_text() for path in makers), *(code_fingerprint(f"tasks.{name}") for name in tasks))
        return digest(*code, str(self.rooms), str(self.seed), str(self.episodes))

    @property
    def place(self) -> Path:
        """Where scans and the lake are."""
        return self.folder / f"datasets-{self.mark[:16]}"

    @property
    def lake(self) -> Lake:
        """The lake of all datasets, where models are trained and policies act."""
        return Lake.open(self.place / "lake")

    @property
    def jobs(self) -> list[tuple[str, int]]:
        """Datasets and numbers of what is made."""
        return [*((name, number) for number in range(self.rooms) for name in (GENERATED, REPLICAS)), (HOME, 0)]

    @property
    def navigation(self) -> tuple[str, ...]:
        """Settings of the stage, whose rooms are all to learn from. The house is never learned from."""
        return (f"navigation.train_episodes={self.episodes}", f"navigation.test_episodes={self.episodes}")


def scene_of(dataset: str, number: int) -> str:
    """Name of a scene."""
    return f"{dataset}/{HOUSE.stem if dataset == HOME else f'scene{number:04d}_00'}"


def make_datasets(data: ComparedDatasets, processes: int, advance: Callable[[str], None]) -> list[str]:
    """Make what the folder lacks, by so many processes; each room stays where it is once it is made. Returns a line for each room that
    leaves the agent no floor, and so is in a dataset without episodes.

    Raises:
        InputError: the house is not there.
        LakeError: a stage failed.
    """
    if not all((data.realdata / part).exists() for part in (HOUSE, MODELS)):
        raise InputError(str(data.realdata), "--realdata", f"holds no {HOUSE} with {MODELS}", "name the folder that does")
    lake = data.lake
    lake.commit(NOTE)  # what an interrupted run had staged
    known = {scene for (scene, stage), state in lake.history().items() if stage == "navigation" and state.done}
    lacking = [job for job in data.jobs if scene_of(*job) not in known]
    for job in data.jobs:
        if job not in lacking:
            advance(scene_of(*job))
    with mapped(processes) as spread:
        for done, job in enumerate(spread(partial(make_scene, data), lacking), start=1):
            advance(scene_of(*job))
            if done % ROOMS_PER_COMMIT == 0:
                lake.commit(NOTE)
    lake.commit(NOTE)
    walked = {row.scene_id for row in lake.snapshot().rows(Episode)}
    return [f"{scene}: has no episodes" for scene in (scene_of(*job) for job in data.jobs) if scene not in walked]


def make_scene(data: ComparedDatasets, job: tuple[str, int]) -> tuple[str, int]:
    """Make a scene with its episodes, and leave all of it staged; the job.

    Raises:
        LakeError: a stage failed.
    """
    dataset, number = job
    scene = scene_of(dataset, number)
    if dataset == GENERATED:
        drawn = disturbed_scene(scene, furnished_room(number, data.seed), np.random.default_rng([data.seed, number, 1]), shares=())
        config = NavigationConfig(train_episodes=data.episodes, test_episodes=data.episodes, test_share=0.0)
        stage_room(data.lake, *with_episodes(*as_drawn(drawn), data.seed, config), data.mark)
        return job
    done = _replica(data, dataset, number)
    if done.error is not None:
        raise LakeError(f"{scene}: {done.stage}: {done.error}")
    return job


def furnished_room(number: int, seed: int) -> FurnishedRoom:
    """Room `number` of a seed: kinds in turn, about as full as rooms of scans are, with clutter on some floors."""
    rng = np.random.default_rng([seed, number])
    return furnish(ROOM_TYPES[number % len(ROOM_TYPES)], rng, int(rng.integers(15, 45)), float(rng.uniform(0.0, 0.6)))


def _replica(data: ComparedDatasets, dataset: str, number: int) -> StagedScan:
    """The stages of a scan: of a generated room by a hurried walk, or of the house with its own models as library."""
    place = data.place / "scans" / scene_of(dataset, number)
    shutil.rmtree(place, ignore_errors=True)
    if dataset == HOME:
        house = next(scan for scan in BY_OTHERS if scan.needs == HOUSE)
        scans, _ = scan_of(house, data.realdata, place)
        return run_stages(
            data.lake, scans, STAGES, 1, (*data.navigation, "navigation.test_share=1.0"), data.realdata / MODELS, dataset
        )  # fmt: skip
    rng = np.random.default_rng([data.seed, number, 2])
    scan_scene(furnished_room(number, data.seed), place, scene_of(dataset, number).partition("/")[2], LIGHT, rng)
    return run_stages(data.lake, place, STAGES, 1, (*data.navigation, "navigation.test_share=0.0"), None, dataset)
