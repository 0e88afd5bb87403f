"""Rectangles of a floor plan that have walls on one side."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tasks.capture.cloud import Cloud
from tasks.capture.rooms.plan import walled


def walled_by_loop(cloud: Cloud, is_wall: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """`walled` by its definition: rectangle by rectangle."""
    is_walled = np.zeros((len(xs) - 1, len(ys) - 1), dtype=np.bool_)

    def length_of(along: np.ndarray) -> float:
        return len(np.unique(np.floor(along / 0.1))) * 0.1

    for axis, across, beside in ((0, xs, ys), (1, ys, xs)):
        upright = is_wall & (np.abs(cloud.normals[:, axis]) > 0.7)
        at, along, normal = cloud.points[upright, axis], cloud.points[upright, 1 - axis], cloud.normals[upright, axis]
        for k, m in itertools.product(range(len(across) - 1), range(len(beside) - 1)):
            is_along = (along > beside[m]) & (along < beside[m + 1])
            near, far = (is_along & (np.abs(at - side) < 0.1) for side in (across[k], across[k + 1]))
            for own, other, facing in ((near, far, normal > 0.0), (far, near, normal < 0.0)):
                has_wall = length_of(along[own & facing]) >= 0.5 * (beside[m + 1] - beside[m])
                is_walled[(k, m) if axis == 0 else (m, k)] |= has_wall and length_of(along[other]) < 0.3
    return is_walled


def scattered(count: int, seed: int) -> tuple[Cloud, np.ndarray]:
    """Points on walls that are a grid of 1 cm, so that some lie on lines, and which of them are wall."""
    random = np.random.default_rng(seed)
    points = np.round(random.uniform(-3.0, 3.0, (count, 3)), 2)
    normals = random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return Cloud(points, normals, np.full(count, 1e-4), np.full(count, -1)), random.random(count) < 0.8


@pytest.mark.parametrize("count", [0, 40, 400, 2000])
@pytest.mark.parametrize("seed", [0, 1])
def test_rectangles_are_walled_as_each_by_itself(count: int, seed: int) -> None:
    cloud, is_wall = scattered(count, seed)
    random = np.random.default_rng(seed + 10)
    xs, ys = (np.sort(np.round(random.uniform(-3.2, 3.2, n), 2)) for n in (12, 9))
    ys[3] = ys[4]
    expected = walled_by_loop(cloud, is_wall, xs, ys)
    assert walled(cloud, is_wall, xs, ys).tolist() == expected.tolist()
    assert count != 400 or 0.0 < expected.mean() < 1.0, "the input tells apart"
