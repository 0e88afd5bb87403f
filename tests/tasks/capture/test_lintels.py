"""Lintels: what was seen of walls over doorways stands in replicas, passes the gates and is in nobody's way."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.capture import Shell
from schemas.families.export_formats import EXPORT_FORMATS
from tasks import navigation
from tasks.capture.cloud import Cloud, dense_cloud
from tasks.capture.labels import FLOOR, WALL
from tasks.capture.rooms.lintels import lintels
from tasks.capture.rooms.room import RoomShape, estimate_room
from tasks.navigation.planar import PlanarConfig
from tasks.navigation.recast import RecastConfig
from tasks.optimization.solids import shell_solids
from tasks.shell import lintel_footprints, room_shell, wall_of
from tests.replicas import furnished, room_of, rows_of, with_navigation
from tests.tasks.capture.test_partitions import DEPTH, HEIGHT, Piece, assembled, shell, solid_piece, wall_with_door, with_walls
from tests.tasks.exports.test_exports import export
from tests.tasks.navigation.test_navigation import furnished as objects_in_a_room
from tests.tasks.navigation.test_navigation import native, solid

CLASSES = {"floor": FLOOR, "wall": WALL, "threshold": WALL, "door": 8, "cupboard": 3}
OPEN_TOP_M = 2.05
"""Where the doorway of `wall_with_door` ends [m]."""

WALLS = [(2.83, 0.0, 2.83, 1.6, 0.1, 2.5), (2.83, 2.6, 2.83, 4.0, 0.1, 2.5)]
LINTEL = (2.83, 1.6, 2.83, 2.6, 0.1, 2.05, 2.5)


def seen(pieces: list[Piece], noise: float = 0.0) -> tuple[Cloud, np.ndarray, RoomShape]:
    """Points, their classes and the room of pieces."""
    room = assembled(pieces, noise)
    cloud = dense_cloud(room.surface, room.instance)
    classes = np.array([CLASSES[label] for label in room.labels])[cloud.instance]
    return cloud, classes, estimate_room(cloud, classes)


def found(pieces: list[Piece], noise: float = 0.0, leaves: list[np.ndarray] | None = None) -> tuple[tuple[float, ...], ...]:
    cloud, classes, shape = seen(pieces, noise)
    return lintels(cloud, classes == WALL, shape.polygon, shape.interior_walls, leaves or ())


def with_lintel(room: Shell) -> Shell:
    return with_walls(room, WALLS, lintels=(LINTEL,))


@pytest.mark.whole
@given(x=st.floats(1.2, 4.8), thickness=st.floats(0.08, 0.3), start=st.floats(0.6, 2.4), width=st.floats(0.75, 1.2), noise=st.booleans())
@settings(max_examples=15, deadline=None)
def test_the_wall_over_a_doorway_is_found_where_it_was_seen(x: float, thickness: float, start: float, width: float, noise: bool) -> None:
    (row,) = found([*shell(), *wall_with_door(x, thickness, (start, start + width))], 0.004 if noise else 0.0)
    assert [row[0], row[2]] == pytest.approx([x, x], abs=0.03)
    assert sorted([row[1], row[3]]) == pytest.approx([start, start + width], abs=0.03)
    assert row[4:] == pytest.approx([thickness, OPEN_TOP_M, HEIGHT], abs=0.04)


def test_a_doorway_up_to_the_ceiling_has_none() -> None:
    assert found([*shell(), *wall_with_door()[:2]]) == ()


def test_a_lintel_hides_no_part_of_the_door_below_it() -> None:
    leaf = np.stack(np.meshgrid([3.0], np.linspace(2.42, 3.28, 20), np.linspace(0.0, 2.12, 40), indexing="ij"), axis=-1).reshape(-1, 3)
    ((*_, bottom, top),) = found([*shell(), *wall_with_door()], leaves=[leaf])
    assert (bottom, top) == pytest.approx((2.12, HEIGHT), abs=0.03)
    assert bottom > np.percentile(leaf[:, 2], 99)
    beside = leaf + np.array([1.0, 0.0, 0.0])
    assert found([*shell(), *wall_with_door()], leaves=[beside]) == found([*shell(), *wall_with_door()])


def test_a_threshold_that_is_called_wall_keeps_its_doorway_open() -> None:
    """The floor below a doorway is annotated with the wall around it: wall above and, by its name, nothing else below."""
    door = (2.4, 3.3)
    a, b = 2.9, 3.1
    floors = [solid_piece("floor", (0, 0, -0.1), (a, DEPTH, 0)), solid_piece("floor", (b, 0, -0.1), (6.0, DEPTH, 0))]
    threshold = solid_piece("threshold", (a, door[0], -0.1), (b, door[1], 0.0))
    pieces = [*floors, *shell()[1:], *wall_with_door(3.0, 0.2, door), threshold]
    _, _, shape = seen(pieces)
    ends = np.sort(shape.interior_walls[:, [1, 3]].ravel())
    assert ends == pytest.approx([0.0, 2.4, 3.3, DEPTH], abs=0.04)
    assert len(found(pieces)) == 1


# replica


def test_a_lintel_is_a_closed_piece_of_the_wall_that_goes_on() -> None:
    room = with_lintel(room_of(polygon=((0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (0.0, 4.0))))
    parts = dict(room_shell(room))
    before = dict(room_shell(dataclasses.replace(room, lintels=())))
    assert sorted(set(parts) - set(before)) == ["inner_00_1"]
    assert wall_of("inner_00_1") == "inner_00"
    mesh = parts["inner_00_1"]
    assert mesh.is_watertight
    assert mesh.bounds == pytest.approx(np.array([[2.78, 1.6, 2.05], [2.88, 2.6, 2.5]]))
    assert mesh.volume == pytest.approx(1.0 * 0.1 * 0.45)
    for name, part in before.items():
        assert np.array_equal(part.vertices, parts[name].vertices)
    solids = {solid.name: solid for solid in shell_solids(room)}
    assert [len(solids[name].hulls) for name in ("inner_00", "inner_01")] == [2, 1]


@pytest.mark.parametrize("lost", [None, ()])
def test_rooms_without_lintels_are_what_they_were(lost: tuple[()] | None) -> None:
    room = with_walls(room_of(), [(0.6, -2.0, 0.6, -0.6, 0.12, 2.6)], lintels=lost)
    assert sorted(name for name, _ in room_shell(room) if name.startswith("inner")) == ["inner_00"]
    assert lintel_footprints(room, 3.0) == []


def test_every_export_with_a_lintel_passes_its_gate() -> None:
    rows, blobs = rows_of(furnished())
    walls = [(0.6, -2.0, 0.6, -0.6, 0.12, 2.6), (0.6, 0.4, 0.6, 2.0, 0.12, 2.6)]
    rows["shells"] = [with_walls(rows["shells"][0], walls, lintels=((0.6, -0.6, 0.6, 0.4, 0.12, 2.05, 2.6),))]
    outcome = export(*with_navigation(rows, blobs))
    assert {row.format for row in outcome.rows["export_checks"]} == set(EXPORT_FORMATS)
    assert [f"{row.format} {row.rule}: {row.message}" for row in outcome.rows["export_checks"] if not row.passed] == []
    assert outcome.degradations == ()


# navigation


def paths(room: Shell, height_m: float, finder: Any) -> dict[str, list[Any]]:
    """Rows of the navigation of a room with two objects, without what names the blob of a navmesh."""
    tables, context = objects_in_a_room({
        "0001": ("bed", [solid((0.8, 1.9, 0.5))], (1.2, 1.2, 0.0), 0.0), "0002": ("chair", [solid((0.5, 0.5, 0.9))], (4.2, 3.0, 0.0), 0.0),
    })  # fmt: skip
    tables["shells"] = [dataclasses.replace(room, floor_polygon=tables["shells"][0].floor_polygon)]
    agent = dataclasses.replace(navigation.NavigationConfig().agent, height_m=height_m)
    config = navigation.NavigationConfig(train_episodes=4, test_episodes=4, agent=agent, path_finder=finder)
    return navigation.run(**tables, context=context, config=config).rows


@pytest.mark.parametrize("finder", [pytest.param(PlanarConfig(), id="planar"), pytest.param(RecastConfig(), id="recast", marks=native)])
@pytest.mark.parametrize("height_m", [0.88, 1.5, 1.8])
def test_agents_pass_below_a_lintel_as_if_it_were_not_there(height_m: float, finder: Any) -> None:
    room = objects_in_a_room({})[0]["shells"][0]
    over, bare = (paths(with_walls(room, WALLS, lintels=rows), height_m, finder) for rows in ((LINTEL,), ()))
    assert over["episodes"]
    assert over["episodes"] == bare["episodes"]
    assert over["unreachable_targets"] == bare["unreachable_targets"]
    (mine,), (theirs,) = over["navmeshes"], bare["navmeshes"]
    assert mine == theirs


def test_agents_that_are_taller_do_not() -> None:
    room = objects_in_a_room({})[0]["shells"][0]
    assert paths(with_lintel(room), 2.2, PlanarConfig()) != paths(with_walls(room, WALLS), 2.2, PlanarConfig())
    assert len(lintel_footprints(with_lintel(room), 2.2)) == 1
    assert lintel_footprints(with_lintel(room), 2.0) == []
