"""Carts in replicas: the shortest paths of episodes driven, as they come, past moved things, and by wheels on the floor."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from bench.policy.datasets import HOME
from bench.robot.replicas import HARD, PLAIN
from bench.selection.trainings import mapped
from flows.evaluation.acting import act, planned_policy
from flows.robot.driving import PlannedDrive, drive_scene, planned_drives
from flows.run.configuration import configure
from schemas.families.policies import POLICIES
from schemas.robot import RobotRun
from schemas.runs import StageRun
from warehouse.lake import Lake

POLICY = POLICIES[0]

BAND = 0.95
"""Share of consistent filters whose mean NEES lies in the band."""

POSE = 3
"""Numbers of a pose: what NEES is on average where the filter knows how good it is."""


@dataclasses.dataclass(frozen=True)
class DriveSetup:
    """How carts drive. settings: Of the stage. routes: Of each replica."""

    name: str
    routes: int
    settings: tuple[str, ...] = ()

    def all_settings(self) -> list[str]:
        """Settings as a command takes them."""
        return [f"robot.routes={self.routes}", *self.settings]


USUAL = DriveSetup("as mapped", 10)
MOVED = DriveSetup("a tenth moved", 10, ("robot.displacement.share=0.1",))
WHEELS = DriveSetup("wheels in MuJoCo", 3, ("robot.body=mujoco",))
WHEELS_MOVED = DriveSetup("wheels, a tenth moved", 3, ("robot.body=mujoco", "robot.displacement.share=0.1"))

SETUPS = (USUAL, MOVED, WHEELS, WHEELS_MOVED)
"""What is driven: noise and slip as by default, things moved, and wheels that touch the floor of the exported scene."""


def drive_all(lake: Lake, seed: int, processes: int, advance: Callable[[str], None]) -> tuple[dict[str, list[RobotRun]], list[str]]:
    """Runs by the name of their setup, and a line for each scene that could not be driven through. What the lake has stays."""
    advance("experts")
    failed = _acted(lake, seed, processes)
    runs: dict[str, list[RobotRun]] = {}
    with mapped(processes) as spread:
        for setup in SETUPS:
            planned = _planned(lake, setup, seed)
            todo = [drive for drive in planned if drive.is_new]
            for done in spread(_driven, todo):
                failed += [f"{setup.name}: {done.error}"] if done.error else []
                advance(f"{setup.name}: a replica")
            for _ in range(len(planned) - len(todo)):
                advance(f"{setup.name}: a replica")
            lake.commit(f"carts, {setup.name}", scenes=[drive.batch_id for drive in planned])
            batches = {drive.batch_id for drive in planned}
            runs[setup.name] = [row for row in lake.snapshot().rows(RobotRun) if row.batch_id in batches]
    return runs, failed


def _acted(lake: Lake, seed: int, processes: int) -> list[str]:
    """Let the experts act wherever they have not."""
    planned = planned_policy(lake, POLICY, configure(seed=seed))
    with mapped(processes) as spread:
        runs = list(spread(act, [scene.task for scene in planned.todo]))
    lake.commit("experts", scenes=planned.batches)
    return [f"{POLICY}: {run.error}" for run in runs if run.error]


def _planned(lake: Lake, setup: DriveSetup, seed: int) -> list[PlannedDrive]:
    """What a setup drives."""
    planned = planned_policy(lake, POLICY, configure(seed=seed))
    known = {run.scene_id for run in lake.snapshot().rows(StageRun) if run.stage == "evaluation" and run.error is None}
    batches = [batch for batch in planned.batches if batch in known]
    return planned_drives(lake, batches, configure(settings=setup.all_settings(), seed=seed))


def _driven(drive: PlannedDrive) -> StageRun:
    return drive_scene(drive.task)


def setup_figures(setup: DriveSetup, runs: Sequence[RobotRun]) -> list[dict[str, Any]]:
    """Figures of a setup, of all replicas and of those of each dataset that has some."""
    return [{"setup": setup.name, **row} for row in _by_dataset(runs)]


def _by_dataset(runs: Sequence[RobotRun]) -> Iterator[dict[str, Any]]:
    yield {"replicas": "all", **figures(runs)}
    for dataset in (PLAIN, HARD, HOME):
        some = [run for run in runs if run.scene_id.startswith(f"{dataset}/")]
        if some:
            yield {"replicas": dataset, **figures(some)}


def figures(runs: Sequence[RobotRun]) -> dict[str, Any]:
    """Of runs: how many arrive and why others did not, what they touch, how far they are off."""
    moving = [run for run in runs if run.seconds > 0]
    low, high = nees_band(len(moving))
    return {
        "runs": len(runs),
        "scenes": len({run.scene_id for run in runs}),
        **{outcome: sum(run.outcome == outcome for run in runs) for outcome in ("arrived", "stuck", "timeout", "collided", "unreachable")},
        "arrived_share": _mean([run.outcome == "arrived" for run in runs]),
        "collisions": sum(run.collisions for run in runs),
        "least_clearance_m": min((run.least_clearance_m for run in moving), default=math.nan),
        "error_m": _mean([run.error_m for run in moving]),
        "greatest_error_m": max((run.greatest_error_m for run in moving), default=math.nan),
        "final_wheels_m": _root_mean_square([run.wheels_error_m for run in moving]),
        "final_wheels_gyro_m": _root_mean_square([run.wheels_gyro_error_m for run in moving]),
        "final_m": _root_mean_square([run.final_error_m for run in moving]),
        "nees": _mean([run.nees for run in moving]),
        "nees_low": low,
        "nees_high": high,
        "moved": sum(len(run.moved) for run in runs),
        "recoveries": sum(run.recoveries for run in runs),
        "travelled_m": sum(run.travelled_m for run in runs),
        "decisions": sum(run.decisions for run in runs),
        "decision_seconds": _mean([run.decision_seconds for run in moving]),
        "slowest_decision_seconds": max((run.slowest_decision_seconds for run in moving), default=math.nan),
        "why": _reasons(runs),
    }


def nees_band(runs: int) -> tuple[float, float]:
    """What the mean of so many independent draws of a consistent filter's NEES lies between, 95 % of the time (Bar-Shalom, Li and
    Kirubarajan 2001). Means over runs vary less than single draws do: the band is the wider one."""
    from scipy.stats import chi2

    if not runs:
        return math.nan, math.nan
    low, high = chi2.ppf([(1 - BAND) / 2, (1 + BAND) / 2], POSE * runs) / runs
    return float(low), float(high)


def _reasons(runs: Sequence[RobotRun]) -> Mapping[str, str]:
    """Why runs did not arrive, by scene and episode."""
    return {f"{run.scene_id} {run.episode_id}": f"{run.outcome}: {run.problem}" for run in runs if run.outcome != "arrived"}


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def _root_mean_square(values: Sequence[float]) -> float:
    return math.sqrt(_mean([value * value for value in values]))
