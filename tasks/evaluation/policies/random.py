"""Chance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.evaluation import ACTIONS
from schemas.navigation import Episode
from tasks.evaluation.batch import Attempt
from tasks.evaluation.configuration import EvaluationConfig
from tasks.evaluation.policy import Policy, Rng, attempt


def random(episodes: Sequence[Episode], config: EvaluationConfig, rng: Rng) -> tuple[Attempt, ...]:
    """Stop with `stop_probability` in every step, else forward, left or right with equal chances; cut at `max_steps`.

    It sees nothing: the lower end. Every episode has a generator of its own, so that its actions depend on no other episode.
    """
    attempts = []
    for episode in episodes:
        draws = rng(RANDOM.name, episode.scene_id, episode.episode_id)
        stops = np.flatnonzero(draws.random(config.max_steps) < config.stop_probability)
        moves = draws.integers(0, 3, config.max_steps)
        count = int(stops[0]) if len(stops) else config.max_steps
        actions = [ACTIONS[move] for move in moves[:count]] + ["stop"] * bool(len(stops))
        attempts.append(attempt(episode, tuple(actions)))
    return tuple(attempts)


RANDOM = Policy(name="random", act=random, is_drawn=True, settings=("stop_probability", "max_steps"))
