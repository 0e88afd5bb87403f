"""Upright boxes of placed assets: what micro-scenes are made of."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.transforms import inverse, yaw_pose

Array = NDArray[np.float64]

LEVEL = 0.5
"""Length in plan of a unit axis below which it says nothing of the yaw: it points up or down more than ahead."""


@dataclasses.dataclass(frozen=True)
class StandingBox:
    """The upright box of a placed asset.

    name: Its instance. pose: To the world frame, turned about +Z alone, origin at the middle of the bottom, 4x4 [m]. size: Extents along
    its own axes [m], shape (3,). up: Direction of the asset's upright axis in the world frame, unit, shape (3,).
    """

    name: str
    pose: Array
    size: Array
    up: Array

    @property
    def bottom(self) -> float:
        """Height of its bottom [m]."""
        return float(self.pose[2, 3])

    @property
    def top(self) -> float:
        """Height of its top [m]."""
        return self.bottom + float(self.size[2])

    @property
    def center(self) -> Array:
        """Its middle in the world frame [m], shape (3,)."""
        return np.array([self.pose[0, 3], self.pose[1, 3], self.bottom + 0.5 * float(self.size[2])])

    @property
    def yaw(self) -> float:
        """Turn of its front about +Z [rad], in (-pi, pi]."""
        return math.atan2(float(self.pose[1, 0]), float(self.pose[0, 0]))

    @property
    def tilt(self) -> float:
        """Angle between the asset's upright axis and +Z [rad], 0 to pi."""
        return math.atan2(float(np.hypot(self.up[0], self.up[1])), float(self.up[2]))

    def within(self, frame: StandingBox) -> tuple[Array, float]:
        """Its middle [m], shape (3,), in the frame of another box, and the turn of its front from that one's [rad], in (-pi, pi]."""
        back = inverse(frame.pose)
        turn = self.yaw - frame.yaw
        return back[:3, :3] @ self.center + back[:3, 3], math.atan2(math.sin(turn), math.cos(turn))


def standing_box(name: str, extents: Sequence[float], scale: Sequence[float], pose: ArrayLike) -> StandingBox:
    """The upright box of an asset: extents of its canonical box [m], shape (3,), scale, shape (3,), and pose to the world frame, 4x4.

    An upright asset's box is its own. Of one that is tilted it is the least upright one around its own, turned as the asset is: by its
    front, or by its side where the front points up or down.
    """
    m = np.asarray(pose, dtype=np.float64)
    rotation = m[:3, :3]
    own = np.asarray(extents, dtype=np.float64) * np.asarray(scale, dtype=np.float64)
    if math.hypot(rotation[0, 0], rotation[1, 0]) >= LEVEL:
        yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    else:  # then the side is level: two axes cannot both stand up
        yaw = math.atan2(-rotation[0, 1], rotation[1, 1])
    turn = yaw_pose(yaw)
    relative = turn[:3, :3].T @ rotation
    relative[np.abs(relative) < 1e-12] = 0.0
    size = np.abs(relative) @ own
    middle = m[:3, 3] + rotation @ np.array([0.0, 0.0, 0.5 * own[2]])
    return StandingBox(name, yaw_pose(yaw, middle - np.array([0.0, 0.0, 0.5 * size[2]])), size, rotation[:, 2].copy())
