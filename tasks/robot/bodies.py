"""What carries a cart through a scene, and what its wheels and its gyro read."""

from __future__ import annotations

import math
from collections import deque
from functools import cache
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.robot.configuration import Cart, DriveNoise
from tasks.robot.drive import body_speeds, limited, moved, stepped, wheel_speeds

if TYPE_CHECKING:
    from tasks.robot.floor_map import Floor

Array = NDArray[np.float64]

_FAR_M = 3.0
"""Edges farther away than this are left out until the cart has gone a part of it."""

_HALVINGS = 20
"""Of the step in which the cart touches something: to less than a micrometre."""


class CartBody(Protocol):
    """A cart in a scene."""

    @property
    def pose(self) -> Array:
        """Where it is: x, y [m] and yaw [rad], world frame, shape (3,)."""
        ...

    @property
    def speeds(self) -> tuple[float, float]:
        """How fast it really goes: speed along its heading [m/s] and turn rate about +Z [rad/s]."""
        ...

    @property
    def touched(self) -> str | None:
        """Name of what it ran into; None while it ran into nothing."""
        ...

    def drive(self, v: float, w: float) -> None:
        """Command a speed [m/s] and a turn rate [rad/s]."""
        ...

    def step(self, seconds: float) -> None:
        """Let time pass."""
        ...

    def wheel_readings(self) -> tuple[float, float]:
        """What the encoders say: turn rates of the left and the right wheel [rad/s]."""
        ...

    def gyro_reading(self) -> float:
        """What the gyro says: the turn rate about +Z [rad/s]."""
        ...


class Motors:
    """What becomes of commands: they arrive late, within the cart's limits, and motors follow with a lag.

    target: What they are to do by now, as their accelerations have it [m/s, rad/s]. speeds: What they do [m/s, rad/s]; they may be under
    way at the start.
    """

    def __init__(self, cart: Cart, noise: DriveNoise, speeds: tuple[float, float] = (0.0, 0.0)) -> None:
        self._cart, self._noise = cart, noise
        self._under_way: deque[tuple[float, float, float]] = deque()
        self._now, self._wanted = 0.0, speeds
        self.target, self.speeds = speeds, speeds

    @property
    def coming(self) -> tuple[float, float]:
        """The last command, arrived or not."""
        return (self._under_way[-1][1], self._under_way[-1][2]) if self._under_way else self._wanted

    def drive(self, v: float, w: float) -> None:
        """Send a command."""
        self._under_way.append((self._now + self._noise.delay_s, *limited(v, w, self._cart)))

    def step(self, seconds: float) -> tuple[float, float]:
        """Let time pass; the speed [m/s] and turn rate [rad/s] that the wheels turn for."""
        self._now += seconds
        while self._under_way and self._under_way[0][0] <= self._now + 1e-9:
            _, *self._wanted = self._under_way.popleft()  # type: ignore[assignment]
        self.target = stepped(*self.target, *self._wanted, seconds, self._cart)
        share = 1.0 - math.exp(-seconds / self._noise.lag_s) if self._noise.lag_s > 0 else 1.0
        v, w = (now + share * (then - now) for now, then in zip(self.speeds, self.target, strict=True))
        self.speeds = (v, w)
        return self.speeds


