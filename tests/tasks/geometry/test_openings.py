"""Bounding polytopes of parts, by which cuts and joins of pieces are ranked."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tasks.geometry.colliders import sightlines
from tasks.geometry.decomposition import Halving, JoinedHulls, _first, _Solid, cut, joins, split
from tasks.geometry.hulls import deviation, is_within
from tasks.geometry.openings import DIRECTIONS, Openings, ReachesBeside, both_reaches, openings, reach_of


def crossed_boards() -> trimesh.Trimesh:
    """Two boards that cross, slightly turned, so that planes meet triangles anywhere."""
    boards = [trimesh.creation.box((0.6, 0.05, 0.4)), trimesh.creation.box((0.05, 0.5, 0.4))]
    mesh = trimesh.util.concatenate(boards)
    assert isinstance(mesh, trimesh.Trimesh)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.2, (0.3, 0.2, 1.0)))
    return mesh


def free_around(mesh: trimesh.Trimesh) -> Openings:
    return openings(sightlines([mesh]))


def test_directions_are_units_with_the_axes_first_and_no_opposites() -> None:
    assert np.linalg.norm(DIRECTIONS, axis=1) == pytest.approx(1.0)
    np.testing.assert_array_equal(DIRECTIONS[:3], np.eye(3))
    cosines = DIRECTIONS @ DIRECTIONS.T - np.eye(len(DIRECTIONS))
    assert np.abs(cosines).max() < 0.999


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_reaches_beside_a_plane_are_those_of_the_triangles_cut_there(axis: int) -> None:
    mesh = crossed_boards()
    triangles = np.asarray(mesh.triangles, dtype=np.float64)
    beside = ReachesBeside(triangles)
    corner = float(np.sort(triangles[:, :, axis].ravel())[7])
    for place in (0.013, -0.1, corner):
        counts, reaches = beside.plane(axis, place)
        for side, part in enumerate(split(triangles, axis, place)):
            assert (counts[side] > 0) == (len(part) > 0)
            if len(part):
                np.testing.assert_allclose(reaches[side], reach_of(part.reshape(-1, 3)), atol=2e-7)


def test_a_triangle_in_the_plane_is_on_neither_side() -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    counts, reaches = ReachesBeside(np.asarray(box.triangles, dtype=np.float64)).plane(2, 0.5)
    assert counts.tolist() == [10, 0, 2]
    np.testing.assert_allclose(reaches[2][:, 2], 0.5)


def test_bounding_polytopes_stop_no_fewer_rays_than_hulls_and_those_of_boxes_just_as_many() -> None:
    mesh = crossed_boards()
    free = free_around(mesh)
    rng = np.random.default_rng(0)
    low, high = mesh.bounds
    for _ in range(20):
        points = rng.uniform(low, high, (8, 3))
        solid = _Solid.around(points, free)
        (bound,) = free.stopped_by_bounds(solid.reach[None])
        assert bound >= solid.cost - 1e-9
        corners = trimesh.bounds.corners(np.sort(rng.uniform(low, high, (2, 3)), axis=0))
        box = _Solid.around(corners, free)
        assert free.stopped_by_bounds(box.reach[None])[0] == pytest.approx(box.cost)
        assert free.stopped_by_bounds(np.array([solid.reach, box.reach]))[1] == pytest.approx(box.cost)
        together = both_reaches(solid.reach, box.reach)
        np.testing.assert_array_equal(together, reach_of(np.concatenate([solid.vertices, box.vertices])))


def test_cuts_open_the_corners_between_boards_and_joins_go_down_to_one_solid() -> None:
    mesh = crossed_boards()
    free = free_around(mesh)
    atoms = cut(np.asarray(mesh.triangles, dtype=np.float64), free, lambda points: points)
    whole = _Solid.around(np.asarray(mesh.vertices, dtype=np.float64), free)
    assert sum(atom.solid.cost for atom in atoms) < 0.2 * whole.cost
    chain: list[JoinedHulls] = list(joins(atoms, free))
    assert [len(joined.clouds) for joined in chain] == list(range(len(atoms), 0, -1))
    assert chain[0].cost == pytest.approx(sum(atom.solid.cost for atom in atoms))
    assert chain[-1].cost == pytest.approx(whole.cost)


@pytest.mark.parametrize("count", [1, 2, 3, 10, 97])
def test_the_first_good_number_is_sought_from_any_guess(count: int) -> None:
    for first in range(count):
        for guess in (0, count // 3, count - 1):
            asked: list[int] = []

            def is_good(i: int, first: int = first, asked: list[int] = asked) -> bool:
                asked.append(i)
                return i >= first

            assert _first(count, guess, is_good) == first
            assert len(asked) == len(set(asked)) <= 2 * np.log2(count) + 2
    assert _first(count, 0, lambda i: False) == count - 1


def test_rounded_clouds_are_halved_until_hulls_are_near_enough() -> None:
    ball = np.asarray(trimesh.creation.icosphere(subdivisions=3).vertices, dtype=np.float64)
    halving = Halving(ball, 0.004)
    coarse, fine = halving.hulls(1.0), halving.hulls(0.02)
    assert coarse == [halving.hull]
    assert len(fine) > 1
    assert all(is_within(hull) for hull in fine)
    assert halving.hulls(0.02)[0] is fine[0], "halves are made once"
    cube = trimesh.creation.box((1, 1, 1)).vertices
    assert Halving(np.asarray(cube, dtype=np.float64), 0.004).hulls(0.0)[0].volume == pytest.approx(1.0)
    assert max(min(deviation(hull, point[None]) for hull in fine) for point in ball) < 0.1
