"""What orchestration costs: the same small scenes through every runner, beside a plain loop over the pool without Prefect."""

from __future__ import annotations

import shutil
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

from bench.flows.runs import PLAIN, Figures, measured_run
from bench.flows.small_scenes import SETTINGS, write_small_scans
from tasks.scanner.demo import demo_scan

WARM_SCENES = 2
"""Scenes of a run before the measured ones: afterwards Prefect's database and compiled code are there."""

SPEED_SCENES = 100
"""Scenes that one worker is timed on beside two: enough that the end, when one of two has nothing left, does not count."""

ALONE = {1: 1}
"""Cores that runs of so many workers are kept to when they are timed: two workers on two cores have no more for each than one on one."""

SPEED_ROOMS = 6
"""Rooms that one worker is timed on beside two: the same number for both of two, and not all of the same size."""


def overheads(
    folder: Path, scenes: Sequence[int], runners: Sequence[str], workers: int, seed: int, advance: Callable[[str], None]
) -> list[Figures]:
    """A run for every number of scenes and runner, each of `runners` and the plain loop; `advance` is told each."""
    figures = []
    for count in scenes:
        scans = small_scans(folder, count, seed)
        for runner in (PLAIN, *runners):
            figures.append(_measured(folder, runner, scans, workers))
            advance(f"{count:,} scenes, {runner}")
    return figures


def speed_ups(folder: Path, scenes: int, seed: int, runs: int, advance: Callable[[str], None]) -> list[Figures]:
    """The same scenes on the pool by one worker, all of its run on one core, and by two on all cores, in turn, so often each."""
    scans = small_scans(folder, scenes, seed)
    figures = []
    for _ in range(runs):
        for workers in (1, 2):
            figures.append(_measured(folder, "pool", scans, workers, cores=ALONE.get(workers)))
            advance(f"{scenes:,} scenes, {workers} workers")
    return figures


def real_run(folder: Path, seed: int) -> Figures:
    """A generated room of about 25 objects, recorded by the virtual scanner, through the pool with default settings."""
    scans = folder / "real"
    if not scans.exists():
        demo_scan(scans, 0, seed)
    return _measured(folder, "pool", scans, 1, ())


def room_speed_ups(folder: Path, rooms: int, seed: int, advance: Callable[[str], None]) -> list[Figures]:
    """So many generated rooms of about 25 objects, with default settings, by one worker, all of its run on one core, and by two."""
    scans = folder / f"rooms{rooms}"
    if not scans.exists():
        for index in range(rooms):
            demo_scan(scans, index, seed)
    figures = []
    for workers in (1, 2):
        figures.append(_measured(folder, "pool", scans, workers, (), ALONE.get(workers)))
        advance(f"{rooms} rooms, {workers} workers")
    return figures


def speed_up(figures: Sequence[Figures]) -> float:
    """How many times as fast two workers do the work as one on one core: medians over the runs of each."""
    seconds = {workers: statistics.median(figure.work_seconds for figure in figures if figure.workers == workers) for workers in (1, 2)}
    return seconds[1] / seconds[2]


def small_scans(folder: Path, count: int, seed: int) -> Path:
    """A folder of so many small scans, made when it is not there."""
    scans = folder / f"scans{count}"
    return scans if scans.exists() else write_small_scans(scans, count, seed)


def warm_up(folder: Path, runners: Sequence[str], seed: int) -> None:
    """Let every runner do a few scenes, so that no measured run is the first."""
    for runner in (PLAIN, *runners):
        _measured(folder, runner, small_scans(folder, WARM_SCENES, seed), 1)


def _measured(
    folder: Path, runner: str, scans: Path, workers: int, settings: Sequence[str] = SETTINGS, cores: int | None = None
) -> Figures:
    """A run into a lake that is removed again."""
    lake = folder / f"lake-{runner}"
    try:
        return measured_run(runner, scans, lake, workers, folder, settings, cores)
    finally:
        shutil.rmtree(lake, ignore_errors=True)
