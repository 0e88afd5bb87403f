"""Doors and windows of which a part was seen are as large as the hole in their wall."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.rooms.leaves import WIDEST_DOOR_M, WIDEST_WINDOW_M, whole_leaves
from tasks.geometry.transforms import transform_points, yaw_pose

Array = np.ndarray

HEIGHT = 2.5
RING = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]])
"""A room of 6 by 4 m; its first wall lies along x at y = 0, the room at y > 0."""

NO_WALLS = np.zeros((0, 6))


def sheet(low: float, high: float, bottom: float, top: float, y: float, step: float) -> Array:
    """Points of a piece of wall or pane, shape (n, 3) [m]."""
    x = np.linspace(low, high, max(round((high - low) / step), 1) + 1)
    z = np.linspace(bottom, top, max(round((top - bottom) / step), 1) + 1)
    return np.stack(np.meshgrid(x, [y], z, indexing="ij"), axis=-1).reshape(-1, 3)


def wall_around(low: float, high: float, bottom: float, top: float) -> Array:
    """Points of the first wall but for a hole, as a coarse mesh has them [m]."""
    points = sheet(0.0, 6.0, 0.0, HEIGHT, 0.0, 0.07)
    hole = (points[:, 0] > low) & (points[:, 0] < high) & (points[:, 2] > bottom) & (points[:, 2] < top)
    return points[~hole]


def whole(seen: Array, is_door: bool, wall: Array, height: float = HEIGHT) -> list[float] | None:
    """Low and high end along the wall, bottom and top of what a part is completed to [m]."""
    (made,) = whole_leaves(RING, NO_WALLS, height, [seen], [is_door], wall)
    return None if made is None else [made[:, 0].min(), made[:, 0].max(), made[:, 2].min(), made[:, 2].max()]


@given(
    at=st.floats(1.0, 4.0), width=st.floats(0.7, 1.35), sill=st.floats(0.3, 1.0), tall=st.floats(0.9, 1.1),
    part=st.tuples(st.floats(0.0, 0.5), st.floats(0.6, 1.0), st.floats(0.0, 0.5), st.floats(0.6, 1.0)),
)  # fmt: skip
def test_a_window_fills_the_hole_in_its_wall_whatever_part_was_seen(
    at: float, width: float, sill: float, tall: float, part: tuple[float, float, float, float]
) -> None:
    hole = at, at + width, sill, sill + tall
    pane = sheet(at + part[0] * width, at + part[1] * width, sill + part[2] * tall, sill + part[3] * tall, -0.05, 0.05)
    made = whole(pane, False, wall_around(*hole))
    if made is None:  # nearly all of it was seen
        made = [pane[:, 0].min(), pane[:, 0].max(), pane[:, 2].min(), pane[:, 2].max()]
    assert np.abs(np.array(made) - hole).max() < 0.2, "to a step, a cell of the mesh and the tenth that is no gain"


@given(at=st.floats(1.0, 4.0), high=st.floats(0.3, 1.9))
def test_a_door_reaches_from_the_floor_to_the_lintel(at: float, high: float) -> None:
    hole = at, at + 0.9, -0.01, 2.05
    leaf = sheet(at, at + 0.4, 0.25, high + 0.1, -0.04, 0.05)
    made = whole(leaf, True, wall_around(*hole))
    assert made is not None
    assert made[2] == 0.0
    assert made[3] == pytest.approx(2.05, abs=0.2)
    assert made[:2] == pytest.approx(hole[:2], abs=0.2)


def test_what_was_seen_whole_stays_as_it_was_seen() -> None:
    assert whole(sheet(2.0, 3.2, 1.0, 2.1, -0.05, 0.05), False, wall_around(2.0, 3.2, 1.0, 2.1)) is None
    assert whole(sheet(2.0, 2.9, 0.0, 2.05, -0.05, 0.05), True, wall_around(2.0, 2.9, -0.01, 2.05)) is None


@given(low=st.floats(1.5, 4.0), width=st.floats(0.1, 2.5), is_door=st.booleans(), height=st.floats(1.7, 3.0))
def test_where_no_wall_was_seen_it_gets_no_larger_than_usual(low: float, width: float, is_door: bool, height: float) -> None:
    high = min(low + width, 5.9)
    made = whole(sheet(low, high, 1.2, 1.6, -0.05, 0.05), is_door, np.zeros((0, 3)), height)
    assert made is not None
    assert made[1] - made[0] <= max(WIDEST_DOOR_M if is_door else WIDEST_WINDOW_M, high - low) + 1e-9
    assert made[0] <= low + 1e-9
    assert made[1] >= high - 1e-9
    assert 0.0 <= made[2] <= 1.2
    assert 1.6 <= made[3] <= height
    assert (made[2] == 0.0) == is_door


def test_what_stands_before_no_wall_is_no_leaf_of_one() -> None:
    (made,) = whole_leaves(RING, NO_WALLS, HEIGHT, [sheet(2.0, 2.4, 0.0, 0.8, 1.5, 0.05)], [True], wall_around(2.0, 2.9, -0.01, 2.05))
    assert made is None


@given(yaw=st.floats(-3.0, 3.0))
def test_the_wall_may_run_in_any_direction(yaw: float) -> None:
    pose = yaw_pose(yaw, [1.0, -2.0, 0.0])
    pane, wall = sheet(2.0, 2.5, 1.0, 1.4, -0.05, 0.05), wall_around(2.0, 3.2, 1.0, 2.1)
    (made,) = whole_leaves(RING, NO_WALLS, HEIGHT, [pane], [False], wall)
    ring = transform_points(np.column_stack([RING, np.zeros(4)]), pose)[:, :2]
    (turned,) = whole_leaves(ring, NO_WALLS, HEIGHT, [transform_points(pane, pose)], [False], transform_points(wall, pose))
    assert made is not None
    assert turned is not None
    np.testing.assert_allclose(turned, transform_points(made, pose), atol=0.051)


@given(at=st.floats(1.0, 3.5), width=st.floats(1.0, 1.35), seen=st.tuples(st.floats(0.25, 0.4), st.floats(0.5, 0.7)))
def test_a_sill_that_runs_on_below_a_window_ends_it_on_no_side(at: float, width: float, seen: tuple[float, float]) -> None:
    """Only the lowest hand of the pane was seen, and of the wall what is no higher; points of the sill lie beside the pane's own."""
    wall = wall_around(at, at + width, 1.1, 2.3)
    wall = np.concatenate([wall[wall[:, 2] < 1.32], sheet(at, at + width, 1.12, 1.12, 0.0, 0.07)])
    pane = sheet(at + seen[0] * width, at + seen[1] * width, 1.12, 1.3, -0.05, 0.05)
    made = whole(pane, False, wall)
    assert made is not None
    assert made[:2] == pytest.approx([at, at + width], abs=0.21)


