"""Where a cart is: the filter against filterpy's, measurements that come late or twice, and drives whose truth is known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from tasks.robot.configuration import Estimation
from tasks.robot.drive import body_speeds, moved, wheel_speeds
from tasks.robot.estimation.localization import DOUBTS, Localization, Senses
from tasks.robot.estimation.odometry import (
    BIAS,
    LATE_S,
    LEFT,
    PUSH,
    PUSH_S,
    RIGHT,
    SIZE,
    SKID,
    SPEED,
    TURN,
    TWIST,
    YAW,
    Odometry,
    wrapped,
)  # fmt: skip
from tasks.robot.lidar import lidar_returns, ray_angles
from tests.tasks.robot.estimation.eights import (
    CART,
    ESTIMATION,
    LIDAR,
    NOISE,
    START,
    STEP,
    Sensed,
    boxed_floor,
    heard,
    localization,
    sensed_eight,
)  # fmt: skip
from tests.tasks.robot.estimation.models import acceleration_noise, slope
from tests.tasks.robot.floors import bare_floor

TRUSTING = dataclasses.replace(ESTIMATION, gate=1.0, slip_sigmas=1e9)
POSE_NOISE = np.diag([1e-4, 1e-4, 1e-4])
Reading = tuple[str, float, tuple]


def blind(estimation: Estimation = ESTIMATION, senses: Senses = "all", pose: np.ndarray = START) -> Localization:
    """A filter without a map, which is given poses."""
    return Localization(CART, NOISE, estimation, LIDAR, None, pose, senses=senses)


def readings_of(seed: int, seconds: float, spread: float = 0.01) -> list[Reading]:
    """What a cart senses that turns and speeds up, with poses in place of scans."""
    rng = np.random.default_rng(seed)
    readings: list[Reading] = []
    pose, v, w = START.copy(), 0.0, 0.0
    for tick in range(round(seconds / STEP)):
        now = tick * STEP
        v, w = 0.4 * (1 - math.cos(now)) / 2, 0.6 * math.sin(1.3 * now)
        if tick % 2 == 0:
            readings.append(("gyro", now, (w + 0.01 + rng.normal(0, 0.005),)))
        if tick % 5 == 0:
            left, right = wheel_speeds(v, w, CART)
            readings.append(("wheels", now, (float(left * 1.02 + rng.normal(0, 0.02)), float(right + rng.normal(0, 0.02)))))
        if tick % 10 == 0:
            readings.append(("position", now, (pose + rng.normal(0, spread, 3), POSE_NOISE, np.eye(3)[: 3 - (tick // 10) % 3])))
            sensor, time, (measured, covariance, along) = readings[-1]
            readings[-1] = (sensor, time, (measured, covariance[: len(along), : len(along)], along))
        pose = moved(pose, v, w, STEP)
    return readings


def given_to(filter_: Localization, readings: list[Reading]) -> Localization:
    for sensor, time, values in readings:
        getattr(filter_, sensor)(time, *values)
    return filter_


def same(filter_: Localization, other: Localization, time: float) -> None:
    for value, expected in zip(filter_.at(time), other.at(time), strict=True):
        np.testing.assert_allclose(value, expected, rtol=0, atol=1e-12)
    for name in ("scans_used", "gated", "slips"):
        assert getattr(filter_, name) == getattr(other, name)


class OtherFilter(ExtendedKalmanFilter):
    """filterpy's, with motion and readings written anew and jacobians by finite differences."""

    def __init__(self) -> None:
        super().__init__(SIZE, 1)
        self.x = Odometry(CART, NOISE).start(START).mean
        self.P = Odometry(CART, NOISE).start(START).covariance
        self.seconds = 0.0

    @staticmethod
    def cart_speeds(state: np.ndarray, speed: float, turn: float) -> tuple[float, float]:
        left, right = wheel_speeds(speed, turn, CART)
        v, w = body_speeds(left * (1 + state[LEFT]), right * (1 + state[RIGHT]), CART)
        return float(v), float(w)

    def motion(self, state: np.ndarray) -> np.ndarray:
        t = self.seconds
        fade, gained = math.exp(-t / PUSH_S), PUSH_S * (1 - math.exp(-t / PUSH_S))
        average = PUSH_S - PUSH_S * gained / t
        after = state.copy()
        v, w = self.cart_speeds(state, state[SPEED] + average * state[PUSH], state[TURN] + average * state[TWIST])
        after[:3] = moved(state[:3], v, w, t)
        outward = state[YAW] + 0.5 * w * t - 0.5 * math.pi
        after[:2] += state[SKID] * v * w * t * np.array([math.cos(outward), math.sin(outward)])
        after[[SPEED, TURN]] += gained * state[[PUSH, TWIST]]
        after[[PUSH, TWIST]] *= fade
        return after

    def predict_x(self, u: float = 0) -> None:
        self.x = self.motion(self.x)

    def later(self, seconds: float) -> None:
        self.seconds = seconds
        self.F = slope(self.motion, self.x)
        heading = self.x[YAW] + 0.5 * (self.motion(self.x)[YAW] - self.x[YAW])
        spread = np.zeros((SIZE, 6))
        spread[:2, 0] = math.cos(heading), math.sin(heading)
        spread[SPEED, 1] = spread[PUSH, 2] = spread[YAW, 3] = spread[TURN, 4] = spread[TWIST, 5] = 1.0
        ahead = acceleration_noise(CART.acceleration_mps2, PUSH_S, seconds)
        around = acceleration_noise(CART.turn_acceleration_rps2, PUSH_S, seconds)
        self.Q = spread @ np.block([[ahead, np.zeros((3, 3))], [np.zeros((3, 3)), around]]) @ spread.T
        self.Q[LEFT, LEFT] = self.Q[RIGHT, RIGHT] = NOISE.slip_walk**2 * seconds
        self.predict()

    def hear(self, measured: np.ndarray, expected: Callable[[np.ndarray], np.ndarray], noise: np.ndarray) -> None:
        self.update(measured, lambda state: slope(expected, state), expected, noise)

    def gyro(self, rate: float) -> None:
        def expected(state: np.ndarray) -> np.ndarray:
            speeds = self.cart_speeds(state, state[SPEED] - LATE_S * state[PUSH], state[TURN] - LATE_S * state[TWIST])
            return np.array([speeds[1] + state[BIAS]])

        self.hear(np.array([rate]), expected, np.array([[NOISE.gyro_noise_rps**2 + 1e-8]]))

    def wheels(self, left: float, right: float) -> None:
        def expected(state: np.ndarray) -> np.ndarray:
            return np.array(wheel_speeds(state[SPEED] - LATE_S * state[PUSH], state[TURN] - LATE_S * state[TWIST], CART))

        self.hear(np.array([left, right]), expected, np.diag((NOISE.encoder * expected(self.x)) ** 2 + 1e-6))

    def position(self, pose: np.ndarray, covariance: np.ndarray, along: np.ndarray) -> None:
        self.hear(along @ pose, lambda state: along @ state[:3], covariance)


