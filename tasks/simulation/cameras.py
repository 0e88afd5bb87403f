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
    cosine, sine, level, steep = np.cos(yaw), np.sin(yaw), math.cos(pitch), math.sin(pitch)
    made = np.zeros((len(x), 4, 4))
    made[:, :3, 0] = np.stack([sine, -cosine, np.zeros_like(x)], axis=1)
    made[:, :3, 1] = np.stack([cosine * steep, sine * steep, np.full_like(x, -level)], axis=1)
    made[:, :3, 2] = np.stack([cosine * level, sine * level, np.full_like(x, steep)], axis=1)
    made[:, :3, 3] = np.stack([x, y, np.full_like(x, height)], axis=1)
    made[:, 3, 3] = 1.0
    return made
