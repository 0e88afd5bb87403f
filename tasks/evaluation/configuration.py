"""What the evaluation stage can be told."""

from __future__ import annotations

import dataclasses
import math

from tasks.navigation.follower import Motion


@dataclasses.dataclass(frozen=True)
class EvaluationConfig:
    """The robot's actions, when an episode is won, what is refused in a file, and the built-in random policy."""

    forward_m: float = 0.25  # as the navigation stage: the paper's action space
    turn_degrees: float = 30.0  # the same
    success_m: float = 0.2  # as the navigation stage; steps of 0.25 m cannot always end within Habitat's 0.1 m for objects
    max_steps: int = 500  # Habitat's limit for both navigation tasks
    reach_m: float = 0.05  # one voxel of Habitat's bake: so far outside the navmesh a pose still counts as on it
    slack_m: float = 0.01  # simulators settle by millimetres; a robot that moves a centimetre too far is another robot
    yaw_slack_radians: float = 0.02  # a degree: files print three digits, degrees and other conventions are off by far more
    stop_probability: float = 0.02  # of the random policy in every step: 50 actions on average, twice an expert's in small rooms

    def __post_init__(self) -> None:
        for name in ("forward_m", "turn_degrees", "success_m"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: must be above 0, is {getattr(self, name):g}")
        for name in ("reach_m", "slack_m", "yaw_slack_radians"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: must be at least 0, is {getattr(self, name):g}")
        if self.max_steps < 1:
            raise ValueError(f"max_steps: must be at least 1, is {self.max_steps}")
        if not 0 <= self.stop_probability <= 1:
            raise ValueError(f"stop_probability: must be 0 to 1, is {self.stop_probability:g}")

    @property
    def motion(self) -> Motion:
        """What one action does."""
        return Motion(self.forward_m, math.radians(self.turn_degrees))
