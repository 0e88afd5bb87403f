"""What every simulator can do: put an agent into an episode, let it act, show what it sees, and say how far it is."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.navigation.follower import FORWARD, LEFT, RIGHT, STOP

if TYPE_CHECKING:
    from schemas.navigation import Episode

ACTIONS = (STOP, FORWARD, LEFT, RIGHT)
"""Actions by number, as Habitat numbers them: stop 0, move_forward 1, turn_left 2, turn_right 3."""

NO_OBJECT = -1
"""Semantic pixel of what is no object: floor, walls, and where nothing is."""


@dataclasses.dataclass(frozen=True)
class AgentState:
    """Where an agent is, on the floor of the world frame.

    x, y: Center of the agent [m]. yaw: Heading about +Z from +X [rad], in (-pi, pi]. collided: The last action was a step that met an
    obstacle. called_stop: The last action was the agent's own stop.
    """

    x: float
    y: float
    yaw: float
    collided: bool = False
    called_stop: bool = False


@dataclasses.dataclass(frozen=True)
class AgentView:
    """What an agent's camera sees.

    rgb: Shape (h, w, 3) uint8. depth: Along the camera's axis [m], 0 where nothing is, shape (h, w) float32. semantic: Number of the
    instance, `NO_OBJECT` where there is none, shape (h, w) int32.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    semantic: NDArray[np.int32]


class Simulator(Protocol):
    """One agent in one scene at a time. All points lie on the floor, world frame [m]."""

    def reset(self, episode: Episode) -> AgentState:
        """Put the agent where an episode of any of the simulator's scenes starts.

        Raises:
            InputError: there is no such scene, or its floor does not go with the episode.
        """
        ...

    def step(self, action: int) -> AgentState:
        """Carry out an action, by its number in `ACTIONS`."""
        ...

    def render(self) -> AgentView:
        """What the agent sees from where it is."""
        ...

    def geodesic(self, points: ArrayLike) -> float:
        """Length of the shortest path from the agent to the nearest of some points, shape (n, 2) [m]; infinite without a path."""
        ...

    def snap(self, point: ArrayLike) -> NDArray[np.float64]:
        """The navigable point nearest to a point, shape (2,)."""
        ...
