from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.geometry.transforms import rotation_of, transform_points, translation, yaw_pose
from tasks.micro_scenes.belonging import belongings
from tasks.micro_scenes.boxes import StandingBox, standing_box
from tasks.micro_scenes.carrying import CarriedBy, CarryingConfig, carriers_of, leans_on, without_circles
from tests.tasks.micro_scenes.stacks import Stack, stacks

ANGLES = st.floats(-3.1, 3.1)
CONFIG = CarryingConfig()


def box(name: str, size: tuple[float, float, float], x: float, y: float, z: float, yaw: float = 0.0) -> StandingBox:
    return standing_box(name, size, (1.0, 1.0, 1.0), yaw_pose(yaw, [x, y, z]))


@given(stacks(), ANGLES, st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-5, 5)), st.randoms(use_true_random=False))
def test_what_carries_what_is_found_wherever_the_scene_stands_and_in_any_order(
    stack: Stack, turn: float, offset: tuple[float, float, float], order
) -> None:
    boxes = stack.boxes
    assert carriers_of(boxes, CONFIG) == stack.carried
    moved = [standing_box(b.name, stack.extents[b.name], (1, 1, 1), yaw_pose(turn, offset) @ stack.poses[b.name]) for b in boxes]
    order.shuffle(moved)
    assert carriers_of(moved, CONFIG) == stack.carried
    assert without_circles(stack.carried)


@given(stacks(), st.sets(st.integers(1, 30)))
def test_all_of_a_stack_belongs_to_what_is_at_its_bottom(stack: Stack, broken: set[int]) -> None:
    """A box that is not small cuts its stack in two: what is on it belongs to it."""
    whole = {f"{number:04d}" for number in broken} & set(stack.extents)

    def is_small(name: str) -> bool:
        return name not in whole

    found = {one.name: one for one in belongings(stack.carried, lambda name: True, is_small)}
    assert set(found) == {name for name in stack.carried if is_small(name)}
    for name, one in found.items():
        way = [name]
        while way[-1] in stack.carried and is_small(way[-1]):
            way.append(stack.carried[way[-1]].parent)
        assert (one.large, one.depth) == (way[-1], len(way) - 1)
        if not whole:
            assert (one.large, one.depth) == (stack.roots[name], stack.depth(name))
    assert belongings(stack.carried, lambda name: False, is_small) == []


@given(
    st.tuples(*[st.floats(0.05, 2.0)] * 3), st.tuples(*[st.floats(0.5, 2.0)] * 3), st.tuples(*[st.floats(-3, 3)] * 3),
    st.tuples(*[st.floats(-9, 9)] * 3), ANGLES,
)  # fmt: skip
def test_the_upright_box_of_a_turned_asset_is_the_least_one_around_it(extents, scale, turn, offset, yaw: float) -> None:
    """Of the directions in plan that it has, and the same wherever the scene is turned to."""
    pose = translation(offset)
    pose[:3, :3] = rotation_of(turn)
    made = standing_box("0001", extents, scale, pose)
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 1)]) * np.array(extents) * np.array(scale)
    own = transform_points(transform_points(corners, pose), np.linalg.inv(made.pose))
    assert np.allclose(own.min(axis=0), [-made.size[0] / 2, -made.size[1] / 2, 0.0], atol=1e-9)
    assert np.allclose(own.max(axis=0), [made.size[0] / 2, made.size[1] / 2, made.size[2]], atol=1e-9)
    assert np.isclose(math.cos(made.tilt), pose[2, 2])
    turned = standing_box("0001", extents, scale, yaw_pose(yaw) @ pose)
    assert np.allclose(turned.pose, yaw_pose(yaw) @ made.pose, atol=1e-9)
    assert np.allclose(turned.size, made.size, atol=1e-9)


def test_an_upright_asset_has_its_own_box() -> None:
    made = standing_box("0001", (0.4, 0.6, 0.5), (1.0, 2.0, 1.0), yaw_pose(0.7, [1, 2, 3]))
    assert made.pose.tolist() == pytest.approx(yaw_pose(0.7, [1, 2, 3]))
    assert made.size.tolist() == pytest.approx([0.4, 1.2, 0.5])
    assert made.tilt == 0.0


@given(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1), st.tuples(*[st.floats(-5, 5)] * 3))
def test_a_middle_comes_back_from_the_frame_of_the_large_object(yaw: float, other: float, offset) -> None:
    large, small = box("0001", (1, 2, 1), 3, 4, 0.2, yaw), box("0002", (0.1, 0.2, 0.3), *offset, other)
    center, turn = small.within(large)
    back = large.pose @ np.array([*center, 1.0])
    assert np.allclose(back[:3], small.center, atol=1e-9)
    assert np.allclose(yaw_pose(large.yaw + turn)[:3, :3], small.pose[:3, :3], atol=1e-9)
    assert -math.pi <= turn <= math.pi


