"""What a cart's state is, how it goes on, and what wheels, gyro and a pose say of it.

The state is x, y [m], yaw [rad], the speed [m/s] and the turn rate [rad/s] that the wheels turn for, the gyro's bias [rad/s], what share of
its speed the left and the right wheel loses or gains, how fast speed [m/s^2] and turn rate [rad/s^2] change, and how far the cart creeps
outward in curves [s]. A wheel that turns for a speed u moves its side of the cart by (1 + share) u; a cart of speed v and turn rate w goes
to the side by skid v w, as tires do and MuJoCo's wheels.

Slip stays the same for a while, so it is estimated: as noise it would be drawn anew with every reading, and an estimate that believes that
is too sure of itself. So do accelerations: as noise they would make every gap between readings as uncertain as a start. The speeds are the
wheels', not the cart's, so that encoders say nothing of slip: of the cart's own speeds they would seem to.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.robot.configuration import Cart, DriveNoise
from tasks.robot.estimation.kalman import Estimate, Innovation, predicted

Array = NDArray[np.float64]

X, Y, YAW, SPEED, TURN, BIAS, LEFT, RIGHT, PUSH, TWIST, SKID = range(11)

SIZE = 11

PUSH_S = 0.1
"""Accelerations stay alike for about so long (Singer, 1970), which is as long as motors take to follow."""

LATE_S = 0.005
"""Readings are of the speeds so long ago: a sensor counts over a step of 0.01 s, so what it gives is of the middle of that."""

NODES, WEIGHTS = (0.5 + 0.5 * np.polynomial.legendre.leggauss(4)[0], 0.5 * np.polynomial.legendre.leggauss(4)[1])
"""Of Gauss and Legendre's integral over a stretch of length 1: a sum of squares, so what it adds to a covariance is positive."""

SLIPPING = 9.0
"""Wheels that slip more than they ever do by themselves count as readings whose error is so many times larger."""


