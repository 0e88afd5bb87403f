"""A differential drive: arcs against fine steps, wheels there and back, and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.robot.configuration import Cart
from tasks.robot.drive import body_speeds, limited, moved, stepped, wheel_speeds

CART = Cart()

speeds = st.floats(-0.5, 0.5)
turns = st.one_of(st.floats(-1.5, 1.5), st.floats(-1e-7, 1e-7))
yaws = st.floats(-math.pi, math.pi)


@given(v=speeds, w=turns, yaw=yaws, seconds=st.floats(0, 3))
def test_an_arc_is_where_fine_steps_end(v: float, w: float, yaw: float, seconds: float) -> None:
    steps = 20_000
    middles = yaw + w * seconds * (np.arange(steps) + 0.5) / steps
    end = np.array([np.cos(middles).sum(), np.sin(middles).sum()]) * v * seconds / steps
    np.testing.assert_allclose(moved([0.0, 0.0, yaw], v, w, seconds), [*end, yaw + w * seconds], atol=1e-8)


@given(v=speeds, w=turns, yaw=yaws, first=st.floats(0, 2), second=st.floats(0, 2))
def test_two_arcs_of_one_speed_are_one(v: float, w: float, yaw: float, first: float, second: float) -> None:
    start = np.array([1.0, -2.0, yaw])
    np.testing.assert_allclose(moved(moved(start, v, w, first), v, w, second), moved(start, v, w, first + second), atol=1e-12)


@given(v=speeds, w=turns, yaw=yaws, seconds=st.floats(0, 3))
def test_going_back_ends_at_the_start(v: float, w: float, yaw: float, seconds: float) -> None:
    start = np.array([0.3, 0.4, yaw])
    np.testing.assert_allclose(moved(moved(start, v, w, seconds), -v, -w, seconds), start, atol=1e-12)


def test_many_arcs_at_once_are_those_one_by_one() -> None:
    v, w = np.linspace(-0.5, 0.5, 5), np.linspace(-1, 1, 7)
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.5]])
    together = moved(poses[:, None, None], v[:, None], w, 1.3)
    assert together.shape == (2, 5, 7, 3)
    for index in np.ndindex(2, 5, 7):
        np.testing.assert_array_equal(together[index], moved(poses[index[0]], v[index[1]], w[index[2]], 1.3))


@given(v=speeds, w=turns)
def test_wheels_and_body_say_the_same(v: float, w: float) -> None:
    np.testing.assert_allclose(body_speeds(*wheel_speeds(v, w, CART), CART), (v, w), atol=1e-12)


def test_equal_wheels_go_straight_and_opposite_ones_turn() -> None:
    assert body_speeds(4.0, 4.0, CART) == pytest.approx((0.2, 0.0))
    assert body_speeds(-2.6, 2.6, CART) == pytest.approx((0.0, 1.0))


@given(v=speeds, w=st.floats(-1, 1), wanted=st.tuples(st.floats(-3, 3), st.floats(-3, 3)), seconds=st.floats(1e-3, 1))
def test_nothing_is_faster_than_the_cart_or_than_its_motors_let_it(v: float, w: float, wanted: tuple[float, float], seconds: float) -> None:
    v, w = limited(v, w, CART)
    after = stepped(v, w, *wanted, seconds, CART)
    assert limited(*after, CART) == pytest.approx(after, abs=1e-12)
    assert abs(after[0] - v) <= CART.acceleration_mps2 * seconds + 1e-12
    assert abs(after[1] - w) <= CART.turn_acceleration_rps2 * seconds + 1e-12
    goal = limited(*wanted, CART)
    assert abs(goal[0] - after[0]) <= abs(goal[0] - v)
    assert abs(goal[1] - after[1]) <= abs(goal[1] - w)
    arrived = stepped(v, w, *wanted, 10.0, CART)
    assert arrived == pytest.approx(goal)
