"""Evaluation: what agents did in episodes, from files or by built-in policies, and how far they were from their targets in the end.

Rows are facts; the metrics are SQL over them (`warehouse/questions/views/trajectory_metrics.sql` and `navigation_metrics*.sql`).
"""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Sequence

from schemas.candidates import Asset
from schemas.capture import Instance, Shell
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Placement
from tasks.evaluation.batch import SCHEMA_FILE, Attempt, TrajectoryBatch, parse_batch, read_batch
from tasks.evaluation.configuration import EvaluationConfig
from tasks.evaluation.measures import SceneAttempts, measure
from tasks.evaluation.policies import POLICIES
from tasks.evaluation.sights import SceneSights
from tasks.navigation.follower import FORWARD, LEFT, RIGHT
from tasks.stage import Context, Outcome, Stage

__all__ = [
    "POLICIES", "SCHEMA_FILE", "STAGE", "Attempt", "EvaluationConfig", "TrajectoryBatch", "check_batch", "parse_batch", "read_batch", "run",
]  # fmt: skip

_TURNS = {LEFT: 1, RIGHT: -1}


def run(
    *,
    trajectory_batch: TrajectoryBatch,
    episodes: Sequence[Episode],
    navmeshes: Sequence[Navmesh],
    shells: Sequence[Shell],
    instances: Sequence[Instance],
    assets: Sequence[Asset],
    placements: Sequence[Placement],
    context: Context,
    config: EvaluationConfig,
) -> Outcome:
    """Trajectories of a batch. All rows are those of all scenes that the batch names.

    Actions without poses are replayed on the scene's navmesh. Refused is what cannot be a run of these episodes by this
    robot (`check_batch`). Recorded, with a line in `problem`, is what an agent or its simulator may do wrong: leave the
    navmesh, or end where no path leads to the target; such an end is no success.

    Raises:
        InputError: a trajectory is refused, or a scene's navmesh cannot be used. Nothing of the batch is imported then.
    """
    check_batch(trajectory_batch, episodes, navmeshes, config)
    batch = trajectory_batch
    labels = {"batch_id": batch.batch_id, "policy": batch.policy, "run_name": batch.run_name, "source_file": batch.source_file}
    attempts: dict[str, list[Attempt]] = defaultdict(list)
    for attempt in batch.attempts:
        attempts[attempt.scene_id].append(attempt)
    work = []
    for scene, of_scene in sorted(attempts.items()):
        named = {e.episode_id: e for e in episodes if e.scene_id == scene}
        agents = {named[attempt.episode_id].agent for attempt in of_scene}
        meshes = {mesh.agent: mesh for mesh in navmeshes if mesh.scene_id == scene and mesh.agent in agents}
        gone = sorted(mesh.navmesh_blob for mesh in meshes.values() if mesh.navmesh_blob not in context.blobs)
        if gone:
            raise InputError(scene, "navmesh", f"blob {gone[0][:12]} is not in the lake", "run the navigation stage again")
        blobs = {agent: context.blobs[mesh.navmesh_blob] for agent, mesh in meshes.items()}
        work.append(SceneAttempts(named, tuple(of_scene), meshes, blobs, labels, config))
    rows: list[Trajectory] = []
    unseen = []
    for scene, part in zip(sorted(attempts), context.spread(measure, work), strict=True):
        sights = _sights(scene, shells, instances, assets, placements, context)  # one scene at a time: meshes take megabytes
        try:
            seen = sights.seen([(row.instance_id, row.poses[-1]) for row in part], config)
        except InputError as error:
            seen = [None] * len(part)
            unseen.append(f"{scene}: what was in view in the end is not known: {error}")
        rows += [dataclasses.replace(row, is_target_seen=is_seen) for row, is_seen in zip(part, seen, strict=True)]
    rows.sort(key=lambda row: (row.scene_id, row.episode_id))
    notes = [f"{row.scene_id} {row.episode_id}: {row.problem}" for row in rows if row.problem]
    return Outcome(trajectories=rows, degradations=[*notes, *unseen])


def _sights(
    scene: str, shells: Sequence[Shell], instances: Sequence[Instance], assets: Sequence[Asset], placements: Sequence[Placement],
    context: Context,
) -> SceneSights:  # fmt: skip
    """What there is to see in a scene."""
    placed = tuple(row for row in placements if row.scene_id == scene)
    named = {row.asset_id for row in placed}
    used = tuple(asset for asset in assets if asset.asset_id in named)
    shell = next((row for row in shells if row.scene_id == scene), None)
    return SceneSights(shell, placed, tuple(row for row in instances if row.scene_id == scene), used, context.blobs)