def test_it_is_filterpys_extended_kalman_filter() -> None:
    other, filter_, before = OtherFilter(), blind(TRUSTING), 0.0
    for sensor, time, values in readings_of(0, 2.0):
        if time > before:
            other.later(time - before)
        getattr(other, sensor)(*values)
        getattr(filter_, sensor)(time, *values)
        before = time
    pose, speeds, covariance = filter_.at(before)
    np.testing.assert_allclose(pose, other.x[:3], atol=1e-8)
    np.testing.assert_allclose(speeds, other.cart_speeds(other.x, other.x[SPEED], other.x[TURN]), atol=1e-7)
    np.testing.assert_allclose(covariance, other.P[:3, :3], rtol=1e-4, atol=1e-10)
    assert filter_.scans_used == 20
    assert filter_.gated == filter_.slips == filter_.dropped == 0


@settings(max_examples=8)
@given(seed=st.integers(0, 1000), shuffle=st.randoms(use_true_random=False), spread=st.sampled_from([0.01, 0.05]))
def test_the_order_of_arrival_does_not_matter(seed: int, shuffle: object, spread: float) -> None:
    """Neither for the estimate, nor for what was gated, whatever comes when within the buffer."""
    readings = readings_of(seed, 0.8, spread)
    mixed = list(readings)
    shuffle.shuffle(mixed)  # type: ignore[attr-defined]
    whole, late = given_to(blind(), readings), given_to(blind(), mixed)
    assert late.dropped == 0
    same(late, whole, 1.0)
    same(late, whole, 0.5)


