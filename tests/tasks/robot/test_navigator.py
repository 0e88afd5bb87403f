"""A cart with a navigator, that knows where it is: it arrives wherever there is a way, and touches nothing, moved or not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import shapely

from tasks.robot.bodies import PlanarBody
from tasks.robot.clearances import Clearances
from tasks.robot.configuration import Displacement, Planner, RobotConfig
from tasks.robot.displaced import displaced
from tasks.robot.floor_map import Floor
from tasks.robot.grid_path import grid_path
from tasks.robot.lidar import lidar_returns, ray_angles
from tasks.robot.navigator import Navigator, Phase
from tasks.robot.subgoals import subgoals
from tests.tasks.robot.floors import bare_floor, random_boxes

CONFIG = RobotConfig()
CORNERS = [(0.5, 0.5), (5.5, 5.5)]


@dataclasses.dataclass(frozen=True)
class Ride:
    """How a ride ended. away: Distance to its end [m]. least: Of the outline to anything [m]."""

    navigator: Navigator
    touched: str | None
    away: float
    least: float
    seconds: float


def ride(goals: np.ndarray, start: tuple[float, float, float], known: Floor, truth: Floor, seed: int, seconds: float = 120.0) -> Ride:
    rng = np.random.default_rng(seed)
    navigator, body = Navigator(goals, known, CONFIG, start), PlanarBody(CONFIG.cart, CONFIG.noise, truth, start, rng)
    clear, least, angles = Clearances.of(truth), np.inf, ray_angles(CONFIG.lidar)
    tick = 0
    while tick < seconds * 100 and not navigator.phase.is_final and body.touched is None:
        if tick % 10 == 0:
            ranges = lidar_returns(truth.segments, body.pose, CONFIG.lidar, rng)
            there = np.isfinite(ranges)
            seen = (ranges * np.array([np.cos(angles + body.pose[2]), np.sin(angles + body.pose[2])])).T[there] + body.pose[:2]
            navigator.see(seen, body.pose)
            body.drive(*navigator.command(tick * 0.01, body.pose, *body.speeds))
        body.step(0.01)
        least = min(least, float(clear.distances(body.pose[None, :2])[0]) - CONFIG.cart.radius_m)
        tick += 1
    return Ride(navigator, body.touched, float(np.hypot(*(body.pose[:2] - goals[-1]))), least, tick * 0.01)


def across(floor: Floor) -> np.ndarray | None:
    """A policy's track from corner to corner, for a body of the agent's radius."""
    way = grid_path(Clearances.of(floor), *CORNERS, 0.18, 0.25)
    return None if way is None else np.column_stack([np.vstack([CORNERS[0], way]), np.zeros(len(way) + 1)])


@pytest.mark.whole
def test_twenty_random_worlds_of_eight_things() -> None:
    """E.5 of the stack's facts: no collision, and at least 95 of 100 arrive."""
    arrived, driven = 0, 0
    for seed in range(20):
        floor = bare_floor(random_boxes(np.random.default_rng(seed), 8, clear=CORNERS))
        track = across(floor)
        if track is None:
            continue
        goals = subgoals(track, floor, CONFIG.cart, CONFIG.planner)
        done = ride(goals.points, (0.5, 0.5, 0.0), floor, floor, seed)
        driven += 1
        arrived += done.navigator.phase is Phase.ARRIVED
        assert done.touched is None
        assert done.least > 0.005
        if done.navigator.phase is Phase.ARRIVED:
            assert done.away < CONFIG.planner.arrive_m
    assert driven >= 18
    assert arrived >= 0.95 * driven


@pytest.mark.slow
@pytest.mark.whole
def test_things_that_were_moved_are_gone_around_and_never_touched() -> None:
    arrived = passable = 0
    for seed in range(12):
        rng = np.random.default_rng(500 + seed)
        floor = bare_floor(random_boxes(rng, 12, clear=CORNERS))
        track = across(floor)
        if track is None:
            continue
        goals = subgoals(track, floor, CONFIG.cart, CONFIG.planner)
        truth = displaced(floor, Displacement(share=0.3), rng, CORNERS, 0.4).floor
        done = ride(goals.points, (0.5, 0.5, 0.0), floor, truth, seed)
        assert done.touched is None
        if is_passable(floor, truth):
            passable += 1
            arrived += done.navigator.phase is Phase.ARRIVED
        if done.navigator.phase is not Phase.ARRIVED:
            assert done.navigator.problem
    assert passable >= 6
    assert arrived == passable


def is_passable(known: Floor, truth: Floor) -> bool:
    """Whether a way with the whole margin leads around what is there and around what the map says."""
    clear, other = Clearances.of(known), Clearances.of(truth)
    both = dataclasses.replace(clear, nodes=np.minimum(clear.nodes, other.nodes))
    margin = CONFIG.cart.radius_m + CONFIG.planner.margin_m + 0.02
    return grid_path(both, *CORNERS, margin, 0.25) is not None


@pytest.mark.whole
def test_behind_a_thing_that_the_map_does_not_have_it_plans_another_way() -> None:
    wall = shapely.box(2.9, 1.0, 3.1, 6.0)
    goals = np.array([[1.5, 4.0], [2.5, 4.0], [3.5, 4.0], [5.0, 4.0]])
    done = ride(goals, (0.6, 4.0, 0.0), bare_floor(), bare_floor([wall]), 0)
    assert done.touched is None
    assert done.navigator.phase is Phase.ARRIVED
    assert done.navigator.recoveries >= 2


def test_a_cart_that_looks_the_other_way_turns_first() -> None:
    done = ride(np.array([[1.0, 3.0]]), (3.0, 3.0, 0.0), bare_floor(), bare_floor(), 1)
    assert done.navigator.phase is Phase.ARRIVED
    assert done.seconds < 15.0


@pytest.mark.whole
def test_where_no_way_leads_it_gives_up_and_says_where() -> None:
    wall = shapely.box(2.9, 0.0, 3.1, 6.0)
    done = ride(np.array([[5.0, 3.0]]), (1.0, 3.0, 0.0), bare_floor([wall]), bare_floor([wall]), 2)
    assert done.touched is None
    assert done.navigator.phase is Phase.GIVEN_UP
    assert done.navigator.recoveries == Planner().recoveries
    assert (done.navigator.problem or "").startswith("no way on from (")


@pytest.mark.parametrize("yaw", [0.0, 1.5, 3.0])
def test_at_its_goal_it_stands_at_once(yaw: float) -> None:
    navigator = Navigator(np.array([[1.0, 1.0]]), bare_floor(), CONFIG, (1.05, 1.0, yaw))
    assert navigator.command(0.0, (1.05, 1.0, yaw), 0.0, 0.0) == (0.0, 0.0)
    assert navigator.phase is Phase.ARRIVED
    assert navigator.command(0.1, (1.05, 1.0, yaw), 0.0, 0.0) == (0.0, 0.0)
