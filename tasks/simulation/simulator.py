"""Our own simulator: scenes of the lake behind the small protocol, one agent at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.simulation.agents import Agents
from tasks.simulation.configuration import SimulationConfig
from tasks.simulation.protocol import AgentState, AgentView, Simulator
from tasks.simulation.world import World

if TYPE_CHECKING:
    from schemas.navigation import Episode


class WorldSimulator(Simulator):
    """One agent on the floor of a scene. Its motion is that of `tasks.navigation.follower.replay`, to the last bit."""

    def __init__(self, world: Callable[[str], World], config: SimulationConfig) -> None:
        """`world`: the scene of a name, made once and kept by whoever gives it."""
        self._world, self._agents = world, Agents(1, config)

    def reset(self, episode: Episode) -> AgentState:
        """Put the agent where an episode starts.

        Raises:
            InputError: there is no such scene, or the episode starts off its navmesh or without a path to a view point.
        """
        world = self._world(episode.scene_id)
        self._agents.place(0, world, world.start(episode), episode.start_yaw_radians)
        return self._agents.state(0)

    def step(self, action: int) -> AgentState:
        """Carry out an action, by its number in `ACTIONS`.

        Raises:
            ValueError: there is no such action, or no episode was begun.
        """
        _ = self.world
        self._agents.step(np.array([action]))
        return self._agents.state(0)

    def render(self) -> AgentView:
        """What the agent sees."""
        _ = self.world
        sight = self._agents.render()
        return AgentView(sight.rgb[0], sight.depth[0], sight.semantic[0])

    def geodesic(self, points: ArrayLike) -> float:
        """Length of the shortest path to the nearest of some points, shape (n, 2) [m]; infinite without a path."""
        return float(self.world.field(points).distances(self._agents.position)[0])

    def snap(self, point: ArrayLike) -> NDArray[np.float64]:
        """The navigable point nearest to a point, shape (2,)."""
        return np.asarray(self.world.finder.snap(point)[0])

    @property
    def world(self) -> World:
        """The scene that the agent is in.

        Raises:
            ValueError: no episode was begun.
        """
        world = self._agents.worlds[0]
        if world is None:
            raise ValueError("reset: must come first")
        return world