@settings(max_examples=8)
@given(seed=st.integers(0, 1000), delay=st.floats(0.0, 0.9))
def test_late_poses_end_as_if_they_had_come_at_once(seed: int, delay: float) -> None:
    readings = readings_of(seed, 1.5)
    arrival = {"position": delay, "wheels": 0.01, "gyro": 0.0}
    late = sorted(readings, key=lambda reading: reading[1] + arrival[reading[0]])
    same(given_to(blind(), late), given_to(blind(), readings), 1.5)


def test_second_copies_say_nothing() -> None:
    readings = readings_of(3, 1.0)
    once, twice = given_to(blind(), readings), given_to(blind(), [*readings, *readings[::3]])
    assert twice.dropped == len(readings[::3])
    same(twice, once, 1.0)


def test_what_comes_after_the_buffer_is_dropped() -> None:
    readings = readings_of(4, 3.0)
    filter_, other = given_to(blind(), readings), given_to(blind(), readings)
    filter_.position(1.9, [9.0, 9.0, 0.0], POSE_NOISE)
    filter_.gyro(0.0, 5.0)
    assert filter_.dropped == 2
    same(filter_, other, 3.0)
    filter_.gyro(2.0, 0.3)
    assert filter_.dropped == 2
    assert len(filter_._orders) < 100, "what is older than the buffer is forgotten"
    assert len(filter_._orders) == len(filter_._measurements) == len(filter_._beliefs)


@pytest.mark.parametrize(("senses", "heard_of"), [("wheels", {"wheels"}), ("wheels_gyro", {"wheels", "gyro"})])
def test_what_senses_do_not_include_is_ignored(senses: Senses, heard_of: set[str]) -> None:
    readings = readings_of(5, 1.0)
    filter_ = given_to(blind(senses=senses), readings)
    same(filter_, given_to(blind(senses=senses), [reading for reading in readings if reading[0] in heard_of]), 1.0)
    filter_.scan(1.0, np.ones((100, 2)))
    assert filter_.scans_used == filter_.dropped == 0


def test_poses_that_disagree_are_gated_until_the_filter_doubts_itself() -> None:
    filter_ = blind()
    for tick in range(1, 11):
        filter_.position(0.1 * tick, START, POSE_NOISE)
    carried = START + np.array([0.5, -0.3, 0.4])
    for tick in range(1, DOUBTS + 1):
        filter_.position(1.0 + 0.1 * tick, carried, POSE_NOISE)
        assert filter_.gated == tick
        np.testing.assert_allclose(filter_.at(1.0 + 0.1 * tick)[0], START, atol=1e-6)
    filter_.position(1.6, carried, POSE_NOISE)
    assert filter_.gated == DOUBTS
    np.testing.assert_allclose(filter_.at(1.6)[0], carried, atol=0.01)
    for tick in range(7, 20):
        filter_.position(1.0 + 0.1 * tick, carried, POSE_NOISE)
    assert filter_.gated == DOUBTS
    assert filter_.nees(2.9, carried) < chi2.ppf(0.99, 3)


def test_one_wrong_pose_changes_nothing() -> None:
    filter_ = blind()
    for tick in range(1, 21):
        filter_.position(0.1 * tick, START if tick != 12 else START + np.ones(3), POSE_NOISE)
    assert (filter_.gated, filter_.scans_used) == (1, 19)
    np.testing.assert_allclose(filter_.at(2.0)[0], START, atol=1e-6)


