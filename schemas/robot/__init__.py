"""Rows of the robot stage: what carts did on the ways that policies took."""

from __future__ import annotations

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record

OUTCOMES = ("arrived", "stuck", "timeout", "collided", "unreachable")
"""How a run ends. Unreachable: the cart does not fit where the way begins or ends."""

BODIES = ("planar", "mujoco")
"""What carries the cart: arcs on the floor, or wheels that touch the floor of the exported scene."""


@record("robot_runs", key=("batch_id", "scene_id", "episode_id"), stage="robot", grain="drive_batch", rule="append")
class RobotRun:
    """A cart on the way that a policy took in an episode. All that metrics need is copied here: a later change of the trajectory changes
    no metric."""

    batch_id: str = column("Drive batch: runs on one policy's trajectories in one scene", pattern=r"[A-Za-z0-9][A-Za-z0-9_.-]*")
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    episode_id: str = column("Episode", pattern=r"[0-9]{4,}")
    trajectory_batch_id: str = column("Trajectory batch of the way", pattern=r"[A-Za-z0-9][A-Za-z0-9_.-]*")
    policy: str = column("Who chose the way")
    run_name: str = column("Run of the policy")
    setup: str = column("What of the settings is not as by default, in a line; empty where all is")
    split: str = column("Split of the room", values=("train", "test"))
    instance_id: str = column("Target of the episode", pattern=INSTANCE_PATTERN)
    category: str = column("Category of the target")
    body: str = column("What carries the cart", values=BODIES)
    radius_m: float = column("Radius of the cart", unit="m", minimum=0)
    outcome: str = column("How the run ended", values=OUTCOMES)
    problem: str | None = column("Why it did not arrive, in a line")
    route_m: float = column("Length of the policy's way", unit="m", minimum=0)
    subgoals: tuple[tuple[float, ...], ...] = column("Sub-goals along the way (x, y), in free space, world frame", unit="m")
    goal_snapped_m: float = column("How far the way's end was moved to where the cart fits", unit="m", minimum=0)
    goal_distance_m: float = column("Distance from the cart's true end to the last sub-goal, or to the way's end", unit="m", minimum=0)
    seconds: float = column("Simulated time", unit="s", minimum=0)
    travelled_m: float = column("Length of the true track", unit="m", minimum=0)
    times: tuple[float, ...] = column("Simulated time of each recorded pose", unit="s")
    track: tuple[tuple[float, ...], ...] = column("True pose at these times: x, y, yaw about +Z from +X; world frame", unit="m, rad")
    estimate: tuple[tuple[float, ...], ...] = column("Pose as the cart knew it at these times; world frame", unit="m, rad")
    clearances: tuple[float, ...] = column("True distance from the cart's outline to the nearest obstacle at these times", unit="m")
    least_clearance_m: float = column("Least of these distances, over every step", unit="m")
    collisions: int = column("Times that the cart ran into something", minimum=0)
    touched: str | None = column("What it ran into first; missing where it ran into nothing")
    error_m: float = column("Mean distance between true position and where the cart believed to be", unit="m", minimum=0)
    greatest_error_m: float = column("Greatest of these distances", unit="m", minimum=0)
    heading_error_radians: float = column("Mean difference of estimated and true heading", unit="rad", minimum=0)
    wheels_error_m: float = column("Distance at the end to where wheels alone say", unit="m", minimum=0)
    wheels_gyro_error_m: float = column("Distance at the end to where wheels and gyro say", unit="m", minimum=0)
    final_error_m: float = column("Distance at the end to where wheels, gyro and lidar say", unit="m", minimum=0)
    nees: float = column("Mean normalized estimation error squared of the pose; 3 where the filter knows how good it is", minimum=0)
    scans: int = column("Scans of the lidar", minimum=0)
    scans_used: int = column("Scans that moved the estimate", minimum=0)
    gated: int = column("Measurements that the filter took for wrong", minimum=0)
    recoveries: int = column("Times that the cart turned, backed up or planned anew", minimum=0)
    moved: tuple[str, ...] = column("Things that do not stand where the map says: instance and how far, in meters")
    decisions: int = column("Decisions of the planner", minimum=0)
    decision_seconds: float = column("Mean time of a decision, scan matching included", unit="s", minimum=0, volatile=True)
    slowest_decision_seconds: float = column("Time that 99 of 100 decisions keep to", unit="s", minimum=0, volatile=True)
