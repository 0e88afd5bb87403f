"""Where a cart is: its wheels, its gyro and its scans, each in its place in time, whenever they arrive."""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_left
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.robot.configuration import Cart, DriveNoise, Estimation, Lidar
from tasks.robot.estimation.kalman import Estimate, Innovation, doubted, gate, nees, passes, updated
from tasks.robot.estimation.odometry import YAW, Odometry, wrapped
from tasks.robot.estimation.scan_matching import ScanMatcher

Array = NDArray[np.float64]
Senses = Literal["wheels", "wheels_gyro", "all"]

DOUBTS = 5
"""So many poses in a row that fail the gate make the filter doubt itself at the next: scans err independently of each other, so what half a
second of them contradicts is the estimate. By chance one in 1e10 true rows of five fails a gate of 0.99."""

GYRO, WHEELS, POSE = range(3)
"""Kinds of measurements, in the order in which those of the same moment are taken."""

MEASURED = {GYRO: "gyro", WHEELS: "wheels", POSE: "pose"}


@dataclasses.dataclass(frozen=True)
class _Measurement:
    """kind: GYRO, WHEELS or POSE. values: As the sensor gave them: a rate, both wheels, or a pose, its covariance and its directions."""

    time: float
    kind: int
    values: tuple[float, ...]

    @property
    def order(self) -> tuple[float, ...]:
        """Sorts measurements the same however they arrive."""
        return (self.time, self.kind, *self.values)

    def innovation(self, odometry: Odometry, estimate: Estimate) -> Innovation:
        """What it says beyond an estimate for its time."""
        if self.kind == GYRO:
            return odometry.gyro(estimate, self.values[0])
        if self.kind == WHEELS:
            return odometry.wheels(estimate, self.values[0], self.values[1])
        count = {7: 1, 13: 2, 21: 3}[len(self.values)]  # 3 of the pose, count squared of the covariance, 3 of each direction
        covariance = np.reshape(self.values[3 : 3 + count * count], (count, count))
        return odometry.pose(estimate, self.values[:3], covariance, np.reshape(self.values[3 + count * count :], (count, 3)))


@dataclasses.dataclass(frozen=True)
class _Belief:
    """An estimate after a measurement, and what has become of all until then. doubts: Poses that failed the gate since one passed it."""

    time: float
    estimate: Estimate
    doubts: int = 0
    poses: int = 0
    gated: int = 0
    slips: int = 0


