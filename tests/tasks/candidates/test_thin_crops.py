"""Crops of strips, rods and sheets in any direction: closed solids with thickness, and convex pieces that stand for them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tasks.candidates.closing import MIN_THICKNESS_M, solid_field
from tasks.candidates.scan_crop import closed_crop, pieces_of_crop
from tasks.geometry.meshes import Surface

MIN_MEAN_THICKNESS_M = 0.0015
"""Twice the volume over the surface: a sheet of 5 mm has 2.5 mm at its least width, a rod of 5 mm half of that."""

Array = NDArray[np.float64]


def crop_of_sheet(
    length: float, width: float, bend: float = 0.0, angles: tuple[float, float, float] = (0, 0, 0), noise: float = 0
) -> Surface:
    """A sheet [m] of triangles of 2 cm, bent across by a share of its width, turned by Euler angles [degrees], with noise [m]."""
    rows, columns = (min(max(int(side / 0.02), 1) + 1, 60) for side in (length, width))
    rows += rows * columns < 14  # twelve faces
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, rows), np.linspace(-0.5, 0.5, columns), indexing="ij")
    points = np.stack([length * u, width * v, bend * width * np.sin(3 * u)], axis=-1).reshape(-1, 3)
    points += np.random.default_rng(7).normal(0, noise, points.shape) if noise else 0.0
    points = Rotation.from_euler("xyz", angles, degrees=True).apply(points)
    points -= [*points[:, :2].mean(axis=0), points[:, 2].min()]
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    halves = [[corner, corner + columns, corner + columns + 1], [corner, corner + columns + 1, corner + 1]]
    faces = np.concatenate([np.stack(half, axis=1) for half in halves])
    return Surface(points, faces.astype(np.int64), np.full((len(points), 3), 99, dtype=np.uint8))


def assert_solid(crop: Surface) -> None:
    """Its closed crop and its pieces enclose something everywhere along the crop's box."""
    field = solid_field(crop)
    solid = closed_crop(crop, field)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert np.allclose(solid.bounds, [field.low, field.high], atol=1e-9)
    assert np.ptp(solid.bounds, axis=0).min() >= MIN_THICKNESS_M - 1e-9
    assert 2 * solid.volume / solid.area >= MIN_MEAN_THICKNESS_M
    surface, pieces = pieces_of_crop(crop, field)
    assert surface.volume > 0
    assert min(piece.volume for piece in pieces) > 0
    assert np.allclose(surface.bounds, [field.low, field.high], atol=1e-9)


@pytest.mark.parametrize(
    ("length", "width", "angles"),
    [
        (2.1, 0.02, (0.0, 0.0, 0.0)),  # a ledge that is narrower than a cell
        (1.3, 0.05, (0.0, 90.0, 0.0)),  # a pole on the floor
        (0.56, 0.017, (45.0, 0.0, 180.0)),
        (0.58, 0.114, (90.0, 0.0, 3.0)),  # a strip that stands on its edge
        (2.0, 0.12, (45.0, 45.0, 90.0)),
        (0.76, 0.25, (90.0, 90.0, 45.0)),
        (0.13, 1.47, (45.0, 45.0, 45.0)),
        (0.09, 0.017, (2.0, 88.0, 0.0)),
    ],
)
def test_a_thin_crop_has_thickness(length: float, width: float, angles: tuple[float, float, float]) -> None:
    assert_solid(crop_of_sheet(length, width, angles=angles))


@settings(max_examples=12)
@example(2.0, 0.0625, 0.0, (0.0, 45.0, 0.0), 0.001)  # beads, each at an edge of the next
@given(
    st.floats(0.1, 2.0),
    st.floats(0.006, 0.4),
    st.sampled_from([0.0, 0.1, 0.3]),
    st.tuples(*[st.sampled_from([0.0, 45.0, 90.0, 180.0]) | st.floats(0.0, 180.0)] * 3),
    st.sampled_from([0.0, 0.001, 0.004]),
)
def test_any_thin_crop_has_thickness(length: float, width: float, bend: float, angles: tuple[float, float, float], noise: float) -> None:
    assert_solid(crop_of_sheet(length, width, bend, angles, noise))
