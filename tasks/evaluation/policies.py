"""Built-in policies: the expert of the episodes, and chance."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from schemas.evaluation import ACTIONS
from schemas.navigation import Episode
from tasks.evaluation.batch import Attempt
from tasks.evaluation.configuration import EvaluationConfig

Rng = Callable[..., np.random.Generator]
"""A generator for words, as `Context.rng` gives it."""


def expert(episodes: Sequence[Episode], config: EvaluationConfig, rng: Rng) -> tuple[Attempt, ...]:
    """The actions that come with every episode: the upper end of what can be expected."""
    return tuple(_attempt(episode, episode.actions) for episode in episodes)


def random(episodes: Sequence[Episode], config: EvaluationConfig, rng: Rng) -> tuple[Attempt, ...]:
    """Stop with `stop_probability` in every step, else forward, left or right with equal chances; cut at `max_steps`.

    It sees nothing: the lower end. Every episode has a generator of its own, so that its actions depend on no other episode.
    """
    attempts = []
    for episode in episodes:
        draws = rng("random", episode.scene_id, episode.episode_id)
        stops = np.flatnonzero(draws.random(config.max_steps) < config.stop_probability)
        moves = draws.integers(0, 3, config.max_steps)
        count = int(stops[0]) if len(stops) else config.max_steps
        actions = [ACTIONS[move] for move in moves[:count]] + ["stop"] * bool(len(stops))
        attempts.append(_attempt(episode, tuple(actions)))
    return tuple(attempts)


POLICIES: dict[str, Callable[[Sequence[Episode], EvaluationConfig, Rng], tuple[Attempt, ...]]] = {"expert": expert, "random": random}
"""Built-in policies by name. Each gives an attempt at every episode, without poses: these follow from the navmesh."""


def _attempt(episode: Episode, actions: tuple[str, ...]) -> Attempt:
    return Attempt(episode.scene_id, episode.episode_id, actions, None, None, f"episode {episode.scene_id} {episode.episode_id}")
