"""Many agents in the scenes of a lake as one batched environment of gymnasium: pictures of a scene are drawn in one call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from flows.simulation.environment import Observation, chosen, facts
from flows.simulation.registration import ENVIRONMENT
from flows.simulation.scenes import EpisodeScenes, Selected, configured, named
from flows.simulation.spaces import action_space, observation_space, observations
from schemas.errors import InputError
from schemas.navigation import Episode
from tasks.simulation.agents import Agents
from tasks.simulation.objectnav import Course
from tasks.simulation.protocol import AgentView
from tasks.simulation.world import view_points

Flags = NDArray[np.bool_]
Step = tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]


class ObjectNavVectorEnv(gymnasium.vector.VectorEnv[Observation, NDArray[np.int64], NDArray[Any]]):
    """As many of `ObjectNavEnv` as asked for, step for step and bit for bit, each with a generator of its own.

    The seeds of a reset are those of `gymnasium.vector.SyncVectorEnv`: one for each, or the first of as many in a row.

    episodes: All that are drawn from.
    """

    def __init__(
        self, num_envs: int, lake: str | Path, scenes: str | Sequence[str] = (), split: str | None = "train", *, agent: str | None = None,
        categories: Sequence[str] | None = None, snapshot: int | None = None, release: str | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP, render_mode: str | None = None,
        max_episode_steps: int | None = None, copy: bool = True, **settings: Any,
    ) -> None:  # fmt: skip
        """
        Args:
            num_envs: Agents.
            lake: As of `ObjectNavEnv`, as all that is not listed here.
            scenes: As there.
            split: As there.
            agent: As there.
            categories: As there.
            snapshot: As there.
            release: As there.
            autoreset_mode: What becomes of an agent whose episode has ended, as gymnasium has it: it begins another one by the next step
                (`NextStep`, whose action does not count), or at once (`SameStep`), or waits for a reset with `reset_mask` (`Disabled`).
            render_mode: `rgb_array`: `render` gives the cameras' pictures.
            max_episode_steps: `max_steps`, as `gymnasium.make_vec` calls it.
            copy: As of gymnasium's own: without it the pictures of every step are in the same memory, which large ones gain by.
            settings: As there.

        Raises:
            InputError: as there, or there is no agent or no such mode.
        """
        self.config = configured(ENVIRONMENT, settings | ({} if max_episode_steps is None else {"max_steps": max_episode_steps}))
        if num_envs < 1:
            raise InputError(ENVIRONMENT, "num_envs", f"must be at least 1, is {num_envs}")
        modes = [mode.value for mode in AutoresetMode]
        if getattr(autoreset_mode, "value", autoreset_mode) not in modes:
            raise InputError(ENVIRONMENT, "autoreset_mode", f"there is no {autoreset_mode!r}", f"it is one of {', '.join(modes)}")
        self._mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 10, "autoreset_mode": self._mode}
        if render_mode not in (None, "rgb_array"):
            raise InputError(ENVIRONMENT, "render_mode", f"there is no {render_mode!r}", "it is rgb_array, or None")
        wanted = Selected(named(scenes), split, agent, snapshot, release, None if categories is None else named(categories))
        self.episodes = EpisodeScenes(lake, wanted, self.config)
        self.num_envs, self.render_mode = num_envs, render_mode
        self.single_observation_space = observation_space(len(self.episodes.categories), self.config)
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._agents, self._course = Agents(num_envs, self.config), Course(num_envs, self.config)
        self._rngs: list[np.random.Generator | None] = [None] * num_envs
        self._episodes: list[Episode | None] = [None] * num_envs
        self._fields: list[Any] = [None] * num_envs
        self._targets, self._goals = np.zeros(num_envs, dtype=np.int64), np.zeros(num_envs, dtype=np.int64)
        self._over = np.zeros(num_envs, dtype=np.bool_)
        self._sight: AgentView | None = None
        self._is_copied = copy
        self._facts = {name: np.full(num_envs, None, dtype=object) for name in ("scene_id", "episode_id", "object_category", "instance_id")}

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode of every agent, or of those alone that `reset_mask` of `options` marks, shape (n,); else as `ObjectNavEnv`.

        Raises:
            InputError: there is no such episode, it cannot be begun, or seeds and mask are not as many as agents.
        """
        given = dict(options or {})
        mask = np.asarray(given.pop("reset_mask", np.ones(self.num_envs, dtype=np.bool_)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise InputError(ENVIRONMENT, "reset_mask", f"must be {self.num_envs} truths, one of them true at least")
        seeds = [seed] * self.num_envs if seed is None else [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        if len(seeds) != self.num_envs:
            raise InputError(ENVIRONMENT, "seed", f"there are {len(seeds)}, and {self.num_envs} agents")
        if not mask.all() and None in self._episodes:
            raise InputError(ENVIRONMENT, "reset_mask", "leaves out agents that have no episode yet", "reset all of them first")
        for index in np.flatnonzero(mask).tolist():
            if seeds[index] is not None or self._rngs[index] is None:
                self._rngs[index] = gymnasium.utils.seeding.np_random(seeds[index])[0]
            self._begin(index, chosen(given))
        self._over[mask] = False
        return self._observed(), self._infos(mask)

    def step(self, actions: NDArray[np.int64]) -> Step:
        """Carry out an action of every agent, by Habitat's number, shape (n,).

        Raises:
            ValueError: there is no such action, no episode was begun, or with autoreset disabled one has ended.
        """
        if None in self._episodes:
            raise ValueError("reset: must come first")
        agents, active = self._agents, ~self._over
        if self._mode is AutoresetMode.DISABLED and not active.all():
            raise ValueError(f"reset: agent {int(np.argmin(active))} has ended its episode")
        before, distances = agents.position.copy(), self._course.distance_m.copy()
        agents.step(np.asarray(actions), np.flatnonzero(active))
        moved = np.hypot(*(agents.position - before).T)
        for index in np.flatnonzero(moved > 0).tolist():
            distances[index] = self._fields[index].distances(agents.position[index])[0]
        for index in np.flatnonzero(~active).tolist():
            self._begin(index, None)
        seen = self._observed()
        sees = np.zeros(self.num_envs, dtype=np.bool_)
        for index in np.flatnonzero(agents.called_stop & active).tolist():
            sees[index] = (seen["semantic"][index] == self._targets[index]).any()
        rewards, terminated, truncated = self._course.advance(moved, distances, agents.collided, agents.called_stop, sees, active)
        self._over = terminated | truncated
        infos: dict[str, Any] = {}
        if self._mode is AutoresetMode.SAME_STEP:
            infos = self._begin_at_once(seen)
        return seen, rewards, terminated, truncated, infos | self._infos(np.ones(self.num_envs, dtype=np.bool_))

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The cameras' pictures, shape (h, w, 3) each, where `render_mode` asks for them.

        Raises:
            ValueError: no episode was begun.
        """
        if self.render_mode is None:
            return None
        if None in self._episodes:
            raise ValueError("reset: must come first")
        return tuple(self._agents.render().rgb)

    def _begin(self, index: int, name: tuple[str, str] | None) -> None:
        """Begin an episode of one agent: the one that is named, or one that is drawn."""
        rng = self._rngs[index]
        assert rng is not None
        names = self.episodes.names
        episode = self.episodes.episode(*(name or names[int(rng.integers(len(names)))]))
        world = self.episodes.world(episode.scene_id)
        self._agents.place(index, world, world.start(episode), episode.start_yaw_radians)
        self._fields[index] = world.field(view_points(episode))
        self._course.begin(index, float(self._fields[index].distances(self._agents.position[index])[0]))
        self._episodes[index] = episode
        self._targets[index], self._goals[index] = int(episode.instance_id), self.episodes.number(episode.category)
        for name_of_fact, value in facts(episode).items():
            self._facts[name_of_fact][index] = value

    def _begin_at_once(self, seen: Observation) -> dict[str, Any]:
        """Begin an episode of all agents whose last has ended: what they see then takes the place of what they saw, which is returned."""
        infos: dict[str, Any] = {}
        ended = np.flatnonzero(self._over)
        measures = self._course.measures() if len(ended) else {}
        for index in ended.tolist():
            last = {name: values[index].copy() for name, values in seen.items()}
            known = {name: values[index].item() for name, values in measures.items()}
            known |= {name: values[index] for name, values in self._facts.items()}
            infos = self._add_info(infos, {"final_obs": last, "final_info": known}, index)
            self._begin(index, None)
        if len(ended):
            for name, values in self._observed(ended).items():
                seen[name][ended] = values
            self._over = np.zeros(self.num_envs, dtype=np.bool_)
        return infos

    def _observed(self, among: NDArray[np.int64] | None = None) -> Observation:
        """What all agents observe, or some of them."""
        agents, some = self._agents, slice(None) if among is None else among
        sight = agents.render(among, self._sight if among is None else None)
        if among is None and not self._is_copied:
            self._sight = sight
        return observations(
            sight, self._goals[some], agents.yaw[some], agents.start_yaw[some], agents.position[some], agents.start[some],
            agents.start_direction[some], self.config,
        )  # fmt: skip

    def _infos(self, mask: Flags) -> dict[str, Any]:
        """What there is to know of the episodes of some agents, as gymnasium has it: a value and a mark for each, nothing of the others."""
        infos: dict[str, Any] = {}
        for name, values in (*self._course.measures().items(), *self._facts.items()):
            infos[name], infos[f"_{name}"] = values.copy(), mask.copy()
            infos[name][~mask] = None if values.dtype == object else 0
        return infos
