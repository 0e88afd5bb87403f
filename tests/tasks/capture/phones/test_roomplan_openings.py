"""Openings without doors and chamfered corners of captured rooms: the shell is open and follows the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from schemas.capture import Shell
from tasks.capture import CaptureConfig, find_scans, run
from tasks.capture.roomplan.room import outline_of_floors
from tasks.geometry.rendering import RayScene
from tasks.shell import room_shell
from tasks.stage import Context
from tests.tasks.capture.phones.captured_rooms import Element, captured, placed, surface, table, write

HEIGHT_M = 2.5
RECTANGLE = [(-2.0, -1.5), (2.0, -1.5), (2.0, 1.5), (-2.0, 1.5)]
CHAMFERED = [(-2.0, -1.5), (1.2, -1.5), (2.0, -0.7), (2.0, 1.5), (-2.0, 1.5)]
"""Corners of rooms by ARKit's x and z [m]."""


def panel(
    category: str, start: tuple[float, float], end: tuple[float, float], width: float | None = None, height: float = HEIGHT_M
) -> Element:
    """A wall between two corners, or a door or opening in its middle."""
    (x0, z0), (x1, z1) = start, end
    pose = placed((x0 + x1) / 2, height / 2, (z0 + z1) / 2, -float(np.arctan2(z1 - z0, x1 - x0)))
    return surface(category, pose, [float(np.hypot(x1 - x0, z1 - z0)) if width is None else width, height, 0])


def shell_of(
    folder: Path, ring: list[tuple[float, float]], ground: list[tuple[float, float]] | None = None, **lists: list[Element]
) -> Shell:
    """The shell of a room with walls along a ring, and a floor of that or another outline."""
    walls = [*(panel("wall", a, b) for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)), *lists.pop("inner", [])]
    pose = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    floor = surface("floor", pose, [4, 3, 0], polygonCorners=[[x, -z, 0] for x, z in ground or ring])
    write(folder / "room", captured(walls=walls, floors=[floor], objects=[table()], **lists))
    (scan,), _ = find_scans(folder / "room")
    outcome = run(scan=scan, context=Context(scan.scene_id, "capture", 0, {}), config=CaptureConfig())
    (shell,) = outcome.rows["shells"]
    return shell


def is_free(shell: Shell, start: tuple[float, float], end: tuple[float, float], height: float) -> bool:
    """True if no part of the shell lies between two places, by ARKit's x and z [m]."""
    a, b = np.array([start[0], -start[1], height]), np.array([end[0], -end[1], height])
    length = float(np.linalg.norm(b - a))
    ray = np.concatenate([a, (b - a) / length]).astype(np.float32)[None]
    return bool(RayScene([mesh for _, mesh in room_shell(shell)]).cast(ray)["t_hit"][0] > length)


@pytest.mark.parametrize("ring", [RECTANGLE, CHAMFERED])
def test_an_opening_without_a_door_goes_through_an_outer_wall(ring: list[tuple[float, float]], tmp_path: Path) -> None:
    back, left = ((2.0, 1.5), (-2.0, 1.5)), ((-2.0, 1.5), (-2.0, -1.5))
    shell = shell_of(
        tmp_path, ring, openings=[panel("opening", *back, width=1.1, height=2.0)], doors=[panel("door", *left, width=0.9, height=2.0)]
    )
    assert is_free(shell, (0.0, 1.0), (0.0, 3.0), 0.1)
    assert is_free(shell, (0.5, 1.0), (0.5, 3.0), 1.9)
    assert not is_free(shell, (0.0, 1.0), (0.0, 3.0), 2.2)
    assert not is_free(shell, (0.7, 1.0), (0.7, 3.0), 1.0)
    assert not is_free(shell, (-1.5, 0.0), (-3.0, 0.0), 1.0), "a door fills its opening"


def test_an_opening_in_a_slanted_wall_is_open(tmp_path: Path) -> None:
    ring = [(-2.0, -1.5), (0.5, -1.5), (2.0, 0.0), (2.0, 1.5), (-2.0, 1.5)]
    shell = shell_of(tmp_path, ring, openings=[panel("opening", (0.5, -1.5), (2.0, 0.0), width=1.1, height=2.0)])
    assert is_free(shell, (0.75, -0.25), (2.25, -1.75), 1.0)
    assert not is_free(shell, (1.65, -0.1), (2.4, -0.8), 1.0)


def test_an_opening_between_rooms_is_open(tmp_path: Path) -> None:
    middle = ((0.0, -1.5), (0.0, 1.5))
    shell = shell_of(tmp_path, RECTANGLE, inner=[panel("wall", *middle)], openings=[panel("opening", *middle, width=1.1, height=2.0)])
    assert shell.interior_walls
    assert is_free(shell, (-1.0, 0.0), (1.0, 0.0), 1.0)
    assert not is_free(shell, (-1.0, 1.2), (1.0, 1.2), 1.0)


@pytest.mark.parametrize("cut", [0.3, 0.8, 1.4])
def test_a_chamfered_corner_follows_the_file(cut: float, tmp_path: Path) -> None:
    ring = [(-2.0, -1.5), (2.0 - cut, -1.5), (2.0, cut - 1.5), (2.0, 1.5), (-2.0, 1.5)]
    shell = shell_of(tmp_path, ring)
    corners = {(round(x, 2), round(y, 2)) for x, y in shell.floor_polygon}
    assert corners == {(round(x, 2), round(-z, 2)) for x, z in ring}
    assert shell.floor_area_m2 == pytest.approx(12.0 - cut * cut / 2, abs=1e-3)
    assert not is_free(shell, (0.0, 0.0), (2.0, -1.5), 1.0)


def test_a_slanted_part_of_a_floor_is_not_the_floor(tmp_path: Path) -> None:
    """A floor that was captured in part, with a border aslant: the room is estimated as without that border."""
    shell = shell_of(tmp_path, RECTANGLE, ground=[(-2.0, -1.5), (0.4, -1.5), (-0.4, 1.5), (-2.0, 1.5)])
    assert shell.floor_area_m2 > 7.5, "the part has 6 m2"


def test_the_height_of_a_ground_is_that_of_a_floor_with_an_area() -> None:
    flat, empty = trimesh.creation.box((2.0, 2.0, 0.1)).apply_translation([0, 0, 1.05]), trimesh.Trimesh()
    ground = outline_of_floors([empty, flat])
    assert ground is not None
    assert np.allclose(ground[:, 2], 1.0)
    assert outline_of_floors([empty]) is None
