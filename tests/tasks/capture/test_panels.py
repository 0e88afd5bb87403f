"""Doors and windows that were annotated together, each in a plane of its own."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tasks.capture.instances.merged import set_apart
from tasks.capture.instances.panels import panels_of
from tasks.geometry.transforms import transform_points, yaw_pose
from tests.tasks.capture.test_merged import scan_of

LEAF = trimesh.creation.box(bounds=[[0.0, -0.02, 0.0], [0.88, 0.02, 2.03]])


def leaf(x: float, y: float, yaw: float) -> trimesh.Trimesh:
    """A leaf that hangs at a place [m] and stands at an angle [rad]."""
    return LEAF.copy().apply_transform(yaw_pose(yaw, [x, y, 0.0]))


def lining() -> list[trimesh.Trimesh]:
    """What lines the doorway of a leaf that hangs at the origin, along x."""
    boxes = [[[-0.06, -0.06, 0.0], [0.0, 0.06, 2.1]], [[0.9, -0.06, 0.0], [0.96, 0.06, 2.1]], [[0.0, -0.06, 2.04], [0.9, 0.06, 2.1]]]
    return [trimesh.creation.box(bounds=box) for box in boxes]


@pytest.mark.parametrize(("x", "y", "yaw"), [(0.7, 0.1, 0.0), (1.1, 0.2, 1.57), (0.5, 0.8, 0.6)])
def test_two_doors_of_one_annotation_are_two(x: float, y: float, yaw: float) -> None:
    first, second = leaf(0.0, 0.0, 1.57), leaf(x, y, yaw)
    groups, meanings, world = scan_of(("dooor", [first, second]), ("door", [leaf(4.0, 0.0, 0.0)]))
    made, labels, notes = set_apart(groups, meanings, world)
    assert [(group.source_id, group.raw_label, label) for group, label in zip(made, labels, strict=True)] == [
        ("0", "dooor", meanings[0]), ("1", "door", meanings[1]), ("0.1", "dooor", meanings[0]),
    ]  # fmt: skip
    assert notes == ["labels.json: 'dooor' 0 is two, of which 0.1 is the other"]
    parts = [made[k].vertices for k in (0, 2)]
    assert np.sort(np.concatenate(parts)).tolist() == groups[0].vertices.tolist(), "nothing is lost, nothing is in two"
    boxes = sorted(np.concatenate(mesh.bounds).round(3).tolist() for mesh in (first, second))
    found = sorted(np.concatenate([world.vertices[own].min(axis=0), world.vertices[own].max(axis=0)]).tolist() for own in parts)
    assert np.allclose(found, boxes, atol=0.1)


@pytest.mark.parametrize("solids", [[leaf(0.0, 0.0, 0.4)], [leaf(0.0, 0.0, 1.57), *lining()], [leaf(0.0, 0.0, 0.0), leaf(0.9, 0.0, 0.0)]])
def test_one_leaf_its_lining_and_two_leaves_of_one_doorway_stay_one(solids: list[trimesh.Trimesh]) -> None:
    groups, meanings, world = scan_of(("door", solids))
    made, labels, notes = set_apart(groups, meanings, world)
    assert (list(made), labels, notes) == (groups, meanings, [])


@given(yaw=st.floats(-3.0, 3.0), seed=st.integers(0, 99))
@settings(max_examples=10, deadline=None)
def test_panels_are_found_in_any_direction_and_order(yaw: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    meshes = [leaf(0.0, 0.0, 1.57), leaf(0.7, 0.1, 1.57)]
    sampled = [trimesh.sample.sample_surface(mesh, count, seed=seed) for mesh, count in zip(meshes, (900, 700), strict=True)]
    points = transform_points(np.concatenate([p for p, _ in sampled]), yaw_pose(yaw, [0.0, 0.0, 0.0]))
    points += rng.normal(0.0, 0.004, points.shape)
    normals = (
        np.concatenate([mesh.face_normals[f] for mesh, (_, f) in zip(meshes, sampled, strict=True)]) @ yaw_pose(yaw, [0, 0, 0])[:3, :3].T
    )
    order = rng.permutation(len(points))
    first, second = panels_of(points[order], normals[order])
    assert (len(first), len(second)) == (900, 700)
    assert (order[first] < 900).all()
    assert (order[second] >= 900).all()


@given(tilt=st.floats(0.0, 90.0), turn=st.floats(-3.2, 3.2), zero=st.floats(0.0, 1.0), seed=st.integers(0, 99))
@example(tilt=22.0, turn=0.0, zero=0.0, seed=0)
@example(tilt=0.0, turn=0.0, zero=1.0, seed=0)
@settings(max_examples=30, deadline=None)
def test_slanted_and_degenerate_windows_lose_no_point(tilt: float, turn: float, zero: float, seed: int) -> None:
    """Normals tilted by any angle [degrees], a share of them zero: every point is in one part, and what faces nowhere is one."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([0.0, 0.0, 0.0], [0.05, 1.0, 1.2], (400, 3))  # at x = 0, y = 0
    up, level = np.sin(np.radians(tilt)), np.cos(np.radians(tilt))
    normals = np.tile([level * np.cos(turn), level * np.sin(turn), up], (400, 1))
    normals[: round(zero * 400)] = 0.0
    parts = panels_of(points, normals)
    assert np.sort(np.concatenate(parts)).tolist() == list(range(400))
    if tilt > 20.0 or zero == 1.0:
        assert len(parts) == 1


def test_a_leaf_beside_a_slanted_pane_is_found_as_far_as_it_faces() -> None:
    """The first plane is taken; what is left faces nowhere and ends the search."""
    rng = np.random.default_rng(0)
    upright, slanted = (rng.uniform([x, 0.0, 0.0], [x + 0.01, 1.0, 1.5], (300, 3)) for x in (0.8, 0.0))
    normals = np.repeat([[1.0, 0.0, 0.0], [np.cos(np.radians(22)), 0.0, np.sin(np.radians(22))]], 300, axis=0)
    (part,) = panels_of(np.concatenate([upright, slanted]), normals)
    assert part.tolist() == list(range(600))
