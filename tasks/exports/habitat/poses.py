"""Positions and headings in the frame of Habitat, rounded to a nanometre: the same text wherever they are made."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.transforms import Z_UP_TO_Y_UP, to_y_up, transform_points, yaw_pose


def numbers(values: ArrayLike) -> list[float]:
    """Numbers as JSON has them, rounded to a nanometre; no negative zeros."""
    return [round(float(value), 9) + 0.0 for value in np.asarray(values).reshape(-1)]


def unit(quaternion: Sequence[float]) -> NDArray[np.float64]:
    """A quaternion of length 1: habitat-sim does not check it."""
    values = np.asarray(quaternion, dtype=np.float64)
    return np.asarray(values / np.linalg.norm(values))


def position(point: ArrayLike) -> list[float]:
    """A position of the world frame, shape (3,), in Habitat's frame."""
    return numbers(transform_points(np.asarray(point, dtype=np.float64)[None], Z_UP_TO_Y_UP)[0])


def rotation(yaw: float) -> list[float]:
    """Heading about +Z from +X [rad] as an episode's quaternion (x, y, z, w): a turn about +Y from -Z."""
    return rotations([yaw])[0]


def rotations(yaws: Sequence[float]) -> list[list[float]]:
    """Many headings at once, as `rotation` has each."""
    from scipy.spatial.transform import Rotation

    if not len(yaws):
        return []
    turns = np.array([to_y_up(yaw_pose(yaw - 0.5 * math.pi))[:3, :3] for yaw in yaws])
    return [numbers(unit(values)) for values in Rotation.from_matrix(turns).as_quat(canonical=True)]


def positions(points: ArrayLike) -> list[list[float]]:
    """Many positions at once, shape (n, 3), as `position` has each."""
    places = transform_points(np.asarray(points, dtype=np.float64).reshape(-1, 3), Z_UP_TO_Y_UP)
    return [[round(value, 9) + 0.0 for value in place] for place in places.tolist()]
