"""The dynamic window: of all speeds that motors can have a moment from now, the best from which the cart can still stop (Fox, Burgard
and Thrun, The dynamic window approach to collision avoidance, 1997)."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.robot.clearances import Clearances, clear_at, compiled
from tasks.robot.configuration import Cart, Planner
from tasks.robot.drive import stepped

Array = NDArray[np.float64]

BRAKING_STEP_S = 0.025
"""Of motion while braking [s]: 12 mm at full speed, and a thing is passed by less than a millimetre between two steps."""

LOOKS = 20
"""Places at which an arc's clearance is looked at: every 5 cm of one at full speed."""

NEAR_M = 0.1
"""Nearer than this the direction to a sub-goal means ever less [m]."""

STILL = 1e-3
"""Slower than this [m/s, rad/s] counts as standing."""


@dataclasses.dataclass(frozen=True)
class MotorState:
    """What a cart's motors are at.

    v, w: How fast it goes [m/s, rad/s]. wanted_v, wanted_w: What the motors were to do by now, as their accelerations have it. coming_v,
    coming_w: The last command, which they carry out until they hear of the next. reaction_s: When that will be. lag_s: Time constant of the
    motors.
    """

    v: float
    w: float
    wanted_v: float
    wanted_w: float
    coming_v: float
    coming_w: float
    reaction_s: float
    lag_s: float


@dataclasses.dataclass(frozen=True)
class DriveChoice:
    """What the window says. v, w: Command [m/s, rad/s]. is_braking: Whether it is only to stop: no other speed lets the cart stop in time,
    or standing is the best there is. clearance: Least distance on the arc, as far as it is looked at [m]."""

    v: float
    w: float
    is_braking: bool
    clearance: float


