"""What the benchmark of the flows measures, put together, and held against its goals."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.flows.chaos import Chaos, disturbed_run
from bench.flows.overhead import (
    SPEED_ROOMS,
    SPEED_SCENES,
    overheads,
    real_run,
    room_speed_ups,
    small_scans,
    speed_up,
    speed_ups,
    warm_up,
)
from bench.flows.runs import PLAIN, Figures, measured_run
from bench.flows.services import plain_server, postgres_programs, services
from bench.flows.sharing import Sharing, shared_runs
from bench.flows.startup import startup_seconds
from bench.flows.warm_scenes import CORES, GOALS, warm_goals, warm_scenes
from bench.goals import goal
from bench.machine import machine
from warehouse.lake import Lake

PARTS = ("startup", "overhead", "scene", "speed", "sharing", "chaos")
"""What can be measured on its own. Memory is seen in the overhead's runs."""

RUNNERS = ("pool", "processes", "dask", "ray")

SHARE = 0.05
SPEED_UP = 1.9
MEMORY_MB = 2000.0
GROWTH_MB = 100.0
"""Per 1,000 scenes: ten thousand would still fit into the memory that a coordinator may have."""

GROWTH_SCENES = 500
"""Fewer are over before a slope means anything."""

ADDED_SCENES = 100
"""Fewer are over so soon that the last scene, on one worker alone, decides."""

_SHARED_SCENES = 30


@dataclasses.dataclass(frozen=True)
class FlowsBench:
    """What is measured. scenes: numbers of small scenes that the overhead is measured on. speed_runs: of one and of two workers."""

    scenes: tuple[int, ...] = (10, 100, 1000)
    runners: tuple[str, ...] = ("pool", "processes", "dask")
    workers: int = 2
    seed: int = 0
    parts: tuple[str, ...] = PARTS
    speed_scenes: int = SPEED_SCENES
    speed_runs: int = 2
    speed_rooms: int = SPEED_ROOMS
    shared_scenes: int = _SHARED_SCENES
    chaos_scenes: int = 50
    kills: int = 12


def steps_of(config: FlowsBench) -> int:
    """How many times `run_flows_bench` tells that something is done."""
    counts = {
        "startup": 1,
        "overhead": len(config.scenes) * (len(config.runners) + 1) + 1,
        "scene": len(GOALS) * len(CORES[: os.cpu_count()]),
        "speed": 2 * config.speed_runs + 2,
        "sharing": 1,
        "chaos": 1,
    }
    return 1 + sum(counts[part] for part in config.parts)


def run_flows_bench(config: FlowsBench, advance: Callable[[str], None], folder: Path | None = None) -> dict[str, Any]:
    """The report: start-up, a line per run, two workers beside one, two runs at once, chaos, goals. Works below `folder`.

    Raises:
        InputError: chaos is wanted and PostgreSQL is not installed.
        LakeError: a run failed that nobody disturbed.
    """
    if "chaos" in config.parts:
        postgres_programs()  # before anything else takes its time
    with tempfile.TemporaryDirectory(prefix="bench-flows-", dir=folder) as work:
        return _report(config, Path(work), advance)


def _report(config: FlowsBench, folder: Path, advance: Callable[[str], None]) -> dict[str, Any]:
    report: dict[str, Any] = {"machine": machine(), "seed": config.seed, "workers": config.workers}
    if "startup" in config.parts:
        report["startup"] = startup_seconds(folder)
        advance("start-up")
    warm_up(folder, config.runners if "overhead" in config.parts else ("pool",), config.seed)
    advance("first runs")
    figures: list[Figures] = []
    if "overhead" in config.parts:
        report["real"] = _plain(real_run(folder, config.seed))
        advance("a real scene")
        figures = overheads(folder, config.scenes, config.runners, config.workers, config.seed, advance)
        report["overhead"] = [_plain(figure) for figure in figures]
    if "scene" in config.parts:
        report["scene"] = [dataclasses.asdict(scene) for scene in warm_scenes(folder / "scene", config.seed, advance)]
    if "speed" in config.parts:
        timed = speed_ups(folder, config.speed_scenes, config.seed, config.speed_runs, advance)
        report["speed"] = [_plain(figure) for figure in timed]
        report["speed_up"] = speed_up(timed)
        timed = room_speed_ups(folder, config.speed_rooms, config.seed, advance)
        report["room_speed"] = [_plain(figure) for figure in timed]
        report["room_speed_up"] = speed_up(timed)
    if "sharing" in config.parts:
        report["sharing"] = dataclasses.asdict(_sharing(config, folder))
        advance("two runs at once")
    if "chaos" in config.parts:
        report["chaos"] = dataclasses.asdict(_chaos(config, folder))
        advance("chaos")
    report["goals"] = goals(report)
    return report


