"""Descriptors of shape, size and color: what changes them, and what does not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tasks.furniture import generate
from tasks.geometry.meshes import sample_surface, surface_of
from tasks.geometry.transforms import transform_points, yaw_pose
from tasks.library.categories import category_similarity
from tasks.library.descriptors import Descriptor, describe, extents_similarity, shape_similarity, similarity
from tests.tasks.candidates.crops import (
    Array,
)


def chair_points(seed: int, category: str = "chair") -> tuple[Array, NDArray[np.uint8]]:
    parts = generate(category, (0.5, 0.5, 0.95), np.random.default_rng(1)).parts
    points, colors, _ = sample_surface(surface_of(parts), 1500, np.random.default_rng(seed))
    return points, colors


@settings(max_examples=15, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(0.3, 3.0), st.integers(0, 5))
def test_shape_does_not_change_with_yaw_place_and_size(yaw: float, scale: float, seed: int) -> None:
    points, colors = chair_points(seed)
    one = describe(points, colors, np.ptp(points, axis=0), np.random.default_rng(seed))
    moved = transform_points(points * scale, yaw_pose(yaw, (3, -2, 1)))
    other = describe(moved, colors, np.ptp(moved, axis=0), np.random.default_rng(seed))
    assert shape_similarity(one, other) > 0.99
    assert similarity(one.colors, other.colors) == pytest.approx(1)


histograms = st.lists(st.floats(0, 10), min_size=6, max_size=6).filter(lambda v: sum(v) > 0.1).map(lambda v: np.array(v) / sum(v))
sizes = st.tuples(*[st.floats(0.01, 4)] * 3)


@given(histograms, histograms)
def test_similarity_is_a_similarity(one: Array, other: Array) -> None:
    assert 0 <= similarity(one, other) <= 1
    assert similarity(one, other) == pytest.approx(similarity(other, one), abs=1e-7)
    assert similarity(one, one) == pytest.approx(1, abs=1e-6)


@given(sizes, sizes)
def test_extents_similarity_ignores_which_side_is_x(one: tuple[float, ...], other: tuple[float, ...]) -> None:
    value = extents_similarity(one, other)
    assert 0 < value <= 1
    assert value == pytest.approx(extents_similarity(other, one))
    assert value == pytest.approx(extents_similarity((one[1], one[0], one[2]), other))
    assert extents_similarity(one, one) == pytest.approx(1)


def test_shape_tells_a_chair_from_a_cabinet() -> None:
    rng = np.random.default_rng(0)

    def descriptor(category: str, seed: int) -> Descriptor:
        points, colors = chair_points(seed, category=category)
        return describe(points, colors, np.ptp(points, axis=0), rng)

    chair = descriptor("chair", 1)
    assert shape_similarity(chair, descriptor("chair", 2)) > shape_similarity(chair, descriptor("cabinet", 2)) + 0.1


def test_categories_are_compared_as_people_would() -> None:
    order = [
        category_similarity("couch", "sofa"),
        category_similarity("garden chair", "beach chair"),
        category_similarity("chair", "stool"),
        category_similarity("chair", "refrigerator"),
    ]
    assert order[0] == 1
    assert order == sorted(order, reverse=True)
    assert order[-1] == 0
