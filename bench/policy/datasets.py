"""Datasets of one lake to learn from and to be tested in: rooms as they were drawn, replicas of scans of the same rooms, and a house that
others furnished."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from bench.dwellings.by_others import BY_OTHERS, scan_of
from bench.policy.rooms import ROOMS_PER_COMMIT, stage_room, with_episodes
from bench.realdata import HOUSE
from bench.replicas import as_drawn
from bench.rooms import disturbed_scene
from bench.selection.rooms import LIGHT
from bench.selection.trainings import mapped
from bench.stages import StagedScan, run_stages
from flows.run.fingerprints import code_fingerprint, digest
from schemas.errors import InputError
from tasks.furniture.rooms import ROOM_TYPES, FurnishedRoom, furnish
from tasks.navigation import NavigationConfig
from tasks.scanner import scan_scene
from warehouse.lake import Lake

GENERATED, REPLICAS, HOME = "generated", "replicas", "house"

OTHERS_HOUSE = next(scan for scan in BY_OTHERS if scan.needs == HOUSE)

STAGES = ("capture", "captions", "candidates", "selection", "optimization", "navigation")
"""Of a scan that are run: what agents need."""

Job = tuple[str, int]
"""A dataset, and the number of a scene in it."""

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

    @cached_property
    def mark(self) -> str:
        """What rows follow from, code, house and all. It goes with what is sent to workers, so that all of them are at one lake."""
        bench = Path(__file__).parents[1]
        own = (
            "policy/datasets",
            "policy/rooms",
            "replicas",
            "rooms",
            "samples",
            "stages",
            "realdata",
            "dwellings/by_others",
            "selection/rooms",
        )
        tasks = ("furniture.rooms", "scanner", "capture.scenes", *STAGES[1:])
        code = (*((bench / f"{name}.py").read_text() for name in own), *(code_fingerprint(f"tasks.{name}") for name in tasks))
        return digest(*code, OTHERS_HOUSE.digest(self.realdata), str(self.rooms), str(self.seed), str(self.episodes))

    @property
    def place(self) -> Path:
        """Where scans and the lake are."""
        return self.folder / f"datasets-{self.mark[:16]}"

    @property
    def lake(self) -> Lake:
        """The lake of all datasets, where models are trained and policies act."""
        return Lake.open(self.place / "lake")

    @property
    def jobs(self) -> list[Job]:
        """Datasets and numbers of what is made; the house, which takes longest, first."""
        return [(HOME, 0), *((name, number) for number in range(self.rooms) for name in (GENERATED, REPLICAS))]

    @property
    def navigation(self) -> tuple[str, ...]:
        """Settings of the stage, whose rooms are all to learn from. The house is never learned from."""
        return (f"navigation.train_episodes={self.episodes}", f"navigation.test_episodes={self.episodes}")


def scene_of(dataset: str, number: int) -> str:
    """Name of a scene."""
    return f"{dataset}/{HOUSE.stem if dataset == HOME else f'scene{number:04d}_00'}"


def check_house(realdata: Path) -> None:
    """Raises InputError where the house, or its library, is not in a folder."""
    if not OTHERS_HOUSE.is_in(realdata):
        problem = f"holds no {OTHERS_HOUSE.needs} with {OTHERS_HOUSE.library}"
        raise InputError(str(realdata), "--realdata", problem, "name the folder that does, or leave the option out")


def make_datasets(data: ComparedDatasets, processes: int, advance: Callable[[str], None]) -> list[str]:
    """Make what the folder lacks, by so many processes; each room stays where it is once it is made. Returns a line for each scan that a
    stage failed on; the same command tries it again.

    Raises:
        InputError: the house is not there.
    """
    check_house(data.realdata)
    return make_lacking(data.lake, data.jobs, lambda job: scene_of(*job), partial(make_scene, data), processes, NOTE, advance)


def make_lacking(
    lake: Lake, jobs: Sequence[Job], name_of: Callable[[Job], str], make: Callable[[Job], str | None], processes: int, note: str,
    advance: Callable[[str], None],
) -> list[str]:  # fmt: skip
    """Stage and commit the scenes that a lake lacks, by so many processes. Returns a line for each that failed.

    Args:
        lake: Where scenes go.
        jobs: What there should be.
        name_of: The scene of a job.
        make: Stages a scene up to its navigation, in a worker process; says why it could not.
        processes: That make scenes.
        note: Of commits.
        advance: Is told of each scene that is there.
    """
    lake.commit(note)  # what an interrupted run had staged
    known = {scene for (scene, stage), state in lake.history().items() if stage == STAGES[-1] and state.done}
    lacking = [job for job in jobs if name_of(job) not in known]
    for job in jobs:
        if job not in lacking:
            advance(name_of(job))
    failed = []
    with mapped(processes) as spread:
        for done, (job, error) in enumerate(zip(lacking, spread(make, lacking), strict=True), start=1):
            advance(name_of(job))
            if error is not None:
                failed.append(f"{name_of(job)}: {error}")
            if done % ROOMS_PER_COMMIT == 0:
                lake.commit(note)
    lake.commit(note)
    return failed


def make_scene(data: ComparedDatasets, job: Job) -> str | None:
    """Make a scene with its episodes, and leave all of it staged; the stage that failed, and why, if one did."""
    dataset, number = job
    scene = scene_of(dataset, number)
    if dataset == GENERATED:
        rng = np.random.default_rng([data.seed, number, 1])
        # every object has its own mesh, as in the scan
        drawn = disturbed_scene(scene, furnished_room(number, data.seed), rng, plain_share=0.0, shares=())
        config = NavigationConfig(train_episodes=data.episodes, test_episodes=data.episodes, test_share=0.0)
        stage_room(data.lake, *with_episodes(*as_drawn(drawn), data.seed, config), data.mark)
        return None
    done = _replica(data, dataset, number)
    return None if done.error is None else f"{done.stage}: {done.error}"


def furnished_room(number: int, seed: int) -> FurnishedRoom:
    """Room `number` of a seed: kinds in turn, about as full as rooms of scans are, with clutter on some floors."""
    rng = np.random.default_rng([seed, number])
    return furnish(ROOM_TYPES[number % len(ROOM_TYPES)], rng, int(rng.integers(15, 45)), float(rng.uniform(0.0, 0.6)))


def _replica(data: ComparedDatasets, dataset: str, number: int) -> StagedScan:
    """The stages of a scan: of a generated room by a hurried walk, or of the house with its own models as library. The scan goes, once
    nothing failed on it."""
    place = data.place / "scans" / scene_of(dataset, number)
    shutil.rmtree(place, ignore_errors=True)  # of a command that was killed
    if dataset == HOME:
        scans, _ = scan_of(OTHERS_HOUSE, data.realdata, place)
        settings = (*data.navigation, "navigation.test_share=1.0")
        done = run_stages(data.lake, scans, STAGES, 1, settings, data.realdata / (OTHERS_HOUSE.library or ""), dataset)
    else:
        rng = np.random.default_rng([data.seed, number, 2])
        scan_scene(furnished_room(number, data.seed), place, scene_of(dataset, number).partition("/")[2], LIGHT, rng)
        done = run_stages(data.lake, place, STAGES, 1, (*data.navigation, "navigation.test_share=0.0"), None, dataset)
    if done.error is None:
        shutil.rmtree(place)
    return done
