"""Corrections of a policy's own mistakes (DAgger, Ross et al. 2011): it acts, and an expert says what would have been right where it got.

Who learns from an expert's walks alone has never seen what lies beside them, where one mistake leads to.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence

import numpy as np

from schemas.navigation import Episode
from tasks.navigation.follower import heading_after
from tasks.navigation.protocol import PathFinder
from tasks.policy.actions import FORWARD, LEFT, RIGHT, STOP, UNKNOWN
from tasks.policy.demonstrations import AgentWalk, Array, Expert, Guide, WalkConfig, start_of, views_of, walk_of
from tasks.policy.inference.actor import Actor
from tasks.policy.senses import channels_of
from tasks.policy.store import Render
from tasks.settings import Config, Count, Natural, Share


@dataclasses.dataclass(frozen=True)
class CorrectionsConfig(Config):
    """How often a policy is let go and corrected."""

    rounds: Natural = 0  # none: imitation of shortest paths alone, as published
    steps: Count = 1500  # of training after each round, beginning with the weights so far
    episodes: Count = 20  # of each training scene in a round: a fifth of those that there are
    max_steps: Count = 60  # of a walk: twice what an expert takes
    expert_share: Share = 0.25  # of steps in which the expert's action is carried out, so that who is stuck comes free


@dataclasses.dataclass(frozen=True)
class TrainingScene:
    """A scene to act in. episodes: With the name of the room, and what knows where one can go."""

    scene_id: str
    room_id: str
    episodes: Sequence[Episode]
    finder: PathFinder


class _Agent:
    """One agent under way."""

    def __init__(self, episode: Episode, course: TrainingScene, guide: Guide, start: Array, rng: np.random.Generator) -> None:
        self.episode, self.course, self.guide, self.rng = episode, course, guide, rng
        self.position, self.turns = start, 0
        self.poses: list[tuple[float, float, float]] = []
        self.targets: list[int] = []
        self.done: list[int] = []
        self.is_done = False

    def pose(self, config: WalkConfig) -> tuple[float, float, float]:
        """Where it is: x, y [m] and yaw [rad]."""
        yaw = heading_after(self.episode.start_yaw_radians, self.turns, config.motion)
        return float(self.position[0]), float(self.position[1]), yaw

    def step(self, action: int, config: WalkConfig, corrections: CorrectionsConfig) -> int:
        """Carry an action out, or the expert's; what was done. Who stops too early goes on as the expert does."""
        x, y, yaw = self.pose(config)
        right = self.guide.right((x, y), yaw)
        guided = self.rng.random() < corrections.expert_share
        if right != UNKNOWN and (guided or action == STOP):
            action = right
        self.guide.did(action)
        self.poses.append((x, y, yaw))
        self.targets.append(right)
        self.done.append(action)
        self.is_done = action == STOP or len(self.done) >= corrections.max_steps
        if action == FORWARD:
            ahead = config.forward_m * np.array([math.cos(yaw), math.sin(yaw)])
            self.position = np.asarray(self.course.finder.try_step(self.position, ahead))
        elif action in (LEFT, RIGHT):
            self.turns += 1 if action == LEFT else -1
        return action

    def walk(self, number: int) -> AgentWalk:
        """What came of it."""
        episode = self.episode
        return AgentWalk(
            episode.scene_id, self.course.room_id, f"{episode.episode_id}-{number}", episode.category, np.array(self.poses),
            np.array(self.targets, dtype=np.int64), np.array(self.done, dtype=np.int64),
        )  # fmt: skip


def corrected(
    actor: Actor, courses: Mapping[str, TrainingScene], render: Render, walks: WalkConfig, config: CorrectionsConfig, number: int, seed: int
) -> list[AgentWalk]:
    """Walks of a policy in scenes, with what an expert would have done at each step; a function of its weights, the round and the seed.

    All agents of a scene act at once. number: Of the round.
    """
    made = []
    for name in sorted(courses):
        agents = _begun(courses[name], walks, config, number, seed)
        actor.reset(len(agents), [agent.episode.category for agent in agents])
        going = list(range(len(agents)))  # in the actor's order
        while going:
            camera = actor.config.camera
            pictures = np.zeros((len(going), camera.height, camera.width, channels_of(actor.config)), dtype=np.uint8)
            if not actor.config.blind:
                pictures = render(name, np.array([agents[place].pose(walks) for place in going]))
            chosen = actor.logits(pictures).argmax(axis=-1)
            actor.did([agents[place].step(int(action), walks, config) for place, action in zip(going, chosen, strict=True)])
            still = [order for order, place in enumerate(going) if not agents[place].is_done]
            if len(still) < len(going):
                actor.keep(still)
                going = [going[order] for order in still]
        made += [agent.walk(number) for agent in agents]
    return made


def _begun(course: TrainingScene, walks: WalkConfig, config: CorrectionsConfig, number: int, seed: int) -> list[_Agent]:
    """Agents at the starts of some of a scene's episodes, drawn by the round."""
    order = _rng(seed, number, course.scene_id).permutation(len(course.episodes))
    agents: list[_Agent] = []
    experts: dict[tuple[tuple[float, ...], ...], Expert] = {}
    for place in order[: config.episodes]:
        episode = course.episodes[int(place)]
        start, shown = start_of(episode, course.finder), walk_of(episode, course.room_id, course.finder, walks)
        if start is None or shown is None:
            continue
        if episode.view_points not in experts:
            experts[episode.view_points] = Expert(course.finder, views_of(episode, course.finder), walks)
        rng = _rng(seed, number, episode.scene_id, episode.episode_id)
        agents.append(_Agent(episode, course, Guide(experts[episode.view_points], shown.targets.tolist()), start, rng))
    return agents


def _rng(*words: object) -> np.random.Generator:
    """A generator that follows from words."""
    return np.random.default_rng(list(hashlib.sha256("\x1f".join(map(str, ("corrections", *words))).encode()).digest()))


def agreement(walks: Sequence[AgentWalk]) -> float:
    """Share of steps in which what was done was right."""
    pairs = [(walk.targets, walk.done) for walk in walks]
    known = sum(int((targets != UNKNOWN).sum()) for targets, _ in pairs)
    return sum(int((targets == done)[targets != UNKNOWN].sum()) for targets, done in pairs) / max(known, 1)
