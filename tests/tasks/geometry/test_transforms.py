"""Conventions there and back: frames, quaternions, cameras."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tasks.geometry import transforms as t
from tasks.geometry.rendering import Camera

angles = st.floats(-np.pi, np.pi)
offsets = st.tuples(*[st.floats(-50, 50)] * 3)


@st.composite
def rigid(draw: st.DrawFn) -> np.ndarray:
    """Any rigid pose."""
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("zyx", [draw(angles) for _ in range(3)]).as_matrix()
    pose[:3, 3] = draw(offsets)
    return pose


@given(rigid())
def test_y_up_and_back_is_exact(pose: np.ndarray) -> None:
    assert np.array_equal(t.to_z_up(t.to_y_up(pose)), pose)
    assert t.is_rigid(t.to_y_up(pose))


@given(offsets)
def test_up_is_up_in_both_frames(point: tuple[float, float, float]) -> None:
    x, y, z = t.transform_points([point], t.Z_UP_TO_Y_UP)[0]
    assert (x, y, z) == (point[0], point[2], -point[1])


@given(rigid())
def test_a_pose_survives_its_quaternion(pose: np.ndarray) -> None:
    wxyz = t.quaternion_wxyz(pose)
    assert np.isclose(np.linalg.norm(wxyz), 1)
    assert np.allclose(t.pose_from_quaternion_wxyz(wxyz, pose[:3, 3]), pose, atol=1e-9)
    assert t.quaternion_xyzw(pose) == (*wxyz[1:], wxyz[0])


@given(rigid(), offsets)
def test_inverse_undoes(pose: np.ndarray, point: tuple[float, float, float]) -> None:
    assert np.allclose(t.transform_points(t.transform_points([point], pose), t.inverse(pose)), [point], atol=1e-9)


@given(angles, offsets)
def test_yaw_is_read_back(yaw: float, offset: tuple[float, float, float]) -> None:
    read = t.yaw_of(t.yaw_pose(yaw, offset))
    assert np.isclose(np.exp(1j * read), np.exp(1j * yaw))


@given(rigid())
def test_rows_hold_a_pose_exactly(pose: np.ndarray) -> None:
    assert np.array_equal(t.matrix(t.flat(pose)), pose)


@given(rigid(), st.floats(0.5, 2.0))
def test_scale_and_mirrors_are_not_rigid(pose: np.ndarray, scale: float) -> None:
    assert t.is_rigid(pose)
    assert not t.is_rigid(pose @ np.diag([-1.0, 1, 1, 1]))
    assert t.is_rigid(pose @ np.diag([scale, 1, 1, 1])) == (abs(scale - 1) < 1e-6)
    assert t.is_rigid(t.nearest_rigid(pose @ np.diag([scale, 1, 1, 1])))
    assert not t.is_rigid(np.where(np.eye(4) > 0, pose, np.nan))


@given(offsets, offsets)
def test_a_camera_sees_its_target_in_the_middle(eye: tuple[float, float, float], target: tuple[float, float, float]) -> None:
    if np.linalg.norm(np.subtract(eye, target)) < 0.1:
        return
    camera = Camera.with_fov(t.look_at(eye, target), 640, 480, 1.0)
    pixel, depth = camera.project(np.array([target]))
    assert np.allclose(pixel, [[319.5, 239.5]], atol=1e-3)
    assert np.isclose(depth[0], np.linalg.norm(np.subtract(eye, target)))
    if abs(camera.pose[2, 2]) < 0.999:  # else it looks straight up or down, where nothing is upright
        above, _ = camera.project(np.add([target], [[0, 0, 0.01]]))
        assert above[0, 1] <= pixel[0, 1] + 1e-3, "up in the world is up in the picture"
