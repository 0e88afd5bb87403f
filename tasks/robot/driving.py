"""A cart on a way: body, senses, estimate and plan, step by step, and what came of it."""

from __future__ import annotations

import dataclasses
import math
import time as clocks
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.robot.bodies import CartBody, distances_to
from tasks.robot.configuration import RobotConfig, Senses
from tasks.robot.estimation.localization import Localization
from tasks.robot.estimation.scan_matching import LEAST_RETURNS, ScanMatcher
from tasks.robot.lidar import lidar_returns, ray_angles
from tasks.robot.navigator import Navigator, Phase

if TYPE_CHECKING:
    from tasks.robot.floor_map import Floor

Array = NDArray[np.float64]

SENSES: tuple[Senses, ...] = ("wheels", "wheels_gyro", "all")
"""What takes part in saying where the cart is: all of them say so on every run, and one is what it goes by."""

ARRIVED_TWICE = 2.0
"""A cart that believes to be there has arrived within so many times `arrive_m`: the estimate may err, but not as much as that."""


@dataclasses.dataclass(frozen=True)
class Drive:
    """What became of a cart on a way.

    times: Of the recorded poses [s], shape (n,). track, estimate: True and estimated pose then, world frame [m, rad], shape (n, 3).
    clearances: True distance of the outline to the nearest obstacle then [m], shape (n,). least_clearance: Over every step [m].
    errors: Distance of estimate and truth at every decision [m], shape (k,). heading_errors: Of the heading [rad], shape (k,).
    final_errors: Distance at the end [m] with wheels, with wheels and gyro, and with all. nees: At every decision, shape (k,).
    scans, scans_used, gated: Counts. decision_seconds: Time of each decision [s], scan matching included, shape (k,). The last record is of
    the end.
    """

    phase: Phase
    problem: str | None
    touched: str | None
    seconds: float
    travelled_m: float
    times: Array
    track: Array
    estimate: Array
    clearances: Array
    least_clearance: float
    errors: Array
    heading_errors: Array
    final_errors: tuple[float, float, float]
    nees: Array
    scans: int
    scans_used: int
    gated: int
    recoveries: int
    decision_seconds: Array


@dataclasses.dataclass(frozen=True)
class DriveRoute:
    """What a cart knows on its way. navigator: Where to go next. filters: Where it is, by what takes part in saying so; `guide`: The one
    that it goes by."""

    navigator: Navigator
    filters: Mapping[str, Localization]
    guide: Localization


def route(goals: ArrayLike, floor: Floor, start: ArrayLike, config: RobotConfig) -> DriveRoute:
    """A cart before it leaves. What it computes on its way is machine code by then, so that its first decision is no slower than others.

    Args:
        goals: Its sub-goals, world frame [m], shape (n, 2).
        floor: As the map has it.
        start: Where it believes to be: x, y [m] and yaw [rad], world frame, shape (3,).
        config: Its settings.
    """
    filters: dict[str, Localization] = {}
    for senses in SENSES:
        matcher = ScanMatcher(floor.segments, config.lidar, config.estimation) if senses == "all" else None
        if matcher is not None:
            matcher.match(np.zeros((LEAST_RETURNS, 2)), start)
        filters[senses] = Localization(config.cart, config.noise, config.estimation, config.lidar, matcher, start, senses=senses)
    return DriveRoute(Navigator(goals, floor, config, start), filters, filters[config.estimation.senses])