def choose(
    pose: ArrayLike, motors: MotorState, goal: ArrayLike, clearances: Clearances, radius: float, cart: Cart, planner: Planner,
    top_mps: float,
) -> DriveChoice:  # fmt: skip
    """The best command for the next period.

    Each pair of a speed and a turn rate within reach of the motors is an exact arc of `horizon_s`, or shorter where it passes the sub-goal.
    It is admissible if the cart, having driven it for a period and the time that it takes to react, and braking then, keeps the radius
    free all along. Of the admissible ones that with the least cost is taken: angle to the sub-goal at its end, progress, speed, clearance.

    Args:
        pose: Where the cart believes to be: x, y [m] and yaw [rad], world frame, shape (3,).
        motors: What its motors are at.
        goal: The sub-goal, world frame [m], shape (2,).
        clearances: Of the floor as it is known.
        radius: What has to be free around the cart's middle [m].
        cart: Its limits.
        planner: Window, horizon and weights.
        top_mps: The fastest to go now [m/s].
    """
    x, y, yaw = (float(value) for value in np.asarray(pose, dtype=np.float64))
    gx, gy = (float(value) for value in np.asarray(goal, dtype=np.float64))
    speeds, turns = windowed(motors, cart, planner, top_mps)
    limits = np.array([cart.acceleration_mps2, cart.turn_acceleration_rps2, motors.lag_s, motors.reaction_s, planner.period_s])
    state = np.array([x, y, yaw, motors.v, motors.w, motors.wanted_v, motors.wanted_w, motors.coming_v, motors.coming_w])
    shares = [planner.heading_weight, planner.distance_weight, planner.speed_weight, planner.clearance_weight]
    weights = np.array([*shares, planner.clear_m, planner.horizon_s])
    best, clear = _kernels()["_best"](
        clearances.nodes, clearances.origin, clearances.points, state, speeds, turns, limits, weights, gx, gy, radius, cart.speed_mps
    )  # fmt: skip
    if best < 0:
        return DriveChoice(0.0, 0.0, True, float(clear))
    v, w = float(speeds[best // len(turns)]), float(turns[best % len(turns)])
    return DriveChoice(v, w, abs(v) < STILL and abs(w) < STILL, float(clear))


def windowed(motors: MotorState, cart: Cart, planner: Planner, top_mps: float) -> tuple[Array, Array]:
    """Speeds [m/s] and turn rates [rad/s] within a period's reach of what the motors will be at; straight on is among them where it is
    within reach. No speed is above `top_mps`, but for what cannot be braked away in a period."""
    dv, dw = cart.acceleration_mps2 * planner.period_s, cart.turn_acceleration_rps2 * planner.period_s
    v, w = stepped(motors.wanted_v, motors.wanted_w, motors.coming_v, motors.coming_w, motors.reaction_s, cart)
    least = min(max(v - dv, 0.0), cart.speed_mps)
    most = max(min(v + dv, top_mps, cart.speed_mps), least)
    rates = np.linspace(max(w - dw, -cart.turn_rps), min(w + dw, cart.turn_rps), planner.turns)
    if rates[0] < 0.0 < rates[-1]:
        rates[np.abs(rates).argmin()] = 0.0
    return np.linspace(least, most, planner.speeds), rates


def stops_within(pose: ArrayLike, motors: MotorState, v: float, w: float, clearances: Clearances, cart: Cart, period: float) -> float:
    """Least distance to anything [m] of a cart that is told a speed [m/s] and a turn rate [rad/s] for a period [s], and to stop then."""
    x, y, yaw = (float(value) for value in np.asarray(pose, dtype=np.float64))
    limits = np.array([cart.acceleration_mps2, cart.turn_acceleration_rps2, motors.lag_s, motors.reaction_s, period])
    state = np.array([x, y, yaw, motors.v, motors.w, motors.wanted_v, motors.wanted_w, motors.coming_v, motors.coming_w])
    kernels, floor = _kernels(), (clearances.nodes, clearances.origin, clearances.points)
    after, least = kernels["_reacted"](*floor, state, limits)
    return float(min(least, kernels["_stopping"](*floor, after, v, w, limits, -1.0)))


@cache
def _kernels() -> Kernels:
    return compile_kernels(_ramped, _along, _followed, _reacted, _stopping, _best, known=compiled())


def _ramped(now: float, wanted: float, most: float) -> float:
    """A speed that goes for another by so much at most."""
    return now + min(max(wanted - now, -most), most)


def _along(x: float, y: float, yaw: float, v: float, w: float, seconds: float) -> tuple[float, float, float]:
    """The pose after an exact arc."""
    half = 0.5 * w * seconds
    chord = v * seconds * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + 2.0 * half


def _followed(state: Array, v: float, w: float, limits: Array) -> None:
    """Let a step of braking's length pass while the motors go for a speed and a turn rate."""
    share = 1.0 - math.exp(-BRAKING_STEP_S / limits[2]) if limits[2] > 0.0 else 1.0
    state[5] = _ramped(state[5], v, limits[0] * BRAKING_STEP_S)
    state[6] = _ramped(state[6], w, limits[1] * BRAKING_STEP_S)
    state[3] += share * (state[5] - state[3])
    state[4] += share * (state[6] - state[4])
    state[0], state[1], state[2] = _along(state[0], state[1], state[2], state[3], state[4], BRAKING_STEP_S)


def _reacted(nodes: Array, origin: Array, points: Array, state: Array, limits: Array) -> tuple[Array, float]:
    """The state when motors hear of the next command, and the least clearance until then."""
    after = state.copy()
    least = clear_at(nodes, origin, points, after[0], after[1])
    for _ in range(int(np.ceil(limits[3] / BRAKING_STEP_S - 1e-6))):
        _followed(after, state[7], state[8], limits)
        least = min(least, clear_at(nodes, origin, points, after[0], after[1]))
    return after, least


def _stopping(nodes: Array, origin: Array, points: Array, start: Array, v: float, w: float, limits: Array, radius: float) -> float:
    """Least clearance while the motors carry out a command for a period, and brake then; looked at until it falls below a radius."""
    state, least = start.copy(), np.inf
    left = int(np.ceil(limits[4] / BRAKING_STEP_S - 1e-6))
    while left > 0 or abs(state[3]) > 5e-3 or abs(state[5]) > 1e-9:  # once it stands it turns at most, where it is
        if left > 0:
            _followed(state, v, w, limits)
        else:
            _followed(state, 0.0, 0.0, limits)
        left -= 1
        least = min(least, clear_at(nodes, origin, points, state[0], state[1]))
        if least < radius:
            break
    return least


def _best(
    nodes: Array, origin: Array, points: Array, state: Array, speeds: Array, turns: Array, limits: Array, weights: Array,
    gx: float, gy: float, radius: float, top: float,
) -> tuple[int, float]:  # fmt: skip
    """Number of the cheapest admissible command, -1 where there is none, and the clearance along its arc."""
    best, least, clear_of_best = -1, np.inf, 0.0
    after, _ = _reacted(nodes, origin, points, state, limits)
    x0, y0, yaw0 = after[0], after[1], after[2]
    away0 = math.hypot(gx - x0, gy - y0)
    horizon = weights[5]
    for i in range(len(speeds)):
        v = speeds[i]
        seconds = horizon if v * horizon <= away0 else max(away0 / v, limits[4])
        for j in range(len(turns)):
            w = turns[j]
            if _stopping(nodes, origin, points, after, v, w, limits, radius) < radius:
                continue
            clear, until = np.inf, seconds
            for k in range(1, LOOKS + 1):
                x, y, _ = _along(x0, y0, yaw0, v, w, seconds * k / LOOKS)
                here = clear_at(nodes, origin, points, x, y)
                clear = min(clear, here)
                if here < radius:  # it will have turned away or stopped before
                    until = seconds * (k - 1) / LOOKS
                    break
            x, y, yaw = _along(x0, y0, yaw0, v, w, until)
            away = math.hypot(gx - x, gy - y)
            angle = 0.0
            if away > 1e-9:
                turned = math.atan2(gy - y, gx - x) - yaw
                angle = abs(math.atan2(math.sin(turned), math.cos(turned))) * min(1.0, away / NEAR_M)
            cost = weights[0] * angle / math.pi
            cost += weights[1] * (1.0 + (away - away0) / (top * horizon))
            cost += weights[2] * (top - v) / top
            cost += weights[3] * (1.0 - min(max(clear - radius, 0.0), weights[4]) / weights[4])
            if cost < least:
                best, least, clear_of_best = i * len(turns) + j, cost, clear
    return best, clear_of_best
