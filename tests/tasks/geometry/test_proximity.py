"""Closest points against an independent implementation that looks at every triangle."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.proximity import closest_points
from tests.conftest import REPOSITORY
from tests.tasks.geometry.slivers import slivers


def brute(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of every point to every triangle, the least of them, by trimesh."""
    triangles = vertices[faces]
    least = np.full(len(points), np.inf)
    for triangle in triangles:
        near = trimesh.triangles.closest_point(np.repeat(triangle[None], len(points), axis=0), points)
        least = np.minimum(least, np.linalg.norm(near - points, axis=1))
    return least


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 60),
    flatness=st.sampled_from([1.0, 1e-3, 0.0]),
    offset=st.sampled_from([0.0, 50.0]),
    size=st.sampled_from([1.0, 0.05]),
)
def test_closest_points_are_those_of_brute_force(seed: int, count: int, flatness: float, offset: float, size: float) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    vertices = (corners.reshape(-1, 3) * [1, 1, flatness]) + offset
    faces = np.arange(3 * count).reshape(-1, 3)
    points = rng.uniform(-2, 2, (40, 3)) + offset
    found = closest_points(vertices, faces, points)
    assert found.distance == pytest.approx(brute(vertices, faces, points), abs=1e-9)
    assert found.distance == pytest.approx(np.linalg.norm(found.point - points, axis=1), abs=1e-9)
    # the point is on the face that is named
    a, b, c = (vertices[faces[found.face]][:, i] for i in range(3))
    on = brute_pairs(a, b, c, found.point)
    assert np.abs(on).max() < 1e-7


def brute_pairs(a: np.ndarray, b: np.ndarray, c: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(trimesh.triangles.closest_point(np.stack([a, b, c], axis=1), points) - points, axis=1)


def test_triangles_without_area_are_the_segment_or_point_that_they_shrank_to() -> None:
    vertices = np.array([[0, 0, 0], [2, 0, 0], [1, 0, 0], [5, 5, 5]], dtype=float)
    found = closest_points(vertices, [[0, 1, 2], [0, 2, 1], [3, 3, 3]], [[0.5, 3, 0], [-3, 0, 4], [5, 5, 7], [1, 0, 0]])
    assert found.distance == pytest.approx([3, 5, 2, 0])
    assert found.point == pytest.approx(np.array([[0.5, 0, 0], [0, 0, 0], [5, 5, 5], [1, 0, 0]]))


def test_the_answer_does_not_depend_on_the_order_of_the_questions() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    rng = np.random.default_rng(0)
    # straight above vertices several triangles are equally near
    points = np.concatenate([rng.normal(size=(300, 3)), 1.5 * mesh.vertices[:200]])
    turn = rng.permutation(len(points))
    whole, turned = closest_points(mesh.vertices, mesh.faces, points), closest_points(mesh.vertices, mesh.faces, points[turn])
    assert np.array_equal(whole.distance[turn], turned.distance)
    assert np.array_equal(whole.face[turn], turned.face)
    assert np.array_equal(whole.point[turn], turned.point)


def test_many_equal_triangles_make_a_tree_too() -> None:
    found = closest_points(np.eye(3), np.tile([[0, 1, 2]], (5000, 1)), np.zeros((3, 3)))
    assert found.distance == pytest.approx(3**-0.5)
    assert (found.face == found.face[0]).all(), "the same question, another face"
    assert closest_points(np.eye(3), [[0, 1, 2]], np.zeros((0, 3))).distance.shape == (0,)


@pytest.mark.parametrize("height", [0.0, 1e-17, 1e-16, 1e-15, 1e-14, 1e-13, 1e-9, 1e-6])
@pytest.mark.parametrize("turn", [0, 1, 2])
def test_slivers_are_as_far_as_the_segment_that_they_all_but_are(height: float, turn: int) -> None:
    for corner, point, distance in zip(*slivers(height, turn), strict=True):
        nearest = closest_points(corner, [[0, 1, 2]], point[None])
        assert nearest.distance[0] == pytest.approx(distance, abs=5 * height + 1e-11)


THREADS = """
import hashlib, sys
import numpy as np
from tasks.geometry.proximity import closest_points
rng = np.random.default_rng(0)
corners = rng.uniform(-1, 1, (20_000, 1, 3)) + 0.05 * rng.normal(size=(20_000, 3, 3))
nearest = closest_points(corners.reshape(-1, 3), np.arange(60_000).reshape(-1, 3), np.round(rng.normal(size=(30_000, 3)), 1))
print(hashlib.sha256(nearest.distance.tobytes() + nearest.face.tobytes() + nearest.point.tobytes()).hexdigest())
"""


@pytest.mark.whole
def test_threads_do_not_change_a_byte() -> None:
    digests = [
        subprocess.run(
            [sys.executable, "-c", THREADS],
            env={**os.environ, "IGL_NUM_THREADS": count},
            cwd=REPOSITORY,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for count in ("1", "4", "4")
    ]
    assert len(digests[0]) == 65
    assert set(digests) == {digests[0]}


@pytest.mark.parametrize(
    ("vertices", "faces", "points", "words"),
    [
        (np.eye(3), np.zeros((0, 3)), np.zeros((1, 3)), "no triangle"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], np.zeros((1, 3)), "not finite"),
        (np.eye(3), [[0, 1, 2]], [[np.inf, 0, 0]], "not finite"),
    ],
)
def test_what_has_no_answer_is_refused(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        closest_points(vertices, faces, points)
