"""RoomPlan: floors in any plane of their own frame, and floors from walls."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.capture.reading import Reading
from tasks.capture.roomplan.elements import RoomElement, in_plane
from tasks.capture.roomplan.floors import ground_within
from tasks.capture.roomplan.surfaces import corners_of
from tasks.geometry.transforms import transform_points
from tasks.geometry.triangles import face_areas, face_normals
from tests.tasks.capture.formats.written import read
from tests.tasks.capture.phones.captured_rooms import (
    DEPTH,
    HEIGHT,
    WIDTH,
    Array,
    captured,
    floor_lying,
    floor_upright,
    placed,
    surface,
    table,
    walls,
    write,
)


def floor_of(reading: Reading) -> tuple[float, Array, Array]:
    """Area of the floor [m2], its corners [m] and the normals of its faces."""
    assert reading.surface is not None
    faces = reading.surface.faces[np.concatenate([group.faces for group in reading.groups or () if group.raw_label == "floor"])]
    vertices = reading.surface.vertices
    return float(face_areas(vertices, faces).sum()), vertices[np.unique(faces)], face_normals(vertices, faces)


def without_corners(floor: dict[str, Any]) -> dict[str, Any]:
    return floor | {"polygonCorners": []}


def reversed_corners(floor: dict[str, Any]) -> dict[str, Any]:
    return floor | {"polygonCorners": floor["polygonCorners"][::-1]}


@pytest.mark.parametrize(
    "floor",
    [
        floor_lying(),
        floor_upright(),
        without_corners(floor_lying()),
        without_corners(floor_upright()),
        reversed_corners(floor_lying()),
        reversed_corners(floor_upright()),
        floor_upright() | {"dimensions": [WIDTH, 0.01, DEPTH]},
        floor_upright() | {"dimensions": [0, 0, 0]},
        # The frame lies below the floor, and the corners lie above its origin.
        floor_upright(-0.2) | {"polygonCorners": [[x, 0.2, z] for x, _, z in floor_upright()["polygonCorners"]]},
    ],
)
def test_a_floor_lies_where_its_corners_are(floor: dict[str, Any], tmp_path: Path) -> None:
    write(tmp_path / "home", captured(walls=walls(), floors=[floor], objects=[table()]))
    area, corners, normals = floor_of(read(tmp_path))
    assert area == pytest.approx(WIDTH * DEPTH)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[-2, -1.5, 0], [2, 1.5, 0]], atol=1e-6)
    np.testing.assert_allclose(normals, np.tile([0, 0, 1.0], (len(normals), 1)), atol=1e-6)


UNUSABLE = {
    "none": ([], "floors: none is usable"),
    "null": (None, "floors: none is usable"),
    "no area": ([surface("floor", placed(), [0, 0, 0])], r"floors\[0\]: has no area"),
    "on a line": ([surface("floor", placed(), [0, 0, 0], polygonCorners=[[0, 0, 0], [1, 0, 0], [2, 0, 0]])], "have no area"),
    "upright": ([floor_lying() | {"transform": placed().T.ravel().tolist()}], r"floors\[0\]: is tilted by 90 degrees"),
    "broken": ([{"dimensions": "large"}], r"floors\[0\].dimensions"),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_walls_give_the_floor_that_no_element_does(case: str, tmp_path: Path) -> None:
    floors, expected = UNUSABLE[case]
    write(tmp_path / "home", captured(walls=walls(), floors=floors, objects=[table()]))
    reading = read(tmp_path)
    area, corners, _ = floor_of(reading)
    assert area == pytest.approx(WIDTH * DEPTH, rel=1e-4)
    assert corners[:, 2] == pytest.approx(0.0)
    notes = "\n".join(reading.degradations)
    assert expected.replace("\\", "") in notes
    assert "the ground within its walls is taken" in notes


def test_a_storey_without_a_floor_gets_its_own(tmp_path: Path) -> None:
    both = captured(walls=[*walls(), *walls(2.8, 1)], floors=[floor_lying()], objects=[table(), table(2.8, story=1)])
    write(tmp_path / "home", both)
    reading = read(tmp_path)
    area, corners, _ = floor_of(reading)
    assert area == pytest.approx(2 * WIDTH * DEPTH, rel=1e-4)
    assert set(np.round(corners[:, 2], 6)) == {0.0, 2.8}
    assert any("storey 1: floors: none is usable" in note for note in reading.degradations)


def test_a_floor_between_walls_that_leave_corners_out(tmp_path: Path) -> None:
    """The ground of a room with six walls is not their convex hull."""
    ends = [(0, 0), (4, 0), (4, 2), (2, 2), (2, 4), (0, 4)]
    listed = []
    for (x0, z0), (x1, z1) in zip(ends, ends[1:] + ends[:1], strict=True):
        pose = placed((x0 + x1) / 2, HEIGHT / 2, (z0 + z1) / 2, -np.arctan2(z1 - z0, x1 - x0))
        listed.append(surface("wall", pose, [float(np.hypot(x1 - x0, z1 - z0)), HEIGHT, 0]))
    write(tmp_path / "home", captured(walls=listed))
    assert floor_of(read(tmp_path))[0] == pytest.approx(12.0, rel=1e-4)


def test_walls_that_do_not_meet_enclose_their_hull() -> None:
    ground = ground_within([np.array([[0, 0], [4, 0.0]]), np.array([[4, 3], [0, 3.0]])])
    assert (ground.area, ground.is_closed) == (pytest.approx(12.0), False)


def ring(x: float, y: float, width: float, depth: float, gap: float = 0.0) -> list[Array]:
    """Walls of a room from above; the first has a gap in its middle."""
    corners = [(x, y), (x + width, y), (x + width, y + depth), (x, y + depth)]
    lines = [np.array([a, b], dtype=np.float64) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    if gap:
        middle = x + 0.5 * width
        lines[:1] = [np.array([[x, y], [middle - gap / 2, y]]), np.array([[middle + gap / 2, y], [x + width, y]])]
    return lines


@pytest.mark.parametrize("place", [(2.0, 2.0), (0.0, 1.0), (4.2, 3.2)])
@pytest.mark.parametrize("gap", [0.0, 0.9, 2.5])
def test_a_column_is_not_the_ground_of_a_room_with_a_gap(gap: float, place: tuple[float, float]) -> None:
    """A boxed column within the room or at its walls changes nothing."""
    ground = ground_within([*ring(0, 0, 5, 4, gap), *ring(*place, 0.8, 0.8)])
    assert ground.area == pytest.approx(20.0, rel=1e-3)
    assert ground.is_closed == (gap == 0.0)


def test_a_column_is_not_the_ground_between_walls_that_stand_alone() -> None:
    walls_alone = [np.array(line, dtype=np.float64) for line in ([[2.5, 0], [7.5, 0]], [[10, 2.5], [10, 7.5]], [[2.5, 10], [7.5, 10]])]
    ground = ground_within([*walls_alone, *ring(5, 5, 0.8, 0.8)])
    assert ground.area == pytest.approx(68.75, abs=1.0)
    assert not ground.is_closed


@pytest.mark.parametrize("gap", [0.9, 2.5])
def test_an_open_room_next_to_a_closed_one_has_ground(gap: float) -> None:
    walls_of_both = [*ring(0, 0, 4, 3), *ring(4.1, 0, 5, 3, gap)]
    ground = ground_within(walls_of_both)
    assert ground.area == pytest.approx(12.0 + 15.0, abs=0.5)
    assert not ground.is_closed
    assert not ground_within(walls_of_both[:-1]).area < 26.5, "the shared wall is that of the closed room"


def test_open_rooms_far_from_each_other_have_ground_each() -> None:
    ground = ground_within([*ring(0, 0, 4, 3, 0.9), *ring(20, 0, 4, 3, 0.9)])
    assert (ground.area, ground.hull_m2) == (pytest.approx(24.0), pytest.approx(72.0))


def test_much_less_ground_than_the_hull_of_all_walls_is_named(tmp_path: Path) -> None:
    write(tmp_path / "home", captured(walls=[*walls(), *walls(x=20.0)], floors=[]))
    assert any("24.0 m2 are taken, the convex hull of all walls has 72.0 m2" in note for note in read(tmp_path).degradations)


@settings(deadline=None, max_examples=60)
@given(st.floats(0.0, 6.3), st.floats(1.0, 8.0), st.floats(1.0, 8.0), st.floats(0.0, 0.12), st.integers(0, 2))
def test_walls_enclose_their_ground_with_small_gaps(yaw: float, width: float, depth: float, gap: float, partitions: int) -> None:
    """Gaps at corners and walls within a room change the ground by less than the gaps' width."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    corners = np.array([[0, 0], [width, 0], [width, depth], [0, depth]])
    lines = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        lines.append(np.array([a + along * gap, b - along * gap]) @ turn.T)
    for k in range(partitions):
        x = width * (k + 1) / 3
        lines.append(np.array([[x, 0.0], [x, depth]]) @ turn.T)
    ground = ground_within(lines)
    assert ground.is_closed
    assert ground.area == pytest.approx(width * depth, abs=4 * gap * (width + depth) + 1e-3)


