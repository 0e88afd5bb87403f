"""What a built-in policy is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from schemas.navigation import Episode
from tasks.evaluation.batch import Attempt
from tasks.evaluation.configuration import EvaluationConfig

Rng = Callable[..., np.random.Generator]
"""A generator for words, as `Context.rng` gives it."""


@dataclasses.dataclass(frozen=True)
class Policy:
    """A member of the family `schemas.families.policies`: who can act in episodes.

    act: An attempt at every episode, without poses: these follow from the navmesh. is_drawn: It draws from the generator.
    settings: Fields of the config that change what it does, besides the robot.
    """

    name: str
    act: Callable[[Sequence[Episode], EvaluationConfig, Rng], tuple[Attempt, ...]]
    is_drawn: bool = False
    settings: tuple[str, ...] = ()


def attempt(episode: Episode, actions: tuple[str, ...]) -> Attempt:
    """These actions in an episode."""
    return Attempt(episode.scene_id, episode.episode_id, actions, None, None, f"episode {episode.scene_id} {episode.episode_id}")