def test_wheels_that_spin_are_noticed_and_hardly_turn_the_estimate() -> None:
    """For a second the right wheel spins half again as fast, on the spot."""
    heading = []
    for senses in ("wheels_gyro", "wheels"):
        filter_ = blind(senses=senses)
        for tick in range(300):
            now = tick * STEP
            v = min(0.5 * now, 0.3)
            left, right = (float(wheel) for wheel in wheel_speeds(v, 0.0, CART))
            if tick % 2 == 0:
                filter_.gyro(now, 0.0)
            if tick % 5 == 0:
                filter_.wheels(now, left, right * (1.5 if 150 <= tick < 250 else 1.0))
        heading.append(abs(filter_.at(3.0)[0][2] - START[2]))
        assert filter_.slips > 0 if senses == "wheels_gyro" else filter_.slips == 0
    assert heading[0] < 0.05
    assert heading[1] > 0.3


def test_speeds_are_the_carts_and_poses_are_predicted() -> None:
    filter_ = given_to(blind(), readings_of(6, 2.0))
    pose, speeds, covariance = filter_.at(1.99)
    later, _, wider = filter_.at(2.14)
    assert speeds[0] == pytest.approx(0.4 * (1 - math.cos(1.99)) / 2, abs=0.02)
    assert np.hypot(*(later - pose)[:2]) == pytest.approx(0.15 * speeds[0], abs=0.01)
    assert np.trace(wider) > np.trace(covariance)
    first = blind().at(5.0)
    np.testing.assert_array_equal(first[0], START)
    np.testing.assert_array_equal(filter_.at(-5.0)[0], filter_.at(-4.0)[0])


@pytest.mark.parametrize("time", [math.nan, math.inf, -math.inf])
def test_times_and_readings_that_are_not_finite_are_refused(time: float) -> None:
    filter_ = blind()
    for call in (
        lambda: filter_.gyro(time, 0.0), lambda: filter_.wheels(time, 0.0, 0.0), lambda: filter_.scan(time, np.zeros((0, 2))),
        lambda: filter_.position(time, START, POSE_NOISE), lambda: filter_.at(time), lambda: filter_.nees(time, START),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"times must be finite seconds, is"):
            call()
    with pytest.raises(ValueError, match=r"^gyro at 1 s: readings must be finite, are "):
        filter_.gyro(1.0, time)
    with pytest.raises(ValueError, match=r"^pose at 1 s: 1 to 3 directions and a covariance for them"):
        filter_.position(1.0, START, np.eye(2))
    same(filter_, blind(), 0.0)


def test_returns_that_a_lidar_cannot_give_are_left_out() -> None:
    floor = boxed_floor(np.random.default_rng(0))
    ranges, angles = lidar_returns(floor.segments, START, LIDAR, np.random.default_rng(1)), ray_angles(LIDAR)
    points = (np.where(np.isfinite(ranges), ranges, 0.0) * np.array([np.cos(angles), np.sin(angles)])).T
    clean, dirty = localization(floor, "all"), localization(floor, "all")
    clean.scan(0.1, points[np.isfinite(ranges)])
    dirty.scan(0.1, np.vstack([points, [[np.nan, 0.0], [np.inf, 1.0], [30.0, 0.0], [0.01, 0.01]]]))
    same(dirty, clean, 0.1)
    assert clean.scans_used == 1


def final_error(filter_: Localization, sensed: Sensed) -> float:
    return float(np.hypot(*(filter_.at(float(sensed.times[-1]))[0] - sensed.poses[-1])[:2]))


def test_late_scans_end_as_those_on_time() -> None:
    rng = np.random.default_rng(1)
    floor = boxed_floor(rng)
    sensed = sensed_eight(floor, rng, 5.0)
    late, on_time = localization(floor, "all"), localization(floor, "all")
    heard(late, sensed)
    for sensor, time, _, values in sensed.readings:
        getattr(on_time, sensor)(time, *values)
    same(late, on_time, 5.0)
    assert on_time.scans_used > 45


