"""Walks to learn from: poses along the actions of episodes, and what an expert would do wherever an agent has got to."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from schemas.evaluation import ACTIONS
from schemas.navigation import Episode
from tasks.evaluation.measures import onto
from tasks.navigation.follower import Motion, follow, replay
from tasks.navigation.protocol import DistanceField, PathFinder
from tasks.policy.actions import LEFT, RIGHT, START, STOP, UNKNOWN
from tasks.settings import Config, Count, Natural, Positive

Array = NDArray[np.float64]
Actions = NDArray[np.int64]

_ON_M = 0.05
"""So far off the navmesh a start still counts as on it [m]: one voxel of Habitat's bake; as evaluation has it."""


@dataclasses.dataclass(frozen=True)
class WalkConfig(Config):
    """The robot, its expert, and how many walks there are to learn from."""

    forward_m: Positive = 0.25  # as the navigation stage: the paper's action space
    turn_degrees: Positive = 30.0  # as the navigation stage: the paper's action space
    stop_m: Positive = 0.1875  # from a view point, where an expert stops; as the navigation stage: its episodes end there
    facing: bool = False  # whether the expert turns to the target before it stops, as soon as it is within `stop_m`; episodes do not
    facing_degrees: Annotated[float, Field(gt=0, le=180)] = 39.5  # half of the camera's field of view: the target is seen then
    train_episodes: Natural = 100  # of a training scene; as printed in the supplementary
    test_episodes: Natural = 50  # of a test scene; as printed in the supplementary
    max_steps: Count = 500  # as the navigation stage: Habitat's limit
    search_expansions: Natural = 400  # as the navigation stage: where an expert cannot go straight on

    @property
    def motion(self) -> Motion:
        """What one action does."""
        return Motion(self.forward_m, math.radians(self.turn_degrees))


@dataclasses.dataclass(frozen=True)
class AgentWalk:
    """An agent's way through a scene, step by step.

    category: That it was sent to. poses: x, y [m] and yaw [rad] before each action, world frame, shape (n, 3). targets: What should have
    been done, places in `ACTIONS`, shape (n,); `UNKNOWN` where nobody knows. done: What was done, shape (n,).
    """

    scene_id: str
    room_id: str
    name: str
    category: str
    poses: Array
    targets: Actions
    done: Actions

    def __len__(self) -> int:
        return len(self.targets)

    @property
    def last(self) -> Actions:
        """The action before each step, shape (n,)."""
        return np.append(START, self.done[:-1]).astype(np.int64)


class Expert:
    """Who knows the way to an episode's target from anywhere: `follow` to the nearest view point.

    finder: Of the scene. views: View points of the target, x, y [m] and yaw towards it [rad], shape (n, 3).
    """

    def __init__(self, finder: PathFinder, views: ArrayLike, config: WalkConfig) -> None:
        self._finder, self._config = finder, config
        self._views = np.asarray(views, dtype=np.float64).reshape(-1, 3)
        self._target = seen_by_all(self._views)
        self.field: DistanceField = finder.field(self._views[:, :2])

    def actions(self, position: ArrayLike, yaw: float) -> list[int]:
        """What to do from a navigable point, world frame [m], shape (2,), heading `yaw` [rad], to the end; empty where there is no way.

        Turn to the next corner of the shortest path until the heading is off by half a turn at most, then go forward; stop within `stop_m`,
        where `facing` says so with the target in view.
        """
        config = self._config
        words = follow(
            position, yaw, self.field, self._finder, config.motion, config.stop_m, config.max_steps, config.search_expansions
        )  # fmt: skip
        if words is None:
            return []
        actions = [ACTIONS.index(action) for action in words]
        return actions if not config.facing else self.turned(actions, position, yaw)

    def turned(self, actions: Sequence[int], position: ArrayLike, yaw: float) -> list[int]:
        """Actions from a point that end with a stop, with turns before it until the target is in view."""
        end = replay([ACTIONS[action] for action in actions], position, yaw, self._finder, self._config.motion).poses[-1]
        goal = self.field.path(end[:2]).goal
        if goal < 0:
            return list(actions)
        turn, ahead = self._config.motion.turn_radians, self._target - end[:2]
        yaw = self._views[goal, 2] if np.hypot(*ahead) < _ON_M else math.atan2(ahead[1], ahead[0])
        off = math.remainder(float(yaw) - float(end[2]), 2 * math.pi)
        most = max(math.radians(self._config.facing_degrees), 0.5 * turn)
        count = max(math.ceil((abs(off) - most) / turn - 1e-9), 0)
        return [*actions[:-1], *[LEFT if off > 0 else RIGHT] * count, actions[-1]]


