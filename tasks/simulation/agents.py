"""Many agents at once, each in a scene of its own choice: a few arrays, and one call per scene for all that stand in it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tasks.navigation.follower import heading_after, is_short
from tasks.simulation.cameras import cameras_along
from tasks.simulation.configuration import SimulationConfig
from tasks.simulation.protocol import ACTIONS, AgentState, AgentView
from tasks.simulation.rasterizer import Pictures
from tasks.simulation.world import World

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

STOP, FORWARD, LEFT, RIGHT = range(len(ACTIONS))


class Agents:
    """Poses of `count` agents, on the floor of their scenes, world frame. Every array has a row for each.

    position: Shape (n, 2) [m]. yaw: Heading about +Z from +X [rad], in (-pi, pi], shape (n,): the heading at the start and the turns
    since, which are counted, so that errors do not add up. direction: Its cosine and sine, shape (n, 2). collided, called_stop: What
    came of the last action, shape (n,). start, start_yaw, start_direction: Where they were put.
    """

    def __init__(self, count: int, config: SimulationConfig) -> None:
        self.config, self._motion = config, config.motion
        self.position, self.start = np.zeros((count, 2)), np.zeros((count, 2))
        self.direction, self.start_direction = np.zeros((count, 2)), np.zeros((count, 2))
        self.yaw, self.start_yaw = np.zeros(count), np.zeros(count)
        self.collided, self.called_stop = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
        self.worlds: list[World | None] = [None] * count
        self._turns = np.zeros(count, dtype=np.int64)
        self._groups: dict[int, Indices] = {}  # by identity of the world
        self._room = Pictures.empty(count, config.width, config.height)

    def __len__(self) -> int:
        return len(self.worlds)

    def place(self, index: int, world: World, position: Array, yaw: float) -> None:
        """Put an agent on a navigable point of a scene, shape (2,) [m], heading `yaw` [rad]."""
        if self.worlds[index] is not world:
            self.worlds[index] = world
            self._groups = {}
        self.position[index] = self.start[index] = position
        self.yaw[index] = self.start_yaw[index] = yaw
        self.collided[index] = self.called_stop[index] = False
        self._turns[index] = 0
        heading = heading_after(yaw, 0, self._motion)
        self.direction[index] = self.start_direction[index] = math.cos(heading), math.sin(heading)

    def step(self, actions: NDArray[np.integer], among: Indices | None = None) -> None:
        """Carry out an action of every agent, by its number in `ACTIONS`, shape (n,); `among`: of these alone, ascending.

        Raises:
            ValueError: there is no such action.
        """
        acts = np.asarray(actions)
        agents = np.arange(len(self)) if among is None else among
        if ((acts < 0) | (acts >= len(ACTIONS))).any():
            raise ValueError(f"action: must be 0 to {len(ACTIONS) - 1}, is {acts[(acts < 0) | (acts >= len(ACTIONS))][0]}")
        mine = acts[agents]
        self.collided[agents] = False
        self.called_stop[agents] = mine == STOP
        for index in agents[(mine == LEFT) | (mine == RIGHT)].tolist():
            self._turns[index] += 1 if acts[index] == LEFT else -1
            yaw = heading_after(float(self.start_yaw[index]), int(self._turns[index]), self._motion)
            self.yaw[index] = yaw
            self.direction[index] = math.cos(yaw), math.sin(yaw)
        yaws = self.yaw[agents]
        for index in agents[(yaws <= -math.pi) | (yaws > math.pi)].tolist():  # a start may be given so; headings after it are not
            self.yaw[index] = heading_after(float(self.start_yaw[index]), int(self._turns[index]), self._motion)
        forward = np.zeros(len(self), dtype=np.bool_)
        forward[agents] = mine == FORWARD
        for world, group in self.groups():
            walkers = group[forward[group]]
            if len(walkers):
                before = self.position[walkers]
                after = world.finder.try_steps(before, self._motion.forward_m * self.direction[walkers])
                self.collided[walkers] = [is_short(moved, self._motion) for moved in after - before]
                self.position[walkers] = after

    def groups(self) -> Iterator[tuple[World, Indices]]:
        """Every scene with the agents in it, ascending."""
        if not self._groups:
            sorted_out: dict[int, list[int]] = {}
            for index, world in enumerate(self.worlds):
                if world is not None:
                    sorted_out.setdefault(id(world), []).append(index)
            self._groups = {key: np.array(indices) for key, indices in sorted_out.items()}
        for indices in self._groups.values():
            world = self.worlds[indices[0]]
            assert world is not None
            yield world, indices

    def state(self, index: int) -> AgentState:
        """Where one agent is."""
        x, y = self.position[index].tolist()
        return AgentState(x, y, float(self.yaw[index]), bool(self.collided[index]), bool(self.called_stop[index]))

    def render(self, among: Indices | None = None, into: AgentView | None = None) -> AgentView:
        """What all agents see, one behind another: rgb is n by height by width by 3, depth and semantic are n by height by width.
        `among`: what these alone see, ascending. `into`: where to put it; new arrays where it is left out."""
        config = self.config
        shown = np.arange(len(self)) if among is None else among
        size, place = (len(shown), config.height, config.width), np.full(len(self), -1)
        place[shown] = np.arange(len(shown))
        sight = into or AgentView(np.empty((*size, 3), np.uint8), np.empty(size, np.float32), np.empty(size, np.int32))
        room = self._room
        for world, group in self.groups():
            mine = group[place[group] >= 0]
            if len(mine):
                poses = cameras_along(self.position[mine], self.direction[mine], config.camera_height_m)
                part = Pictures(room.rgb[: len(mine)], room.depth[: len(mine)], room.part[: len(mine)])
                world.look(poses, config.hfov, sight, place[mine], part)
        return sight
