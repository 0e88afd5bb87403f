"""Settings of the evaluation stage."""

from __future__ import annotations

import dataclasses
import math

from tasks.navigation.follower import Motion
from tasks.settings import Config, Count, NonNegative, Positive, Share


@dataclasses.dataclass(frozen=True)
class EvaluationConfig(Config):
    """The robot's actions, when an episode is won, what is refused in a file, and the built-in random policy."""

    forward_m: Positive = 0.25  # as the navigation stage: the paper's action space
    turn_degrees: Positive = 30.0  # as the navigation stage: the paper's action space
    success_m: Positive = 0.2  # as the navigation stage; steps of 0.25 m cannot always end within Habitat's 0.1 m for objects
    max_steps: Count = 500  # Habitat's limit for both navigation tasks
    reach_m: NonNegative = 0.05  # one voxel of Habitat's bake: so far outside the navmesh a pose still counts as on it
    slack_m: NonNegative = 0.01  # simulators settle by millimetres; a robot that moves a centimetre too far is another robot
    yaw_slack_radians: NonNegative = 0.02  # a degree: files print three digits, degrees and other conventions are off by far more
    stop_probability: Share = 0.02  # of the random policy in every step: 50 actions on average, twice an expert's in small rooms

    @property
    def motion(self) -> Motion:
        """What one action does."""
        return Motion(self.forward_m, math.radians(self.turn_degrees))