@pytest.mark.parametrize(
    ("boxes", "expected"),
    [
        ([box("2", (0.2, 0.2, 0.3), 0, 0, 0.005)], {}),  # a bin under the desk, on an uneven floor
        ([box("2", (0.2, 0.2, 0.2), 0, 0, 0.79)], {"2": CarriedBy("1", "on")}),  # floats
        ([box("2", (0.2, 0.2, 0.2), 0, 0, 0.82)], {}),  # hangs
        ([box("2", (0.2, 0.2, 0.2), 0.48, 0, 0.75)], {"2": CarriedBy("1", "on")}),  # over the edge, by less than half
        ([box("2", (0.2, 0.2, 0.2), 0.62, 0, 0.75)], {}),
        ([box("2", (0.2, 0.2, 0.5), 0, 0, 0.5)], {"2": CarriedBy("1", "on")}),  # on a seat below its back
        ([box("2", (0.2, 0.2, 0.1), 0, 0, 0.5)], {"2": CarriedBy("1", "inside")}),
        # a mug on a laptop on the desk, whose tops are nearly as high
        (
            [box("2", (0.3, 0.3, 0.02), 0, 0, 0.75), box("3", (0.1, 0.1, 0.1), 0, 0, 0.77)],
            {"2": CarriedBy("1", "on"), "3": CarriedBy("2", "on")},
        ),
        # an apple in a basket on the desk, whose bottom is thin
        (
            [box("2", (0.3, 0.3, 0.2), 0, 0, 0.75), box("3", (0.1, 0.1, 0.1), 0, 0, 0.765)],
            {"2": CarriedBy("1", "on"), "3": CarriedBy("2", "inside")},
        ),
        # a mug on a book below the arm of a lamp, which is called 4
        (
            [box("2", (0.3, 0.3, 0.03), 0, 0, 0.75), box("3", (0.1, 0.1, 0.1), 0, 0, 0.78), box("4", (0.3, 0.3, 0.5), 0, 0, 0.75)],
            {"2": CarriedBy("1", "on"), "3": CarriedBy("2", "on"), "4": CarriedBy("1", "on")},
        ),
        # a vase on a board in a shelf, close above a book
        (
            [box("2", (0.1, 0.2, 0.2), 0, 0, 0.1), box("3", (0.1, 0.1, 0.1), 0, 0, 0.34)],
            {"2": CarriedBy("1", "inside"), "3": CarriedBy("1", "inside")},
        ),
        # an apple in a basket in a shelf
        (
            [box("2", (0.3, 0.3, 0.2), 0, 0, 0.3), box("3", (0.1, 0.1, 0.1), 0, 0, 0.33)],
            {"2": CarriedBy("1", "inside"), "3": CarriedBy("2", "inside")},
        ),
    ],
)
def test_borders_of_being_carried(boxes: list[StandingBox], expected: dict[str, CarriedBy]) -> None:
    assert carriers_of([box("1", (1.0, 0.6, 0.75), 0, 0, 0.0), *boxes], CONFIG, solid={"4"}) == expected


def tilted(degrees: float, towards: float, x: float, z: float = 0.0) -> StandingBox:
    """A board of 30 by 60 by 2 cm, tilted about its foot to a direction in plan [rad]."""
    pose = translation([x, 0.0, z])
    axis = np.array([-math.sin(towards), math.cos(towards), 0.0])
    pose[:3, :3] = rotation_of(axis * math.radians(degrees)) @ yaw_pose(towards)[:3, :3]
    return standing_box("0002", (0.02, 0.3, 0.6), (1, 1, 1), pose)


@pytest.mark.parametrize(
    ("board", "leans"),
    [
        (tilted(12, 0.0, 0.35), True),
        (tilted(12, math.pi, 0.45), False),  # away from it
        (tilted(3, 0.0, 0.46), False),  # nearly upright
        (tilted(12, 0.0, 0.2), False),  # too far
        (tilted(12, 0.0, 0.35, 0.9), False),  # above it
        (tilted(12, math.pi / 2, 0.46), False),  # along it
    ],
)
def test_what_is_near_and_tilted_towards_a_side_leans_on_it(board: StandingBox, leans: bool) -> None:
    wardrobe = box("0001", (1.0, 1.0, 0.8), 1.0, 0.0, 0.0)
    far = box("0003", (1.0, 1.0, 0.8), 5.0, 0.0, 0.0)
    assert leans_on(board, [far, wardrobe], CONFIG) == ("0001" if leans else None)
    assert leans_on(board, [far], CONFIG) is None


def test_circles_are_seen() -> None:
    assert without_circles({"a": CarriedBy("b", "on"), "b": CarriedBy("c", "on")})
    assert not without_circles({"a": CarriedBy("a", "on")})
    assert not without_circles({"a": CarriedBy("b", "on"), "b": CarriedBy("c", "on"), "c": CarriedBy("b", "on")})
