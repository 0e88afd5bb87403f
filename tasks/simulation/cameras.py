"""Where the cameras of agents are and look."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def camera_poses(poses: ArrayLike, height: float, pitch: float = 0.0) -> Array:
    """Camera-to-world matrices of agents, OpenCV's convention (+X right, +Y down, +Z ahead), shape (n, 4, 4).

    Args:
        poses: x, y [m] and yaw [rad], world frame, shape (n, 3).
        height: Of the camera above the floor [m].
        pitch: Of its axis, up is above 0 [rad].
    """
    x, y, yaw = np.asarray(poses, dtype=np.float64).reshape(-1, 3).T
    return cameras_along(np.column_stack([x, y]), np.column_stack([np.cos(yaw), np.sin(yaw)]), height, pitch)


def cameras_along(positions: Array, directions: Array, height: float, pitch: float = 0.0) -> Array:
    """The same of agents that head along unit vectors, shape (n, 2), from points of the floor, shape (n, 2) [m], world frame."""
    level, steep = math.cos(pitch), math.sin(pitch)
    made = np.zeros((len(positions), 4, 4))
    made[:, 0, 0], made[:, 1, 0] = directions[:, 1], -directions[:, 0]  # to the right
    made[:, :2, 1], made[:, 2, 1] = directions * steep, -level  # down
    made[:, :2, 2], made[:, 2, 2] = directions * level, steep  # ahead
    made[:, :2, 3], made[:, 2, 3], made[:, 3, 3] = positions, height, 1.0
    return made
