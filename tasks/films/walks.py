"""What a film shows: one trajectory, how it ended, and the look of the pictures."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.evaluation import Trajectory
from tasks.policy.model.config import AgentCamera
from tasks.stats.scenes import PictureConfig

_ROOM = PictureConfig(width=720, height=540, elevation_radians=0.95, hung_m=0.14, standing_m=-1.0)


@dataclasses.dataclass(frozen=True)
class FilmLook:
    """How films look. room: The room from above: steeply, so that furniture hides little floor, and without doors and pictures, as thin
    as they are, on walls that are cut away. view_px: Width of what the agent sees [px]. text_px: Size of letters."""

    room: PictureConfig = _ROOM
    view_px: int = 248  # two of them and their headings are as high as the room
    text_px: int = 15
    max_depth_m: float = 5.0  # as agents' depth cameras have it; what is farther looks alike
    quality: int = 82  # of WebP; below that letters have halos
    step_ms: int = 180  # of a pose: an action can be read, and twenty of them take 4 seconds
    rest_ms: int = 1800  # of the first and of the last pose


STRIP_LOOK = FilmLook(room=dataclasses.replace(_ROOM, width=300, height=225), view_px=146, text_px=11)
"""Of strips of stills: four poses side by side fill a page, 60 kB as JPEG."""


@dataclasses.dataclass(frozen=True)
class WalkStrip:
    """Stills of a walk, a JPEG, and what is to be said of it."""

    policy: str
    run_name: str
    outcome: str
    scene_id: str
    episode_id: str
    category: str
    ending: str
    picture: bytes


class FilmedBody(Protocol):
    """Whatever goes through a room, seen from above."""

    @property
    def poses(self) -> NDArray[np.float64]:
        """x, y [m] and yaw [rad], world frame, shape (n, 3)."""
        ...

    @property
    def target(self) -> str:
        """Where it goes: an instance."""
        ...

    @property
    def camera(self) -> AgentCamera:
        """What it looks through."""
        ...

    @property
    def radius_m(self) -> float:
        """Of the body."""
        ...

    @property
    def height_m(self) -> float:
        """Of the body."""
        ...


@dataclasses.dataclass(frozen=True)
class FilmedWalk:
    """A trajectory to film.

    is_success: As the view `trajectory_metrics` has it. radius_m, height_m: Of the agent. camera: What it saw through; its size is the
    film's.
    """

    trajectory: Trajectory
    is_success: bool
    radius_m: float
    height_m: float
    camera: AgentCamera = dataclasses.field(default_factory=AgentCamera)

    @property
    def poses(self) -> NDArray[np.float64]:
        """x, y [m] and yaw [rad], world frame, before the first action and after every action, shape (n, 3)."""
        return np.array(self.trajectory.poses, dtype=np.float64).reshape(-1, 3)

    @property
    def target(self) -> str:
        """The episode's instance."""
        return self.trajectory.instance_id

    @property
    def outcome(self) -> str:
        """`success` or `failure`."""
        return "success" if self.is_success else "failure"

    @property
    def ending(self) -> str:
        """How it ended, for people."""
        row = self.trajectory
        if not row.called_stop:
            return f"never stopped in {len(row.actions)} actions"
        if row.final_distance_m is None:
            return "stopped where no path leads to a view point"
        seen = {True: ", target in view", False: ", target not in view", None: ""}[row.is_target_seen]
        return f"stopped {row.final_distance_m:.2f} m from a view point{seen}"

    def act(self, step: int) -> str:
        """What led to a pose, by its number."""
        return "start" if step == 0 else f"step {step} of {len(self.poses) - 1}: {self.trajectory.actions[step - 1]}"