def test_a_cart_that_was_put_elsewhere_finds_itself_again() -> None:
    """As far as scans reach."""
    rng = np.random.default_rng(2)
    floor = boxed_floor(rng)
    sensed = sensed_eight(floor, rng, 6.0)
    filter_ = localization(floor, "all", START + np.array([0.12, -0.1, 0.05]))
    heard(filter_, sensed)
    assert final_error(filter_, sensed) < 0.01
    assert filter_.gated >= DOUBTS


def test_an_unfavourable_slip_leads_wheels_astray_but_not_scans() -> None:
    rng = np.random.default_rng(0)
    floor = boxed_floor(rng)
    sensed = sensed_eight(floor, rng, 60.0, slip=(0.03, -0.03), bias=0.01)
    filters = {senses: localization(floor, senses) for senses in ("wheels", "wheels_gyro", "all")}
    for filter_ in filters.values():
        heard(filter_, sensed)
    errors = {senses: final_error(filter_, sensed) for senses, filter_ in filters.items()}
    assert errors["wheels"] > 1.0
    assert errors["wheels_gyro"] < 0.5
    assert errors["all"] < 0.05


def nees_of(seed: int, seconds: float, period: float, estimation: Estimation = ESTIMATION) -> list[float]:
    """Of the filter with all senses, every so often, each time as a scan arrives."""
    rng = np.random.default_rng(seed)
    floor = boxed_floor(rng)
    sensed = sensed_eight(floor, rng, seconds)
    start = START + rng.normal(0, [NOISE.start_m, NOISE.start_m, NOISE.start_radians])
    filter_, squares, due = localization(floor, "all", start, estimation), [], period
    for sensor, time, arrival, values in sorted(sensed.readings, key=lambda reading: reading[2]):
        getattr(filter_, sensor)(time, *values)
        if sensor == "scan" and arrival >= due and arrival <= seconds:
            tick = round(arrival / STEP)
            squares.append(filter_.nees(tick * STEP, sensed.poses[tick]))
            due += period
    assert final_error(filter_, sensed) < 0.05
    assert filter_.scans_used > 0.97 * 10 * (seconds - 1)
    return squares


@pytest.mark.slow
def test_the_filter_knows_how_good_it_is() -> None:
    """The map is exact there, and is taken to be, nearly. Errors two seconds apart are all but independent, which is tested, too, so that
    the mean of their squares keeps to chi-square's band."""
    exact = dataclasses.replace(ESTIMATION, map_sigma_m=0.0005)
    runs = np.array([nees_of(seed, 60.0, 2.0, exact) for seed in range(10)])
    low, high = chi2.ppf([0.025, 0.975], 3 * runs.size) / runs.size
    assert low < runs.mean() < high
    rest = runs - runs.mean()
    assert abs((rest[:, 1:] * rest[:, :-1]).mean() / (rest**2).mean()) < 2 / math.sqrt(runs.size)
    assert runs.mean(axis=1).max() < chi2.ppf(0.999, 3 * runs.shape[1]) / runs.shape[1]


def test_in_a_short_drive_it_does_so_too() -> None:
    squares = nees_of(11, 10.0, 0.5)
    assert chi2.ppf(0.001, 3 * len(squares)) < np.sum(squares) < chi2.ppf(0.999, 3 * len(squares))


def test_angles_of_errors_are_wrapped() -> None:
    filter_ = Localization(CART, NOISE, ESTIMATION, LIDAR, None, [0.0, 0.0, math.pi])
    assert filter_.nees(0.0, [0.0, 0.0, -math.pi]) == pytest.approx(0.0, abs=1e-12)
    assert wrapped(2 * math.pi) == pytest.approx(0.0)
    assert bare_floor().segments.shape == (4, 4)
