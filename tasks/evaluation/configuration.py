"""Settings of the evaluation stage."""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated

from pydantic import Field

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
    camera_height_m: Positive = 0.88  # of the camera that looks for the target in the end; as agents and policies have it
    camera_hfov_degrees: Annotated[float, Field(gt=0, lt=180)] = 79.0  # of that camera, across the picture; as agents and policies have it
    camera_px: Count = 128  # width and height of its picture: a mug 3 m away is 4 pixels wide
    seen_share: Share = 0.001  # of the picture, from which on a target is seen: 16 pixels; what is smaller nobody would recognize
    turns_aside: bool = True  # a trained policy that runs against something (`tasks.policy.reflex`); false: it repeats what led nowhere
    stop_probability: Share = 0.02  # of the random policy in every step: 50 actions on average, twice an expert's in small rooms

    @property
    def camera_hfov(self) -> float:
        """Angle that the picture spans from left to right [rad]."""
        return math.radians(self.camera_hfov_degrees)

    @property
    def motion(self) -> Motion:
        """What one action does."""
        return Motion(self.forward_m, math.radians(self.turn_degrees))
