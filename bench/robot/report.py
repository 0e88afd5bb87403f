"""The benchmark of carts: drives in replicas, held against goals, and kills. All of it is kept."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from bench.goals import goal
from bench.machine import machine
from bench.robot.drives import MOVED, SETUPS, USUAL, drive_all, setup_figures
from bench.robot.killed import ADVANCES, measure_kills
from bench.robot.replicas import RobotReplicas, make_replicas

DRIVES, KILLED = "drives", "killed"

PARTS = (DRIVES, KILLED)
"""What can be measured: carts in replicas, and what a kill leaves."""

ARRIVED, ERROR_M, HERTZ = 95.0, 0.05, 10.0
"""What is wanted: of 100 runs so many arrive, with an error below this [m], deciding so many times a second."""


@dataclasses.dataclass(frozen=True)
class RobotBench:
    """What is measured. folder: Of replicas and runs, from which the same command goes on. rooms: That are generated, every other one
    hard. realdata: Folder with the AWS small house; None for none. parts: Of `PARTS`."""

    folder: Path
    rooms: int = 20
    seed: int = 0
    processes: int = 1
    realdata: Path | None = None
    parts: tuple[str, ...] = PARTS

    @property
    def data(self) -> RobotReplicas:
        """Replicas that are driven in."""
        return RobotReplicas(self.folder, self.rooms, self.seed, self.realdata)

    @property
    def advances(self) -> int:
        """How often the benchmark advances."""
        replicas = len(self.data.jobs)
        counts = {DRIVES: 1 + len(SETUPS) * replicas, KILLED: ADVANCES}
        return replicas + sum(counts[part] for part in self.parts)


def run_robot_bench(config: RobotBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report. `advance` is told each part of it that is done.

    Raises:
        InputError: the house is not where it should be.
        LakeError: a command of those that are killed fails by itself.
    """
    failed = make_replicas(config.data, config.processes, advance)
    lake, parts = config.data.lake, {}
    if DRIVES in config.parts:
        runs, undriven = drive_all(lake, config.seed, config.processes, advance)
        rows = [row for setup in SETUPS for row in setup_figures(setup, runs[setup.name])]
        failed += undriven
        all_driven = goal("replicas that were not made, or not driven in", len(failed), "==", 0)
        parts[DRIVES] = {"setups": rows, "goals": [all_driven, *drive_goals(rows, len(config.data.jobs))]}
    if KILLED in config.parts:
        parts[KILLED] = measure_kills(lake, config.folder, partial(advance))
    return {
        "machine": machine(), "seed": config.seed, "processes": config.processes, "failed": failed, "parts": parts,
        "goals": [row for part in parts.values() for row in part["goals"]],
    }  # fmt: skip


def drive_goals(rows: Sequence[Mapping[str, Any]], replicas: int) -> list[dict[str, Any]]:
    """What carts are held against, in so many replicas. Moved things may bar the only way: of those runs only what is touched is a goal."""
    whole = {row["setup"]: row for row in rows if row["replicas"] == "all"}
    usual, moved = whole[USUAL.name], whole[MOVED.name]
    goals = [
        goal("replicas that were driven in", usual["scenes"], ">=", replicas),
        goal("runs", usual["runs"], ">=", USUAL.routes * replicas),
        goal("runs that arrive [%]", _figure(100 * usual["arrived_share"]), ">=", ARRIVED),
        *(goal(f"collisions, {name}", row["collisions"], "==", 0) for name, row in whole.items()),
        goal("things that were moved", moved["moved"], ">=", 1),
        goal("mean error with wheels, gyro and lidar [m]", _figure(usual["error_m"]), "<", ERROR_M),
        goal("error at the end with wheels, gyro and lidar [m]", _figure(usual["final_m"]), "<", ERROR_M),
        goal(f"mean NEES, at least {usual['nees_low']:.2f}", _figure(usual["nees"]), ">=", round(usual["nees_low"], 4)),
        goal(f"mean NEES, at most {usual['nees_high']:.2f}", _figure(usual["nees"]), "<=", round(usual["nees_high"], 4)),
        goal("decisions per second, 99 of 100 of the slowest run", _figure(1 / usual["slowest_decision_seconds"]), ">=", HERTZ),
    ]
    return goals


def _figure(value: float) -> float | None:
    return None if math.isnan(value) else value
