"""A planar cart: delay and lag, slip, readings, and what it runs into."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.robot.bodies import Motors, PlanarBody, distances_to
from tasks.robot.configuration import Cart, DriveNoise
from tasks.robot.drive import body_speeds
from tests.tasks.robot.floors import QUIET, bare_floor, random_boxes

CART = Cart()
STEP = 0.01


def body(
    noise: DriveNoise = QUIET, pose: tuple[float, float, float] = (1.0, 1.0, 0.0), boxes: tuple[shapely.Geometry, ...] = (), seed: int = 0
) -> PlanarBody:
    return PlanarBody(CART, noise, bare_floor(boxes), pose, np.random.default_rng(seed))


def test_a_perfect_cart_goes_as_far_as_its_acceleration_lets_it() -> None:
    cart = body()
    for _ in range(400):
        cart.drive(0.5, 0.0)
        cart.step(STEP)
    braking = 0.5 * CART.speed_mps**2 / CART.acceleration_mps2
    assert cart.pose[0] == pytest.approx(1.0 + 4.0 * CART.speed_mps - braking, abs=0.01)
    assert cart.pose[1:] == pytest.approx([1.0, 0.0])


def test_commands_arrive_late_and_motors_follow() -> None:
    motors = Motors(CART, DriveNoise(delay_s=0.2, lag_s=0.1))
    motors.drive(0.5, 0.0)
    speeds = [motors.step(STEP)[0] for _ in range(400)]
    assert speeds[:18] == [0.0] * 18
    assert speeds[25] > 0
    assert speeds == sorted(speeds)
    assert speeds[-1] == pytest.approx(0.5, abs=1e-6)
    ramp = np.clip(CART.acceleration_mps2 * (STEP * np.arange(1, 401) - 0.19), 0, 0.5)
    lag = (ramp - speeds)[60:100]
    assert lag == pytest.approx(np.full(40, CART.acceleration_mps2 * 0.1), abs=0.005)


@settings(max_examples=30)
@given(seed=st.integers(0, 1000))
def test_it_runs_into_boxes_and_walls_and_never_into_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = (3.0, 3.0, float(rng.uniform(-3, 3)))
    boxes = random_boxes(rng, clear=[start[:2]], keep=0.2)
    cart = body(pose=start, boxes=tuple(boxes))
    solid = shapely.union_all(boxes)
    edge = shapely.box(0, 0, 6, 6).exterior
    for _ in range(1500):
        cart.drive(0.5, float(rng.uniform(-0.2, 0.2)))
        cart.step(STEP)
        here = shapely.Point(cart.pose[:2])
        assert min(here.distance(solid), here.distance(edge)) >= CART.radius_m - 1e-9
        if cart.touched:
            break
    assert cart.touched, "the room is six meters wide"
    reached = {"edge of the floor": edge, **{f"{index:04d}": box for index, box in enumerate(boxes)}}[cart.touched]
    assert shapely.Point(cart.pose[:2]).distance(reached) < CART.radius_m + 1e-6
    before = cart.pose.copy()
    cart.drive(-0.1, 0.0)
    cart.step(STEP)
    np.testing.assert_array_equal(cart.pose, before)
    assert cart.gyro_reading() == 0.0


def test_slip_is_lost_on_the_floor_and_not_at_the_wheels() -> None:
    ends, read = [], []
    for seed in range(120):
        cart = body(dataclasses.replace(QUIET, slip=0.03), seed=seed)
        travelled = 0.0
        for _ in range(150):
            cart.drive(0.5, 0.0)
            cart.step(STEP)
            travelled += float(body_speeds(*cart.wheel_readings(), CART)[0]) * STEP
        ends.append(float(np.hypot(*(cart.pose[:2] - 1.0))))
        read.append(travelled)
    assert np.ptp(read) < 1e-12
    shares = np.array(ends) / read[0]
    assert 0.015 < shares.std() < 0.028, "3 % a wheel is 2.1 % of both"
    assert abs(shares.mean() - 1) < 0.006


def test_readings_err_as_they_say() -> None:
    noise = DriveNoise(slip=0.0, slip_walk=0.0, encoder=0.02, gyro_noise_rps=0.005, gyro_bias_rps=0.01)
    biases = []
    for seed in range(300):
        cart = body(noise, seed=seed)
        gyro = [cart.gyro_reading() for _ in range(50)]
        biases.append(np.mean(gyro))
    assert 0.0085 < np.std(biases) < 0.0115
    cart = body(noise)
    for _ in range(300):
        cart.drive(0.2, 0.0)
        cart.step(STEP)
    read = np.array([cart.wheel_readings() for _ in range(4000)]) / (0.2 / CART.wheel_radius_m)
    assert abs(read.mean() - 1) < 0.002
    assert 0.019 < read.std() < 0.021


def test_the_same_seed_gives_the_same_track() -> None:
    tracks = []
    for seed in (3, 3, 4):
        cart = body(DriveNoise(), seed=seed)
        track = []
        for index in range(200):
            cart.drive(0.4, 0.5 * math.sin(index / 20))
            cart.step(STEP)
            track.append([*cart.pose, *cart.wheel_readings(), cart.gyro_reading()])
        tracks.append(track)
    assert tracks[0] == tracks[1] != tracks[2]


@given(x=st.floats(-2, 8), y=st.floats(-2, 8), seed=st.integers(0, 100))
def test_distances_are_those_of_shapely(x: float, y: float, seed: int) -> None:
    edges = bare_floor(random_boxes(np.random.default_rng(seed))).edges
    true = shapely.distance(shapely.Point(x, y), shapely.linestrings(edges.reshape(-1, 2, 2)))
    np.testing.assert_allclose(distances_to(edges, (x, y)), true, atol=1e-12)
