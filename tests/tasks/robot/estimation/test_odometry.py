"""The cart's model against finite differences, exact arcs, and what control theory says of noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.robot.configuration import Cart, DriveNoise
from tasks.robot.drive import body_speeds, moved, wheel_speeds
from tasks.robot.estimation.kalman import Estimate
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
    X,
    Y,
    wrapped,
)  # fmt: skip
from tests.tasks.robot.estimation.eights import on_the_eight
from tests.tasks.robot.estimation.models import acceleration_noise, slope

CART, NOISE = Cart(), DriveNoise()
ODOMETRY = Odometry(CART, NOISE)
few = settings(max_examples=40)
turns = st.one_of(st.floats(-2, 2), st.floats(-1e-3, 1e-3), st.just(0.0))
means = st.tuples(
    st.floats(-5, 5), st.floats(-5, 5), st.floats(-4, 4), st.floats(-0.5, 0.5), turns, st.floats(-0.05, 0.05),
    st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.5, 0.5), st.one_of(st.floats(-2, 2), st.just(0.0)), st.floats(-0.02, 0.02),
).map(np.array)  # fmt: skip


def believed(mean: np.ndarray, spread: float = 0.01) -> Estimate:
    return Estimate(np.asarray(mean, dtype=float), spread**2 * np.eye(SIZE))


def jacobian_of_after(mean: np.ndarray, seconds: float) -> np.ndarray:
    """Read off covariances: each state alone is uncertain, and what that does to the others shows."""
    nothing = ODOMETRY.after(Estimate(mean, np.zeros((SIZE, SIZE))), seconds).covariance
    columns = []
    for state in range(SIZE):
        alone = np.zeros((SIZE, SIZE))
        alone[state, state] = 1.0
        spread = ODOMETRY.after(Estimate(mean, alone), seconds).covariance - nothing
        columns.append(spread[:, state] / math.sqrt(spread[state, state]))
    return np.array(columns).T


@few
@given(mean=means, seconds=st.floats(0.001, 0.3))
def test_the_jacobian_of_a_motion_is_what_finite_differences_say(mean: np.ndarray, seconds: float) -> None:
    numbers = slope(lambda state: ODOMETRY.after(believed(state), seconds).mean, mean)
    np.testing.assert_allclose(jacobian_of_after(mean, seconds), numbers, atol=1e-7)


@few
@given(mean=means, left=st.floats(-10, 10), right=st.floats(-10, 10), rate=st.floats(-2, 2))
def test_the_jacobians_of_readings_are_what_finite_differences_say(mean: np.ndarray, left: float, right: float, rate: float) -> None:
    wheels, gyro = ODOMETRY.wheels(believed(mean), left, right), ODOMETRY.gyro(believed(mean), rate)
    np.testing.assert_allclose(wheels.jacobian, -slope(lambda m: ODOMETRY.wheels(believed(m), left, right).difference, mean), atol=1e-6)
    np.testing.assert_allclose(gyro.jacobian, -slope(lambda m: ODOMETRY.gyro(believed(m), rate).difference, mean), atol=1e-7)


@given(mean=means, ago=st.floats(-0.2, 0.2))
def test_the_speeds_of_the_cart_are_those_of_wheels_that_slip(mean: np.ndarray, ago: float) -> None:
    speeds, jacobian = ODOMETRY.speeds(believed(mean), ago)
    wheels = wheel_speeds(mean[SPEED] - ago * mean[PUSH], mean[TURN] - ago * mean[TWIST], CART)
    slipped = [wheel * (1 + mean[slip]) for wheel, slip in zip(wheels, (LEFT, RIGHT), strict=True)]
    np.testing.assert_allclose(speeds, body_speeds(*slipped, CART), atol=1e-12)
    np.testing.assert_allclose(jacobian, slope(lambda m: ODOMETRY.speeds(believed(m), ago)[0], mean), atol=1e-7)


@given(mean=means, seconds=st.floats(0.001, 10.0))
def test_without_acceleration_a_motion_is_an_exact_arc(mean: np.ndarray, seconds: float) -> None:
    mean[[PUSH, TWIST, SKID]] = 0.0
    v, w = ODOMETRY.speeds(believed(mean))[0]
    after = ODOMETRY.after(believed(mean), seconds)
    np.testing.assert_allclose(after.mean[:3], moved(mean[:3], v, w, seconds), atol=1e-9)
    np.testing.assert_array_equal(after.mean[3:], mean[3:])


@given(skid=st.floats(-0.02, 0.02), v=st.floats(0.05, 0.5), w=st.floats(0.1, 1.0))
def test_a_cart_that_creeps_in_curves_comes_out_of_them_farther_ahead(skid: float, v: float, w: float) -> None:
    """Outward by skid v w: half a turn takes it 2 v / w to the side, as ever, and 2 skid v ahead besides."""
    mean = np.zeros(SIZE)
    mean[[SPEED, TURN, SKID]] = v, w, skid
    estimate = believed(mean)
    for _ in range(400):
        estimate = ODOMETRY.after(estimate, math.pi / w / 400)
    np.testing.assert_allclose(estimate.mean[:2], [2 * skid * v, 2 * v / w], atol=1e-4)


@few
@given(mean=means, seconds=st.floats(0.001, 0.2), share=st.floats(0.1, 0.9))
def test_speeds_do_not_depend_on_how_time_is_divided(mean: np.ndarray, seconds: float, share: float) -> None:
    whole = ODOMETRY.after(believed(mean), seconds)
    parts = ODOMETRY.after(ODOMETRY.after(believed(mean), share * seconds), (1 - share) * seconds)
    np.testing.assert_allclose(parts.mean[YAW:], whole.mean[YAW:], atol=1e-12)
    np.testing.assert_allclose(parts.covariance[SPEED:, SPEED:], whole.covariance[SPEED:, SPEED:], rtol=1e-3, atol=1e-9)


@few
@given(seconds=st.floats(0.001, 0.2))
def test_the_noise_of_a_motion_is_the_integral_of_that_of_accelerations(seconds: float) -> None:
    """By van Loan's matrix exponential."""
    mean = np.zeros(SIZE)
    added = ODOMETRY.after(Estimate(mean, np.zeros((SIZE, SIZE))), seconds).covariance
    for states, most in (((X, SPEED, PUSH), CART.acceleration_mps2), ((YAW, TURN, TWIST), CART.turn_acceleration_rps2)):
        expected = acceleration_noise(most, PUSH_S, seconds)
        np.testing.assert_allclose(added[np.ix_(states, states)], expected, rtol=1e-4, atol=1e-15)
    assert added[Y].tolist() == [0.0] * SIZE
    assert added[LEFT, LEFT] == pytest.approx(NOISE.slip_walk**2 * seconds)


