"""A policy that stops at once."""

from __future__ import annotations

from collections.abc import Sequence

from schemas.navigation import Episode
from tasks.evaluation.batch import Attempt
from tasks.evaluation.configuration import EvaluationConfig
from tasks.evaluation.policy import Policy, Rng, attempt


def act(episodes: Sequence[Episode], config: EvaluationConfig, rng: Rng) -> tuple[Attempt, ...]:
    return tuple(attempt(episode, ("stop",)) for episode in episodes)


TOY_POLICY = Policy(name="toy_policy", act=act)
