"""Walls with doors and windows: what is cut out of them, from what was scanned, and that it is seen from inside."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.capture import Shell
from tasks.capture.rooms.openings import open_sides, wall_openings
from tasks.optimization.solids import shell_solids
from tasks.shell import ShellConfig, is_open_side, room_shell, wall_of
from tests.replicas import room_of

SQUARE = ((0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0))
NONE = np.zeros((0, 6))
HEIGHT = 2.6


def plate(wall: int, low: float, high: float, bottom: float, top: float, front: float, back: float) -> np.ndarray:
    """Points of a flat box in a wall of the square room: between distances along it, heights, and depths behind its inner face [m]."""
    start = np.array(SQUARE[wall])
    end = np.array(SQUARE[(wall + 1) % 4])
    along = (end - start) / np.linalg.norm(end - start)
    out = np.array([along[1], -along[0]])
    s, d, z = (g.ravel() for g in np.meshgrid(np.linspace(low, high, 40), np.linspace(front, back, 3), np.linspace(bottom, top, 40)))
    return np.column_stack([start + s[:, None] * along + d[:, None] * out, z])


def contains(shell: list[tuple[str, trimesh.Trimesh]], points: np.ndarray) -> np.ndarray:
    """Which points are inside of any part, all of which are convex, shape (n,)."""
    inside = np.zeros(len(points), dtype=bool)
    for _, mesh in shell:
        inside |= (np.einsum("nfk,fk->nf", points[:, None] - mesh.triangles[:, 0], mesh.face_normals) < 0).all(axis=1)
    return inside


@st.composite
def openings(draw: st.DrawFn) -> tuple[int, float, float, float, float, float]:
    """Wall, interval along it, bottom, top, depth [m], 0 where nothing fills the opening."""
    wall = draw(st.integers(0, 3))
    length = (5.0, 4.0)[wall % 2]
    low, high = draw(st.sampled_from([(0.0, length), (0.0, 1.0), (length - 1.2, length), (0.05, 0.9), (1.3, 2.4), (0.7, 3.3)]))
    bottom = draw(st.sampled_from([0.0, 0.3, 0.9]))
    depth = draw(st.just(0.0) | st.floats(0.01, 0.3))
    return wall, low, high, bottom, draw(st.sampled_from([bottom + 0.5, 2.0, HEIGHT, HEIGHT + 0.5])), depth


def cut(rows: list[tuple[int, float, float, float, float, float]]) -> Shell:
    made = []
    for wall, low, high, bottom, top, depth in rows:
        start, end = np.array(SQUARE[wall]), np.array(SQUARE[(wall + 1) % 4])
        along = (end - start) / np.linalg.norm(end - start)
        made.append((*(start + low * along).tolist(), *(start + high * along).tolist(), bottom, top, depth))
    return dataclasses.replace(room_of(polygon=SQUARE), openings=tuple(made))


@pytest.mark.whole
@given(st.lists(openings(), max_size=3))
@settings(max_examples=30, deadline=None)
def test_walls_are_solid_all_but_their_openings(rows: list[tuple[int, float, float, float, float, float]]) -> None:
    room = cut(rows)
    shell = room_shell(room)
    names = [name for name, _ in shell]
    assert len(set(names)) == len(names)
    assert all(mesh.is_volume and mesh.is_convex and mesh.volume > 0 for _, mesh in shell)
    assert [solid.name for solid in shell_solids(room)] == list(dict.fromkeys(wall_of(name) for name in names[1:])) == names_of_walls()
    thickness, panel = ShellConfig().thickness_m, ShellConfig().panel_m
    rng = np.random.default_rng(0)
    for wall in range(4):
        length = (5.0, 4.0)[wall % 2]
        along, height, depth = rng.uniform([0, 0, 0], [length, HEIGHT, thickness], (200, 3)).T
        start = np.array(SQUARE[wall])
        way = (np.array(SQUARE[(wall + 1) % 4]) - start) / length
        points = np.column_stack([start + along[:, None] * way + depth[:, None] * [way[1], -way[0]], height])
        free, closed = np.zeros((2, 200), dtype=bool)
        for which, low, high, bottom, top, deep in rows:
            front = max(deep, thickness - panel)
            wider = panel if front + panel > thickness else 0.0
            if which == wall:
                free |= (along > low) & (along < high) & (height > bottom) & (height < min(top, HEIGHT))
                across = (along > low - wider) & (along < high + wider) & (height > bottom - wider) & (height < top + wider)
                closed |= (deep > 0.0) & (depth > front) & across
        np.testing.assert_array_equal(contains(shell, points), ~free | closed)


def names_of_walls() -> list[str]:
    return [f"wall_{index:02d}" for index in range(4)]


@given(openings(), st.floats(-0.05, 0.08), st.floats(0.02, 0.06))
@settings(max_examples=30, deadline=None)
def test_what_was_scanned_in_a_wall_is_its_opening_and_is_seen_from_inside(
    row: tuple[int, float, float, float, float, float], front: float, thickness: float
) -> None:
    wall, low, high, bottom, top, _ = row
    low, high, top = max(low, 0.03), min(high, (5.0, 4.0)[wall % 2] - 0.03), min(top, HEIGHT)
    points = plate(wall, low, high, bottom, top, front, front + thickness)
    made = wall_openings(np.array(SQUARE), NONE, HEIGHT, [points])
    assert len(made) == 1
    room = dataclasses.replace(room_of(polygon=SQUARE), openings=made)
    leaf = trimesh.convex.convex_hull(points)
    eyes = np.array([2.5, 2.0, 1.4])
    inside = plate(wall, low + 0.05, high - 0.05, bottom + 0.05, top - 0.05, front, front)
    directions = inside - eyes
    assert seen(leaf, room_shell(room), eyes, directions) > 0.97
    behind = plate(wall, low, high, bottom, top, max(front, 0.005), max(front, 0.005) + thickness)
    assert seen(trimesh.convex.convex_hull(behind), room_shell(room_of(polygon=SQUARE)), eyes, directions) == 0.0


U_SHAPE = ((0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (2.1, 4.0), (2.1, 1.0), (2.0, 1.0), (2.0, 4.0), (0.0, 4.0))
L_SHAPE = ((0.0, 0.0), (5.0, 0.0), (5.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0))


@given(
    polygon=st.sampled_from([SQUARE, U_SHAPE, L_SHAPE]), wall=st.integers(0, 7), ends=st.sampled_from([(0.0, 1.0), (0.0, 0.4), (0.3, 1.0)]),
    depth=st.floats(0.01, 0.46), top=st.sampled_from([0.8, 2.0, HEIGHT]), seed=st.integers(0, 5),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_a_room_is_closed_around_and_free_inside_whatever_is_filled(
    polygon: tuple[tuple[float, float], ...], wall: int, ends: tuple[float, float], depth: float, top: float, seed: int
) -> None:
    start, end = (np.array(polygon[(wall + i) % len(polygon)]) for i in range(2))
    low, high = (start + share * (end - start) for share in ends)
    room = dataclasses.replace(room_of(polygon=polygon), openings=((*low.tolist(), *high.tolist(), 0.0, top, depth),))
    shell = room_shell(room)
    ring = shapely.Polygon(polygon)
    for name, mesh in shell[1:]:
        assert mesh.is_volume, name
        assert mesh.volume > 0, name
        assert shapely.MultiPoint(np.asarray(mesh.vertices)[:, :2]).convex_hull.intersection(ring).area < 1e-6, "walls stand outside"
    rng = np.random.default_rng(seed)
    turns = rng.uniform(0, 2 * np.pi, 150)
    eyes = np.column_stack([np.tile([1.0, 0.5], (150, 1)), rng.uniform(0.05, HEIGHT - 0.05, 150)])
    every = trimesh.util.concatenate([mesh for _, mesh in shell])
    assert every.ray.intersects_any(eyes, np.column_stack([np.cos(turns), np.sin(turns), np.zeros(150)])).all()


@given(
    polygon=st.sampled_from([SQUARE, L_SHAPE]), wall=st.integers(0, 5), width=st.floats(0.5, 1.5), top=st.floats(0.8, HEIGHT),
    share=st.floats(0.02, 0.98), height=st.floats(0.02, 0.98),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_a_passage_is_open_through_its_wall_and_its_wall_closed_around(
    polygon: tuple[tuple[float, float], ...], wall: int, width: float, top: float, share: float, height: float
) -> None:
    start, end = (np.array(polygon[(wall + i) % len(polygon)]) for i in range(2))
    length = float(np.linalg.norm(end - start))
    along, middle = (end - start) / length, 0.5 * length
    corners = np.array([[*(start + (middle + side * width / 2) * along), z] for side in (-1, 1) for z in (0.0, top)])
    (row,) = wall_openings(np.array(polygon), NONE, HEIGHT, [], [corners])
    assert row[6] == 0.0
    every = trimesh.util.concatenate([mesh for _, mesh in room_shell(dataclasses.replace(room_of(polygon=polygon), openings=(row,)))])
    out = np.array([along[1], -along[0], 0.0])

    def is_closed(at: float, z: float) -> bool:
        eye = np.array([*(start + at * along), z]) - 0.1 * out
        return bool(every.ray.intersects_any(eye[None], out[None])[0])

    assert not is_closed(middle + (share - 0.5) * width, height * top)
    assert is_closed(middle + width / 2 + 0.05, height * top)
    assert is_closed(middle - width / 2 - 0.05, height * top)


def test_a_passage_that_overlaps_a_door_is_filled_with_it() -> None:
    door = plate(0, 1.0, 1.9, 0.0, 2.0, 0.0, 0.04)
    passage = np.array([[x, 0.0, z] for x in (1.5, 2.5) for z in (0.0, 2.0)])
    apart = np.array([[x, 0.0, z] for x in (3.0, 4.0) for z in (0.0, 2.0)])
    joined, alone = wall_openings(np.array(SQUARE), NONE, HEIGHT, [door], [passage, apart])
    assert joined[6] > 0.0
    assert (joined[0], joined[2]) == pytest.approx((1.0, 2.5), abs=0.02)
    assert alone[6] == 0.0


def test_a_window_over_the_height_of_the_room_is_no_opening() -> None:
    assert wall_openings(np.array(SQUARE), NONE, 2.5, [plate(0, 1.0, 2.0, 2.55, 3.2, 0.0, 0.04)]) == ()
    assert wall_openings(np.array(SQUARE), NONE, 2.5, [plate(0, 1.0, 2.0, 2.49, 3.2, 0.0, 0.04)]) == ()


def seen(leaf: trimesh.Trimesh, shell: list[tuple[str, trimesh.Trimesh]], eyes: np.ndarray, directions: np.ndarray) -> float:
    """Share of rays to a leaf that no part of the shell stops before it."""
    every = trimesh.util.concatenate([leaf, *(mesh for _, mesh in shell)])
    first = every.ray.intersects_first(np.tile(eyes, (len(directions), 1)), directions)
    return float(((first >= 0) & (first < len(leaf.faces))).mean())


def test_a_door_of_an_interior_wall_goes_through_it() -> None:
    inner = ((2.5, 0.0, 2.5, 4.0, 0.1, HEIGHT),)
    leaf = np.array([[x, y, z] for x in (2.47, 2.53) for y in np.linspace(1, 1.9, 30) for z in np.linspace(0, 2.0, 30)])
    made = wall_openings(np.array(SQUARE), np.array(inner), HEIGHT, [leaf])
    np.testing.assert_allclose(made, [(2.5, 1.0, 2.5, 1.9, 0.0, 2.0, 0.0)], atol=0.03)
    shell = room_shell(dataclasses.replace(room_of(polygon=SQUARE), interior_walls=inner, openings=made))
    points = np.array([[2.5, 1.5, 1.0], [2.5, 0.5, 1.0], [2.5, 1.5, 2.2], [2.5, 2.5, 1.0]])
    assert contains(shell, points).tolist() == [False, True, True, True]


def test_two_leaves_that_overlap_are_one_opening() -> None:
    leaves = [plate(0, 1.0, 2.0, 0.0, 2.0, 0.0, 0.04), plate(0, 1.8, 2.6, 0.0, 2.1, 0.0, 0.04), plate(0, 3.5, 4.2, 0.9, 2.0, 0.0, 0.04)]
    made = wall_openings(np.array(SQUARE), NONE, HEIGHT, leaves)
    np.testing.assert_allclose([(*row[:2], *row[2:4], *row[4:6]) for row in made], [
        (1.0, 0.0, 2.6, 0.0, 0.0, 2.1), (3.5, 0.0, 4.2, 0.0, 0.9, 2.0),
    ], atol=0.05)  # fmt: skip


@pytest.mark.parametrize(
    ("points", "why"),
    [
        (plate(0, 1.0, 1.2, 0.0, 2.0, 0.0, 0.04), "narrow: seen in part"),
        (plate(0, 1.0, 1.9, 0.0, 2.0, -0.8, -0.76), "a cupboard's door in the room"),
        (plate(0, 1.0, 1.9, 0.0, 2.0, -0.9, 0.0), "a leaf that stands open"),
        (plate(0, 1.0, 1.9, 0.0, 2.0, 0.6, 0.64), "of the next room"),
    ],
)
def test_what_fills_no_wall_opens_none(points: np.ndarray, why: str) -> None:
    assert wall_openings(np.array(SQUARE), NONE, HEIGHT, [points]) == (), why


def test_nothing_is_left_of_walls_that_are_openings() -> None:
    """A floor without walls around it: no posts in the corners, no solids, and the other walls stay if only one side is open."""
    sides = open_sides(np.array(SQUARE), HEIGHT)
    free = dataclasses.replace(cut([]), openings=sides)
    assert [name for name, _ in room_shell(free)] == ["floor"]
    assert shell_solids(free) == ()
    one = dataclasses.replace(cut([]), openings=sides[1:2])
    assert {wall_of(name) for name, _ in room_shell(one)} == {"floor", "wall_00", "wall_02", "wall_03"}
    assert [is_open_side(one, np.array(SQUARE[k]), np.array(SQUARE[(k + 1) % 4])) for k in range(4)] == [False, True, False, False]