def check_batch(batch: TrajectoryBatch, episodes: Sequence[Episode], navmeshes: Sequence[Navmesh], config: EvaluationConfig) -> None:
    """Refuse a batch that cannot be a run of these episodes by this robot.

    Raises:
        InputError: a trajectory names a scene or episode that is not there, has more actions than `max_steps`, starts
            elsewhere than its episode, or moves farther or turns otherwise than an action does; or the scene has no navmesh
            for the agent.
    """
    known = {(row.scene_id, row.episode_id): row for row in episodes}
    scenes = {row.scene_id for row in episodes}
    meshes = {(row.scene_id, row.agent) for row in navmeshes}
    file = batch.source_file or batch.policy
    for attempt in batch.attempts:
        where = attempt.where
        if attempt.scene_id not in scenes:
            problem = f"scene {attempt.scene_id} has no episodes in the lake"
            raise InputError(file, f"{where}.scene_id", problem, "replicate its scan first")
        episode = known.get((attempt.scene_id, attempt.episode_id))
        if episode is None:
            problem = f"scene {attempt.scene_id} has no episode {attempt.episode_id}"
            raise InputError(file, f"{where}.episode_id", problem, "run the episodes that are in the lake")
        if (episode.scene_id, episode.agent) not in meshes:
            problem = f"scene {attempt.scene_id} has no navmesh for agent {episode.agent}"
            raise InputError(file, f"{where}.scene_id", problem, "run the navigation stage again")
        if len(attempt.actions) > config.max_steps:
            problem = f"has {len(attempt.actions)} actions, the limit is {config.max_steps}"
            raise InputError(file, f"{where}.actions", problem, "cut it there, or set evaluation.max_steps to the limit that was used")
        if attempt.poses is not None:
            _check_poses(attempt, episode, file, config)


def _check_poses(attempt: Attempt, episode: Episode, file: str, config: EvaluationConfig) -> None:
    """Refuse poses that do not begin at the episode's start, that jump, or that turn otherwise than their actions."""
    assert attempt.poses is not None
    where, (x, y, yaw) = f"{attempt.where}.poses", attempt.poses[0]
    away = math.hypot(x - episode.start_position[0], y - episode.start_position[1])
    if away > config.slack_m:
        problem = f"begins {away:.3g} m from the start of the episode"
        raise InputError(file, where, problem, "give metres in the frame that the batch names, of the episode that is in the lake")
    turned = abs(math.remainder(yaw - episode.start_yaw_radians, 2 * math.pi))
    if turned > config.yaw_slack_radians:
        problem = f"begins {math.degrees(turned):.3g} degrees off the heading of the episode"
        raise InputError(file, where, problem, "give the yaw about +Z from +X in radians, or Habitat's rotations with frame habitat")
    for index, (action, before, after) in enumerate(zip(attempt.actions, attempt.poses, attempt.poses[1:], strict=False)):
        moved = math.hypot(after[0] - before[0], after[1] - before[1])
        most = config.forward_m if action == FORWARD else 0.0
        if moved > most + config.slack_m:
            problem = f"moves {moved:.3g} m by {action!r}, which moves {most:g} m at most (action {index})"
            raise InputError(file, where, problem, "give every pose; a robot with another step needs evaluation.forward_m")
        turned = math.remainder(after[2] - before[2], 2 * math.pi)
        due = _TURNS.get(action, 0) * config.motion.turn_radians
        if abs(math.remainder(turned - due, 2 * math.pi)) > config.yaw_slack_radians:
            problem = f"turns {math.degrees(turned):.3g} degrees (left is above 0) by {action!r}, which turns {math.degrees(due):.3g}"
            what_to_do = "give every action and the pose after it; a robot with other turns needs evaluation.turn_degrees"
            raise InputError(file, where, f"{problem} (action {index})", what_to_do)


STAGE = Stage(
    name="evaluation",
    reads=("shells", "instances", "assets", "placements", "navmeshes", "episodes"),
    writes=("trajectories",),
    config=EvaluationConfig,
    run=run,
    grain="trajectory_batch",
    outside=("trajectory_batch",),
)
