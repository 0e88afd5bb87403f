"""The benchmark of hard and wild rooms: scanned badly, through the pipeline up to the optimization, held against what is true and, by
the stage `fidelity`, against the scan."""

from __future__ import annotations

import dataclasses
import json
import math
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from bench.dwellings.by_others import ScanByOthers, held_by, judged_by_others, nothing_known, scan_of
from bench.dwellings.judgement import FIGURES, judged, lost_room, summed
from bench.dwellings.kinds import ROOMS, SETTINGS, Kind, has_frames, home_of, make_scan
from bench.dwellings.replicas import replica_of
from bench.dwellings.unlabeled import regions_without_labels
from bench.goals import goal
from bench.machine import machine
from bench.stages import run_stages
from flows.run.configuration import configure
from flows.run.fingerprints import code_fingerprint, digest
from flows.run.pool import WorkerLost, WorkerPool, WorkerTimeout
from schemas.capture import Scene
from schemas.files import write_whole
from warehouse.lake import Lake

STEPS = ("capture", "captions", "candidates", "selection", "optimization", "fidelity")
"""The stages that are run."""

SECONDS = 1800.0
"""A room that takes longer has failed."""

OTHERS_SECONDS = 7200.0
"""A scan by others that takes longer has: a house is four times as large as a dwelling."""


@dataclasses.dataclass(frozen=True)
class DwellingsBench:
    """Settings of the benchmark.

    Attributes:
        folder: where finished rooms are remembered, so that the same command goes on; nowhere if None.
        realdata: folder of scans by others, which are measured with hard rooms, and whose models furnish wild ones; None for none.
        warms_up: a room that is not in the table goes first, so that the seconds of the others are without compiling.
        settings: of the stages, as `--set` takes them.
        kind: of room.
    """

    rooms: int = 30
    seed: int = 0
    processes: int = 1
    folder: Path | None = None
    realdata: Path | None = None
    warms_up: bool = True
    settings: tuple[str, ...] = ()
    kind: Kind = "hard"

    @property
    def all_settings(self) -> tuple[str, ...]:
        """The settings of the kind of room, then those that were asked for."""
        return (*SETTINGS[self.kind], *self.settings)

    @property
    def scans_by_others(self) -> Path | None:
        """Folder of scans by others that are measured, too: they belong to the table of hard rooms."""
        return self.realdata if self.kind == "hard" else None

    @property
    def steps(self) -> int:
        """How often the benchmark advances."""
        return self.rooms + len(held_by(self.scans_by_others)[0])


@dataclasses.dataclass(frozen=True)
class DwellingJob:
    """Room `index` of a kind and seed, to be scanned and worked on in an empty folder, which is the caller's to remove, by as many
    processes as there are cores for it. realdata: folder whose models furnish it, too."""

    index: int
    seed: int
    folder: str
    cores: int = 1
    settings: tuple[str, ...] = ()
    kind: Kind = "hard"
    realdata: str | None = None

    @property
    def models(self) -> Path | None:
        """Folder of real data, where one was given."""
        return Path(self.realdata) if self.realdata is not None else None


@dataclasses.dataclass(frozen=True)
class OthersJob:
    """A scan by others, to be worked on in an empty folder, which is the caller's to remove, by as many processes as there are cores
    for it."""

    scan: ScanByOthers
    realdata: str
    folder: str
    cores: int = 1
    settings: tuple[str, ...] = ()