class Pilot:
    """Drives a body along a route, by what its senses say. truth: The floor as it is; what the cart knows of it is in the route."""

    def __init__(self, body: CartBody, route: DriveRoute, truth: Floor, config: RobotConfig, rng: np.random.Generator) -> None:
        self._body, self._config, self._rng = body, config, rng
        self._navigator, self._filters, self._guide = route.navigator, route.filters, route.guide
        self._segments, self._edges = truth.segments, truth.edges
        self._under_way: deque[tuple[int, float, Array]] = deque()

    def drive(self) -> Drive:
        """To the end of the way, until it is given up, something is touched, or time is out."""
        config, body = self._config, self._body
        each = {name: max(round(period / config.substep_s), 1) for name, period in self._periods().items()}
        recorded: list[tuple[float, Array, Array, float]] = []
        decided: list[tuple[float, float, float, float]] = []
        least, travelled, spent, scans, tick = math.inf, 0.0, 0.0, 0, 0
        for tick in range(round(config.seconds / config.substep_s) + 1):
            now = tick * config.substep_s
            self._measure(tick, now, each)
            scans += tick % each["lidar"] == 0
            spent += self._arrivals(tick)
            is_due, is_recorded = tick % each["planner"] == 0, tick % each["record"] == 0
            least = min(least, self._clearance())
            if is_due:
                began = clocks.perf_counter()
                pose, speeds, _ = self._guide.at(now)
                command = self._navigator.command(now, pose, float(speeds[0]), float(speeds[1]))
                spent += clocks.perf_counter() - began
                nees = self._guide.nees(now, body.pose)
                decided.append((*apart(pose, body.pose), nees, spent))
                spent = 0.0
                body.drive(*command)
            if is_recorded:
                recorded.append(self._record(now))
            if self._navigator.phase.is_final or body.touched:
                break
            before = body.pose[:2].copy()
            body.step(config.substep_s)
            travelled += float(np.hypot(*(body.pose[:2] - before)))
        end = tick * config.substep_s
        if recorded[-1][0] < end:
            recorded.append(self._record(end))
        return self._drive(end, travelled, least, recorded, decided, scans)

    def _clearance(self) -> float:
        """True distance of the outline to the nearest thing [m]."""
        return float(distances_to(self._edges, self._body.pose[:2]).min()) - self._config.cart.radius_m

    def _record(self, now: float) -> tuple[float, Array, Array, float]:
        """Time, true and believed pose, and clearance."""
        return now, self._body.pose.copy(), self._guide.at(now)[0], self._clearance()

    def _periods(self) -> dict[str, float]:
        """How often things happen [s]."""
        config = self._config
        return {
            "planner": config.planner.period_s, "lidar": config.lidar.period_s, "record": config.record_s,
            "wheels": config.noise.encoder_period_s, "gyro": config.noise.gyro_period_s,
        }  # fmt: skip

    def _measure(self, tick: int, now: float, each: Mapping[str, int]) -> None:
        """What senses read in this moment. A scan is under way until its latency is over."""
        if tick % each["gyro"] == 0:
            rate = self._body.gyro_reading()
            for localization in self._filters.values():
                localization.gyro(now, rate)
        if tick % each["wheels"] == 0:
            left, right = self._body.wheel_readings()
            for localization in self._filters.values():
                localization.wheels(now, left, right)
        if tick % each["lidar"] == 0:
            lidar = self._config.lidar
            ranges = lidar_returns(self._segments, self._body.pose, lidar, self._rng)
            points = returns_at(ranges, ray_angles(lidar))
            due = tick + round(lidar.latency_s / self._config.substep_s)
            self._under_way.append((due, now, points))

    def _arrivals(self, tick: int) -> float:
        """Take in the scans that have arrived; how long that took [s]."""
        began = clocks.perf_counter()
        while self._under_way and self._under_way[0][0] <= tick:
            _, then, points = self._under_way.popleft()
            for localization in self._filters.values():
                localization.scan(then, points)
            pose = self._guide.at(then)[0]  # by now it is known better than when the scan was taken
            self._navigator.see(in_world(points, pose), pose)
        return clocks.perf_counter() - began

    def _drive(
        self, seconds: float, travelled: float, least: float, recorded: list[tuple[float, Array, Array, float]],
        decided: list[tuple[float, float, float, float]], scans: int,
    ) -> Drive:  # fmt: skip
        """What became of it."""
        pose = self._body.pose
        errors = np.array(decided).reshape(-1, 4)
        ends = [apart(self._filters[name].at(seconds)[0], pose)[0] for name in SENSES]
        return Drive(
            self._navigator.phase,
            self._navigator.problem,
            self._body.touched,
            seconds,
            travelled,
            np.array([row[0] for row in recorded]),
            np.array([row[1] for row in recorded]).reshape(-1, 3),
            np.array([row[2] for row in recorded]).reshape(-1, 3),
            np.array([row[3] for row in recorded]),
            least,
            errors[:, 0],
            errors[:, 1],
            (ends[0], ends[1], ends[2]),
            errors[:, 2],
            scans,
            self._guide.scans_used,
            self._guide.gated,
            self._navigator.recoveries,
            errors[:, 3],
        )


def returns_at(ranges: Array, angles: Array) -> Array:
    """Where rays end, in the frame of the cart [m], shape (k, 2): of distances and directions, shape (n,), those that are finite."""
    there = np.isfinite(ranges)
    ends: Array = (ranges[there] * np.array([np.cos(angles[there]), np.sin(angles[there])])).T
    return ends


def in_world(points: Array, pose: Array) -> Array:
    """Points in the frame of a pose, shape (n, 2), in the world frame."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    placed: Array = points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    return placed


def apart(pose: Array, other: Array) -> tuple[float, float]:
    """Distance of two poses, shape (3,) each [m], and of their headings [rad]."""
    return float(np.hypot(*(pose[:2] - other[:2]))), abs(math.remainder(float(pose[2] - other[2]), 2 * math.pi))
