"""A stand-in for habitat-sim: what the simulator's adapter uses of its documented Python interface, on the project's own path finder.

It takes and gives what the real one does (glTF frame, single precision, quaternions) and refuses names that the real one does not have.
"""

from __future__ import annotations

import dataclasses
import math
from enum import Enum
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from tasks.navigation.planar import PlanarPathFinder

FLOOR = 0.1
"""Height of the navmesh: a voxel's top, as the real one bakes it."""

SensorType = Enum("SensorType", "COLOR DEPTH SEMANTIC")


@dataclasses.dataclass
class Quaternion:
    w: float
    x: float
    y: float
    z: float


class CameraSensorSpec:
    __slots__ = ("hfov", "position", "resolution", "sensor_type", "uuid")


class SimulatorConfiguration:
    __slots__ = ("allow_sliding", "enable_physics", "scene_dataset_config_file", "scene_id")


class AgentConfiguration:
    __slots__ = ("action_space", "sensor_specifications")


@dataclasses.dataclass
class ActuationSpec:
    amount: float


@dataclasses.dataclass
class ActionSpec:
    name: str
    actuation: ActuationSpec


class AgentState:
    __slots__ = ("position", "rotation")


@dataclasses.dataclass
class Configuration:
    sim_cfg: SimulatorConfiguration
    agents: list[AgentConfiguration]


class MultiGoalShortestPath:
    __slots__ = ("geodesic_distance", "requested_ends", "requested_start")


class PathFinder:
    def __init__(self, finder: PlanarPathFinder | None) -> None:
        self.finder = finder

    @property
    def is_loaded(self) -> bool:
        return self.finder is not None

    def snap_point(self, point: np.ndarray) -> np.ndarray:
        x, y = self.finder.snap([[point[0], -point[2]]])[0]
        return np.array([x, FLOOR, -y], dtype=np.float32)

    def find_path(self, path: MultiGoalShortestPath) -> bool:
        ends = self.finder.snap([[end[0], -end[2]] for end in path.requested_ends])
        start = self.finder.snap([[path.requested_start[0], -path.requested_start[2]]])
        path.geodesic_distance = float(self.finder.field(ends).distances(start)[0])
        return math.isfinite(path.geodesic_distance)


class Agent:
    def __init__(self, config: AgentConfiguration, pathfinder: PathFinder) -> None:
        self._config, self._pathfinder = config, pathfinder

    def set_state(self, state: AgentState) -> None:
        assert state.position.dtype == np.float32
        x, y, z, w = np.asarray(state.rotation).tolist()
        assert math.isclose(x * x + y * y + z * z + w * w, 1.0)
        assert (x, z) == (0.0, 0.0)
        self._position, self._psi = state.position, 2 * math.atan2(y, w)

    def get_state(self) -> AgentState:
        state = AgentState()
        state.position, state.rotation = self._position, Quaternion(math.cos(self._psi / 2), 0.0, math.sin(self._psi / 2), 0.0)
        return state

    def act(self, name: str) -> bool:
        amount = self._config.action_space[name].actuation.amount
        if name != "move_forward":
            self._psi += math.radians(amount) * (1 if name == "turn_left" else -1)
            return False
        x, height, z = self._position.tolist()
        start, offset = self._pathfinder.finder.snap([[x, -z]])[0], amount * np.array([-math.sin(self._psi), math.cos(self._psi)])
        end = self._pathfinder.finder.try_step(start, offset)
        self._position = np.array([end[0], height, -end[1]], dtype=np.float32)
        return math.dist(end, start + offset) > 1e-5


class Simulator:
    """Knows the scenes that a test put into `SCENES`, by handle: a path finder and objects. Others load as the real one's do: empty."""

    SCENES: ClassVar[dict[str, tuple[PlanarPathFinder, dict[str, dict[str, Any]]]]] = {}
    opened = 0

    def __init__(self, configuration: Configuration) -> None:
        backend, (agent,) = configuration.sim_cfg, configuration.agents
        assert (backend.enable_physics, backend.allow_sliding) == (False, False)
        finder, objects = self.SCENES.get(backend.scene_id, (None, {}))
        self.pathfinder, self._agent = PathFinder(finder), None
        self._agent, self._sensors = Agent(agent, self.pathfinder), agent.sensor_specifications
        self._objects = {
            name: SimpleNamespace(user_attributes=known, semantic_id=known.get("nyu40_id", 0)) for name, known in objects.items()
        }
        type(self).opened += 1

    def get_agent(self, number: int) -> Agent:
        assert number == 0
        return self._agent

    def get_rigid_object_manager(self) -> SimpleNamespace:
        return SimpleNamespace(get_objects_by_handle_substring=lambda part: {n: o for n, o in self._objects.items() if part in n})

    def get_sensor_observations(self) -> dict[str, np.ndarray]:
        """Every object fills columns of its own; the last is the room's."""
        seen = {}
        for sensor in self._sensors:
            height, width = sensor.resolution
            if sensor.sensor_type is SensorType.COLOR:
                seen[sensor.uuid] = np.full((height, width, 4), 200, dtype=np.uint8)
            elif sensor.sensor_type is SensorType.DEPTH:
                seen[sensor.uuid] = np.full((height, width), 2.0, dtype=np.float32)
            else:
                columns = [thing.semantic_id for thing in self._objects.values()]
                seen[sensor.uuid] = np.array([([*columns, *[0] * width])[:width]] * height, dtype=np.uint32)
        return seen

    def close(self) -> None:
        type(self).opened -= 1
