"""Half-height walls: found as high as they are, and no shelf, sill or wall of which only the lower part was seen among them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.optimization.support.walls import wall_faces
from tasks.shell import room_shell
from tests.replicas import room_of
from tests.tasks.capture.test_partitions import HEIGHT, estimated, shell, solid_piece


@pytest.mark.whole
@given(
    st.floats(0.7, 1.55), st.floats(0.06, 0.22), st.floats(0.9, 2.0), st.floats(2.0, 4.0), st.sampled_from([0.0, 0.5, 1.0, 1.57]),
    st.booleans(),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_a_half_height_wall_is_as_high_long_and_thick_as_it_was_scanned(
    height: float, thickness: float, length: float, x: float, yaw: float, is_noisy: bool
) -> None:
    low = solid_piece("wall", (x - length / 2, 1.9 - thickness / 2, 0.0), (x + length / 2, 1.9 + thickness / 2, height), yaw)
    shape = estimated([*shell(), low], noise=0.003 if is_noisy else 0.0)
    (wall,) = shape.interior_walls
    assert shape.height == pytest.approx(HEIGHT, abs=0.03)
    assert wall[5] == pytest.approx(height, abs=0.03)
    assert wall[4] == pytest.approx(max(thickness, 0.04), abs=0.03)
    assert math.hypot(*(wall[2:4] - wall[:2])) == pytest.approx(length, abs=0.06)
    assert np.abs((wall[:2] + wall[2:4]) / 2 - [x, 1.9]).max() < 0.05
    angle = math.atan2(wall[3] - wall[1], wall[2] - wall[0])
    assert abs((angle - yaw + math.pi / 2) % math.pi - math.pi / 2) < 0.05


def test_one_that_stands_at_a_wall_reaches_it_and_is_as_low_in_the_replica_as_in_the_scan() -> None:
    shape = estimated([*shell(), solid_piece("wall", (0.02, 1.9, 0), (1.3, 2.0, 1.0))])
    (wall,) = shape.interior_walls
    assert np.allclose(np.sort(wall[[0, 2]]), [0.0, 1.3], atol=0.03)
    assert not shape.notes
    row = shape.row("scans/one", [])
    tops = {name: part.bounds[1][2] for name, part in room_shell(row) if isinstance(part, trimesh.Trimesh)}
    assert tops["inner_00"] == pytest.approx(1.0, abs=0.03)
    assert {round(tops[f"wall_{i:02d}"], 2) for i in range(4)} == {round(shape.height, 2)}


def test_with_its_far_side_unseen_it_is_as_thick_as_its_top() -> None:
    low = solid_piece("wall", (2.0, 1.9, 0), (3.5, 2.05, 1.1))
    (wall,) = estimated([*shell(), low], without=(1.9, 2.04, 0.0, 3.6, 2.06, 1.08)).interior_walls
    assert wall[4] == pytest.approx(0.15, abs=0.04)
    assert wall[5] == pytest.approx(1.1, abs=0.03)


@pytest.mark.parametrize(
    "piece",
    [
        solid_piece("wall", (2.0, 1.5, 0), (3.5, 2.1, 0.9)),  # as deep as a counter
        solid_piece("wall", (2.0, 1.9, 0), (3.5, 2.0, 0.3)),  # a step
        solid_piece("wall", (2.0, 1.9, 0.7), (3.5, 2.0, 0.9)),  # a board in the air
        solid_piece("counter", (2.0, 1.9, 0), (3.5, 2.0, 0.9)),  # nobody calls it a wall
        solid_piece("wall", (1.0, 0.01, 0), (3.5, 0.2, 1.0)),  # in front of a wall: there is no room behind
    ],
    ids=["counter", "step", "board", "unnamed", "plinth"],
)
def test_what_is_no_wall_stays_none(piece: tuple[str, tuple[np.ndarray, np.ndarray]]) -> None:
    assert not [wall for wall in estimated([*shell(), piece]).interior_walls if wall[5] < 1.2]


def test_a_wall_that_goes_on_above_what_was_seen_of_it_is_no_low_one() -> None:
    wall = solid_piece("wall", (3.0, 0, 0), (3.1, 2.4, HEIGHT))
    (row,) = estimated([*shell(), wall], without=(2.8, -0.1, 1.3, 3.3, 2.6, 2.0)).interior_walls
    assert row[5] == pytest.approx(HEIGHT, abs=0.03)


def test_nothing_hangs_in_the_air_above_a_half_height_wall() -> None:
    sides = ((2.0, 1.55, 3.5, 1.55), (3.5, 1.45, 2.0, 1.45))
    faces = wall_faces(dataclasses.replace(room_of("scans/one"), interior_walls=((2.0, 1.5, 3.5, 1.5, 0.1, 1.0),), walls=sides))
    low = [face for face in faces if face.length == pytest.approx(1.5) and face.start[1] in (pytest.approx(1.45), pytest.approx(1.55))]
    assert len(low) >= 2
    assert {round(face.height, 3) for face in low} == {1.0}
