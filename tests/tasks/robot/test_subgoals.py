"""Sub-goals of tracks: spaced, in free space, and reached from the start."""

from __future__ import annotations

import dataclasses

import numpy as np
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tasks.robot.configuration import Cart, Planner
from tasks.robot.subgoals import SPARE_M, subgoals
from tests.tasks.robot.floors import bare_floor, random_boxes

CART, PLANNER = Cart(), Planner()


def track(*places: tuple[float, float]) -> np.ndarray:
    return np.column_stack([np.array(places, dtype=float), np.zeros(len(places))])


def test_a_track_is_cut_every_half_metre_along_its_length_and_at_its_end() -> None:
    goals = subgoals(track((1.0, 1.0), (2.2, 1.0), (2.2, 2.0)), bare_floor(), CART, PLANNER)
    assert np.allclose(goals.points, [[1.5, 1.0], [2.0, 1.0], [2.2, 1.3], [2.2, 1.8], [2.2, 2.0]])
    assert (goals.goal_snapped_m, goals.dropped, goals.problem) == (0.0, 0, None)


def test_a_whole_number_of_spacings_has_its_end_once() -> None:
    assert np.allclose(subgoals(track((1.0, 1.0), (2.0, 1.0)), bare_floor(), CART, PLANNER).points, [[1.5, 1.0], [2.0, 1.0]])


def test_a_way_shorter_than_a_spacing_is_its_end() -> None:
    assert np.allclose(subgoals(track((1.0, 1.0), (1.2, 1.0)), bare_floor(), CART, PLANNER).points, [[1.2, 1.0]])


@given(st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_sub_goals_have_the_carts_clearance_and_are_near_the_track(seed: int) -> None:
    rng = np.random.default_rng(seed)
    floor = bare_floor(random_boxes(rng, 10))
    way = rng.uniform(0.3, 5.7, (4, 2))
    fitting = floor.free(CART.radius_m)
    assume(fitting.contains(shapely.Point(way[0])))
    goals = subgoals(track(*map(tuple, way)), floor, CART, PLANNER)
    if goals.problem:
        assert not len(goals.points)
        return
    (part,) = [part for part in fitting.geoms if part.distance(shapely.Point(way[0])) < 1e-6]
    line = shapely.LineString(way)
    for point in map(shapely.Point, goals.points):
        things = shapely.union_all([floor.polygon.exterior, *floor.obstacles.values()])
        assert point.distance(things) >= CART.radius_m + SPARE_M - 2e-3  # circles are polygons of many corners
        assert point.distance(line) <= PLANNER.snap_m + 1e-9
        assert point.distance(part) < 1e-6
    assert np.isclose(np.hypot(*(goals.points[-1] - way[-1])), goals.goal_snapped_m)
    assert goals.goal_snapped_m <= PLANNER.snap_m
    lengths = np.floor(line.length / PLANNER.spacing_m + 1e-9)
    assert lengths <= len(goals.points) + goals.dropped <= lengths + 1


def test_a_sub_goal_in_a_thing_moves_out_of_it_by_the_margin_too() -> None:
    goals = subgoals(track((1.0, 3.0), (2.0, 3.0)), bare_floor([shapely.box(1.45, 2.0, 1.55, 3.1)]), CART, PLANNER)
    assert goals.dropped == 1  # 0.32 m beside the track: too far
    low = subgoals(track((1.0, 3.0), (2.0, 3.0)), bare_floor([shapely.box(1.45, 2.0, 1.55, 2.9)]), CART, PLANNER)
    assert np.allclose(
        low.points, [[1.5, 2.9 + CART.radius_m + PLANNER.margin_m], [2.0, 3.0]], atol=6e-3
    )  # a circle of few corners around the thing's


def test_where_there_is_no_room_for_the_margin_the_cart_still_fits() -> None:
    walls = [shapely.box(1.0, 0.0, 4.0, 2.0), shapely.box(1.0, 2.4, 4.0, 6.0)]
    goals = subgoals(track((0.5, 2.2), (2.5, 2.2)), bare_floor(walls), CART, PLANNER)
    assert goals.problem is None
    assert np.allclose(goals.points[-1], [2.5, 2.2])


def test_what_cannot_be_reached_is_a_problem_and_says_how_far_it_is() -> None:
    walls = [shapely.box(2.9, 0.0, 3.1, 6.0)]
    beyond = subgoals(track((1.0, 1.0), (5.0, 1.0)), bare_floor(walls), CART, PLANNER)
    assert beyond.problem == f"the way ends {beyond.goal_snapped_m:.2f} m from where the cart can be; planner.snap_m allows 0.2 m"
    assert np.isclose(beyond.goal_snapped_m, 2.1 + CART.radius_m + SPARE_M, atol=6e-3)
    inside = subgoals(track((3.0, 1.0), (5.0, 1.0)), bare_floor(walls), CART, PLANNER)
    assert inside.problem is not None
    assert inside.problem.startswith("the cart does not fit where the way begins")
    tight = bare_floor([shapely.box(0.0, 0.0, 6.0, 2.82), shapely.box(0.0, 3.18, 6.0, 6.0)])
    barely = subgoals(track((1.0, 3.0), (2.0, 3.0)), tight, CART, PLANNER)
    assert barely.problem == "where the way begins the cart has less than 1 cm to spare, and nowhere to go"
    assert barely.goal_snapped_m == 0.0
    wide = dataclasses.replace(CART, radius_m=3.5)
    assert subgoals(track((1.0, 1.0), (2.0, 1.0)), bare_floor(), wide, PLANNER).problem == "the cart fits nowhere on this floor"
