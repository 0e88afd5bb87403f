"""habitat-sim behind the small protocol, where it is installed: it acts in a Habitat dataset that the project exported."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.errors import InputError
from tasks.geometry.transforms import quaternion_xyzw, to_y_up, to_z_up, yaw_of, yaw_pose
from tasks.navigation.detour import from_above, space
from tasks.navigation.habitat import habitat_sim
from tasks.navigation.points import rows
from tasks.simulation.configuration import SimulationConfig
from tasks.simulation.protocol import ACTIONS, NO_OBJECT, AgentState, AgentView, Simulator

if TYPE_CHECKING:
    from schemas.navigation import Episode

STOP, FORWARD, LEFT, RIGHT = range(len(ACTIONS))

_NAMES = {FORWARD: "move_forward", LEFT: "turn_left", RIGHT: "turn_right"}
"""Actions as habitat-sim calls them; a stop is no affair of it."""

_SENSORS = {"rgb": "COLOR", "depth": "DEPTH", "semantic": "SEMANTIC"}


class HabitatSimulator(Simulator):
    """habitat-sim's own motion, collisions, distances and pictures. Its floor lies where its navmesh does, up to a voxel above ours."""

    def __init__(self, dataset: Path, config: SimulationConfig) -> None:
        """
        Args:
            dataset: The `.scene_dataset_config.json` of an exported Habitat dataset.
            config: Camera and robot.

        Raises:
            InputError: habitat-sim is not installed, or there is no such file.
        """
        self._sim_module = habitat_sim("simulator", "act in tasks.simulation.simulator.WorldSimulator, which needs nothing")
        if not dataset.is_file():
            raise InputError(
                str(dataset), "dataset", "there is no such file", "`metascenes export` writes habitat/*.scene_dataset_config.json"
            )
        self._dataset, self._config = dataset, config
        self._scene: str | None = None
        self._sim: Any = None

    def reset(self, episode: Episode) -> AgentState:
        """Put the agent where an episode starts.

        Raises:
            InputError: habitat-sim does not find the scene, or no navmesh of it.
        """
        if episode.scene_id != self._scene:
            self._open(episode.scene_id)
        position = self._sim.pathfinder.snap_point(space(rows(episode.start_position[:2]))[0].astype(np.float32))
        if not np.isfinite(np.asarray(position)).all():
            raise InputError(episode.scene_id, f"episode {episode.episode_id}", "starts off the navmesh", "export the dataset again")
        state = self._sim_module.AgentState()
        state.position, state.rotation = np.asarray(position, dtype=np.float32), np.array(rotation_of(episode.start_yaw_radians))
        self._agent.set_state(state)
        return self._state(False, False)

    def step(self, action: int) -> AgentState:
        """Carry out an action, by its number in `ACTIONS`.

        Raises:
            ValueError: there is no such action.
        """
        if not 0 <= action < len(ACTIONS):
            raise ValueError(f"action: must be 0 to {len(ACTIONS) - 1}, is {action}")
        collided = bool(self._agent.act(_NAMES[action])) if action != STOP else False
        return self._state(collided and action == FORWARD, action == STOP)

    def render(self) -> AgentView:
        """What the agent sees."""
        seen = self._sim.get_sensor_observations()
        semantic = np.asarray(seen["semantic"]).astype(np.int32) - 1  # as `_open` numbered them; 0 is the room
        return AgentView(
            np.ascontiguousarray(seen["rgb"][..., :3]), np.asarray(seen["depth"], dtype=np.float32), np.maximum(semantic, NO_OBJECT)
        )

    def geodesic(self, points: ArrayLike) -> float:
        """Length of habitat-sim's path to the nearest of some points, shape (n, 2) [m]; infinite without a path."""
        path = self._sim_module.MultiGoalShortestPath()
        path.requested_start = self._agent.get_state().position
        path.requested_ends = list(space(rows(points)).astype(np.float32))
        return float(path.geodesic_distance) if self._sim.pathfinder.find_path(path) else math.inf

    def snap(self, point: ArrayLike) -> NDArray[np.float64]:
        """The point of habitat-sim's navmesh nearest to a point, shape (2,)."""
        nearest = self._sim.pathfinder.snap_point(space(rows(point))[0].astype(np.float32))
        return np.asarray(from_above(np.array([nearest], dtype=np.float64))[0])

    def close(self) -> None:
        """Let go of the scene."""
        if self._sim is not None:
            self._sim.close()
        self._sim = self._scene = None

    @property
    def _agent(self) -> Any:
        return self._sim.get_agent(0)

    def _state(self, collided: bool, called_stop: bool) -> AgentState:
        state = self._agent.get_state()
        x, y = from_above(np.array([state.position], dtype=np.float64))[0].tolist()
        turn = state.rotation
        return AgentState(x, y, yaw_from((turn.x, turn.y, turn.z, turn.w)), collided, called_stop)

    def _open(self, scene_id: str) -> None:
        """Load a scene, and number its objects as the lake does, one higher: habitat-sim's own numbers are those of classes."""
        from tasks.exports.habitat import scene_handle

        self.close()
        module, config = self._sim_module, self._config
        backend = module.SimulatorConfiguration()
        backend.scene_dataset_config_file, backend.scene_id = str(self._dataset), scene_handle(scene_id)
        backend.enable_physics, backend.allow_sliding = False, False
        agent = module.AgentConfiguration()
        agent.sensor_specifications = [self._sensor(uuid, kind) for uuid, kind in _SENSORS.items()]
        amounts = {FORWARD: config.forward_m, LEFT: config.turn_degrees, RIGHT: config.turn_degrees}
        agent.action_space = {
            name: module.ActionSpec(name, module.ActuationSpec(amount=amounts[number])) for number, name in _NAMES.items()
        }
        self._sim = module.Simulator(module.Configuration(backend, [agent]))
        if not self._sim.pathfinder.is_loaded:
            self.close()
            raise InputError(
                str(self._dataset), scene_id, "habitat-sim finds no such scene, or no navmesh of it", "export the dataset again"
            )
        self._scene = scene_id
        for item in self._sim.get_rigid_object_manager().get_objects_by_handle_substring("").values():
            instance = item.user_attributes.get("instance_id")
            item.semantic_id = int(instance) + 1 if instance else 0

    def _sensor(self, uuid: str, kind: str) -> Any:
        config = self._config
        sensor = self._sim_module.CameraSensorSpec()
        sensor.uuid, sensor.sensor_type = uuid, getattr(self._sim_module.SensorType, kind)
        sensor.resolution, sensor.position, sensor.hfov = (
            [config.height, config.width],
            [0.0, config.camera_height_m, 0.0],
            config.hfov_degrees,
        )
        return sensor


def rotation_of(yaw: float) -> tuple[float, float, float, float]:
    """Heading about +Z from +X [rad] as habitat-sim's quaternion (x, y, z, w): a turn about +Y from -Z."""
    return quaternion_xyzw(to_y_up(yaw_pose(yaw - 0.5 * math.pi)))


def yaw_from(quaternion: Sequence[float]) -> float:
    """The inverse: heading about +Z from +X [rad], in (-pi, pi], of a quaternion (x, y, z, w)."""
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(np.asarray(quaternion, dtype=np.float64)).as_matrix()
    return yaw_of(to_z_up(pose) @ yaw_pose(0.5 * math.pi))
