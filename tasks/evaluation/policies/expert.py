"""The expert of the episodes."""

from __future__ import annotations

from collections.abc import Sequence

from schemas.navigation import Episode
from tasks.evaluation.batch import Attempt
from tasks.evaluation.configuration import EvaluationConfig
from tasks.evaluation.policy import Policy, Rng, attempt


def expert(episodes: Sequence[Episode], config: EvaluationConfig, rng: Rng) -> tuple[Attempt, ...]:
    """The actions that come with every episode: the upper end of what can be expected."""
    return tuple(attempt(episode, episode.actions) for episode in episodes)


EXPERT = Policy(name="expert", act=expert)
