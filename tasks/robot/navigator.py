"""What a cart does next: along its sub-goals by the dynamic window, and out of where that leads nowhere."""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.robot.bodies import Motors
from tasks.robot.configuration import RobotConfig
from tasks.robot.dynamic_window import STILL, MotorState, choose, stops_within
from tasks.robot.grid_path import grid_path
from tasks.robot.subgoals import SPARE_M
from tasks.robot.unmapped import UnmappedPlaces

if TYPE_CHECKING:
    from tasks.robot.floor_map import Floor

Array = NDArray[np.float64]

LEVELS = (1.0, 0.5, 0.2)
"""Shares of the margin that a way may keep: the largest that leads there."""

PROGRESS_M = 0.02
"""A cart comes on when it is nearer to its sub-goal by so much [m]; a turn to it counts as far as the cart's rim moves."""

FACING = 0.2
"""A cart faces its sub-goal when it is off by less [rad]."""

NEAR_M = 2.0
"""Unmapped places farther away do not count in this decision [m]: the horizon is half of that."""

LEAST_M = 0.005
"""What a cart keeps beside it if it already stands near to something [m]."""

MODEL_STEP_S = 0.02
"""Of the model of the motors [s]."""


class Phase(enum.Enum):
    """What a cart is at."""

    DRIVING = "driving"
    TURNING = "turning"
    BACKING = "backing"
    STOPPING = "stopping"
    ARRIVED = "arrived"
    GIVEN_UP = "given up"

    @property
    def is_final(self) -> bool:
        """Whether nothing follows."""
        return self in (Phase.ARRIVED, Phase.GIVEN_UP)


