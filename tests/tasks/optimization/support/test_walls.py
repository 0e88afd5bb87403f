"""Faces of walls, and what hangs on them or stands against them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.optimization.support.supports import (
    find_carriers,
)
from tasks.optimization.support.walls import wall_faces, wall_snap
from tasks.shell import room_shell
from tests.tasks.optimization.support.furnishings import (
    CHAIR,
    CONFIG,
    FRAME,
    MAT,
    at,
    block,
    room,
    small,
)


def test_faces_are_those_of_the_shell_and_look_into_the_room() -> None:
    polygon = ((-2.0, -2.0), (2.0, -2.0), (2.0, 0.0), (0.0, 0.0), (0.0, 2.0), (-2.0, 2.0))
    place = room(polygon, interior=((-1.0, -2.0, -1.0, 0.0, 0.1, 2.2),), walls=((-0.5, 1.0, 0.5, 1.0),))
    meshes = dict(room_shell(place))
    faces = wall_faces(place)
    assert {face.name for face in faces} == set(meshes) - {"floor"} | {None}
    for face in faces:
        if face.name is None:
            continue
        box = meshes[face.name].bounds
        for share in (0.1, 0.5, 0.9):
            on = face.start + share * face.length * face.along
            behind, before = on - 0.02 * face.inward, on + 0.02 * face.inward
            assert (box[0, :2] <= behind + 1e-9).all()
            assert (behind <= box[1, :2] + 1e-9).all()
            assert not ((box[0, :2] < before).all() and (before < box[1, :2]).all())
        assert face.height == pytest.approx(box[1, 2])


@given(
    wall=st.integers(0, 3), along=st.floats(-1.4, 1.4), distance=st.floats(-0.3, 0.119), turn=st.floats(-0.05, 0.05),
    category=st.sampled_from(["picture", "tv", "whiteboard", "thing"]),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_a_snapped_object_has_its_back_on_its_wall(wall: int, along: float, distance: float, turn: float, category: str) -> None:
    normal = np.array([(0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0)][wall])
    tangent = np.array([-normal[1], normal[0]])
    depth = 0.04
    center = -2.0 * normal + (distance + depth / 2) * normal + along * tangent
    yaw = float(np.arctan2(normal[1], normal[0])) + turn
    obj = at(0, FRAME, *center, 1.2, category, yaw)
    found = find_carriers([obj], room(), CONFIG)["0000"]
    back = float((obj.surface.vertices[:, :2] @ normal).min()) + 2.0
    far = float((obj.surface.vertices[:, :2] @ normal).max()) + 2.0
    if far < -0.29 or back > 0.11:
        return  # in the next room, or too far off to tell
    assert (found.relation, found.against) == ("wall", f"wall_{wall:02d}")
    move = np.array(wall_snap(obj, room(), found))
    assert np.abs(move @ tangent) < 1e-9
    assert float(((obj.surface.vertices[:, :2] + move) @ normal).min()) == pytest.approx(-2.0, abs=1e-9)
    assert np.linalg.norm(move) == pytest.approx(abs(back), abs=1e-9)


def test_doors_and_what_does_not_hang_on_a_wall_stay_where_they_are() -> None:
    door = small(2.06, 0, 0.0, block(0.12, 0.9, 2.0), "door")
    found = find_carriers([door], room(), CONFIG)["0000"]
    assert (found.relation, found.against, found.is_fixed) == ("wall", "wall_01", True)
    assert wall_snap(door, room(), found) == (0.0, 0.0)
    chair = small(-1.7, 0, 0, CHAIR, "chair")
    assert wall_snap(chair, room(), find_carriers([chair], room(), CONFIG)["0000"]) == (0.0, 0.0)
    lamp = small(0, 0, 2.2, block(0.4, 0.4, 0.3), "ceiling lamp")
    found = find_carriers([lamp], room(), CONFIG)["0000"]
    assert (found.relation, found.against) == ("ceiling", "ceiling")
    assert wall_snap(lamp, room(), found) == (0.0, 0.0)


def test_furniture_stands_against_the_wall_that_it_stands_along() -> None:
    cupboard = block(0.5, 1.0, 0.8)
    for obj, wall in (
        (at(0, cupboard, -1.72, 0.3, 0, "cabinet"), "wall_03"),  # back 3 cm off
        (at(0, cupboard, -1.78, 0.3, 0, "cabinet"), "wall_03"),  # back 3 cm in
        (at(0, cupboard, -1.6, 0.3, 0, "cabinet"), None),  # 15 cm off
        (at(0, cupboard, 0, 1.72, 0, "cabinet", np.pi / 2), "wall_02"),
        (at(0, cupboard, -1.46, 0.3, 0, "cabinet", np.pi / 4), None),  # only a corner is near
        (at(0, cupboard, -1.73, -1.48, 0, "cabinet"), "wall_03"),  # in a corner: its broad side counts
        (at(0, MAT, -1.24, 0, 0, "rug"), None),
    ):
        found = find_carriers([obj], room(), CONFIG)["0000"]
        assert (found.relation, found.against) == ("floor", wall), obj.low


def test_objects_hang_on_both_sides_of_an_inner_wall() -> None:
    place = room(interior=((0.0, -2.0, 0.0, 1.0, 0.1, 2.5),))
    for side in (-1, 1):
        picture = small(side * 0.10, 0, 1.3, FRAME, "picture")  # 3 cm before the face at 5 cm
        found = find_carriers([picture], place, CONFIG)["0000"]
        assert (found.relation, found.against) == ("wall", "inner_00")
        assert wall_snap(picture, place, found) == pytest.approx((-side * 0.03, 0.0), abs=1e-9)


def test_a_room_whose_outline_crosses_itself_still_has_its_scanned_walls() -> None:
    bow = room(((-2.0, -2.0), (2.0, 2.0), (2.0, -2.0), (-2.0, 2.0)), walls=((-2.0, 2.0, -2.0, -2.0),))
    picture = small(-1.95, 0, 1.2, FRAME, "picture")
    found = find_carriers([picture], bow, CONFIG)["0000"]
    assert (found.relation, found.against) == ("wall", None)
    assert wall_snap(picture, bow, found) == (0.0, 0.0)


@given(
    side=st.sampled_from([-1.0, 1.0]), gap=st.floats(-0.3, 0.4), thickness=st.floats(0.06, 0.25), along=st.floats(-1.0, 1.0),
    category=st.sampled_from(["picture", "range hood", "kitchen cabinet", "curtain"]),
)  # fmt: skip
@settings(deadline=None)
def test_nothing_is_snapped_through_an_interior_wall(side: float, gap: float, thickness: float, along: float, category: str) -> None:
    depth = 0.3
    place = room(interior=((0.0, -2.0, 0.0, 2.0, thickness, 2.5),))
    middle = side * (0.5 * thickness + gap + 0.5 * depth)
    obj = small(middle, along, 1.5, block(depth, 0.5, 0.5), category)
    found = find_carriers([obj], place, CONFIG)["0000"]
    move = np.array(wall_snap(obj, place, found))
    after = side * (middle + move[0])
    if found.against == "inner_00" and gap > -0.5 * depth:
        assert after == pytest.approx(0.5 * (thickness + depth), abs=1e-9), "with its back on the face of its own room"
    elif gap > 0.12:
        assert found.against in (None, "ceiling")
        assert move.tolist() == [0.0, 0.0]