def goals(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What was measured, held against what was wanted."""
    rows: list[dict[str, Any]] = []
    if "overhead" in report:
        for figure in report["overhead"]:
            if figure["runner"] != PLAIN:
                name = f"overhead's share of a real run, {figure['runner']}, {figure['scenes']:,} scenes"
                rows.append(goal(name, real_share(figure, report["real"]), "<=", SHARE))
        for figure in report["overhead"]:
            if figure["runner"] == "pool" and figure["scenes"] >= ADDED_SCENES:
                name = f"what Prefect adds to a plain loop, its share of {figure['scenes']:,} small scenes' run"
                rows.append(goal(name, added_share(figure, report["overhead"]), "<=", SHARE))
        for figure in report["overhead"]:
            if figure["runner"] == "pool" and figure["scenes"] >= GROWTH_SCENES:
                rows.append(goal(f"coordinator's memory, {figure['scenes']:,} scenes [MB]", figure["peak_memory_mb"], "<=", MEMORY_MB))
                rows.append(goal("its growth in the second half [MB per 1,000 scenes]", figure["growth_mb"], "<=", GROWTH_MB))
    if "scene" in report:
        rows += warm_goals(report["scene"])
    if "speed_up" in report:
        rows.append(goal("small scenes: two workers are so many times as fast as one on one core", report["speed_up"], ">=", SPEED_UP))
        rows.append(goal("rooms: two workers are so many times as fast as one on one core", report["room_speed_up"], ">=", SPEED_UP))
    if "sharing" in report:
        seen = report["sharing"]
        rows.append(goal("two runs at once: commands that failed", sum(code != 0 for code in seen["codes"]), "==", 0))
        rows.append(goal("two runs at once: scenes computed by both, or by neither", len(seen["both"]) + len(seen["neither"]), "==", 0))
        rows.append(goal("two runs at once: faults of the lake", _faults(seen), "==", 0))
    if "chaos" in report:
        seen = report["chaos"]
        rows.append(goal("chaos: the last command's exit code", seen["codes"][-1], "==", 0))
        rows.append(goal("chaos: commands that hung", seen["hung"], "==", 0))
        rows.append(goal("chaos: faults of the lake", _faults(seen), "==", 0))
        rows.append(goal("chaos: finished stages that were done again", len(seen["redone"]), "==", 0))
        rows.append(goal("chaos: lost workers of which no log says so", len(seen["unsaid"]), "==", 0))
        # Without these the zeros would say nothing.
        rows.append(goal("chaos: kills", len(seen["kills"]), ">=", 1))
        rows.append(goal("chaos: stage runs that lost their worker", len(seen["lost"]), ">=", 1))
    return rows


def real_share(figure: Mapping[str, Any], real: Mapping[str, Any]) -> float:
    """Share of a run's overhead per stage run when stages take what they take on a real scene, within 0..1."""
    stage = real["stage_seconds"] / real["stage_runs"]
    return float(figure["overhead_seconds"] / (figure["overhead_seconds"] + stage))


def added_share(figure: Mapping[str, Any], runs: Sequence[Mapping[str, Any]]) -> float:
    """Share of a run's time by which its overhead exceeds that of the plain loop over the same scenes, within -1..1."""
    plain = next(other for other in runs if other["runner"] == PLAIN and other["scenes"] == figure["scenes"])
    added = (figure["overhead_seconds"] - plain["overhead_seconds"]) * figure["stage_runs"]
    return float(added / (figure["work_seconds"] * figure["workers"]))


def _faults(seen: Mapping[str, Any]) -> int:
    return sum(len(faults) for faults in seen["verdict"].values())


def _sharing(config: FlowsBench, folder: Path) -> Sharing:
    scans = small_scans(folder, config.shared_scenes, config.seed)
    undisturbed = _undisturbed(scans, folder, config.workers)
    with plain_server(folder / "server") as server:
        return shared_runs(scans, folder / "sharing", undisturbed, server.access)


def _chaos(config: FlowsBench, folder: Path) -> Chaos:
    scans = small_scans(folder, config.chaos_scenes, config.seed)
    undisturbed = _undisturbed(scans, folder, config.workers)
    with services(folder / "services") as up:
        return disturbed_run(scans, folder / "chaos", undisturbed, up, workers=config.workers, kills=config.kills, seed=config.seed)


def _undisturbed(scans: Path, folder: Path, workers: int) -> Lake:
    """The lake of a run that nobody disturbs."""
    lake = folder / f"undisturbed-{scans.name}"
    if not lake.exists():
        measured_run("pool", scans, lake, workers, folder)
    return Lake.open(lake)


def _plain(figure: Figures) -> dict[str, Any]:
    """Figures as JSON takes them, with what follows from them; of the memory samples, 200 at most."""
    every = max(1, len(figure.samples) // 200)
    samples: Sequence[Any] = [(round(s.seconds, 2), round(s.memory_mb, 1), round(s.others_mb, 1)) for s in figure.samples[::every]]
    derived = {name: getattr(figure, name) for name in ("overhead_seconds", "share", "peak_memory_mb", "growth_mb")}
    return dataclasses.asdict(dataclasses.replace(figure, samples=())) | derived | {"samples": samples}
