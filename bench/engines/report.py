"""What engines make of exported scenes: a row for each, where they judge otherwise than the certificates, goals."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bench.engines.scenes import SceneChoice, SceneFiles, exported_scenes
from bench.engines.setups import NUDGE_M_S, RUNS, SECONDS, SETUPS, Setup
from bench.engines.simulation import Moved, SceneRuns, simulate
from bench.goals import goal
from bench.machine import machine

GOAL_PERCENT = 98.0
"""Share of free objects that stay within 1 cm and 5 degrees in every engine, nudged ones too."""

LIMITS_M = {"1cm": 0.01, "5cm": 0.05}


@dataclasses.dataclass(frozen=True)
class EnginesBench:
    """What is measured, and the interpreters of engines that are not the project's, by the engine's name."""

    scenes: SceneChoice
    interpreters: Mapping[str, Path]

    @property
    def setups(self) -> list[Setup]:
        """The rows of the table that can be measured."""
        return [setup for setup in SETUPS if setup.engine.script is None or setup.engine.name in self.interpreters]


def scenes_of(config: EnginesBench, advance: Callable[[str], None]) -> list[SceneFiles]:
    """The scenes to measure, exported. `advance` is given the name of each part that is made."""
    return exported_scenes(config.scenes, advance)


def run_engines_bench(config: EnginesBench, scenes: Sequence[SceneFiles], advance: Callable[[str], None]) -> dict[str, Any]:
    """The report on scenes in every engine that is installed. `advance` is given each scene and engine that is done."""

    def measure(job: tuple[Setup, SceneFiles]) -> SceneRuns:
        setup, scene = job
        runs = simulate(scene, setup, config.interpreters.get(setup.engine.name))
        advance(f"{scene.scene_id} in {setup.name}")
        return runs

    with ThreadPoolExecutor(config.scenes.processes) as threads:
        runs = list(threads.map(measure, [(setup, scene) for setup in config.setups for scene in scenes]))
    head = {
        "machine": machine(), "seed": config.scenes.seed, "processes": config.scenes.processes, "seconds": SECONDS,
        "nudge_m_s": NUDGE_M_S, "left_out": config.scenes.left_out,
    }  # fmt: skip
    return head | report_of(scenes, runs)


def report_of(scenes: Sequence[SceneFiles], runs: Sequence[SceneRuns]) -> dict[str, Any]:
    """Rows by engine, disagreements and goals. Engines without any runs are not installed."""
    engines = [_row(setup, [run for run in runs if run.setup == setup.name], scenes) for setup in SETUPS]
    disagreements = [line for run in runs for line in disagreeing(run, next(s for s in scenes if s.scene_id == run.scene_id))]
    return {
        "scenes": [
            {
                "scene": scene.scene_id, "source": scene.source, "objects": scene.objects, "free": len(scene.poses),
                "certified_1cm": sum(scene.certified.values()),
            }
            for scene in scenes
        ],
        "engines": engines,
        "disagreements": disagreements,
        "failures": [[run.scene_id, run.setup, run.failure] for run in runs if run.failure is not None],
        "goals": goals(engines, disagreements),
    }  # fmt: skip


def _row(setup: Setup, runs: Sequence[SceneRuns], scenes: Sequence[SceneFiles]) -> dict[str, Any]:
    """An engine: what it is, and how many of all free objects stay."""
    about = {"engine": setup.name, "format": setup.format, "settings": dict(setup.settings), "objects": sum(len(s.poses) for s in scenes)}
    if not runs:
        remedy = f"{setup.engine.install}; then --engine {setup.engine.name}=PYTHON"
        empty = dict.fromkeys(("version", "apart_m", "seconds", *(f"{when}_{key}" for when in ("rest", "nudged") for key in LIMITS_M)))
        return about | empty | {"missing": remedy, "by_scene": {}}
    moved = [each for run in runs for each in run.moved.values()]
    counts = {
        f"{when}_{key}": sum(each.is_stable(limit, when == "nudged") for each in moved)
        for when in ("rest", "nudged") for key, limit in LIMITS_M.items()
    }  # fmt: skip
    return about | counts | {
        "version": next((run.version for run in runs if run.version is not None), None),
        "apart_m": max((run.apart_m for run in runs if run.apart_m is not None), default=None),
        "seconds": sum(run.seconds for run in runs),
        "missing": None,
        "by_scene": {
            run.scene_id: [sum(each.is_stable(0.01, nudged) for each in run.moved.values()) for nudged in (False, True)] for run in runs
        },
    }  # fmt: skip


def disagreeing(run: SceneRuns, scene: SceneFiles) -> list[dict[str, Any]]:
    """Objects that an engine and the certificate judge otherwise at 1 cm, nudges included; by the run that tells most."""
    lines = []
    for name, moved in run.moved.items():
        stays = moved.is_stable(0.01, nudged=True)
        if stays == scene.certified[name]:
            continue
        when = _telling(moved)
        lines.append({
            "scene": scene.scene_id, "instance": name, "body": scene.names[name], "engine": run.setup,
            "certificate": _verdict(scene.certified[name]),
            "verdict": _verdict(stays), "when": list(RUNS)[when], "moved_mm": 1000.0 * moved.metres[when],
            "tilt_degrees": math.degrees(moved.radians[when]),
        })  # fmt: skip
    return lines


def _telling(moved: Moved) -> int:
    """The run that a verdict follows from: at rest where the object moves there, else the one in which it goes farthest."""
    falls = [run for run in range(len(moved.metres)) if not moved.stays(0.01, run)]
    if falls and falls[0] == 0:
        return 0
    return max(falls or range(len(moved.metres)), key=lambda run: (moved.metres[run], moved.radians[run]))


def _verdict(stable: bool) -> str:
    return "stable" if stable else "moves"


def goals(engines: Sequence[Mapping[str, Any]], disagreements: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Nearly every object stays in every engine, and no two engines contradict a certificate. n/a for what is not installed."""
    rows = []
    for row in engines:
        share = None if row["missing"] or not row["objects"] else 100.0 * row["nudged_1cm"] / row["objects"]
        rows.append(goal(f"free objects within 1 cm and 5 degrees, nudged too: {row['engine']} [%]", share, ">=", GOAL_PERCENT))
    opinion = {setup.name: setup.same_as or setup.name for setup in SETUPS}
    disputed = Counter((scene, name) for scene, name, _ in {(d["scene"], d["instance"], opinion[d["engine"]]) for d in disagreements})
    many = sum(count > 1 for count in disputed.values())
    return [*rows, goal("objects on which more than one engine contradicts the certificate", many, "<=", 0)]
