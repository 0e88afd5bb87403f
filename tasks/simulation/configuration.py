"""Settings of a simulated agent, its camera, and the task that it is given."""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from tasks.navigation.follower import Motion
from tasks.settings import Config, Count, NonNegative, Positive


@dataclasses.dataclass(frozen=True)
class SimulationConfig(Config):
    """Camera, robot, and what is rewarded."""

    width: Count = 64  # small networks learn from it, at some ten thousand pictures a second; Habitat's HSSD episodes have 640
    height: Count = 64  # square, as most networks take pictures; Habitat's HSSD episodes have 480
    hfov_degrees: Annotated[float, Field(gt=0, lt=180)] = 79.0  # Habitat's object navigation on HSSD, across the picture
    camera_height_m: Positive = 0.88  # Habitat's object navigation on HSSD: at the top of its robot
    min_depth_m: NonNegative = 0.5  # Habitat's object navigation on HSSD: what is nearer reads as 0
    max_depth_m: Positive = 5.0  # Habitat's object navigation on HSSD: what is farther reads as 1
    forward_m: Positive = 0.25  # as the navigation stage: the paper's action space, and Habitat's
    turn_degrees: Positive = 30.0  # as the navigation stage: the paper's action space, and Habitat's
    max_steps: Count = 500  # Habitat's limit for both navigation tasks
    success_m: Positive = 0.1  # Habitat's object navigation, to a view point; experts of the lake end within 0.2 m, `success_m` there
    must_see: bool = False  # Habitat does not look; with success_m = 1.0, true asks for a stop nearby with the target in view
    slack_reward: NonNegative = 0.01  # taken for every action, so that short ways pay; habitat-lab's default
    success_reward: NonNegative = 2.5  # as much as 2.5 m of way: habitat-lab's default
    reach_m: NonNegative = 0.05  # as the evaluation stage: so far outside the navmesh a start or view point still counts as on it

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.max_depth_m <= self.min_depth_m:
            raise ValueError(f"max_depth_m: must be above min_depth_m, {self.min_depth_m:g}, is {self.max_depth_m:g}")
        return self

    @property
    def motion(self) -> Motion:
        """What one action does."""
        return Motion(self.forward_m, math.radians(self.turn_degrees))

    @property
    def hfov(self) -> float:
        """Angle that the picture spans from left to right [rad]."""
        return math.radians(self.hfov_degrees)
