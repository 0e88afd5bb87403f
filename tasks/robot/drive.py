"""The motion of a differential drive: exact arcs, wheels, and what motors let it do.

A pose is x, y [m] and yaw about +Z from +X [rad] in the world frame; v is the speed along the heading [m/s], w the turn rate [rad/s].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.robot.configuration import Cart

Array = NDArray[np.float64]

_STRAIGHT = 1e-6
"""An arc that turns by less [rad] is told from its series: sin(a) / a loses no digit then."""


def moved(pose: ArrayLike, v: ArrayLike, w: ArrayLike, seconds: ArrayLike) -> Array:
    """The pose after an arc of constant speed and turn rate, shape (..., 3); all arguments broadcast, poses over their leading axes.

    Exact: the cart goes along a chord of length v t sin(a) / a, a half of the turn, in the direction of its middle heading.
    """
    start = np.asarray(pose, dtype=np.float64)
    v, w, seconds = (np.asarray(value, dtype=np.float64) for value in (v, w, seconds))
    half = 0.5 * w * seconds
    small = np.abs(half) < _STRAIGHT
    safe = np.where(small, 1.0, half)
    chord = v * seconds * np.where(small, 1.0 - half * half / 6.0, np.sin(safe) / safe)
    middle = start[..., 2] + half
    x, y, yaw = start[..., 0] + chord * np.cos(middle), start[..., 1] + chord * np.sin(middle), start[..., 2] + 2.0 * half
    return np.stack(np.broadcast_arrays(x, y, yaw), axis=-1)


def wheel_speeds(v: ArrayLike, w: ArrayLike, cart: Cart) -> tuple[Array, Array]:
    """Turn rates of the left and of the right wheel [rad/s] that give a speed and a turn rate."""
    v, w = np.asarray(v, dtype=np.float64), np.asarray(w, dtype=np.float64)
    side = 0.5 * cart.track_m * w
    return (v - side) / cart.wheel_radius_m, (v + side) / cart.wheel_radius_m


def body_speeds(left: ArrayLike, right: ArrayLike, cart: Cart) -> tuple[Array, Array]:
    """Speed [m/s] and turn rate [rad/s] that wheels give which turn at these rates [rad/s] and do not slip."""
    left, right = np.asarray(left, dtype=np.float64), np.asarray(right, dtype=np.float64)
    return 0.5 * cart.wheel_radius_m * (left + right), cart.wheel_radius_m * (right - left) / cart.track_m


def limited(v: float, w: float, cart: Cart) -> tuple[float, float]:
    """The nearest speed and turn rate that the cart can have."""
    return min(max(v, -cart.reverse_mps), cart.speed_mps), min(max(w, -cart.turn_rps), cart.turn_rps)


def stepped(v: float, w: float, wanted_v: float, wanted_w: float, seconds: float, cart: Cart) -> tuple[float, float]:
    """Speed and turn rate after so long on the way to wanted ones, within the limits of the cart and of its acceleration."""
    wanted_v, wanted_w = limited(wanted_v, wanted_w, cart)
    dv, dw = cart.acceleration_mps2 * seconds, cart.turn_acceleration_rps2 * seconds
    return v + min(max(wanted_v - v, -dv), dv), w + min(max(wanted_w - w, -dw), dw)