@pytest.mark.parametrize("mirrored", [False, True])
def test_wall_farther_off_than_a_window_is_wide_says_nothing_of_where_it_ends(mirrored: bool) -> None:
    """A curtain hides what lies between the wall and the pane."""
    pane, wall = sheet(3.0, 3.6, 1.0, 2.0, -0.05, 0.05), sheet(0.0, 1.9, 0.0, HEIGHT, 0.0, 0.07)
    sill = sheet(1.9, 5.0, 0.0, 0.97, 0.0, 0.07)
    if mirrored:
        pane, wall, sill = ([6.0, 0.0, 0.0] + [-1.0, 1.0, 1.0] * points for points in (pane, wall, sill))
    made = whole(pane, False, np.concatenate([wall, sill]))
    assert made is not None
    assert made[:2] == pytest.approx([6.0 - 3.9, 6.0 - 2.7] if mirrored else [2.7, 3.9], abs=0.03)


@given(top=st.floats(0.9, 1.25), turn=st.floats(0.0, 1.5))
def test_the_lower_half_of_a_leaf_that_hangs_at_the_end_of_a_wall_is_a_door(top: float, turn: float) -> None:
    inner = np.array([[0.0, 2.0, 3.0, 2.0, 0.12, HEIGHT]])
    leaf = transform_points(sheet(0.05, 0.9, 0.02, top, 0.0, 0.05), yaw_pose(turn - 1.5, [3.0, 2.0, 0.0]))
    (made,) = whole_leaves(RING, inner, HEIGHT, [leaf], [True], sheet(0.0, 3.0, 0.0, HEIGHT, 2.0, 0.07))
    assert made is not None
    assert [made[:, 2].min(), made[:, 2].max()] == pytest.approx([0.0, 2.03], abs=0.02)
    for away in ([1.0, 0.0, 0.0], [0.0, 0.0, 0.4]):  # at no wall, or not down to the floor
        assert whole_leaves(RING, inner, HEIGHT, [leaf + np.array(away)], [True], np.zeros((0, 3)))[0] is None