def run_dwellings_bench(config: DwellingsBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report: figures of every room, of those with frames, of those without, of all, and of scans by others. `advance` is told each
    room done.

    Raises:
        InputError: a folder of real data is named, and holds none of the scans, or a setting is none.
    """
    configure(settings=config.all_settings)
    held, absent = held_by(config.scans_by_others) if config.kind == "hard" else ([], [])
    with tempfile.TemporaryDirectory(prefix="rooms-", ignore_cleanup_errors=True) as temporary:
        work = Path(temporary)
        rooms: list[dict[str, Any]] = []
        cores = max(1, machine()["cores"] // config.processes)
        foreign: list[dict[str, Any]] = []
        warming: float | None = None
        with WorkerPool(config.processes) as pool, ThreadPoolExecutor(config.processes) as threads:
            if config.warms_up and any(_remembered(_room_file(config, i), _mark(config, i)) is None for i in range(config.rooms)):
                warming = _warmed_up(pool, config, work, cores)
            for room in threads.map(partial(_measured, pool, config, work, cores), range(config.rooms)):
                advance(str(room["room"]))
                rooms.append(room)
            if config.scans_by_others is not None:
                for figures in threads.map(partial(_measured_by_others, pool, config, config.scans_by_others, work, cores), held):
                    advance(str(figures["room"]))
                    foreign.append(figures)
    groups = {"with frames": [r for r in rooms if r["has_frames"]], "mesh only": [r for r in rooms if not r["has_frames"]], "all": rooms}
    sums = {name: summed(chosen) for name, chosen in groups.items() if chosen}
    return {
        "machine": machine(),
        "kind": config.kind,
        "seed": config.seed,
        "processes": config.processes,
        "settings": list(config.all_settings),
        "warm_up_seconds": warming,
        "figures": [key for key, _, _ in FIGURES],
        "rooms": rooms,
        "groups": sums,
        "others": foreign,
        "not_measured": absent,
        "errors": [{"room": r["room"], "stage": r["stage"], "error": r["error"]} for r in (*rooms, *foreign) if r["error"]],
        "goals": [
            *(goals(sums["all"], config.kind) if rooms else []),
            *([goal("failed scans by others", sum(r["error"] is not None for r in foreign), "==", 0)] if foreign else []),
        ],
    }


def goals(group: Mapping[str, Any], kind: Kind = "hard") -> list[dict[str, Any]]:
    """Goals for the figures of all rooms of a kind, from `summed`; a figure that is NaN, since every room failed, misses its goal."""

    def figure(key: str, scale: int = 1) -> float | int | None:
        return None if math.isnan(group[key]) else scale * group[key]

    if kind == "wild":
        return [
            goal("F-score over objects at 5 cm, mean of rooms", figure("object_f_5cm"), ">=", 0.85),
            goal("completeness of objects at 5 cm, mean of rooms", figure("object_completeness_5cm"), ">=", 0.88),
            goal("free objects that the annotation has, stable at 5 cm [%]", figure("annotated_5cm", 100), ">=", 97),
            goal("pairs deeper than 2 mm, of rooms that did not fail", figure("deep_pairs"), "==", 0),
            goal("objects moved by more than 30 cm", figure("moved_30cm"), "==", 0),
            goal("placed objects moved by more than 15 cm [%]", figure("moved_share", 100), "<=", 2),
            goal("annotated free objects that were fixed [%]", figure("anchored_share", 100), "<=", 10),
            goal("openings without a door that are open [%]", figure("ways_open", 100), "==", 100),
            goal("regions per object where labels are left out", figure("regions_per_object"), "<=", 4),
            goal("CPU seconds of the optimization per 25 objects", figure("optimization_cpu_per_25"), "<=", 30),
            goal("failed rooms", figure("failed"), "==", 0),
        ]
    return [
        goal("free objects that the annotation has, stable at 5 cm [%]", figure("annotated_5cm", 100), ">=", 97),
        goal("F-score over objects at 5 cm, mean of rooms", figure("object_f_5cm"), ">=", 0.8),
        goal("pairs deeper than 2 mm, of rooms that did not fail", figure("deep_pairs"), "==", 0),
        goal("objects moved by more than 30 cm", figure("moved_30cm"), "==", 0),
        goal("doors and windows with at least 80 % of the silhouette seen [%]", figure("openings_seen", 100), ">=", 95),
        goal("free objects anchored wrongly, of rooms that did not fail", figure("anchored"), "==", 0),
        goal("failed rooms", figure("failed"), "==", 0),
        goal("seconds per 25 objects, of rooms that did not fail", figure("seconds_per_25"), "<=", 12),
    ]


def _measured(pool: WorkerPool, config: DwellingsBench, work: Path, cores: int, index: int) -> dict[str, Any]:
    """A room's figures, remembered or measured."""
    seed = config.seed

    def measure(place: str) -> dict[str, Any]:
        return pool.call(measure_room, _job(config, index, place, cores), timeout=SECONDS)

    def lost(error: str) -> dict[str, Any]:
        return lost_room(index, has_frames(index), home_of(config.kind, seed, index, config.realdata), "worker", error)

    return _known_or_measured(_room_file(config, index), _mark(config, index), work, measure, lost)


def _job(config: DwellingsBench, index: int, place: str, cores: int) -> DwellingJob:
    realdata = str(config.realdata) if config.realdata is not None and config.kind == "wild" else None
    return DwellingJob(index, config.seed, place, cores, config.all_settings, config.kind, realdata)


def _warmed_up(pool: WorkerPool, config: DwellingsBench, work: Path, cores: int) -> float:
    """Seconds that the room after the last takes [s], of which nothing is kept but what its stages compiled."""
    clock = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="room_", dir=work, ignore_cleanup_errors=True) as place, suppress(WorkerLost, WorkerTimeout):
        pool.call(measure_room, _job(config, config.rooms, place, cores), timeout=SECONDS)
    return time.perf_counter() - clock


def _room_file(config: DwellingsBench, index: int) -> Path | None:
    """Where a room's figures are remembered, if anywhere."""
    word = "room" if config.kind == "hard" else config.kind
    return config.folder / f"{word}_{config.seed}_{index:04d}.json" if config.folder is not None else None


def _mark(config: DwellingsBench, index: int) -> dict[str, Any]:
    """What a room's figures hang on."""
    mark = {"code": _code(), "seed": config.seed, "index": index, "settings": list(config.all_settings)}
    return mark if config.kind == "hard" else mark | {"kind": config.kind, "models": config.realdata is not None}


