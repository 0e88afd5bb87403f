"""Areas, volumes and normals against what trimesh and geometry say."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.triangles import (
    MOST_FACES,
    corner_normals,
    crosses,
    distinct_rows,
    enclosed_volume,
    face_areas,
    face_normals,
    face_planes,
    is_closed,
    spread,
    surface_area,
    vertex_normals,
    welded,
)


def solid(seed: int) -> trimesh.Trimesh:
    points = np.random.default_rng(seed).normal(size=(40, 3)) * [1.0, 2.0, 0.3]
    return trimesh.convex.convex_hull(points)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_areas_volumes_normals_and_planes_of_a_solid(seed: int) -> None:
    mesh = solid(seed)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    assert face_areas(vertices, faces) == pytest.approx(mesh.area_faces, rel=1e-12)
    assert surface_area(vertices, faces) == pytest.approx(mesh.area, rel=1e-12)
    assert enclosed_volume(vertices, faces) == pytest.approx(mesh.volume, rel=1e-10)
    assert enclosed_volume(vertices, faces[:, ::-1]) == pytest.approx(-mesh.volume, rel=1e-10)
    assert face_normals(vertices, faces) == pytest.approx(mesh.face_normals, abs=1e-9)
    normals, offsets = face_planes(vertices, faces)
    assert (vertices @ normals.T <= offsets + 1e-9).all()
    # the mean of the crossing faces, weighted by their areas, written out
    expected = np.zeros_like(vertices)
    for corner in faces.T:
        np.add.at(expected, corner, mesh.area_faces[:, None] * mesh.face_normals)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert vertex_normals(vertices, faces) == pytest.approx(expected, abs=1e-9)


def test_what_has_no_area_has_a_normal_all_the_same() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [9, 9, 9]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 1, 1], [0, 1, 3]])
    assert (face_normals(vertices, faces) == [0, 0, 1]).all()
    assert np.isfinite(corner_normals(vertices, faces, 0.6)).all()
    normals = vertex_normals(vertices, faces)
    assert (normals[[0, 1, 3]] == [0, 0, 1]).all()
    assert (normals[[2, 4]] == 0).all()
    assert len(face_planes(vertices, faces)[0]) == 1


def test_corners_are_smooth_across_split_vertices_and_flat_in_a_crowd() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    loose = np.array(ball.vertices)[ball.faces].reshape(-1, 3)
    faces = np.arange(len(loose)).reshape(-1, 3)
    whole = corner_normals(np.array(ball.vertices), np.array(ball.faces), 0.6)
    assert corner_normals(loose, faces, 0.6) == pytest.approx(whole, abs=1e-12)
    for sections, smooth in ((MOST_FACES, True), (MOST_FACES + 1, False)):
        turn = 2 * np.pi * np.arange(sections) / sections
        fan = np.concatenate([[[0, 0, 1]], np.stack([np.cos(turn), np.sin(turn), np.zeros(sections)], axis=1)])
        ring = 1 + np.arange(sections)
        sides = np.stack([np.zeros(sections, dtype=np.int64), ring, np.roll(ring, -1)], axis=1)
        apex = corner_normals(fan, sides, 3.0)[:, 0]
        expected = np.tile([0.0, 0.0, 1.0], (sections, 1)) if smooth else face_normals(fan, sides)
        assert apex == pytest.approx(expected, abs=1e-9)


def test_places_are_spread_by_area() -> None:
    mesh = solid(3)
    face, weights = spread(np.array(mesh.vertices), np.array(mesh.faces), 20_000, np.random.default_rng(0))
    assert (np.diff(face) >= 0).all()
    assert weights.min() >= 0
    assert weights.sum(axis=1) == pytest.approx(1.0)
    # one place in each of the equal strips of area
    assert np.abs(np.bincount(face, minlength=len(mesh.faces)) - 20_000 * mesh.area_faces / mesh.area).max() <= 2
    flat, _ = spread(np.zeros((3, 3)), np.array([[0, 1, 2], [0, 2, 1]]), 10, np.random.default_rng(0))
    assert np.bincount(flat).tolist() == [5, 5]


def test_welding_names_the_first_vertex_at_a_place() -> None:
    vertices = np.array([[1, 0, 0], [0, 0, 0], [1, 1e-8, 0], [1e-3, 0, 0]])
    first, place = welded(vertices)
    assert np.abs(vertices[first][place] - vertices).max() <= 1e-8
    assert place[0] == place[2]
    assert len(first) == 3
    assert 2 not in first


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40), decimals=st.integers(0, 1))
def test_products_and_distinct_rows_are_numpys(seed: int, count: int, decimals: int) -> None:
    rng = np.random.default_rng(seed)
    first, other = rng.normal(size=(2, count, 3))
    assert np.array_equal(crosses(first, other), np.cross(first, other))
    whole = np.round(other).astype(np.int64)
    for rows in (np.round(first, decimals), whole, whole * 2**40, (whole + 9).astype(np.uint8), whole[:0]):
        kept, place = distinct_rows(rows)
        _, expected, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        assert np.array_equal(kept, expected)
        assert np.array_equal(place, inverse.reshape(-1))


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), lost=st.integers(0, 2), twice=st.integers(0, 2))
def test_a_surface_is_closed_where_trimesh_calls_it_watertight(seed: int, lost: int, twice: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = solid(seed % 5)
    faces = np.array(mesh.faces)[lost:]
    faces = rng.permutation(np.concatenate([faces, faces[:twice], faces[:twice]]))
    assert is_closed(faces) == trimesh.Trimesh(mesh.vertices, faces, process=False).is_watertight
    assert not is_closed(np.zeros((0, 3)))
