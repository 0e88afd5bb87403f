"""Normals of depth frames, against NumPy's eigenvectors and against planes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.capture.segmentation.organized import _compiled, organized_frame
from tasks.capture.small_objects.lifting import DepthView

LENS = (120.0, 120.0, 49.5, 39.5)


def plane_view(normal: np.ndarray, distance: float, step: float = 0.0) -> DepthView:
    """A frame of the plane normal . p = -distance; its right half is nearer by `step` [m]."""
    rows, columns = np.indices((80, 100))
    rays = np.stack([(columns - LENS[2]) / LENS[0], (rows - LENS[3]) / LENS[1], np.ones(rows.shape)], axis=-1)
    depth = -distance / (rays @ normal)
    depth[:, 50:] -= step
    return DepthView("0", depth.astype(np.float32), np.zeros((80, 100, 3), np.uint8), LENS, np.eye(4))


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=9, max_size=9))
def test_the_least_direction_is_an_eigenvector_of_the_least_eigenvalue(numbers: list[float]) -> None:
    half = np.array(numbers).reshape(3, 3)
    matrix = half @ half.T
    found = np.array(_compiled()["_least_direction"](*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2]))
    values = np.linalg.eigvalsh(matrix)
    if values[1] - values[0] < 1e-3 * max(values[2], 1.0):
        return  # any direction of a plane is as good
    assert np.linalg.norm(found) == pytest.approx(1.0)
    assert np.abs(matrix @ found - values[0] * found).max() < 1e-5 * max(values[2], 1.0)


@settings(max_examples=20, deadline=None)
@given(tilt=st.floats(-0.7, 0.7), turn=st.floats(-3, 3), distance=st.floats(0.5, 2.0))
def test_normals_of_a_plane_are_its_own_and_look_at_the_camera(tilt: float, turn: float, distance: float) -> None:
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    frame = organized_frame(plane_view(normal, distance), 6.0, 0.01, 5.0, 4.0)
    assert frame.has_normal[frame.valid].all()
    assert (frame.normals[frame.valid] @ normal).min() > np.cos(np.deg2rad(0.5))
    assert np.abs(frame.points[frame.valid] @ normal + distance).max() < 1e-5


def test_no_normal_is_made_of_two_surfaces() -> None:
    normal = np.array([0.0, 0.0, -1.0])
    frame = organized_frame(plane_view(normal, 1.0, 0.1), 6.0, 0.01, 5.0, 4.0)
    assert (frame.normals @ normal).min() > 1 - 1e-9


def test_what_is_no_reading_has_neither_point_nor_normal() -> None:
    view = plane_view(np.array([0.0, 0.0, -1.0]), 1.0)
    view.depth[10:20, 10:20] = [[0.0, np.nan, np.inf, -1.0, 7.0] * 2] * 10
    frame = organized_frame(view, 6.0, 0.01, 5.0, 4.0)
    hole = np.zeros(view.depth.shape, dtype=bool)
    hole[10:20, 10:20] = True
    assert (frame.valid == ~hole).all()
    assert not frame.has_normal[hole].any()