class Localization:
    """A filter over what a cart senses. Measurements may arrive late and in any order, up to `buffer_s` after the newest.

    Args:
        cart: Whose wheels they are.
        noise: What wheels and gyro err by.
        estimation: What the filter believes of its measurements.
        lidar: Returns that it cannot give are left out.
        matcher: Holds scans against the map; without one they say nothing.
        pose: Where the cart stands at first: x, y [m], yaw [rad], world frame, shape (3,).
        covariance: How well that is known, shape (3, 3); by default as `DriveNoise` says.
        senses: What is listened to; the rest is ignored.
    """

    def __init__(
        self, cart: Cart, noise: DriveNoise, estimation: Estimation, lidar: Lidar, matcher: ScanMatcher | None, pose: ArrayLike,
        covariance: ArrayLike | None = None, senses: Senses = "all",
    ) -> None:  # fmt: skip
        self._odometry = Odometry(cart, noise)
        self._estimation, self._lidar, self._matcher, self._senses = estimation, lidar, matcher, senses
        self._gates = {count: gate(estimation.gate, count) for count in (1, 2, 3)}
        # A list for each, sorted by time: what was measured, and what was believed after it. The first is what was believed before.
        self._orders: list[tuple[float, ...]] = [(-math.inf,)]
        self._measurements: list[_Measurement | None] = [None]
        self._beliefs = [_Belief(-math.inf, self._odometry.start(pose, covariance))]
        self.dropped = 0
        """Measurements that came too late, and second copies."""

    @property
    def scans_used(self) -> int:
        """Scans, or other poses, that moved the estimate."""
        return self._beliefs[-1].poses

    @property
    def gated(self) -> int:
        """Measurements that were taken for wrong."""
        return self._beliefs[-1].gated

    @property
    def slips(self) -> int:
        """Readings of wheels that slipped more than they do by themselves."""
        return self._beliefs[-1].slips

    def wheels(self, time: float, left: float, right: float) -> None:
        """Readings of the left and the right encoder [rad/s] at a time [s].

        Raises:
            ValueError: one is not finite.
        """
        self._take(time, WHEELS, (left, right))

    def gyro(self, time: float, rate: float) -> None:
        """A reading of the gyro, the turn rate about +Z [rad/s], at a time [s].

        Raises:
            ValueError: one is not finite.
        """
        if self._senses != "wheels":
            self._take(time, GYRO, (rate,))

    def scan(self, time: float, points: ArrayLike) -> None:
        """A scan that the lidar took at a time [s].

        Args:
            time: When it was taken, not when it came.
            points: Where rays ended, in the frame of the cart at that time [m], shape (k, 2). Those that are not finite are left out.

        Raises:
            ValueError: the time is not finite.
        """
        _check(time, POSE, ())
        if self._senses != "all" or self._matcher is None:
            return
        if self._is_late(time):
            self.dropped += 1
            return
        returns = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        ranges = np.hypot(returns[:, 0], returns[:, 1])
        returns = returns[(ranges >= self._lidar.least_m) & (ranges <= self._lidar.range_m)]
        match = self._matcher.match(returns, self._before(time).mean[:3])
        if match.is_used:
            self.position(time, match.pose, match.covariance, match.directions)

    def position(self, time: float, pose: ArrayLike, covariance: ArrayLike, directions: ArrayLike | None = None) -> None:
        """A pose that was measured at a time [s], as a scan is once it is matched.

        Args:
            time: When it was measured.
            pose: x, y [m], yaw [rad], world frame, shape (3,).
            covariance: Of the pose along the directions, shape (k, k).
            directions: Unit vectors of x [m], y [m] and yaw [rad] that are known, by rows, shape (k, 3); by default all three.

        Raises:
            ValueError: something is not finite, or shapes do not fit together.
        """
        along = np.eye(3) if directions is None else np.asarray(directions, dtype=np.float64).reshape(-1, 3)
        spread = np.asarray(covariance, dtype=np.float64)
        count = len(along)
        if not 1 <= count <= 3 or spread.shape != (count, count):
            raise ValueError(f"pose at {time:g} s: 1 to 3 directions and a covariance for them, is {count} and shape {spread.shape}")
        measured = np.asarray(pose, dtype=np.float64).reshape(3)
        if self._senses == "all":
            self._take(time, POSE, (*measured.tolist(), *spread.ravel().tolist(), *along.ravel().tolist()))

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """What is believed of a time [s], predicted from the newest measurement until then; of one before the buffer, what is oldest in it.

        Returns:
            Pose x, y [m], yaw [rad], world frame, shape (3,); speed [m/s] and turn rate [rad/s], shape (2,); covariance of the pose,
            shape (3, 3).
        """
        estimate = self._estimate(time)
        return estimate.mean[:3].copy(), self._odometry.speeds(estimate)[0], estimate.covariance[:3, :3].copy()

    def nees(self, time: float, true_pose: ArrayLike) -> float:
        """Normalized estimation error squared of a time [s], given the true pose, world frame, shape (3,); 3 on average if consistent."""
        estimate = self._estimate(time)
        error = np.asarray(true_pose, dtype=np.float64) - estimate.mean[:3]
        error[YAW] = wrapped(error[YAW])
        return nees(estimate, error)

    def _estimate(self, time: float) -> Estimate:
        if not math.isfinite(time):
            raise ValueError(f"times must be finite seconds, is {time}")
        return self._at_place(bisect_left(self._orders, (time, math.inf)), time)

    def _before(self, time: float) -> Estimate:
        """What is believed of a time by what was measured before: the same for a scan, whatever else of that moment has arrived."""
        return self._at_place(bisect_left(self._orders, (time,)), time)

    def _at_place(self, place: int, time: float) -> Estimate:
        """The belief before a place in the buffer, predicted to a time."""
        belief = self._beliefs[max(place - 1, 0)]
        return self._odometry.after(belief.estimate, _seconds(belief.time, time))

    def _is_late(self, time: float) -> bool:
        return time < self._beliefs[-1].time - self._estimation.buffer_s

    def _take(self, time: float, kind: int, values: tuple[float, ...]) -> None:
        """Put a measurement in its place, and believe anew what comes after it."""
        _check(time, kind, values)
        measurement = _Measurement(float(time), kind, tuple(map(float, values)))
        order = measurement.order
        place = bisect_left(self._orders, order)
        if self._is_late(time) or (place < len(self._orders) and self._orders[place] == order):
            self.dropped += 1
            return
        self._orders.insert(place, order)
        self._measurements.insert(place, measurement)
        self._beliefs.insert(place, self._beliefs[place - 1])
        for index in range(place, len(self._orders)):
            self._beliefs[index] = self._believed(self._beliefs[index - 1], self._measurements[index])
        self._forget()

    def _forget(self) -> None:
        """What no measurement can come before any more, but for the last: it is what the first of the rest begins with."""
        count = bisect_left(self._orders, (self._beliefs[-1].time - self._estimation.buffer_s,)) - 1
        if count > 0:
            del self._orders[:count], self._measurements[:count], self._beliefs[:count]

    def _believed(self, belief: _Belief, measurement: _Measurement | None) -> _Belief:
        """What is believed after a measurement."""
        assert measurement is not None, "only the first belief, which nothing comes before, has none"
        estimate = self._odometry.after(belief.estimate, _seconds(belief.time, measurement.time))
        slips, poses, doubts = belief.slips, belief.poses, belief.doubts
        innovation = measurement.innovation(self._odometry, estimate)
        if measurement.kind == WHEELS and self._senses != "wheels":
            left, right = measurement.values
            if self._odometry.is_slipping(estimate, left, right, self._estimation.slip_sigmas):
                innovation = self._odometry.wheels(estimate, left, right, is_slipping=True)
                slips += 1
        if measurement.kind == POSE and doubts >= DOUBTS:
            estimate = doubted(estimate, innovation)
        is_true = passes(estimate, innovation, self._gates[len(innovation.difference)])
        if is_true:
            estimate = updated(estimate, innovation)
        if measurement.kind == POSE:
            poses, doubts = poses + is_true, 0 if is_true else doubts + 1
        return _Belief(measurement.time, estimate, doubts, poses, belief.gated + (not is_true), slips)


def _seconds(before: float, time: float) -> float:
    """From a belief until a time; none from the start, whose time is not known."""
    return time - before if math.isfinite(before) else 0.0


def _check(time: float, kind: int, values: tuple[float, ...]) -> None:
    if not math.isfinite(time):
        raise ValueError(f"{MEASURED[kind]}: times must be finite seconds, is {time}")
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{MEASURED[kind]} at {time:g} s: readings must be finite, are {', '.join(f'{value:g}' for value in values)}")