CONTRADICTIONS = {
    "corners and dimensions": (
        floor_upright() | {"dimensions": [2, 0, DEPTH]}, "corners span 4.00 x 3.00 m, dimensions state 2.00 x 3.00 m",
    ),
    "far above the walls": (floor_upright(0.9), "lies 0.90 m above the lower edges of its walls"),
    "outside": (floor_lying(x=20.0), "floors cover 0.0 of 12.0 m2 within the walls"),
    "a small part": (floor_lying() | {"polygonCorners": [[0, 0, 0], [1, 0, 0], [1, 1, 0]]}, "floors cover 0.5 of 12.0 m2"),
}  # fmt: skip


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_floors_that_contradict_other_facts_are_named(case: str, tmp_path: Path) -> None:
    floor, expected = CONTRADICTIONS[case]
    write(tmp_path / "home", captured(walls=walls(), floors=[floor]))
    assert any(expected in note for note in read(tmp_path).degradations), read(tmp_path).degradations


@settings(deadline=None, max_examples=60)
@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3), st.floats(-2, 2), st.floats(0.5, 4), st.floats(0.5, 4))
def test_any_plane_keeps_corners_in_place(vector: list[float], lift: float, width: float, depth: float) -> None:
    """A frame along the normal moves no corner."""
    normal = np.array(vector) + np.array([0, 0, 1e-3])
    normal /= np.linalg.norm(normal)
    across = np.cross(normal, [0.3, 0.5, 0.8])
    across /= max(float(np.linalg.norm(across)), 1e-9)
    up = np.cross(normal, across)
    corners = np.array([normal * lift + across * x + up * y for x, y in ((0, 0), (width, 0), (width, depth), (0, depth))])
    pose = placed(1.0, 2.0, 3.0, 0.7)
    before = RoomElement("", "floor", pose, np.zeros(3), corners, "", "floors[0]")
    if np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])) < 1e-3:
        return
    after, _ = in_plane(before)
    np.testing.assert_allclose(transform_points(corners_of(after), after.pose), transform_points(corners, pose), atol=1e-6)
    np.testing.assert_allclose(corners_of(after)[:, 2], 0.0, atol=1e-5)
