"""Rooms out of an outline and its walls: right on planned dwellings, disjoint, inside the outline, and nothing lost but walls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bench.dwellings import make_scan
from bench.dwellings.judgement import shared_floors
from schemas.capture import Instance, Shell
from schemas.record import check
from tasks import capture
from tasks.capture.formats import find_scans
from tasks.capture.rooms.rows import SEVERAL, parted
from tasks.capture.rooms.separation import LEAST_ROOM_M2, Separation, corners_of, separated
from tasks.furniture.dwellings.plans import PARTITION_M, FloorPlan, floor_plan
from tasks.geometry.transforms import flat, inverse, matrix, yaw_pose
from tasks.stage import Blobs, Context
from tests.samples import sample

Array = NDArray[np.float64]
Wall = tuple[float, ...]
RECTANGLE = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 5.0], [0.0, 5.0]])


def shell_of(plan: FloorPlan) -> tuple[Array, list[Wall]]:
    """Outline and interior walls of a plan, as a perfect scan would show them: walls end at doorways and passages."""
    floors = [shapely.Polygon(room.polygon).buffer(0.2, join_style="mitre") for room in plan.rooms]
    outline = shapely.union_all(floors).buffer(-0.2, join_style="mitre").simplify(1e-6)
    walls: list[Wall] = []
    for index, room in enumerate(plan.rooms):
        for number, face in enumerate(room.walls):
            middle = face.start - 0.5 * PARTITION_M * face.inward
            for low, high, other in room.shared[number]:
                if other < index:
                    continue
                holes = sorted(o.span for o in plan.openings_of(index, number) if o.to == other)
                edges = [low - 0.5 * PARTITION_M, *(edge for span in holes for edge in span), high + 0.5 * PARTITION_M]
                for start, end in zip(edges[::2], edges[1::2], strict=True):
                    ends = (*(middle + start * face.along), *(middle + end * face.along))
                    walls.append((*map(float, ends), PARTITION_M, plan.height))
    return np.asarray(shapely.geometry.polygon.orient(outline).exterior.coords)[:-1], walls


def shared(room: shapely.Polygon, true: shapely.Polygon) -> float:
    return float(room.intersection(true).area / room.union(true).area)


def check_rooms(outline: Array, walls: list[Wall], found: Separation) -> None:
    """What holds of every separation: floors are rings without holes, large enough, disjoint and inside; the rest is walls, doorways
    and parts too small for a room."""
    whole = shapely.Polygon(outline)
    assert found.rooms
    for room in found.rooms:
        assert room.is_valid
        assert not room.interiors
        assert room.exterior.is_ccw
        assert room.difference(whole.buffer(1e-6)).area < 1e-6
        assert room.area >= LEAST_ROOM_M2 - 0.01 or len(found.rooms) == 1
        ring = corners_of(room)
        assert tuple(ring[0]) == min(map(tuple, ring))
        assert shapely.Polygon(ring).equals_exact(shapely.Polygon(ring), 0.0)
        assert shared(shapely.Polygon(ring), room) > 0.9999
    areas = [room.area for room in found.rooms]
    assert areas == pytest.approx(sorted(areas, reverse=True), abs=2e-3)
    union = shapely.union_all(found.rooms)
    assert union.area == pytest.approx(sum(areas), abs=1e-3), "rooms lie over one another"
    # no floor is lost: what is in no room is wall or doorway, or too small
    solid = [_footprint(wall).buffer(0.05, join_style="mitre") for wall in walls]
    rest = whole.difference(shapely.union_all([union, found.doorways.buffer(0.05, join_style="mitre"), *solid]))
    assert all(part.area < LEAST_ROOM_M2 for part in shapely.get_parts(rest))
    assert found.doorways.is_valid
    assert found.doorways.intersection(union).area < 0.01


def _footprint(wall: Wall) -> shapely.Polygon:
    return shapely.LineString([wall[:2], wall[2:4]]).buffer(0.5 * wall[4], cap_style="flat")


@pytest.mark.parametrize("first", range(0, 60, 20))
def test_rooms_of_planned_dwellings_come_out_right(first: int) -> None:
    for seed in range(first, first + 20):
        rng = np.random.default_rng(seed)
        plan = floor_plan(int(rng.integers(40, 81)), rng)
        outline, walls = shell_of(plan)
        found = separated(outline, walls)
        check_rooms(outline, walls, found)
        assert len(found.rooms) == len(plan.rooms), seed
        for room in plan.rooms:
            assert max(shared(own, shapely.Polygon(room.polygon)) for own in found.rooms) > 0.98, (seed, room.kind)


@st.composite
def partitioned(draw: st.DrawFn) -> tuple[Array, list[Wall]]:
    """A rectangle or an L with walls anywhere in it, across one another, through the outline, thick and thin, low and high."""
    width, depth = draw(st.floats(1.5, 12.0)), draw(st.floats(1.5, 12.0))
    corners = [(0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)]
    if draw(st.booleans()):
        x, y = draw(st.floats(0.2, 0.8)) * width, draw(st.floats(0.2, 0.8)) * depth
        corners = [(0.0, 0.0), (width, 0.0), (width, y), (x, y), (x, depth), (0.0, depth)]
    walls: list[Wall] = []
    for _ in range(draw(st.integers(0, 6))):
        ends = [draw(st.floats(-0.3, side + 0.3)) for side in (width, depth, width, depth)]
        if draw(st.booleans()):
            ends[2 + draw(st.integers(0, 1))] = ends[draw(st.integers(0, 1))]
        walls.append((*ends, draw(st.floats(0.04, 0.36)), draw(st.sampled_from([1.2, 2.0, 2.6]))))
    return np.array(corners), walls


SLIVER = (
    np.array([[0.0, 0.0], [9.078125, 0.0], [9.078125, 1.5], [0.0, 1.5]]),
    [(2.1009245235674556, 0.17374988704425876, 0.917996033761385, 1.765963590284146, 0.04, 2.0)],
)
"""An outline, and an askew wall that leaves a sliver of a doorway."""

CROSSING = (
    np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 9.0], [0.0, 9.0]]),
    [(7.15625, 0.15625, 1.5, 9.0, 0.0625, 2.0), (7.25, 0.0, 0.0, 1.0, 0.15625, 2.0)],
)
"""Two askew walls that cross beside the outline: rounding once took the largest of three rooms away."""


TOUCHING = (
    np.array([[-3.0, -2.0], [1.1, -2.0], [1.1, -3.7], [3.0, -3.7], [3.0, 1.0], [1.0, 1.0], [1.0, 2.0], [-3.0, 2.0]]),
    [(3.0, -2.05, 1.1, -2.05, 0.1, 2.6)],
)
"""A wall whose doorway touches the outline along a line."""


@given(partitioned())
@example(SLIVER)
@example(CROSSING)
@example(TOUCHING)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_rooms_are_disjoint_inside_and_nothing_is_lost_but_walls(made: tuple[Array, list[Wall]]) -> None:
    outline, walls = made
    found = separated(outline, walls)
    check_rooms(outline, [wall for wall in walls if wall[5] > 1.6], found)
    again = separated(outline, list(reversed(walls)))
    assert len(again.rooms) == len(found.rooms)
    for one_way, other_way in zip(found.rooms, again.rooms, strict=True):  # which corner is on which side of a rounded digit differs
        assert corners_of(other_way) == pytest.approx(corners_of(one_way), abs=3e-6)


@given(st.floats(0.5, 1.9), st.floats(1.5, 6.5), st.floats(0.05, 0.3))
@settings(deadline=None)
def test_a_gap_in_a_wall_is_a_doorway(gap: float, at: float, thickness: float) -> None:
    """Of a wall that goes on behind it."""
    rest = (5.0 - gap) / 2
    walls = [(at, 0.0, at, rest, thickness, 2.5), (at, rest + gap, at, 5.0, thickness, 2.5)]
    found = separated(RECTANGLE, walls)
    assert len(found.rooms) == 2
    assert sum(room.area for room in found.rooms) == pytest.approx(5.0 * (8.0 - thickness), rel=0.01)


@pytest.mark.parametrize(("length", "count"), [(5.0, 2), (4.2, 2), (3.9, 2), (3.7, 1), (2.0, 1)])
def test_a_wall_that_nearly_reaches_the_other_side_parts_a_room(length: float, count: int) -> None:
    found = separated(RECTANGLE, [(4.0, 0.0, 4.0, length, 0.1, 2.5)])
    assert len(found.rooms) == count
    if count == 1:  # the spur stands in the room: its floor goes round it
        assert found.rooms[0].area == pytest.approx(40.0 - 0.1 * length, abs=0.01)


def test_what_closes_a_gap_and_parts_nothing_is_floor() -> None:
    """Two walls of a closet that is open on its third side."""
    walls = [(2.0, 0.0, 2.0, 1.5, 0.1, 2.5), (3.5, 0.0, 3.5, 1.5, 0.1, 2.5)]
    found = separated(RECTANGLE, walls)
    assert len(found.rooms) == 1
    assert found.rooms[0].area == pytest.approx(40.0 - 2 * 0.15, abs=0.02)


def test_a_low_wall_parts_nothing_and_a_pillar_is_in_its_room() -> None:
    assert separated(RECTANGLE, [(4.0, 0.0, 4.0, 5.0, 0.1, 1.25)]).rooms[0].area == pytest.approx(40.0)
    assert separated(RECTANGLE, [(3.8, 2.5, 4.2, 2.5, 0.4, 2.5)]).rooms[0].area == pytest.approx(40.0)


def test_a_room_in_the_middle_of_another_is_not_in_it() -> None:
    walls = [(3.0, 1.5, 5.0, 1.5, 0.1, 2.5), (5.0, 1.5, 5.0, 3.5, 0.1, 2.5), (5.0, 3.5, 3.0, 3.5, 0.1, 2.5), (3.0, 3.5, 3.0, 1.5, 0.1, 2.5)]
    found = separated(RECTANGLE, walls)
    assert len(found.rooms) == 2
    check_rooms(RECTANGLE, walls, found)
    assert found.rooms[0].area == pytest.approx(40.0 - 2.1**2, abs=0.05)
    assert found.rooms[1].area == pytest.approx(1.9**2, abs=0.02)


def test_a_hidden_wall_is_followed_and_an_open_floor_is_not() -> None:
    """A wall of 2 m, and on its line 3 m of which a cupboard hides what is there."""
    walls = [(4.0, 0.0, 4.0, 2.0, 0.1, 2.5)]

    def behind_cupboards(points: Array) -> NDArray[np.bool_]:
        return (np.abs(points[:, 0] - 4.0) > 0.05) | (points[:, 1] < 3.2)

    assert len(separated(RECTANGLE, walls, behind_cupboards).rooms) == 2
    assert len(separated(RECTANGLE, walls, lambda points: np.ones(len(points), dtype=np.bool_)).rooms) == 1
    assert len(separated(RECTANGLE, walls, lambda points: np.zeros(len(points), dtype=np.bool_)).rooms) == 1, "nobody looked"


@pytest.mark.parametrize("ring", [[[0, 0], [2, 2], [2, 0], [0, 2]], [[0, 0], [1, 0], [1, 0], [0, 0]]])
def test_an_outline_that_is_none_is_one_room(ring: list[list[float]]) -> None:
    assert len(separated(np.array(ring, dtype=np.float64), [(0.5, 0.0, 0.5, 1.0, 0.1, 2.5)]).rooms) == 1


# --- rows ---


def shell_row(walls: list[Wall]) -> Shell:
    row: Shell = sample(
        Shell, scene_id="demo/a", floor_polygon=tuple(map(tuple, RECTANGLE.tolist())), floor_area_m2=40.0, interior_walls=tuple(walls)
    )
    return row


def instance(number: int, category: str, x: float, y: float, **values: object) -> Instance:
    given_ = {"is_structure": False, "box_pose": flat(yaw_pose(0.3, [x, y, 0.5])), **values}
    row: Instance = sample(Instance, scene_id="demo/a", instance_id=f"{number:04d}", category=category, **given_)
    return row


TWO = [(5.0, 0.0, 5.0, 2.0, 0.1, 2.5), (5.0, 3.0, 5.0, 5.0, 0.1, 2.5)]
THINGS = [
    instance(0, "sofa", 1.0, 1.0), instance(1, "toilet", 6.5, 1.0), instance(2, "door", 4.98, 2.5), instance(3, "window", 8.1, 3.0),
    instance(4, "chair", 9.0, 3.0), instance(5, "wall", 5.0, 1.0, is_structure=True), instance(6, "coffee table", 1.0, 2.0),
]  # fmt: skip


def test_each_of_several_rooms_is_what_stands_in_it() -> None:
    shell, rooms, rows = parted(shell_row(TWO), THINGS, "")
    check(rooms, type(rooms[0]))
    assert [(room.room_index, room.room_type) for room in rooms] == [(0, "living room"), (1, "bathroom")]
    assert shell.room_type == SEVERAL
    assert [row.room_index for row in rows] == [0, 1, 0, 1, None, None, 0]
    assert [room.floor_area_m2 for room in rooms] == pytest.approx([4.95 * 5, 2.95 * 5], rel=1e-6)
    for row, before in zip(rows, THINGS, strict=True):
        assert row.box_pose == before.box_pose


def test_what_the_scan_states_is_the_kind_of_the_one_room_or_of_the_whole() -> None:
    shell, rooms, _ = parted(shell_row(TWO), THINGS, "apartment")
    assert (shell.room_type, [room.room_type for room in rooms]) == ("apartment", ["living room", "bathroom"])
    shell, rooms, _ = parted(shell_row([]), THINGS, "office")
    assert (shell.room_type, [room.room_type for room in rooms]) == ("office", ["office"])
    shell, rooms, _ = parted(shell_row([]), THINGS, "")
    assert shell.room_type == rooms[0].room_type == "bathroom"
    assert rooms[0].floor_polygon == shell.floor_polygon


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize(("index", "least"), [(1, 0.95), (3, 0.95)])
def test_rooms_are_found_in_hard_scans(tmp_path: Path, index: int, least: float) -> None:
    """With walls estimated from a scan of which a third is missing: one where walls end at doorways, one where furniture hides a wall."""
    truth = make_scan(tmp_path, index, seed=0)
    scan = find_scans(tmp_path)[0][0]
    outcome = capture.STAGE.run(scan=scan, context=Context(scan.scene_id, "capture", 0, Blobs()), config=capture.STAGE.config())
    rooms, (scene,) = outcome.rows["rooms"], outcome.rows["scenes"]
    assert len(rooms) == len(truth.rooms)
    assert min(shared_floors(truth, rooms, matrix(scene.alignment) @ inverse(matrix(truth.alignment)))) > least
    held = {row.room_index for row in outcome.rows["instances"] if not row.is_structure}
    assert held >= set(range(len(rooms)))
