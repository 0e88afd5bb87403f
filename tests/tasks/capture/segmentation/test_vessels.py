"""What joins what: convex and hollow joints, insides and outsides of bowls, things that lie in them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.segmentation.convexity import ConvexityConfig, contacts_of, is_joint
from tasks.capture.segmentation.frame import FrameConfig, segmented_frame
from tasks.capture.segmentation.patches import _compiled
from tasks.capture.segmentation.vessels import bridged, bulge, outlines, rises
from tests.tasks.capture.segmentation.test_frame import TOP, best, shown, thing

CONVEXITY = ConvexityConfig()


@given(angle=st.floats(0.4, 1.5))
def test_an_edge_joins_and_a_hollow_parts(angle: float) -> None:
    """Two planes that meet along y: seen from above, their normals turn apart at an edge, towards each other in a hollow."""
    normals = np.array([[-np.sin(angle / 2), 0, np.cos(angle / 2)]]), np.array([[np.sin(angle / 2), 0, np.cos(angle / 2)]])
    edge = is_joint(np.array([[-1.0, 0, 0]]), normals[0], np.array([[1.0, 0, 0]]), normals[1], CONVEXITY)
    hollow = is_joint(np.array([[-1.0, 0, 0]]), normals[1], np.array([[1.0, 0, 0]]), normals[0], CONVEXITY)
    assert edge.all()
    assert not hollow.any()
    along = is_joint(np.array([[0, -1.0, 0]]), normals[0], np.array([[0, 1.0, 0]]), normals[1], CONVEXITY)
    assert not along.any() or np.degrees(angle) < CONVEXITY.crease_degrees, "two that meet at the end of an edge have no joint"


def test_contacts_are_counted_as_a_slow_count_has_them() -> None:
    rng = np.random.default_rng(5)
    label, depth = rng.integers(-1, 4, (23, 31)), rng.uniform(1, 1.02, (23, 31))
    step = np.full(depth.shape, 0.01)
    found = contacts_of(label, depth, step, 3)
    slow: dict[tuple[int, int], list[int]] = {}
    for v, u in np.ndindex(*label.shape):
        for i, j in [(v + k, u) for k in (1, 2, 3)] + [(v, u + k) for k in (1, 2, 3)]:
            if i < 23 and j < 31 and label[v, u] >= 0 <= label[i, j] != label[v, u]:
                pair = slow.setdefault((min(label[v, u], label[i, j]), max(label[v, u], label[i, j])), [0, 0])
                pair[0] += 1
                pair[1] += bool(abs(depth[v, u] - depth[i, j]) <= 0.01)
    assert {(a, b): [p, q] for a, b, p, q in zip(found.first, found.second, found.pairs, found.passing, strict=True)} == slow


def test_parts_hang_together_as_scipy_has_them() -> None:
    from scipy.ndimage import label as components

    image = np.random.default_rng(2).integers(0, 2, (40, 50)) - 1
    part = _compiled()["_connected"](image.astype(np.int64), np.ones(image.shape), np.full(image.shape, 0.1))
    expected, count = components(image == 0)
    assert part.max() + 1 == count
    assert len(np.unique(np.stack([part[image == 0], expected[image == 0]]), axis=1).T) == count


def test_outlines_count_neighbors_both_ways() -> None:
    region = np.array([[0, 0, 1], [0, -1, 1]])
    assert outlines(region, 2).tolist() == [[0, 1, 2], [1, 0, 1]]


def test_rises_say_which_of_two_is_higher() -> None:
    region, heights = np.array([[0, 0, 1], [0, -1, 1]]), np.array([[0.0, 0.0, 0.5], [0.0, 9.0, 0.25]])
    assert rises(region, heights, 2).tolist() == [[0.0, 0.5], [-0.5, 0.0]]


def test_holes_are_bridged_and_no_farther() -> None:
    label = np.array([[0, -1, -1, -1, -1, -1, -1, 1]])
    found, place = bridged(label, 2)
    assert found.tolist() == [[0, 0, 0, -1, -1, 1, 1, 1]]
    assert place[1, 0, [1, 2, 5, 6]].tolist() == [0, 0, 7, 7]


def test_a_ball_bulges_and_a_bowl_does_not() -> None:
    ball = trimesh.creation.icosphere(3)
    half = ball.vertices[ball.vertices[:, 2] > 0.2]
    assert bulge(half, half) > 0.4
    assert bulge(half, -half) < -0.4
    assert bulge(half * [1, 1, 0], np.tile([0.0, 0.0, 1.0], (len(half), 1))) == pytest.approx(0.0)


def bin_with(content: trimesh.Trimesh | None) -> tuple[list[trimesh.Trimesh], list[trimesh.Trimesh]]:
    """An open box of walls 1 cm thick, 12 cm high, and what lies in it."""
    sides = [((0.01, 0.28, 0.12), 0.1, 0), ((0.01, 0.28, 0.12), -0.1, 0), ((0.2, 0.01, 0.12), 0, 0.135), ((0.2, 0.01, 0.12), 0, -0.135)]
    walls = [thing(size, x, y) for size, x, y in [*sides, ((0.2, 0.28, 0.01), 0, 0)]]
    return [trimesh.util.concatenate(walls)], [] if content is None else [content]


def test_the_inside_of_a_vessel_is_the_vessel_and_what_lies_in_it_is_not() -> None:
    ball = trimesh.creation.icosphere(3, radius=0.045)
    ball.apply_translation([0, 0, TOP + 0.055])
    vessel, content = bin_with(ball)
    view, owner = shown([*vessel, *content], 0.9, noise=0.5)
    found = segmented_frame(view, FrameConfig())
    assert best(found, owner, 1) > 0.6, "the ball"
    assert best(found, owner, 0) > 0.5, "walls inside and outside, and the bottom"
