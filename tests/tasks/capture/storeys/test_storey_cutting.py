"""Triangles cut at heights: nothing is lost, nothing is added, and what was whole can be put together again."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.storeys.cutting import strips
from tasks.geometry.triangles import enclosed_volume, face_crosses, is_closed, surface_area

cuts = st.lists(st.sampled_from([-0.8, -0.5, -0.25, 0.0, 0.1, 0.5, 0.9]), max_size=4, unique=True).map(sorted)


@given(seed=st.integers(0, 10**6), at=cuts, on_grid=st.booleans())
def test_every_strip_has_its_own_heights_and_together_they_have_each_faces_area(seed: int, at: list[float], on_grid: bool) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.uniform(-1, 1, (30, 3))
    if on_grid:  # corners and edges in the planes of cuts
        vertices = np.round(vertices * 4) / 4
    faces = rng.integers(0, 30, (60, 3))
    cut = strips(vertices[:, 2], faces, at)
    points = cut.extended(vertices)
    bounds = [-np.inf, *at, np.inf]
    total = np.zeros((60, 3))
    for low, high, own, origins in zip(bounds[:-1], bounds[1:], cut.faces, cut.origins, strict=True):
        assert ((points[own][:, :, 2] >= low - 1e-12) & (points[own][:, :, 2] <= high + 1e-12)).all()
        np.add.at(total, origins, face_crosses(points, own))
    assert total == pytest.approx(face_crosses(vertices, faces), abs=1e-9)  # the area, and which way it looks
    assert sum(surface_area(points, own) for own in cut.faces) == pytest.approx(surface_area(vertices, faces), rel=1e-9)


@given(at=cuts, turn=st.floats(0, 3))
def test_strips_of_a_closed_mesh_are_closed_together_since_both_sides_share_their_new_vertices(at: list[float], turn: float) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, [1, 2, 0]))
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    cut = strips(vertices[:, 2], faces, at)
    together = np.concatenate(cut.faces)
    points = cut.extended(vertices)
    areas = np.linalg.norm(face_crosses(points, together), axis=1)
    assert areas.sum() / 2 == pytest.approx(mesh.area, rel=1e-9)
    assert is_closed(together)
    assert enclosed_volume(points, together) == pytest.approx(enclosed_volume(vertices, faces), rel=1e-9)


@given(seed=st.integers(0, 10**6), at=cuts)
def test_columns_that_are_linear_in_space_stay_so(seed: int, at: list[float]) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = rng.uniform(-1, 1, (20, 3)), rng.integers(0, 20, (30, 3))
    slope = rng.normal(size=(3, 2))
    cut = strips(vertices[:, 2], faces, at)
    assert cut.extended(vertices @ slope) == pytest.approx(cut.extended(vertices) @ slope, abs=1e-9)
    colors = np.round(127 + 120 * vertices).astype(np.uint8)
    off = cut.extended(colors).astype(float) - (127 + 120 * cut.extended(vertices))
    assert cut.extended(colors).dtype == np.uint8
    assert np.abs(off).max() <= 0.5 + len(at) / 2 + 0.5


def test_new_vertices_are_of_whom_both_ends_of_their_edge_are() -> None:
    height, faces = np.array([0.0, 0.0, 2.0, 2.0]), np.array([[0, 1, 2], [1, 3, 2]])
    cut = strips(height, faces, [1.0])
    owner = cut.extended_owner(np.array([5, 7, 5, 7]))
    ends = cut.crossings[0].ends.tolist()
    assert dict(zip(map(tuple, ends), owner[4:].tolist(), strict=True)) == {(0, 2): 5, (1, 2): -1, (1, 3): 7}


def test_what_lies_in_the_plane_of_a_cut_is_the_ceiling_of_what_is_below() -> None:
    cut = strips(np.array([1.0, 1.0, 1.0, 3.0]), np.array([[0, 1, 2], [0, 1, 3]]), [1.0])
    assert [own.tolist() for own in cut.origins] == [[0], [1]]
