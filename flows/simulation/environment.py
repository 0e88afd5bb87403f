"""Object navigation in the scenes of a lake as an environment of gymnasium, with our simulator or another behind it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from flows.simulation.registration import ENVIRONMENT
from flows.simulation.scenes import EpisodeScenes, Selected, configured, named
from flows.simulation.spaces import action_space, observation_space, observations
from schemas.errors import InputError
from schemas.navigation import Episode
from tasks.simulation.objectnav import Course
from tasks.simulation.protocol import AgentState, AgentView, Simulator
from tasks.simulation.simulator import WorldSimulator
from tasks.simulation.world import view_points

Observation = dict[str, NDArray[Any]]


class ObjectNavEnv(gymnasium.Env[Any, np.int64]):
    """One agent that looks for objects, as Habitat's ObjectNav has it.

    An episode ends (`terminated`) when the agent stops, and is cut (`truncated`) after `max_steps`. It is a success when the agent
    stops within `success_m` of a view point of the target, along the floor; with `must_see` it must also have the target in view.
    `info` has Habitat's measures (`distance_to_goal`, `success`, `spl`, `soft_spl`, `num_steps`, `collisions`) and the episode:
    `scene_id`, `episode_id`, `object_category`, `instance_id`.

    episodes: All that are drawn from: how `scenes` and `split` chose them. simulator: What the agent acts in.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - as gymnasium has it

    def __init__(
        self, lake: str | Path, scenes: str | Sequence[str] = (), split: str | None = "train", *, agent: str | None = None,
        categories: Sequence[str] | None = None, snapshot: int | None = None, release: str | None = None,
        render_mode: str | None = None, simulator: Simulator | None = None, **settings: Any,
    ) -> None:  # fmt: skip
        """
        Args:
            lake: Folder or address of the lake.
            scenes: Scenes to be in; all when there is none.
            split: `train` or `test`; None for both.
            agent: Name of the agent in `navmeshes`; to be given where there are several.
            categories: What targets can be, by number; all categories of the snapshot's episodes, sorted, when it is left out.
            snapshot: Snapshot of the lake; the last one when it is left out.
            release: Release of the lake, in place of a snapshot.
            render_mode: `rgb_array`: `render` gives the camera's picture.
            simulator: What to act in, in place of our own.
            settings: Fields of `tasks.simulation.configuration.SimulationConfig`.

        Raises:
            InputError: there is no such lake, scene, split, agent or setting, or no episode of what is asked for.
        """
        self.config = configured(ENVIRONMENT, settings)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(ENVIRONMENT, "render_mode", f"there is no {render_mode!r}", "it is rgb_array, or None")
        wanted = Selected(named(scenes), split, agent, snapshot, release, None if categories is None else named(categories))
        self.episodes = EpisodeScenes(lake, wanted, self.config)
        self.simulator = simulator or WorldSimulator(self.episodes.world, self.config)
        self.render_mode = render_mode
        self.observation_space = observation_space(len(self.episodes.categories), self.config)
        self.action_space = action_space()
        self._course = Course(1, self.config)
        self._episode: Episode | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: one of `options` (`scene_id` and `episode_id`), or one drawn from all, each as likely as another.

        Raises:
            InputError: there is no such episode, or it cannot be begun.
        """
        super().reset(seed=seed)
        name = chosen(options) or self.episodes.names[int(self.np_random.integers(len(self.episodes.names)))]
        self._episode = episode = self.episodes.episode(*name)
        self._goals = view_points(episode)
        self._start = self._state = self.simulator.reset(episode)
        self._course.begin(0, self.simulator.geodesic(self._goals))
        self._sight = self.simulator.render()
        return self._observation(), self._info()

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry out an action, by Habitat's number.

        Raises:
            ValueError: there is no such action, or no episode was begun.
        """
        if self._episode is None:
            raise ValueError("reset: must come first")
        before, self._state = self._state, self.simulator.step(int(action))
        self._sight = self.simulator.render()
        state = self._state
        sees = bool((self._sight.semantic == int(self._episode.instance_id)).any()) if state.called_stop else False
        rewards, terminated, truncated = self._course.advance(
            np.hypot(*np.array([[state.x - before.x], [state.y - before.y]])), np.array([self.simulator.geodesic(self._goals)]),
            np.array([state.collided]), np.array([state.called_stop]), np.array([sees]), np.ones(1, dtype=np.bool_),
        )  # fmt: skip
        return self._observation(), float(rewards[0]), bool(terminated[0]), bool(truncated[0]), self._info()

    def render(self) -> NDArray[np.uint8] | None:
        """The camera's picture, shape (h, w, 3), where `render_mode` asks for it.

        Raises:
            ValueError: no episode was begun.
        """
        if self.render_mode is None:
            return None
        if self._episode is None:
            raise ValueError("reset: must come first")
        return self._sight.rgb.copy()

    def _observation(self) -> Observation:
        assert self._episode is not None
        sight, at, start = self._sight, self._state, self._start
        batch = observations(
            AgentView(sight.rgb[None].copy(), sight.depth[None].copy(), sight.semantic[None].copy()),
            [self.episodes.number(self._episode.category)], np.array([at.yaw]), np.array([start.yaw]), _point(at), _point(start),
            np.array([[math.cos(start.yaw), math.sin(start.yaw)]]), self.config,
        )  # fmt: skip
        return {name: values[0] for name, values in batch.items()}

    def _info(self) -> dict[str, Any]:
        assert self._episode is not None
        return {name: values[0].item() for name, values in self._course.measures().items()} | facts(self._episode)


def chosen(options: dict[str, Any] | None) -> tuple[str, str] | None:
    """The episode that options of a reset name; None where they name none.

    Raises:
        InputError: they name half of one, or something else.
    """
    given = dict(options or {})
    if not given:
        return None
    if given.keys() != {"scene_id", "episode_id"}:
        raise InputError(ENVIRONMENT, "options", f"are {', '.join(map(str, given))}", "give scene_id and episode_id, or none")
    return str(given["scene_id"]), str(given["episode_id"])


def facts(episode: Episode) -> dict[str, str]:
    """What `info` says of an episode."""
    return {
        "scene_id": episode.scene_id, "episode_id": episode.episode_id, "object_category": episode.category,
        "instance_id": episode.instance_id,
    }  # fmt: skip


def _point(state: AgentState) -> NDArray[np.float64]:
    return np.array([[state.x, state.y]])
