"""What an agent's camera saw along its way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tasks.simulation.cameras import camera_poses
from tasks.simulation.protocol import AgentView

if TYPE_CHECKING:
    from tasks.policy.model.config import AgentCamera
    from tasks.simulation.world import World

AT_ONCE = 32
"""Pictures that are drawn together: some megabytes, whatever the length of the way."""


def first_person(world: World, poses: ArrayLike, camera: AgentCamera) -> Iterator[AgentView]:
    """What the camera sees from every pose, x, y [m] and yaw [rad] in the world frame, shape (n, 3): the simulator's observations."""
    from tasks.simulation.rasterizer import Pictures

    ways = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    for first in range(0, len(ways), AT_ONCE):
        some = ways[first : first + AT_ONCE]
        size = (len(some), camera.height, camera.width)
        seen = AgentView(np.empty((*size, 3), np.uint8), np.empty(size, np.float32), np.empty(size, np.int32))
        cameras = camera_poses(some, camera.height_m, math.radians(camera.pitch_degrees))
        world.look(cameras, camera.hfov_radians, seen, np.arange(len(some)), Pictures.empty(len(some), camera.width, camera.height))
        for index in range(len(some)):
            yield AgentView(seen.rgb[index], seen.depth[index], seen.semantic[index])
