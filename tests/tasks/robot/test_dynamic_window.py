"""The dynamic window: whatever it commands, the cart can still stop; arcs are exact; the weights do what they are for."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tasks.robot.bodies import Motors, PlanarBody
from tasks.robot.clearances import Clearances
from tasks.robot.configuration import Cart, DriveNoise, Planner
from tasks.robot.drive import moved
from tasks.robot.dynamic_window import MotorState, _kernels, choose, stops_within, windowed
from tests.tasks.robot.floors import bare_floor, random_boxes

CART, PLANNER = Cart(), Planner()
CLEAN = DriveNoise(slip=0.0, slip_walk=0.0)
RADIUS = CART.radius_m + 0.02
FLOORS = [bare_floor(random_boxes(np.random.default_rng(seed), 8)) for seed in range(6)]
CLEAR = [Clearances.of(floor) for floor in FLOORS]

PLACES = st.tuples(st.floats(0.3, 5.7), st.floats(0.3, 5.7), st.floats(-3.1, 3.1))


def standing(v: float = 0.0, w: float = 0.0, noise: DriveNoise = CLEAN) -> MotorState:
    return MotorState(v, w, v, w, v, w, noise.delay_s, noise.lag_s)


@given(st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(-1, 1), st.floats(0.01, 3.0))
def test_arcs_are_those_of_the_drive(yaw: float, v: float, w: float, seconds: float) -> None:
    assert np.allclose(_kernels()["_along"](1.0, 2.0, yaw, v, w, seconds), moved([1.0, 2.0, yaw], v, w, seconds), atol=1e-9)


@given(st.integers(0, 5), PLACES, st.floats(0.0, 0.5), st.floats(-1.0, 1.0), PLACES)
@settings(max_examples=60, deadline=None)
def test_after_every_command_the_cart_can_stop(number: int, pose: tuple, v: float, w: float, goal: tuple) -> None:
    floor, clear = FLOORS[number], CLEAR[number]
    assume(clear.distances([pose[:2]])[0] > RADIUS)
    choice = choose(pose, standing(v, w), goal[:2], clear, RADIUS, CART, PLANNER, CART.speed_mps)
    body = PlanarBody(CART, CLEAN, floor, pose, np.random.default_rng(0), (v, w))
    body.drive(choice.v, choice.w)
    for tick in range(400):
        if tick == 10:
            body.drive(0.0, 0.0)
        body.step(0.01)
    assert np.hypot(*body.speeds) < 1e-3
    alone = PlanarBody(CART, CLEAN, floor, pose, np.random.default_rng(0), (v, w))
    alone.drive(0.0, 0.0)
    for _ in range(400):
        alone.step(0.01)
    if alone.touched is None:  # nothing could have saved the others
        assert body.touched is None


@given(st.integers(0, 5), PLACES, st.floats(0.0, 0.5), st.floats(-1.0, 1.0), st.floats(-0.15, 0.5), st.floats(-1.0, 1.0))
@settings(max_examples=25, deadline=None)
def test_how_near_the_cart_comes_until_it_stands_is_what_fine_integration_says(
    number: int, pose: tuple, v: float, w: float, to_v: float, to_w: float
) -> None:
    clear = CLEAR[number]
    motors = Motors(CART, CLEAN, (v, w))
    at, least = np.array(pose), np.inf
    motors.drive(to_v, to_w)
    for tick in range(2000):
        if tick == 50:
            motors.drive(0.0, 0.0)
        at = moved(at, *motors.step(0.002), 0.002)
        least = min(least, clear.distances(at[None, :2])[0])
    assert abs(stops_within(pose, standing(v, w), to_v, to_w, clear, CART, 0.1) - least) < 0.012


def test_the_window_is_what_motors_reach_in_a_period() -> None:
    speeds, turns = windowed(standing(0.2, 0.3), CART, PLANNER, CART.speed_mps)
    assert np.allclose((speeds[0], speeds[-1], turns[0], turns[-1]), (0.15, 0.25, 0.1, 0.5))
    speeds, turns = windowed(standing(0.5, 0.95), CART, PLANNER, CART.speed_mps)
    assert np.allclose((speeds[-1], turns[-1]), (0.5, 1.0))
    speeds, turns = windowed(standing(), CART, PLANNER, CART.speed_mps)
    assert speeds[0] == 0.0
    assert 0.0 in turns
    slow, _ = windowed(standing(0.5), CART, PLANNER, 0.1)
    assert np.allclose(slow, 0.45)  # it cannot brake faster
    coming = dataclasses.replace(standing(0.2), coming_v=0.5)
    assert np.isclose(windowed(coming, CART, PLANNER, CART.speed_mps)[0][-1], 0.2 + 0.05 + 0.05)


def test_on_an_open_floor_it_goes_for_the_sub_goal_as_fast_as_it_may() -> None:
    clear = Clearances.of(bare_floor())
    ahead = choose((1.0, 3.0, 0.0), standing(0.3), (3.0, 3.0), clear, RADIUS, CART, PLANNER, CART.speed_mps)
    assert np.isclose(ahead.v, 0.35)
    assert abs(ahead.w) < 1e-9
    left = choose((1.0, 3.0, 0.0), standing(0.3), (1.5, 4.0), clear, RADIUS, CART, PLANNER, CART.speed_mps)
    assert left.w > 0.1
    slow = choose((1.0, 3.0, 0.0), standing(0.3), (3.0, 3.0), clear, RADIUS, CART, PLANNER, 0.1)
    assert np.isclose(slow.v, 0.25)


def test_before_a_wall_nothing_but_braking_is_left() -> None:
    clear = Clearances.of(bare_floor())
    choice = choose((6.0 - 0.45, 3.0, 0.0), standing(0.5), (7.0, 3.0), clear, RADIUS, CART, PLANNER, CART.speed_mps)
    assert (choice.v, choice.w, choice.is_braking) == (0.0, 0.0, True)
    far = choose((6.0 - 1.2, 3.0, 0.0), standing(0.5), (7.0, 3.0), clear, RADIUS, CART, PLANNER, CART.speed_mps)
    assert not far.is_braking


def test_without_delay_and_lag_the_braking_way_is_that_of_the_formula() -> None:
    """A cart that stands v^2 / 2a before a wall may still go on for a period, and not a centimetre later."""
    quick = MotorState(0.5, 0.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0)
    clear = Clearances.of(bare_floor())
    needed = 0.5 * PLANNER.period_s + 0.5**2 / (2 * CART.acceleration_mps2)
    least = stops_within((1.0, 3.0, 0.0), quick, 0.5, 0.0, clear, CART, PLANNER.period_s)
    assert np.isclose(least, 1.0, atol=1.1e-3)
    for spare, fits in ((0.02, True), (-0.02, False)):
        x = 6.0 - RADIUS - needed - spare
        assert (stops_within((x, 3.0, 0.0), quick, 0.5, 0.0, clear, CART, PLANNER.period_s) >= RADIUS) is fits
