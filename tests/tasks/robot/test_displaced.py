"""What is moved after the scan: where it may go, what goes with it, and the replica moved alike."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.transforms import is_rigid, translation, yaw_pose
from tasks.robot.configuration import Cart, Displacement, Lidar
from tasks.robot.displaced import GAP_M, Displaced, PlanarMotion, carried_by, displaced, moved_poses
from tasks.robot.floor_map import Floor, floor_of
from tests.replicas import cube, furnished, replica_of, rows_of
from tests.tasks.robot.floors import bare_floor, random_boxes

NOWHERE = np.zeros((0, 2))
MUCH = Displacement(share=0.5)


def moved(floor: Floor, displacement: Displacement = MUCH, seed: int = 0, keep_clear: object = NOWHERE, keep_m: float = 0.3) -> Displaced:
    return displaced(floor, displacement, np.random.default_rng(seed), keep_clear, keep_m)


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), share=st.floats(0.01, 1), reach=st.floats(0.05, 2))
def test_things_go_where_nothing_is_and_nothing_else_changes(seed: int, share: float, reach: float) -> None:
    rng = np.random.default_rng(seed)
    clear = rng.uniform(0.5, 5.5, (3, 2))
    inside = [box for box in random_boxes(rng, 10) if shapely.covers(shapely.box(0, 0, 6, 6), box)]
    floor = bare_floor([box for index, box in enumerate(inside) if all(box.distance(other) > 0 for other in inside[:index])])
    wanted = Displacement(share=share, reach_m=reach)
    result = moved(floor, wanted, seed, clear)
    assert not set(result.motions) & set(result.stayed)
    assert result.motions or result.stayed
    assert len(result.motions) <= max(1, round(share * len(floor.standing)))
    for name, motion in result.motions.items():
        here = result.floor.obstacles[name]
        assert math.hypot(*motion[:2]) <= reach
        assert abs(motion.turn) <= wanted.turn_radians
        assert here.area == pytest.approx(floor.obstacles[name].area)
        assert here.centroid.distance(floor.obstacles[name].centroid) == pytest.approx(math.hypot(*motion[:2]))
        assert floor.polygon.buffer(1e-9).contains(here)
        assert here.distance(shapely.MultiPoint(clear)) >= 0.3 - 1e-9
        assert all(here.distance(shape) >= GAP_M - 1e-9 for other, shape in result.floor.obstacles.items() if other != name)
        lines = shapely.multilinestrings(list(result.floor.plane[name].reshape(-1, 2, 2)))
        assert shapely.hausdorff_distance(lines, here.exterior, densify=0.1) < 1e-6
    for name in floor.obstacles.keys() - result.motions.keys():
        assert result.floor.obstacles[name].equals(floor.obstacles[name])
        np.testing.assert_array_equal(result.floor.plane[name], floor.plane[name])
    assert result.motions == moved(floor, wanted, seed, clear).motions, "the same seed moves the same"


def test_no_share_moves_nothing_and_any_share_something() -> None:
    floor = bare_floor([shapely.box(x, 2, x + 0.3, 2.3) for x in (1, 2, 3, 4)])
    assert moved(floor, Displacement()).motions == {}
    assert moved(floor, Displacement()).floor is floor
    assert len(moved(floor, Displacement(share=0.01)).motions) == 1
    assert len(moved(floor, Displacement(share=0.5)).motions) == 2
    assert len(moved(floor, Displacement(share=1.0)).motions) == 4


def test_what_is_large_or_has_no_place_stays() -> None:
    large = bare_floor([shapely.box(1, 1, 2.2, 1.3)])
    assert moved(large) == Displaced(large, {}, {})
    packed = moved(bare_floor([shapely.box(0.1, 0.1, 0.9, 0.9)], size=(1.0, 1.0)), Displacement(share=1.0, reach_m=3.0))
    assert packed.motions == {}
    assert packed.stayed == {"0000": "none of 50 places within 3 m is free"}


def test_a_motion_turns_about_the_thing_itself() -> None:
    motion = PlanarMotion(1.0, -0.5, math.pi / 2, 2.0, 3.0)
    np.testing.assert_allclose(motion.matrix @ [2.0, 3.0, 0.7, 1.0], [3.0, 2.5, 0.7, 1.0])
    np.testing.assert_allclose(motion.matrix @ [2.1, 3.0, 0.0, 1.0], [3.0, 2.6, 0.0, 1.0])
    assert is_rigid(motion.matrix)
    assert motion.of_shape(shapely.Point(2.1, 3.0)).distance(shapely.Point(3.0, 2.6)) < 1e-12


def test_what_stands_on_it_goes_along_and_the_replica_alike() -> None:
    rows, blobs = rows_of(furnished())
    replica, parents = replica_of(rows, blobs), {row.instance_id: row.parent_id for row in rows["supports"]}
    floor = floor_of(replica, Cart(), Lidar(), parents)
    assert carried_by(floor, "0001") == ("0001", "0004")
    seen = set()
    for seed in range(12):
        result = moved(floor, Displacement(share=0.4, largest_m=2.0), seed)
        seen |= set(result.motions)
        assert ("0001" in result.motions) == ("0004" in result.motions)
        assert result.motions.get("0001") == result.motions.get("0004")
        again = floor_of(moved_poses(replica, result.motions), Cart(), Lidar(), parents)
        assert again.obstacles.keys() == result.floor.obstacles.keys()
        for name, shape in again.obstacles.items():
            assert shapely.hausdorff_distance(shape, result.floor.obstacles[name]) < 0.006, "both are told to 2 mm"
        for name, envelope in again.envelopes.items():
            mine = result.floor.envelopes[name]
            assert shapely.symmetric_difference(envelope.plan, mine.plan).area < 1e-9
            assert envelope[1:] == pytest.approx(mine[1:])
    assert seen >= {"0001", "0002", "0003", "0004", "0005"}
    assert "0006" not in seen, "it hangs on a wall"


def test_heights_decide_what_is_in_the_way() -> None:
    shelf = cube((6.0, 4.0, 0.3), translation((0.0, 0.0, 1.0)), relation="wall")
    rug = cube((6.0, 4.0, 0.01), translation((0.0, 0.0, 0.0)))
    low, tall = (cube((0.3, 0.3, height), yaw_pose(0.3, (1.5, 0.0, 0.01)), relation="on", parent_id="0002") for height in (0.5, 1.5))
    for box, is_moved in ((low, True), (tall, False)):
        rows, blobs = rows_of([shelf, rug, box])
        parents = {row.instance_id: row.parent_id for row in rows["supports"]}
        result = moved(floor_of(replica_of(rows, blobs), Cart(), Lidar(), parents))
        assert set(result.motions) == ({"0003"} if is_moved else set())
        assert set(result.stayed) == (set() if is_moved else {"0003"})
