"""Equal models are told from others, whatever order, place, unit and turn their vertices have."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tasks.furniture import generate
from tasks.geometry.meshes import surface_of
from tasks.geometry.transforms import transform_points, yaw_pose
from tasks.library.duplicates import NEAR, is_same, signature_of

CATEGORIES = ("chair", "vase", "mug", "desk lamp", "table")


@cache
def vertices(category: str, seed: int = 0) -> NDArray[np.float64]:
    return surface_of(generate(category, None, np.random.default_rng(seed)).parts).vertices


@pytest.mark.parametrize("category", CATEGORIES)
@settings(max_examples=8, deadline=None)
@given(st.floats(-3.14, 3.14), st.sampled_from([1.0, 0.01, 100.0, 39.37]), st.integers(0, 99))
def test_the_same_vertices_are_the_same(category: str, yaw: float, scale: float, seed: int) -> None:
    points = vertices(category)
    order = np.random.default_rng(seed).permutation(len(points))
    moved = transform_points(points[order], yaw_pose(yaw, (3.0, -1.0, 0.5))) * scale
    kept = moved.astype(np.float32).astype(np.float64)
    assert np.abs(signature_of(points) - signature_of(kept)).max() < NEAR
    assert is_same(points, kept)
    assert is_same(kept, points)


@pytest.mark.parametrize("category", CATEGORIES)
@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2), st.integers(0, 10**6))
def test_other_vertices_are_not(category: str, axis: int, seed: int) -> None:
    points = vertices(category)
    number = seed % len(points)
    moved = points.copy()
    moved[np.all(np.isclose(points, points[number]), axis=1), axis] += 0.02 * np.ptp(points, axis=0).max()
    assert not is_same(points, moved)
    stretched = points * np.where(np.arange(3) == axis, 1.01, 1.0)
    assert not is_same(points, stretched)


@pytest.mark.parametrize("category", ["chair", "desk lamp"])
def test_upside_down_and_mirrored_models_are_others(category: str) -> None:
    points = vertices(category)
    assert not is_same(points, points * [1, -1, -1])
    skewed = points + [0.3, 0.2, 0.0] * points[:, 2:] ** 2  # like none of its mirror images
    skewed[:, 1] += 0.1 * skewed[:, 0] ** 2
    assert not is_same(skewed, skewed * [1, -1, 1])


def test_two_of_a_category_are_not_the_same() -> None:
    assert not is_same(vertices("chair", 0), vertices("chair", 1))
    assert np.abs(signature_of(vertices("chair", 0)) - signature_of(vertices("chair", 1))).max() > NEAR


def test_a_line_is_itself() -> None:
    line = np.array([[0, 0, z] for z in (0.0, 1.0, 3.0)])
    assert is_same(line, line * 5 + 1)
    assert not is_same(line, line * [1, 1, -1])
