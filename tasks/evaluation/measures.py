"""What is measured of an agent's way through a scene: its poses, where it ended, and how far it still was."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.navigation import Episode, Navmesh
from tasks.evaluation.batch import Attempt, Pose
from tasks.evaluation.configuration import EvaluationConfig
from tasks.navigation.follower import FORWARD, STOP, replay
from tasks.navigation.planar import PlanarPathFinder
from tasks.navigation.protocol import DistanceField, PathFinder

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class SceneAttempts:
    """Attempts at episodes of one scene, with all that measuring them takes. Travels to a worker process.

    navmeshes, blobs: Row and bytes of the navmesh, by agent. labels: batch_id, policy, run_name and source_file of the batch.
    """

    episodes: Mapping[str, Episode]
    attempts: tuple[Attempt, ...]
    navmeshes: Mapping[str, Navmesh]
    blobs: Mapping[str, bytes]
    labels: Mapping[str, str | None]
    config: EvaluationConfig


def path_finder(data: bytes, file: str) -> PlanarPathFinder:
    """Path finder on what an agent on the floor reaches of a .navmesh file, whoever made it, in plan.

    Raises:
        InputError: the bytes are no such file, or nothing in it can be walked on.
    """
    from tasks.navigation.navmesh import read_navmesh

    finder = PlanarPathFinder.from_navmesh(read_navmesh(data, file), floor_only=True, file=file)
    if not finder.islands:
        raise InputError(file, "polygons", "none can be walked on", "run the navigation stage again")
    return finder


def measure(work: SceneAttempts) -> list[Trajectory]:
    """Trajectories of one scene, in the order of the attempts.

    Raises:
        InputError: a navmesh cannot be used, or an episode starts off the navmesh or without a path to a view point.
    """
    finders: dict[str, PathFinder] = {}
    fields: dict[tuple[str, tuple[tuple[float, ...], ...]], DistanceField] = {}
    rows = []
    for attempt in work.attempts:
        episode = work.episodes[attempt.episode_id]
        agent = episode.agent
        if agent not in finders:
            finders[agent] = path_finder(work.blobs[agent], f"{episode.scene_id} {work.navmeshes[agent].navmesh_blob[:12]}.navmesh")
        key = (agent, episode.view_points)
        if key not in fields:
            views, near = onto(finders[agent], np.array(episode.view_points)[:, :2], work.config.reach_m)
            fields[key] = finders[agent].field(views[near])
        rows.append(_trajectory(attempt, episode, finders[agent], fields[key], work))
    return rows


def _trajectory(attempt: Attempt, episode: Episode, finder: PathFinder, field: DistanceField, work: SceneAttempts) -> Trajectory:
    """The row of one attempt."""
    config = work.config
    start, near = onto(finder, np.array([episode.start_position[:2]]), config.reach_m)
    start_distance = float(field.distances(start)[0]) if near[0] else np.inf
    if not np.isfinite(start_distance):
        why = "starts off the navmesh" if not near[0] else "has no view point with a path from its start"
        raise InputError(episode.scene_id, f"episode {episode.episode_id}", why, "run the navigation stage again")
    if attempt.poses is None:
        done = replay(attempt.actions, start[0], episode.start_yaw_radians, finder, config.motion)
        poses: tuple[Pose, ...] = tuple((float(x), float(y), float(yaw)) for x, y, yaw in done.poses)
        collisions = done.collisions
    else:
        poses, collisions = attempt.poses, _blocked(attempt.actions, attempt.poses, config)
    at = np.array(poses)[:, :2]
    final_distance, problem = _ending(at, finder, field, config)
    return Trajectory(
        scene_id=episode.scene_id,
        episode_id=episode.episode_id,
        **{name: work.labels[name] for name in ("batch_id", "policy", "run_name", "source_file")},  # type: ignore[arg-type]
        agent=episode.agent,
        split=episode.split,
        instance_id=episode.instance_id,
        category=episode.category,
        start_position=episode.start_position,
        start_yaw_radians=episode.start_yaw_radians,
        actions=attempt.actions,
        poses=poses,
        called_stop=bool(attempt.actions) and attempt.actions[-1] == STOP,
        collisions=collisions if attempt.collisions is None else attempt.collisions,
        travelled_m=float(np.hypot(*np.diff(at, axis=0).T).sum()),
        start_distance_m=start_distance,
        final_distance_m=final_distance,
        is_target_seen=None,
        success_distance_m=config.success_m,
        expert_actions=len(episode.actions),
        path_finder=finder.name,
        problem=problem,
    )


def _ending(at: Array, finder: PathFinder, field: DistanceField, config: EvaluationConfig) -> tuple[float | None, str | None]:
    """Distance from the last position to the nearest view point, None without one, and what is odd about the way there."""
    snapped, near = onto(finder, at, config.reach_m)
    notes = []
    if not near.all():
        worst = float(np.hypot(*(snapped - at)[~near].T).max())
        notes.append(f"{np.count_nonzero(~near)} of {len(at)} poses lie up to {worst:.2f} m off the navmesh")
    if not near[-1]:
        notes.append("the last one among them")
        return None, ", ".join(notes)
    distance = float(field.distances(snapped[-1:])[0])
    if not np.isfinite(distance):
        notes.append("no path leads from the last pose to a view point")
        return None, ", ".join(notes)
    return distance, ", ".join(notes) or None


def onto(finder: PathFinder, points: Array, reach: float) -> tuple[Array, NDArray[np.bool_]]:
    """The nearest navigable points, shape (n, 2), and whether each lies within `reach` [m] of its point, shape (n,).

    Points of the free polygon may lie a rounding error outside a navmesh: it holds 32-bit floats.
    """
    snapped = finder.snap(points)
    return snapped, np.hypot(*(snapped - points).T) <= reach


def _blocked(actions: Sequence[str], poses: Sequence[Pose], config: EvaluationConfig) -> int:
    """Forward steps that ended more than `slack_m` short of where they should."""
    moved = np.hypot(*np.diff(np.array(poses)[:, :2], axis=0).T)
    forward = np.array([action == FORWARD for action in actions], dtype=bool)
    return int(np.count_nonzero(moved[forward] < config.forward_m - config.slack_m))