class Slip:
    """What of each wheel's speed reaches the floor: a share that is drawn for a run and wanders.

    skid: How far the cart creeps outward in curves, per speed and turn rate [s]: its speed to the side is skid v w.
    """

    def __init__(self, noise: DriveNoise, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self.shares: Array = 1.0 - noise.slip * rng.standard_normal(2)
        self.skid = float(noise.skid_s * rng.standard_normal())

    def step(self, seconds: float) -> Array:
        """The shares after so long: left and right, shape (2,)."""
        self.shares = self.shares + self._noise.slip_walk * math.sqrt(seconds) * self._rng.standard_normal(2)
        return self.shares


class Readings:
    """What encoders and a gyro say of what there is."""

    def __init__(self, noise: DriveNoise, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self.bias = float(noise.gyro_bias_rps * rng.standard_normal())

    def wheels(self, left: float, right: float) -> tuple[float, float]:
        """Turn rates of the wheels [rad/s], read."""
        errors = self._noise.encoder * self._rng.standard_normal(2)
        return left * (1.0 + float(errors[0])), right * (1.0 + float(errors[1]))

    def gyro(self, rate: float) -> float:
        """A turn rate [rad/s], read."""
        return rate + self.bias + float(self._noise.gyro_noise_rps * self._rng.standard_normal())


class PlanarBody:
    """A disc that goes along arcs on a floor, and stops where it touches something.

    truth: The floor as it is. pose: Where it starts: x, y [m] and yaw [rad], world frame, shape (3,). rng: Draws what goes wrong. speeds:
    How fast it goes there [m/s, rad/s].
    """

    def __init__(
        self,
        cart: Cart,
        noise: DriveNoise,
        truth: Floor,
        pose: ArrayLike,
        rng: np.random.Generator,
        speeds: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self._cart, self._names = cart, truth.edge_names
        self._edges = np.ascontiguousarray(truth.edges)
        slipping, reading = rng.spawn(2)  # what is read does not change what happens
        self._motors, self._slip, self._readings = Motors(cart, noise, speeds), Slip(noise, slipping), Readings(noise, reading)
        self.pose: Array = np.array(pose, dtype=np.float64)
        self.touched: str | None = None
        self.speeds, self._wheels = (0.0, 0.0), (0.0, 0.0)
        self._near: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._looked: Array = np.full(2, np.inf)

    def drive(self, v: float, w: float) -> None:
        """Command a speed [m/s] and a turn rate [rad/s]."""
        self._motors.drive(v, w)

    def step(self, seconds: float) -> None:
        """Let time pass. Once something is touched, the cart stands."""
        v, w = self._motors.step(seconds)
        left, right = wheel_speeds(v, w, self._cart)
        shares = self._slip.step(seconds)
        self._wheels = (float(left), float(right))
        if self.touched is not None:
            self.speeds = (0.0, 0.0)
            return
        v, w = (float(value) for value in body_speeds(left * shares[0], right * shares[1], self._cart))
        after = self._gone(v, w, seconds)
        distance, edge = self._nearest(after)
        if distance < self._cart.radius_m:
            self.touched, self.speeds = self._names[edge], (0.0, 0.0)
            self.pose = self._last_free(v, w, seconds)
            return
        self.pose, self.speeds = after, (v, w)

    def wheel_readings(self) -> tuple[float, float]:
        """What the encoders say: turn rates of the left and the right wheel [rad/s]."""
        return self._readings.wheels(*self._wheels)

    def gyro_reading(self) -> float:
        """What the gyro says: the turn rate about +Z [rad/s]."""
        return self._readings.gyro(self.speeds[1])

    def _last_free(self, v: float, w: float, seconds: float) -> Array:
        """Where on an arc that ends in something the cart comes to touch it; where it is, if it does already."""
        free, blocked = 0.0, seconds
        for _ in range(_HALVINGS):
            middle = 0.5 * (free + blocked)
            is_free = self._nearest(self._gone(v, w, middle))[0] >= self._cart.radius_m
            free, blocked = (middle, blocked) if is_free else (free, middle)
        return self._gone(v, w, free)

    def _gone(self, v: float, w: float, seconds: float) -> Array:
        """Where it is after so long, if nothing is in its way."""
        after, aside = moved(self.pose, v, w, seconds), self._slip.skid * v * w * seconds
        middle = float(self.pose[2]) + 0.5 * w * seconds
        after[:2] += aside * math.sin(middle), -aside * math.cos(middle)
        return after

    def _nearest(self, pose: Array) -> tuple[float, int]:
        """Distance to the nearest edge [m], exact below `_FAR_M / 2`, and its number."""
        if not np.hypot(*(pose[:2] - self._looked)) < _FAR_M / 2:
            distances = distances_to(self._edges, pose[:2])
            self._near, self._looked = np.flatnonzero(distances < _FAR_M), pose[:2].copy()
        if not len(self._near):
            return _FAR_M / 2, -1
        distances = distances_to(self._edges[self._near], pose[:2])
        nearest = int(np.argmin(distances))
        return float(distances[nearest]), int(self._near[nearest])


def distances_to(segments: Array, point: ArrayLike) -> Array:
    """Distance of a point, shape (2,), to segments, shape (n, 4) [m], shape (n,)."""
    x, y = np.asarray(point, dtype=np.float64)
    distances: Array = _kernels()["_distances"](np.ascontiguousarray(segments), float(x), float(y))
    return distances


@cache
def _kernels() -> Kernels:
    return compile_kernels(_distances)


def _distances(segments: Array, x: float, y: float) -> Array:
    lengths = np.empty(len(segments))
    for i in range(len(segments)):
        ax, ay = segments[i, 0], segments[i, 1]
        dx, dy = segments[i, 2] - ax, segments[i, 3] - ay
        length = dx * dx + dy * dy
        share = 0.0
        if length > 0.0:
            share = min(max(((x - ax) * dx + (y - ay) * dy) / length, 0.0), 1.0)
        lengths[i] = math.hypot(x - ax - share * dx, y - ay - share * dy)
    return lengths
