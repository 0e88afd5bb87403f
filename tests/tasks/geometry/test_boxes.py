"""Boxes: overlaps of oriented and of axis-aligned ones against another library and each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.boxes import aabb_overlaps, convex_overlap_area, oriented_iou, oriented_overlap
from tasks.geometry.transforms import matrix, translation, yaw_pose

turns, sides, places = st.floats(-4, 4), st.floats(0.05, 3), st.floats(-1.5, 1.5)
oriented = st.tuples(turns, st.tuples(places, places, places), st.tuples(sides, sides, sides)).map(
    lambda b: (yaw_pose(b[0], b[1]), np.array(b[2]))
)


@given(a=oriented, b=oriented)
@settings(max_examples=150, deadline=None)
def test_oriented_iou_equals_clipping_by_another_library(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> None:
    from shapely import Polygon

    def ring(pose: np.ndarray, size: np.ndarray) -> Polygon:
        half = size[:2] / 2
        return Polygon([(pose @ [sx * half[0], sy * half[1], 0, 1])[:2] for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))])

    (pose_a, size_a), (pose_b, size_b) = a, b
    tops, bottoms = ([p[2, 3] + s * z[2] / 2 for p, z in (a, b)] for s in (1, -1))
    shared = ring(*a).intersection(ring(*b)).area * max(min(tops) - max(bottoms), 0)
    expected = shared / (size_a.prod() + size_b.prod() - shared)
    found = oriented_iou(pose_a, size_a, pose_b, size_b)
    assert found == pytest.approx(expected, abs=1e-9)
    assert found == pytest.approx(oriented_iou(pose_b, size_b, pose_a, size_a), abs=1e-12)
    assert 0.0 <= found <= 1.0
    assert oriented_iou(pose_a, size_a, pose_a, size_a) == pytest.approx(1.0)
    far = translation([300.0, -200.0, 10.0])
    assert oriented_iou(far @ pose_a, size_a, far @ pose_b, size_b) == pytest.approx(found, abs=1e-9)


@given(a=oriented, b=oriented)
@settings(max_examples=50, deadline=None)
def test_boxes_without_turn_have_the_same_overlap_as_axis_aligned_ones(a: Any, b: Any) -> None:
    flat_boxes = [(translation(pose[:3, 3]), size) for pose, size in (a, b)]
    corners = [(pose[:3, 3] - size / 2, pose[:3, 3] + size / 2) for pose, size in flat_boxes]
    low, high = (np.array([c[i] for c in corners]) for i in (0, 1))
    volume = oriented_overlap(*flat_boxes[0], *flat_boxes[1])
    assert aabb_overlaps(low, high)[0, 1] == pytest.approx(volume, abs=1e-9)
    union = sum(size.prod() for _, size in flat_boxes) - volume
    assert oriented_iou(*flat_boxes[0], *flat_boxes[1]) == pytest.approx(volume / union, abs=1e-9)
    depth = max(0.0, min((high[0] - low[1]).min(), (high[1] - low[0]).min()))
    assert (depth > 0) == (volume > 0)
    # moving one box by the penetration along the right axis parts them
    parted = [aabb_overlaps(np.array([low[0], low[1] + s * step]), np.array([high[0], high[1] + s * step]))[0, 1]
              for step in np.eye(3) * (depth + 1e-9) for s in (1, -1)]  # fmt: skip
    assert min(parted) == 0.0


def test_a_leaning_box_is_refused() -> None:
    leaning = matrix([1, 0, 0, 0, 0, 0.8, -0.6, 0, 0, 0.6, 0.8, 0, 0, 0, 0, 1])
    with pytest.raises(ValueError, match="about \\+Z"):
        oriented_iou(leaning, (1, 1, 1), np.eye(4), (1, 1, 1))


def test_a_ring_without_area_shares_none() -> None:
    square = np.array([[0, 0], [2, 0], [2, 2], [0, 2]], dtype=float)
    for flat in (np.ones((4, 2)), np.array([[0, 1], [2, 1], [2, 1], [0, 1]], dtype=float)):
        assert convex_overlap_area(square, flat) == convex_overlap_area(flat, square) == 0.0
    assert convex_overlap_area(square, square + 1) == 1.0