class Guide:
    """What an expert would do at each step of one agent. Whoever does as it says is led on; who does not is led from where that led to."""

    def __init__(self, expert: Expert, plan: Sequence[int] = ()) -> None:
        self._expert, self._plan = expert, list(plan)

    def right(self, position: ArrayLike, yaw: float) -> int:
        """The right action at the agent's pose; `UNKNOWN` where there is no way."""
        if not self._plan:
            self._plan = self._expert.actions(position, yaw)
        return self._plan[0] if self._plan else UNKNOWN

    def did(self, action: int) -> None:
        """What the agent did."""
        self._plan = self._plan[1:] if self._plan[:1] == [action] else []


def seen_by_all(views: Array) -> Array:
    """The point, shape (2,) [m], that view points x, y, yaw, shape (n, 3), look at, in least squares; where they look along one line, a
    little ahead of the first."""
    along = np.column_stack([np.cos(views[:, 2]), np.sin(views[:, 2])])
    across = np.eye(2) - along[:, :, None] * along[:, None]
    crossing = across.sum(axis=0)
    if not len(views) or np.linalg.det(crossing) < 2.5e-3 * len(views) ** 2:  # two that are a tenth of a radian apart
        return np.asarray(views[0, :2] + 0.5 * along[0] if len(views) else np.zeros(2))
    return np.asarray(np.linalg.solve(crossing, (across @ views[:, :2, None]).sum(axis=0)[:, 0]))


def views_of(episode: Episode, finder: PathFinder) -> Array:
    """View points of an episode's target that lie on the navmesh: x, y [m] and yaw [rad], shape (n, 3)."""
    views = np.array(episode.view_points, dtype=np.float64).reshape(-1, 4)
    at, is_on = onto(finder, views[:, :2], _ON_M)
    return np.column_stack([at, views[:, 3]])[is_on]


def start_of(episode: Episode, finder: PathFinder) -> Array | None:
    """Where an episode starts on the navmesh, shape (2,); None where it starts off it."""
    (at,), (is_on,) = onto(finder, np.array([episode.start_position[:2]]), _ON_M)
    return np.asarray(at) if is_on else None


def walk_of(episode: Episode, room_id: str, finder: PathFinder, config: WalkConfig) -> AgentWalk | None:
    """An episode as a walk; None where its actions cannot be carried out on the navmesh as they should."""
    start = start_of(episode, finder)
    if start is None or not episode.actions:
        return None
    actions = [ACTIONS.index(action) for action in episode.actions]
    if (config.facing or config.stop_m > WalkConfig.stop_m) and actions[-1] == STOP:
        views = views_of(episode, finder)
        if not len(views):
            return None
        expert = Expert(finder, views, config)
        poses = replay(episode.actions, start, episode.start_yaw_radians, finder, config.motion).poses[:-1, :2]
        near = np.flatnonzero(expert.field.distances(poses) < config.stop_m)
        actions = [*actions[: int(near[0]) if len(near) else -1], STOP]
        if config.facing:
            actions = expert.turned(actions, start, episode.start_yaw_radians)
    done = replay([ACTIONS[action] for action in actions], start, episode.start_yaw_radians, finder, config.motion)
    if done.collisions:
        return None
    made = np.array(actions, dtype=np.int64)
    return AgentWalk(episode.scene_id, room_id, episode.episode_id, episode.category, done.poses[:-1], made, made)


def chosen(episodes: Iterable[Episode], count: int) -> list[Episode]:
    """The first episodes of a scene, by name."""
    return sorted(episodes, key=lambda episode: episode.episode_id)[:count]


def majority(walks: Sequence[AgentWalk]) -> int:
    """The action that is right most often; of those that are, the first."""
    counts = sum((np.bincount(walk.targets[walk.targets >= 0], minlength=len(ACTIONS)) for walk in walks), np.zeros(len(ACTIONS)))
    return int(np.argmax(counts))