def _measured_by_others(
    pool: WorkerPool, config: DwellingsBench, realdata: Path, work: Path, cores: int, scan: ScanByOthers
) -> dict[str, Any]:
    """Figures of a scan by others, remembered or measured, like a room's."""
    mark = {"code": _code(), "files": scan.digest(realdata), "settings": list(config.settings)}

    def measure(place: str) -> dict[str, Any]:
        return pool.call(measure_by_others, OthersJob(scan, str(realdata), place, cores, config.settings), timeout=OTHERS_SECONDS)

    path = config.folder / f"{scan.name}.json" if config.folder is not None else None
    return _known_or_measured(path, mark, work, measure, lambda error: nothing_known(scan, "worker", error))


def _code() -> list[str]:
    """Hashes of the pipeline, of what makes dwellings and scans, and of this folder and what runs stages, which fingerprints of code do not
    follow."""
    here = Path(__file__).parent
    own = digest(*(path.read_text() for path in (*sorted(here.glob("*.py")), here.with_name("stages.py"))))
    return [code_fingerprint("tasks.pipeline"), code_fingerprint("tasks.scanner.dwellings"), code_fingerprint("tasks.furniture.wild"), own]


def _known_or_measured(
    path: Path | None, mark: Mapping[str, Any], work: Path, measure: Callable[[str], dict[str, Any]], lost: Callable[[str], dict[str, Any]]
) -> dict[str, Any]:
    """What a file remembers under a mark, else what is measured in an empty folder; a worker that dies or hangs has lost it, which is
    not remembered: it may have been the machine's fault. What it left below `work` goes, whatever became of the worker."""
    known = _remembered(path, mark)
    if known is not None:
        return known
    with tempfile.TemporaryDirectory(prefix="room_", dir=work, ignore_cleanup_errors=True) as place:
        try:
            figures = measure(place)
        except (WorkerLost, WorkerTimeout) as error:
            return lost(str(error))
    if path is not None:
        write_whole(path, json.dumps({"mark": dict(mark), "figures": figures}).encode())
    return figures


def _remembered(path: Path | None, mark: Mapping[str, Any]) -> dict[str, Any] | None:
    """The figures in a file, if it has them under this mark; None where there is none, it cannot be read, or is of other code."""
    if path is None:
        return None
    try:
        known = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    if not isinstance(known, dict) or known.get("mark") != mark or not isinstance(known.get("figures"), dict):
        return None
    return dict(known["figures"])


def measure_room(job: DwellingJob) -> dict[str, Any]:
    """A room's figures: scan it, run the stages of `STEPS`, judge what came out. Runs in a worker."""
    place = Path(job.folder)
    home = home_of(job.kind, job.seed, job.index, job.models)
    clock = time.perf_counter()
    truth = make_scan(place / "scans", job.index, job.seed, job.kind, job.models)
    scanned = time.perf_counter() - clock
    lake = Lake.open(place / "lake")
    done = run_stages(lake, place / "scans", STEPS, job.cores, job.settings)
    if done.error is not None:
        return lost_room(job.index, has_frames(job.index), home, done.stage, done.error, truth, done.seconds) | {"scan_seconds": scanned}
    lake.commit()
    try:
        figures = judged(
            job.index, has_frames(job.index), home, truth, replica_of(lake, "scannet/" + truth.scan), done.seconds, done.cpu_seconds
        )
        if job.kind == "wild":
            figures["regions_per_object"] = regions_without_labels(place, truth, job.cores)
    except Exception as problem:
        figures = lost_room(job.index, has_frames(job.index), home, "judgement", _where(problem), truth, done.seconds)
    return figures | {"scan_seconds": scanned}


def measure_by_others(job: OthersJob) -> dict[str, Any]:
    """Figures of a scan by others: run the stages of `STEPS`, with its library if it has one, and judge what came out. Runs in a worker."""
    place, realdata, scan = Path(job.folder), Path(job.realdata), job.scan
    scans, truth = scan_of(scan, realdata, place / "scans")
    lake = Lake.open(place / "lake")
    done = run_stages(lake, scans, STEPS, job.cores, job.settings, realdata / scan.library if scan.library is not None else None)
    if done.error is not None:
        return nothing_known(scan, done.stage, done.error, done.seconds)
    lake.commit()
    try:
        return judged_by_others(scan, truth, replica_of(lake, lake.snapshot().rows(Scene)[0].scene_id), done.seconds)
    except Exception as problem:
        return nothing_known(scan, "judgement", _where(problem), done.seconds)


def _where(problem: Exception) -> str:
    """An error in one line, with the line of code that it comes from."""
    where = traceback.extract_tb(problem.__traceback__)[-1]
    return f"{type(problem).__name__}: {problem} ({Path(where.filename).name}:{where.lineno})"


__all__ = [
    "ROOMS",
    "DwellingJob",
    "DwellingsBench",
    "Kind",
    "OthersJob",
    "goals",
    "has_frames",
    "make_scan",
    "measure_room",
    "run_dwellings_bench",
]
