"""What is seen of an asset as arrays: no vertex twice, manifold, the same triangles."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tasks.exports.bodies import Shape
from tasks.exports.visuals import Visual, visuals_of
from tasks.geometry.meshes import dump_glb
from tests.replicas import cube, replica_of, rows_of

cells = st.sets(st.tuples(*[st.integers(0, 2)] * 3), min_size=1, max_size=8)


@pytest.fixture(scope="module")
def shape() -> Shape:
    return replica_of(*rows_of([cube((1, 1, 1), np.eye(4))])).bodies[0].shape


def seen(shape: Shape, mesh: trimesh.Trimesh) -> Visual:
    """What is seen of a shape that is this mesh."""
    (visual,) = visuals_of(dataclasses.replace(shape, glb=dump_glb([mesh]), parts=[mesh]))
    return visual


def triangles(vertices: np.ndarray, faces: np.ndarray) -> Counter[tuple[tuple[float, ...], ...]]:
    """Triangles by their corners, each turned so that its smallest corner is first."""
    turned = []
    for corners in vertices[faces].astype(np.float32).tolist():
        at = corners.index(min(corners))
        turned.append(tuple(map(tuple, corners[at:] + corners[:at])))
    return Counter(turned)


@given(cells=cells)
def test_cubes_are_welded_into_manifolds_also_where_they_touch(cells: set[tuple[int, int, int]], shape: Shape) -> None:
    cubes = [trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix(cell)) for cell in sorted(cells)]
    mesh = trimesh.util.concatenate(cubes)
    mesh.unmerge_vertices()
    visual = seen(shape, mesh)
    assert triangles(visual.vertices, visual.faces) == triangles(mesh.vertices, mesh.faces)
    assert visual.solids is not None
    apart = all(max(abs(a - b) for a, b in zip(first, second, strict=True)) > 1 for first in cells for second in cells if first != second)
    assert len(visual.vertices) == 8 * len(cells) if apart else len(visual.vertices) >= 8 * len(cells)
    sides = np.sort(np.concatenate([visual.faces[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]), axis=1)
    assert np.unique(sides, axis=0, return_counts=True)[1].max() <= 2
    for face in visual.faces:
        assert len(set(visual.solids[face].tolist())) == 1
    if apart:
        welded = trimesh.Trimesh(visual.vertices, visual.faces, process=False)
        assert welded.is_watertight
        assert np.isclose(welded.volume, len(cells))
        assert len(set(visual.solids.tolist())) == len(cells)


def test_triangles_without_area_are_left_out(shape: Shape) -> None:
    mesh = trimesh.creation.box((1, 1, 1))
    mesh.apply_translation((0, 0, 0.5))
    flat = np.array([[0, 1, 1], [2, 2, 2]])
    visual = seen(shape, trimesh.Trimesh(mesh.vertices, np.concatenate([mesh.faces, flat]), process=False))
    assert len(visual.faces) == 12
    assert len(visual.vertices) == 8


def test_a_sheet_that_is_there_twice_takes_no_more_vertices(shape: Shape) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    both = trimesh.Trimesh(ball.vertices, np.concatenate([ball.faces, ball.faces[:, ::-1]]), process=False)
    visual = seen(shape, both)
    assert len(visual.vertices) == len(ball.vertices)
    assert triangles(visual.vertices, visual.faces) == triangles(both.vertices, both.faces)


def test_solids_of_their_own_that_touch_stay_as_they_are(shape: Shape) -> None:
    pair = trimesh.util.concatenate(
        [trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix((0, 0, z))) for z in (0, 1)]
    )
    visual = seen(shape, pair)
    assert len(visual.vertices) == 16
    assert visual.solids is not None
    assert len(set(visual.solids.tolist())) == 2
    assert trimesh.Trimesh(visual.vertices, visual.faces, process=False).is_watertight