class Navigator:
    """Drives along sub-goals. goals: World frame [m], shape (n, 2), the last the end. floor: As the map has it. start: Where the cart
    believes to stand, world frame, shape (3,): how much of its margin the way leaves is looked up before it leaves."""

    def __init__(self, goals: ArrayLike, floor: Floor, config: RobotConfig, start: ArrayLike) -> None:
        self._cart, self._planner, self._noise = config.cart, config.planner, config.noise
        self.goals: Array = np.asarray(goals, dtype=np.float64).reshape(-1, 2)
        self._map, self._unmapped = floor.clearances, UnmappedPlaces(floor)
        self._clearances = self._map
        self._motors = Motors(config.cart, config.noise)
        self._now: float | None = None
        self._at, self._level = 0, 0
        self._best, self._since = math.inf, 0.0
        self._backed_from: Array = np.zeros(2)
        self._planned_at = -math.inf
        self.phase, self.recoveries = Phase.DRIVING, 0
        self.problem: str | None = None
        here = np.asarray(start, dtype=np.float64)
        self._find_level(here)
        standing = MotorState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, self._noise.delay_s, self._noise.lag_s)
        choose(here, standing, self.goal, self._map, self._cart.radius_m, self._cart, self._planner, self._cart.speed_mps)

    @property
    def goal(self) -> Array:
        """The sub-goal that it drives to, shape (2,)."""
        return self.goals[self._at]

    def see(self, returns: ArrayLike, pose: ArrayLike) -> None:
        """Take in a scan: where its rays ended, world frame [m], shape (n, 2), and the pose from which it was taken, shape (3,)."""
        self._unmapped.see(returns, pose)

    def command(self, now: float, pose: ArrayLike, v: float, w: float) -> tuple[float, float]:
        """What to do next: a speed [m/s] and a turn rate [rad/s].

        Args:
            now: The time [s]; it does not go back.
            pose: Where the cart believes to be: x, y [m] and yaw [rad], world frame, shape (3,).
            v: How fast it believes to go [m/s].
            w: How fast it believes to turn [rad/s].
        """
        here = np.asarray(pose, dtype=np.float64)
        motors = self._motor_state(now, v, w)
        self._clearances = self._map.with_points(self._within_reach(here))
        command = self._next(now, here, motors)
        self._motors.drive(*command)
        return command

    def _next(self, now: float, pose: Array, motors: MotorState) -> tuple[float, float]:
        """The command in the phase that it is in."""
        if self.phase.is_final:
            return 0.0, 0.0
        if self.phase is Phase.STOPPING:
            return self._stop(motors, Phase.ARRIVED)
        self._advance(pose)
        if self._at == len(self.goals) - 1 and self._away(pose) < self._planner.arrive_m:
            self.phase = Phase.STOPPING
            return self._stop(motors, Phase.ARRIVED)
        if self.phase is Phase.TURNING:
            return self._turn(now, pose)
        if self.phase is Phase.BACKING:
            return self._back_up(now, pose, motors)
        return self._drive(now, pose, motors)

    def _drive(self, now: float, pose: Array, motors: MotorState) -> tuple[float, float]:
        """Go on by the dynamic window; recover where that has led nowhere for a while. When something turns out to stand on a sub-goal it
        plans another way at once."""
        if now - self._planned_at > self._planner.stuck_s and self._is_barred():
            self._planned_at = now
            if self._plan(pose):
                self._since, self._best = now, math.inf
        left = self._away(pose) + self._cart.radius_m * abs(self._off(pose))
        if left < self._best - PROGRESS_M:
            self._best, self._since = left, now
        elif now - self._since > self._planner.stuck_s:
            return self._recover(now, pose, motors)
        facing = max(math.cos(self._off(pose)), 0.0)  # what lies aside is turned to before it is driven to
        top = self._cart.speed_mps * facing * min(1.0, self._away(pose) / self._planner.slow_m)
        choice = choose(pose, motors, self.goal, self._clearances, self._kept(pose), self._cart, self._planner, top)
        if choice.is_braking and abs(motors.v) < 0.01:
            return 0.0, self._toward(pose)  # standing still is no way to go: it turns to its sub-goal
        return choice.v, choice.w

    def _recover(self, now: float, pose: Array, motors: MotorState) -> tuple[float, float]:
        """Turn to the sub-goal, or back up and plan anew, by turns."""
        if self.recoveries >= self._planner.recoveries:
            self.phase = Phase.GIVEN_UP
            self.problem = f"no way on from ({pose[0]:.2f}, {pose[1]:.2f}) after {self.recoveries} recoveries"
            return 0.0, 0.0
        self.recoveries += 1
        self._since, self._best = now, math.inf
        if self.recoveries % 2:
            self.phase = Phase.TURNING
            return self._turn(now, pose)
        self.phase, self._backed_from = Phase.BACKING, pose[:2].copy()
        return self._back_up(now, pose, motors)

    def _turn(self, now: float, pose: Array) -> tuple[float, float]:
        """Turn to the sub-goal where it stands."""
        if abs(self._off(pose)) < FACING or now - self._since > math.pi / self._cart.turn_rps + self._planner.stuck_s:
            self.phase, self._since, self._best = Phase.DRIVING, now, math.inf
        return 0.0, self._toward(pose)

    def _back_up(self, now: float, pose: Array, motors: MotorState) -> tuple[float, float]:
        """Go back a little where there is room, and plan anew then."""
        gone = float(np.hypot(*(pose[:2] - self._backed_from)))
        speed = -self._cart.reverse_mps
        has_room = stops_within(pose, motors, speed, 0.0, self._clearances, self._cart, self._planner.period_s) >= self._kept(pose)
        seconds = self._planner.back_up_m / max(self._cart.reverse_mps, STILL) + self._planner.stuck_s
        if gone < self._planner.back_up_m and has_room and now - self._since < seconds and self._cart.reverse_mps > 0:
            return speed, 0.0
        if abs(motors.v) < 0.01:
            self._plan(pose)
            self.phase, self._since, self._best = Phase.DRIVING, now, math.inf
        return 0.0, 0.0

    def _is_barred(self) -> bool:
        """Whether something that the map does not have stands on a sub-goal to come."""
        known = self._map.with_points(self._unmapped.points)
        return bool((known.distances(self.goals[self._at :]) < self._cart.radius_m).any())

    def _plan(self, pose: Array) -> bool:
        """Whether there is another way to the end: with as much of the margin as leads there. The sub-goals are those of it then."""
        known = self._map.with_points(self._unmapped.points)
        for level in range(len(LEVELS)):
            way = grid_path(known, pose[:2], self.goals[-1], self._radius(level), self._planner.spacing_m)
            if way is not None:
                self.goals, self._at, self._level = way, 0, level
                return True
        return False

    def _find_level(self, pose: Array) -> None:
        """How much of the margin the way to the end leaves."""
        for level in range(len(LEVELS)):
            self._level = level
            if grid_path(self._clearances, pose[:2], self.goals[-1], self._radius(level), self._planner.spacing_m) is not None:
                return

    def _advance(self, pose: Array) -> None:
        """Go for the next sub-goal when this one is near, or the next one is nearer, and a straight way leads to it."""
        while self._at < len(self.goals) - 1:
            after = self.goals[self._at + 1]
            is_near = self._away(pose) < self._planner.advance_m or np.hypot(*(after - pose[:2])) < self._away(pose)
            has_way = self._clearances.least_along(pose[:2], after) >= min(self._radius(len(LEVELS) - 1), self._kept(pose))
            if not (is_near and (has_way or self._away(pose) < 0.5 * self._planner.advance_m)):
                return
            self._at, self._best = self._at + 1, math.inf

    def _stop(self, motors: MotorState, after: Phase) -> tuple[float, float]:
        """Stand."""
        if abs(motors.v) < 0.01 and abs(motors.w) < 0.05:
            self.phase = after
        return 0.0, 0.0

    def _motor_state(self, now: float, v: float, w: float) -> MotorState:
        """What the motors are at, by what they were told."""
        coming = self._motors.coming
        if self._now is None:
            self._since = now
        before = now if self._now is None else self._now
        count = max(math.ceil((now - before) / MODEL_STEP_S - 1e-6), 0)
        for _ in range(count):
            self._motors.step((now - before) / count)
        self._now = now
        return MotorState(v, w, *self._motors.target, *coming, self._noise.delay_s, self._noise.lag_s)

    def _within_reach(self, pose: Array) -> Array:
        """Unmapped places that the next decisions may come near to."""
        points = self._unmapped.points
        return points[np.hypot(*(points - pose[:2]).T) < NEAR_M]

    def _radius(self, level: int) -> float:
        """What a way keeps free around the cart's middle [m]."""
        margin = self._planner.margin_m
        return self._cart.radius_m + max(LEVELS[level] * margin, min(SPARE_M, margin))

    def _kept(self, pose: Array) -> float:
        """What the next decision keeps free [m]: a cart that stands nearer to something than that may go where it is not nearer."""
        here, least = float(self._clearances.distances(pose[None, :2])[0]), self._cart.radius_m + LEAST_M
        return min(self._radius(self._level), max(here - 1e-3, least) if here > least else here)

    def _away(self, pose: Array) -> float:
        return float(np.hypot(*(self.goal - pose[:2])))

    def _off(self, pose: Array) -> float:
        """Angle from its heading to its sub-goal [rad]."""
        dx, dy = self.goal - pose[:2]
        return math.remainder(math.atan2(dy, dx) - float(pose[2]), 2.0 * math.pi)

    def _toward(self, pose: Array) -> float:
        """A turn rate to its sub-goal from which it can still stop there [rad/s]."""
        off = self._off(pose)
        lead = self._noise.delay_s + self._noise.lag_s + self._planner.period_s
        rate = min(math.sqrt(self._cart.turn_acceleration_rps2 * abs(off)), abs(off) / (2.0 * lead), self._cart.turn_rps)
        return math.copysign(rate, off)