@dataclasses.dataclass(frozen=True)
class Odometry:
    """How a cart moves and what its sensors say of that."""

    cart: Cart
    noise: DriveNoise

    def start(self, pose: ArrayLike, covariance: ArrayLike | None = None) -> Estimate:
        """A cart that stands at a pose, which is known as well as `covariance` says, shape (3, 3); by default as `start_m` does."""
        noise = self.noise
        known = np.diag([noise.start_m**2, noise.start_m**2, noise.start_radians**2]) if covariance is None else np.asarray(covariance)
        mean, whole = np.zeros(SIZE), np.zeros((SIZE, SIZE))
        mean[:3] = np.asarray(pose, dtype=np.float64)
        whole[:3, :3] = known
        whole[BIAS, BIAS] = noise.gyro_bias_rps**2
        whole[LEFT, LEFT] = whole[RIGHT, RIGHT] = noise.slip**2
        whole[SKID, SKID] = noise.skid_s**2
        return Estimate(mean, whole + 1e-12 * np.eye(SIZE))

    def speeds(self, estimate: Estimate, ago: float = 0.0) -> tuple[Array, Array]:
        """The cart's speed along its heading [m/s] and its turn rate [rad/s] some seconds ago, shape (2,); their jacobian, (2, 11)."""
        mean, half = estimate.mean, 0.5 * self.cart.track_m
        speed, turn = mean[SPEED] - ago * mean[PUSH], mean[TURN] - ago * mean[TWIST]
        left, right = speed - half * turn, speed + half * turn
        both, uneven = 1.0 + 0.5 * (mean[LEFT] + mean[RIGHT]), mean[RIGHT] - mean[LEFT]
        jacobian = np.zeros((2, SIZE))
        jacobian[0, SPEED], jacobian[0, TURN] = both, 0.5 * half * uneven
        jacobian[1, SPEED], jacobian[1, TURN] = 0.5 * uneven / half, both
        jacobian[0, LEFT], jacobian[0, RIGHT] = 0.5 * left, 0.5 * right
        jacobian[1, LEFT], jacobian[1, RIGHT] = -0.5 * left / half, 0.5 * right / half
        jacobian[:, PUSH], jacobian[:, TWIST] = -ago * jacobian[:, SPEED], -ago * jacobian[:, TURN]
        return np.array([both * speed + 0.5 * half * uneven * turn, both * turn + 0.5 * uneven * speed / half]), jacobian

    def after(self, estimate: Estimate, seconds: float) -> Estimate:
        """The estimate so much later: an arc of the speeds that it has on average until then, and accelerations that fade."""
        if seconds <= 0.0:
            return estimate
        mean = estimate.mean.copy()
        fade = math.exp(-seconds / PUSH_S)
        gained = PUSH_S * (1.0 - fade)  # of speed, by an acceleration of 1
        early = PUSH_S * (1.0 - gained / seconds)  # on average until then
        (v, w), by_state = self.speeds(estimate, -early)
        half = 0.5 * w * seconds
        middle = mean[YAW] + half
        cos, sin = math.cos(middle), math.sin(middle)
        if abs(half) > 1e-4:
            share, slope = math.sin(half) / half, (half * math.cos(half) - math.sin(half)) / half**2
        else:
            share, slope = 1.0 - half * half / 6.0, -half / 3.0
        chord = v * seconds * share
        turning = 0.5 * seconds * v * seconds * slope
        aside = mean[SKID] * v * w * seconds
        mean[X] += chord * cos + aside * sin
        mean[Y] += chord * sin - aside * cos
        mean[YAW] += 2.0 * half
        mean[SPEED] += gained * mean[PUSH]
        mean[TURN] += gained * mean[TWIST]
        mean[PUSH] *= fade
        mean[TWIST] *= fade
        by_speeds = np.array([
            [seconds * share * cos, turning * cos - 0.5 * seconds * chord * sin],
            [seconds * share * sin, turning * sin + 0.5 * seconds * chord * cos],
            [0.0, seconds],
        ])  # fmt: skip
        outward, along = mean[SKID] * seconds * np.array([w, v]), np.array([0.0, 0.5 * seconds * aside])
        by_speeds[0] += outward * sin + along * cos
        by_speeds[1] += -outward * cos + along * sin
        jacobian = np.eye(SIZE)
        jacobian[:3] += by_speeds @ by_state
        jacobian[X, YAW], jacobian[Y, YAW] = -chord * sin + aside * cos, chord * cos + aside * sin
        jacobian[X, SKID], jacobian[Y, SKID] = v * w * seconds * sin, -v * w * seconds * cos
        jacobian[SPEED, PUSH] = jacobian[TURN, TWIST] = gained
        jacobian[PUSH, PUSH] = jacobian[TWIST, TWIST] = fade
        return predicted(estimate, mean, jacobian, self._wander(cos, sin, seconds))

    def wheels(self, estimate: Estimate, left: float, right: float, *, is_slipping: bool = False) -> Innovation:
        """Readings of both encoders [rad/s]."""
        radius, half, mean = self.cart.wheel_radius_m, 0.5 * self.cart.track_m, estimate.mean
        jacobian = np.zeros((2, SIZE))
        jacobian[:, SPEED], jacobian[:, TURN] = 1.0 / radius, (-half / radius, half / radius)
        jacobian[:, PUSH], jacobian[:, TWIST] = -LATE_S * jacobian[:, SPEED], -LATE_S * jacobian[:, TURN]
        expected = jacobian @ mean
        # By what is expected, not by what is read: of two readings that err alike, the smaller would count more.
        variances = (self.noise.encoder * expected) ** 2 + 1e-6
        return Innovation(np.array([left, right]) - expected, jacobian, np.diag(variances * (SLIPPING**2 if is_slipping else 1.0)))

    def gyro(self, estimate: Estimate, rate: float) -> Innovation:
        """A reading of the gyro [rad/s]."""
        speeds, by_state = self.speeds(estimate, LATE_S)
        jacobian = by_state[1:]
        jacobian[0, BIAS] = 1.0
        return Innovation(np.array([rate - speeds[1] - estimate.mean[BIAS]]), jacobian, np.array([[self.noise.gyro_noise_rps**2 + 1e-8]]))

    def pose(self, estimate: Estimate, pose: ArrayLike, covariance: ArrayLike, directions: ArrayLike) -> Innovation:
        """A measured pose, in the directions of x, y and yaw that it says something of.

        Args:
            estimate: What is believed.
            pose: Measured, world frame, shape (3,).
            covariance: Of what is measured along the directions, shape (k, k).
            directions: Unit vectors by rows, shape (k, 3).
        """
        along = np.asarray(directions, dtype=np.float64).reshape(-1, 3)
        difference = np.asarray(pose, dtype=np.float64) - estimate.mean[:3]
        difference[YAW] = wrapped(difference[YAW])
        jacobian = np.zeros((len(along), SIZE))
        jacobian[:, :3] = along
        return Innovation(along @ difference, jacobian, np.asarray(covariance, dtype=np.float64))

    def is_slipping(self, estimate: Estimate, left: float, right: float, sigmas: float) -> bool:
        """Whether the turn rate of both wheels is farther from the cart's, as the gyro keeps it, than slip and noise explain."""
        innovation = self.wheels(estimate, left, right)
        turn = np.array([-1.0, 1.0]) * self.cart.wheel_radius_m / self.cart.track_m
        spread = math.sqrt(float(turn @ innovation.covariance(estimate) @ turn))
        return abs(float(turn @ innovation.difference)) > sigmas * spread

    def _wander(self, cos: float, sin: float, seconds: float) -> Array:
        """What a stretch of time adds to the covariance, as much in one stretch as in many: changes of acceleration at every moment of it,
        along a heading of cosine and sine and around it, and what slip changes by."""
        left = seconds * NODES  # after a change
        fade = np.exp(-left / PUSH_S)
        speed = PUSH_S * (1.0 - fade)
        way = PUSH_S * (left - speed)
        effects = np.zeros((2, len(NODES), SIZE))
        effects[0, :, X], effects[0, :, Y], effects[0, :, SPEED], effects[0, :, PUSH] = way * cos, way * sin, speed, fade
        effects[1, :, YAW], effects[1, :, TURN], effects[1, :, TWIST] = way, speed, fade
        most = np.array([self.cart.acceleration_mps2, self.cart.turn_acceleration_rps2])
        # An acceleration that is anything up to the most has a third of its square as variance.
        effects *= np.sqrt(2.0 / PUSH_S * seconds * WEIGHTS / 3.0)[:, None] * most[:, None, None]
        flat = effects.reshape(-1, SIZE)
        added: Array = flat.T @ flat
        added[LEFT, LEFT] = added[RIGHT, RIGHT] = self.noise.slip_walk**2 * seconds
        return added


def wrapped(angle: float) -> float:
    """An angle in [-pi, pi]."""
    return math.remainder(angle, 2 * math.pi)
