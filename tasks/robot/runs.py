"""Rows of runs, of what became of carts on their ways."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from schemas.evaluation import Trajectory
from schemas.robot import RobotRun
from tasks.robot.configuration import RobotConfig
from tasks.robot.driving import ARRIVED_TWICE, Drive
from tasks.robot.navigator import Phase
from tasks.robot.routes import DriveBatch
from tasks.robot.subgoals import Subgoals


@dataclasses.dataclass(frozen=True)
class Labels:
    """What a run's row says of where it belongs."""

    batch: DriveBatch
    way: Trajectory
    config: RobotConfig

    @property
    def columns(self) -> dict[str, Any]:
        """Columns of the row."""
        way = self.way
        copied = {name: getattr(way, name) for name in ("scene_id", "episode_id", "policy", "run_name", "split", "instance_id", "category")}
        own = {"batch_id": self.batch.batch_id, "trajectory_batch_id": way.batch_id, "setup": self.batch.setup, "route_m": way.travelled_m}
        return {**copied, **own, "body": self.config.body, "radius_m": self.config.cart.radius_m}


def run_of(labels: Labels, subgoals: Subgoals, drive: Drive, moved: tuple[str, ...]) -> RobotRun:
    """The row of a way that was driven."""
    goal_distance = float(np.hypot(*(drive.track[-1, :2] - subgoals.points[-1])))
    outcome, problem = _outcome(drive, goal_distance, labels.config)
    return RobotRun(
        **labels.columns,
        outcome=outcome,
        problem=problem,
        subgoals=_rows(subgoals.points),
        goal_snapped_m=float(subgoals.goal_snapped_m),
        goal_distance_m=goal_distance,
        seconds=drive.seconds,
        travelled_m=drive.travelled_m,
        times=tuple(float(value) for value in drive.times),
        track=_rows(drive.track),
        estimate=_rows(drive.estimate),
        clearances=tuple(float(value) for value in drive.clearances),
        least_clearance_m=drive.least_clearance,
        collisions=int(drive.touched is not None),
        touched=drive.touched,
        error_m=float(drive.errors.mean()),
        greatest_error_m=float(drive.errors.max()),
        heading_error_radians=float(drive.heading_errors.mean()),
        wheels_error_m=drive.final_errors[0],
        wheels_gyro_error_m=drive.final_errors[1],
        final_error_m=drive.final_errors[2],
        nees=float(drive.nees.mean()),
        scans=drive.scans,
        scans_used=drive.scans_used,
        gated=drive.gated,
        recoveries=drive.recoveries,
        moved=moved,
        decisions=len(drive.decision_seconds),
        decision_seconds=float(drive.decision_seconds.mean()),
        slowest_decision_seconds=float(np.quantile(drive.decision_seconds, 0.99)),
    )


def unreachable(labels: Labels, problem: str, snapped_m: float) -> RobotRun:
    """The row of a way that no cart can drive."""
    way = labels.way
    start = way.poses[0]
    far = float(np.hypot(way.poses[-1][0] - start[0], way.poses[-1][1] - start[1]))
    return RobotRun(
        **labels.columns, outcome="unreachable", problem=problem, subgoals=(), goal_snapped_m=snapped_m, goal_distance_m=far, seconds=0.0,
        travelled_m=0.0, times=(0.0,), track=(tuple(start),), estimate=(tuple(start),), clearances=(0.0,), least_clearance_m=0.0,
        collisions=0, touched=None, error_m=0.0, greatest_error_m=0.0, heading_error_radians=0.0, wheels_error_m=0.0,
        wheels_gyro_error_m=0.0, final_error_m=0.0, nees=0.0, scans=0, scans_used=0, gated=0, recoveries=0, moved=(), decisions=0,
        decision_seconds=0.0, slowest_decision_seconds=0.0,
    )  # fmt: skip


def _outcome(drive: Drive, goal_distance: float, config: RobotConfig) -> tuple[str, str | None]:
    """How a run ended, and why it did not arrive."""
    if drive.touched:
        return "collided", f"ran into {drive.touched} after {drive.seconds:.1f} s"
    if drive.phase is Phase.ARRIVED:
        if goal_distance <= ARRIVED_TWICE * config.planner.arrive_m:
            return "arrived", None
        return "stuck", f"believes to be there, and is {goal_distance:.2f} m off"
    if drive.phase.is_final:
        return "stuck", drive.problem
    return "timeout", f"was still {goal_distance:.2f} m away after {drive.seconds:.0f} s"


def _rows(points: Any) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in points)