def test_no_time_changes_nothing_and_backward_neither() -> None:
    estimate = ODOMETRY.start([1.0, 2.0, 3.0])
    assert ODOMETRY.after(estimate, 0.0) is estimate
    assert ODOMETRY.after(estimate, -1.0) is estimate


def test_a_start_is_known_as_well_as_it_is_said_to_be() -> None:
    start = ODOMETRY.start([1.0, 2.0, 3.0])
    np.testing.assert_allclose(np.sqrt(np.diag(start.covariance)[:3]), [NOISE.start_m, NOISE.start_m, NOISE.start_radians], rtol=1e-6)
    given_ = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.16]])
    np.testing.assert_allclose(ODOMETRY.start([0, 0, 0], given_).covariance[:3, :3], given_, atol=1e-9)


def test_readings_are_of_the_speeds_a_moment_ago() -> None:
    mean = np.zeros(SIZE)
    mean[[SPEED, TURN, BIAS, PUSH, TWIST]] = 0.4, 0.3, 0.01, 0.5, -2.0
    then = (0.4 - LATE_S * 0.5, 0.3 + LATE_S * 2.0)
    np.testing.assert_allclose(ODOMETRY.wheels(believed(mean), *wheel_speeds(*then, CART)).difference, 0.0, atol=1e-12)
    assert ODOMETRY.gyro(believed(mean), then[1] + 0.01).difference == pytest.approx(0.0, abs=1e-12)


def test_encoders_alone_say_nothing_of_slip() -> None:
    innovation = ODOMETRY.wheels(believed(np.array([0, 0, 0, 0.4, 0.2, 0, 0.02, -0.01, 0, 0, 0])), 8.0, 8.5)
    assert not innovation.jacobian[:, [LEFT, RIGHT]].any()


@given(yaw=st.floats(-3.1, 3.1), off=st.floats(-1.0, 1.0), rounds=st.integers(-3, 3))
def test_a_pose_differs_by_less_than_half_a_turn(yaw: float, off: float, rounds: int) -> None:
    mean = np.zeros(SIZE)
    mean[:3] = 1.0, 2.0, yaw + 2 * math.pi * rounds
    innovation = ODOMETRY.pose(believed(mean), [1.5, 2.0, yaw + off], np.eye(3), np.eye(3))
    np.testing.assert_allclose(innovation.difference, [0.5, 0.0, off], atol=1e-9)


def test_a_pose_is_measured_along_its_directions() -> None:
    along = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    innovation = ODOMETRY.pose(believed(np.zeros(SIZE)), [1.0, 1.0, 0.1], np.diag([0.01, 0.02]), along)
    np.testing.assert_allclose(innovation.difference, [1.4, 0.1])
    np.testing.assert_array_equal(innovation.jacobian[:, :3], along)
    assert not innovation.jacobian[:, 3:].any()


def test_slip_beyond_the_usual_is_noticed_and_counts_less() -> None:
    mean = np.zeros(SIZE)
    mean[[SPEED, TURN]] = 0.4, 0.2
    spread = np.diag([1e-4, 1e-4, 1e-4, 1e-4, 2.5e-5, 1e-6, 9e-4, 9e-4, 0.0, 0.0, 0.0])
    estimate = Estimate(mean, spread)
    left, right = (float(wheel) for wheel in wheel_speeds(0.4, 0.2, CART))
    assert not ODOMETRY.is_slipping(estimate, left, right, 3.0)
    assert not ODOMETRY.is_slipping(estimate, 1.01 * left, 0.99 * right, 3.0)
    assert ODOMETRY.is_slipping(estimate, left, 1.3 * right, 3.0)
    assert ODOMETRY.is_slipping(estimate, 0.0, right, 3.0)
    assert not ODOMETRY.is_slipping(estimate, left + 3.0, right + 3.0, 3.0), "the gyro does not see both wheels slip alike"
    usual, slipping = (ODOMETRY.wheels(estimate, left, right, is_slipping=is_slipping) for is_slipping in (False, True))
    np.testing.assert_allclose(slipping.noise, 81 * usual.noise)


def test_angles_are_wrapped() -> None:
    assert wrapped(3 * math.pi / 2) == pytest.approx(-math.pi / 2)
    assert abs(wrapped(-5 * math.pi)) == pytest.approx(math.pi)
    assert on_the_eight(4 * math.pi)[0][:2] == pytest.approx([3.0, 3.0])
