"""Every convention of frames, rotations and cameras, converted here and nowhere else.

World frame: right-handed, +Z up, metres. glTF, Habitat: +Y up, -Z forward. OpenCV cameras: x right, y down,
z forward; OpenGL cameras: x right, y up, z backward. A pose is a rigid 4x4 object-to-world matrix.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

Z_UP_TO_Y_UP: Array = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=np.float64)
"""(x, y, z) with +Z up to (x, z, -y) with +Y up: the world frame to glTF and Habitat."""

Y_UP_TO_Z_UP: Array = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=np.float64)
"""The inverse: glTF and Habitat to the world frame."""

OPENGL_TO_OPENCV: Array = np.diag([1.0, -1.0, -1.0, 1.0])
"""Camera axes of OpenGL (y up, z backward) to OpenCV (y down, z forward); its own inverse."""

MIRRORED_Y: Array = np.diag([1.0, -1.0, 1.0, 1.0])
"""Left-handed axes (Unity: x right, y up, z forward) to right-handed ones of an OpenCV camera; its own inverse."""


def matrix(values: Sequence[float]) -> Array:
    """A 4x4 matrix from 16 numbers, row by row, as rows of the lake hold it."""
    return np.array(values, dtype=np.float64).reshape(4, 4)


def flat(pose: ArrayLike) -> tuple[float, ...]:
    """16 numbers of a 4x4 matrix, row by row; negative zeros become zeros."""
    return tuple(float(v) + 0.0 for v in np.asarray(pose, dtype=np.float64).reshape(16))


def translation(offset: ArrayLike) -> Array:
    """Pose that moves by `offset` [m], shape (3,)."""
    pose = np.eye(4)
    pose[:3, 3] = offset
    return pose


def yaw_pose(yaw: float, offset: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Pose that turns by `yaw` about +Z [rad], then moves by `offset` [m], shape (3,)."""
    c, s = float(np.cos(yaw)), float(np.sin(yaw))
    pose = np.eye(4)
    pose[:2, :2] = [[c, -s], [s, c]]
    pose[:3, 3] = offset
    return pose


def yaw_of(pose: ArrayLike) -> float:
    """Turn about +Z of a pose's x axis [rad], in (-pi, pi]."""
    m = np.asarray(pose, dtype=np.float64)
    return float(np.arctan2(m[1, 0], m[0, 0]))


def transform_points(points: ArrayLike, pose: ArrayLike) -> Array:
    """Points through a 4x4 matrix. Shapes (n, 3) and (4, 4) to (n, 3)."""
    m = np.asarray(pose, dtype=np.float64)
    return np.asarray(points, dtype=np.float64) @ m[:3, :3].T + m[:3, 3]


def inverse(pose: ArrayLike) -> Array:
    """Inverse of a rigid pose."""
    m = np.asarray(pose, dtype=np.float64)
    result = np.eye(4)
    result[:3, :3] = m[:3, :3].T
    result[:3, 3] = -m[:3, :3].T @ m[:3, 3]
    return result


def is_rigid(pose: ArrayLike, tolerance: float = 1e-6) -> bool:
    """Whether a 4x4 matrix is finite, a proper rotation (no mirror, no scale) and a translation."""
    m = np.asarray(pose, dtype=np.float64)
    if m.shape != (4, 4) or not np.isfinite(m).all():
        return False
    rotation = m[:3, :3]
    return bool(
        np.allclose(rotation @ rotation.T, np.eye(3), atol=tolerance)
        and np.linalg.det(rotation) > 0
        and np.allclose(m[3], [0, 0, 0, 1], atol=tolerance)
    )


def nearest_rigid(pose: ArrayLike) -> Array:
    """The rigid pose nearest to a 4x4 matrix whose rotation has drifted (orthogonal Procrustes)."""
    m = np.array(pose, dtype=np.float64)
    u, _, vt = np.linalg.svd(m[:3, :3])
    m[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    m[3] = [0, 0, 0, 1]
    return m


def to_y_up(pose: ArrayLike) -> Array:
    """A pose of the world frame as glTF and Habitat have it: conjugated, for objects that are +Y up there."""
    return Z_UP_TO_Y_UP @ np.asarray(pose, dtype=np.float64) @ Y_UP_TO_Z_UP


def to_z_up(pose: ArrayLike) -> Array:
    """A pose of glTF or Habitat in the world frame; inverse of `to_y_up`."""
    return Y_UP_TO_Z_UP @ np.asarray(pose, dtype=np.float64) @ Z_UP_TO_Y_UP


def quaternion_wxyz(pose: ArrayLike) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z), w >= 0, of a pose: USD and Habitat scene instances."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(np.asarray(pose, dtype=np.float64)[:3, :3]).as_quat(canonical=True)
    return float(w), float(x), float(y), float(z)


def quaternion_xyzw(pose: ArrayLike) -> tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w), w >= 0, of a pose: Habitat episodes."""
    w, x, y, z = quaternion_wxyz(pose)
    return x, y, z, w


def pose_from_quaternion_wxyz(quaternion: Sequence[float], offset: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Pose from a quaternion (w, x, y, z) and a translation [m]; inverse of `quaternion_wxyz`."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = quaternion
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    pose[:3, 3] = offset
    return pose


def look_at(eye: ArrayLike, target: ArrayLike) -> Array:
    """Camera-to-world pose of an OpenCV camera at `eye` that looks at `target`, upright. Both [m], shape (3,)."""
    eye_, forward = np.asarray(eye, dtype=np.float64), np.asarray(target, dtype=np.float64) - np.asarray(eye, dtype=np.float64)
    forward = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, eye_
    return pose


def rotation_of(turn: ArrayLike) -> Array:
    """Rotation, shape (3, 3), of a rotation vector [rad] (Rodrigues)."""
    x, y, z = (float(v) for v in np.asarray(turn, dtype=np.float64))
    angle = np.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return np.eye(3)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / angle
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))


def rotation_vector(rotation: Array) -> tuple[float, float, float]:
    """Rotation vector [rad] of a rotation by less than half a turn, shape (3, 3)."""
    axis = 0.5 * np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return 0.0, 0.0, 0.0
    x, y, z = axis / sine * np.arctan2(sine, 0.5 * (float(np.trace(rotation)) - 1.0))
    return float(x), float(y), float(z)
