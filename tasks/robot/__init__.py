"""Robot: a cart drives the ways that policies took, through replicas, by encoders, a gyro and a lidar (supplementary B.3, Figures A9 and
A13).

Rows are facts, each of one run; the metrics are SQL over them (`warehouse/questions/views/robot_metrics.sql`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, Scene, Shell
from schemas.errors import InputError
from schemas.optimization import Placement, Support
from schemas.robot import RobotRun
from tasks.exports.bodies import Replica, gather
from tasks.exports.config import ExportsConfig
from tasks.robot.bodies import CartBody, PlanarBody
from tasks.robot.configuration import RobotConfig
from tasks.robot.displaced import Displaced, displaced
from tasks.robot.driving import Drive, Pilot, route
from tasks.robot.floor_map import Floor, floor_of
from tasks.robot.routes import DriveBatch
from tasks.robot.runs import Labels, run_of, unreachable
from tasks.robot.subgoals import Subgoals, subgoals
from tasks.stage import Context, Outcome, Stage

__all__ = ["STAGE", "DriveBatch", "RobotConfig", "run"]

CLEAR_M = 0.3
"""Nothing is moved to where a way begins or ends, or so near to the cart there [m]: it could neither start nor arrive."""


@dataclasses.dataclass(frozen=True)
class _Work:
    """A way, the floor as the map has it, the scene for MuJoCo where it carries the cart, and the seeds of what is drawn, by name."""

    labels: Labels
    floor: Floor
    scene: str | None
    seeds: Mapping[str, int]


def run(
    *,
    drive_batch: DriveBatch,
    scenes: Sequence[Scene],
    shells: Sequence[Shell],
    instances: Sequence[Instance],
    captions: Sequence[Caption],
    assets: Sequence[Asset],
    placements: Sequence[Placement],
    supports: Sequence[Support],
    context: Context,
    config: RobotConfig,
) -> Outcome:
    """What a cart did on the ways of a batch, in one scene.

    What goes wrong on a way is drawn from the seed, the scene, the policy and the episode alone: runs with other settings meet the same.

    Raises:
        InputError: the scene has no room, or cannot be written for MuJoCo.
    """
    tables = {
        "scenes": scenes, "shells": shells, "instances": instances, "captions": captions, "assets": assets, "placements": placements,
        "supports": supports,
    }  # fmt: skip
    floor, notes = floor_in(tables, context.blobs, config)
    _ = floor.clearances, floor.plane_distances  # once for all ways, which take them along
    scene = _scene(replica_in(tables, context.blobs)[0]) if config.body == "mujoco" else None
    drawn = dataclasses.replace(context, scene_id=drive_batch.scene_id)
    work = []
    for way in drive_batch.ways:
        words = (way.policy, way.run_name, way.episode_id)
        seeds = {name: int(drawn.rng(name, *words).integers(2**63)) for name in ("displaced", "body", "lidar", "start")}
        work.append(_Work(Labels(drive_batch, way, config), floor, scene, seeds))
    rows: list[RobotRun] = context.spread(_driven, work)
    rows.sort(key=lambda row: row.episode_id)
    problems = [f"{row.scene_id} {row.episode_id}: {row.outcome}: {row.problem}" for row in rows if row.problem]
    return Outcome(robot_runs=rows, degradations=[*notes, *problems])


def floor_in(tables: Mapping[str, Sequence[Any]], blobs: Mapping[str, bytes], config: RobotConfig) -> tuple[Floor, list[str]]:
    """The floor of a scene as a cart meets it, and what had to be left out. tables: The stage's inputs, by name.

    Raises:
        InputError: the scene has no room.
    """
    replica, notes = replica_in(tables, blobs)
    return floor_of(replica, config.cart, config.lidar, {row.instance_id: row.parent_id for row in tables["supports"]}), notes


def replica_in(tables: Mapping[str, Sequence[Any]], blobs: Mapping[str, bytes]) -> tuple[Replica, list[str]]:
    """The replica of a scene, of the stage's inputs by name, and what had to be left out of it.

    Raises:
        InputError: the scene has no room.
    """
    t = tables
    return gather(
        t["scenes"], t["shells"], t["instances"], t["captions"], t["assets"], t["placements"], t["supports"], blobs, ExportsConfig()
    )  # fmt: skip


def _driven(work: _Work) -> RobotRun:
    """The run of one way."""
    config, way = work.labels.config, work.labels.way
    goals = subgoals(way.poses, work.floor, config.cart, config.planner)
    if goals.problem is not None:
        return unreachable(work.labels, goals.problem, goals.goal_snapped_m)
    rngs = {name: np.random.default_rng(seed) for name, seed in work.seeds.items()}
    ends = np.array([way.poses[0][:2], goals.points[-1]])
    truth = displaced(work.floor, config.displacement, rngs["displaced"], ends, config.cart.radius_m + CLEAR_M)
    drive = _drive(work, goals, truth, rngs)
    moved = [
        f"{name} {np.hypot(motion.dx, motion.dy):.2f}" for name, motion in sorted(truth.motions.items()) if name in work.floor.standing
    ]
    return run_of(work.labels, goals, drive, tuple(moved))


def _drive(work: _Work, goals: Subgoals, truth: Displaced, rngs: Mapping[str, np.random.Generator]) -> Drive:
    """Let the cart drive to sub-goals; it knows its start only as well as `noise.start_m` says."""
    config, start = work.labels.config, np.array(work.labels.way.poses[0], dtype=np.float64)
    spread = np.array([config.noise.start_m, config.noise.start_m, config.noise.start_radians])
    believed = start + spread * rngs["start"].standard_normal(3)
    planned = route(goals.points, work.floor, believed, config)
    return Pilot(_body(work, start, truth, rngs["body"]), planned, truth.floor, config, rngs["lidar"]).drive()


def _body(work: _Work, start: np.ndarray, truth: Displaced, rng: np.random.Generator) -> CartBody:
    """What carries the cart."""
    config = work.labels.config
    if work.scene is None:
        return PlanarBody(config.cart, config.noise, truth.floor, start, rng)
    from tasks.robot.cart import MujocoBody, cart_model

    return MujocoBody(cart_model(work.scene, config.cart, truth.motions), config.cart, config.noise, start, rng)


def _scene(replica: Replica) -> str:
    """The exported scene as MuJoCo reads it.

    Raises:
        InputError: it cannot be written.
    """
    from tasks.robot.cart import scene_text

    try:
        return scene_text(replica, ExportsConfig())
    except ValueError as error:
        raise InputError(
            replica.scene_id, "exports", f"MuJoCo's scene cannot be written: {error}", "drive with robot.body=planar"
        ) from None


STAGE = Stage(
    name="robot",
    reads=("scenes", "shells", "instances", "captions", "assets", "placements", "supports"),
    writes=("robot_runs",),
    config=RobotConfig,
    run=run,
    grain="drive_batch",
    outside=("drive_batch",),
)
