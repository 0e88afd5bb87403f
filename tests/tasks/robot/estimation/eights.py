"""A cart that drives figures of eight between boxes, and all that it senses on the way."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from tasks.robot.bodies import PlanarBody
from tasks.robot.configuration import Cart, DriveNoise, Estimation, Lidar
from tasks.robot.drive import moved
from tasks.robot.estimation.localization import Localization, Senses
from tasks.robot.estimation.odometry import wrapped
from tasks.robot.estimation.scan_matching import ScanMatcher
from tasks.robot.floor_map import Floor
from tasks.robot.lidar import lidar_returns, ray_angles
from tests.tasks.robot.floors import bare_floor, random_boxes

CART, NOISE, LIDAR, ESTIMATION = Cart(), DriveNoise(), Lidar(), Estimation()
SPEED, TURN, STEP = 0.4, 0.5, 0.01
START = np.array([3.0, 3.0, math.pi / 2])
LOOP_S = 2 * math.pi / TURN


@dataclasses.dataclass(frozen=True)
class Sensed:
    """Times [s] with true poses, shape (n, 3), and what was sensed: sensor, time, when it arrived, and what it gave."""

    times: np.ndarray
    poses: np.ndarray
    readings: list[tuple[str, float, float, object]]


def on_the_eight(time: float) -> tuple[np.ndarray, float]:
    """Pose and turn rate that a cart should have on it: a circle to the left, then one to the right."""
    loop, rest = divmod(time, LOOP_S)
    turn = TURN if int(loop) % 2 == 0 else -TURN
    return moved(START, SPEED, turn, rest), turn


def boxed_floor(rng: np.random.Generator, count: int = 8, unseen: Sequence[int] = ()) -> Floor:
    """A floor of 6 m with boxes beside the eight."""
    track = [on_the_eight(time)[0][:2] for time in np.arange(0.0, 2 * LOOP_S, 0.5)]
    return bare_floor(random_boxes(rng, count, clear=track, keep=0.35), unseen=unseen)


def sensed_eight(
    floor: Floor, rng: np.random.Generator, seconds: float = 60.0, slip: tuple[float, float] | None = None, bias: float | None = None,
    lidar: Lidar = LIDAR, noise: DriveNoise = NOISE,
) -> Sensed:  # fmt: skip
    """What a cart senses that somebody steers along the eight by where it truly is. slip, bias: Given instead of drawn."""
    body = PlanarBody(CART, noise, floor, START, rng)
    if slip is not None:
        body._slip.shares = 1.0 - np.array(slip)
    if bias is not None:
        body._readings.bias = bias
    poses, readings = [], []
    angles = ray_angles(lidar)
    rays = np.array([np.cos(angles), np.sin(angles)])
    ticks = round(seconds / STEP)
    for tick in range(ticks + 1):
        now = tick * STEP
        poses.append(body.pose.copy())
        if tick % 2 == 0:
            readings.append(("gyro", now, now, (body.gyro_reading(),)))
        if tick % 5 == 0:
            readings.append(("wheels", now, now, body.wheel_readings()))
        if tick % 10 == 0:
            ranges = lidar_returns(floor.segments, body.pose, lidar, rng)
            seen = np.isfinite(ranges)
            readings.append(("scan", now, now + lidar.latency_s, ((ranges[seen] * rays[:, seen]).T,)))
        wanted, turn = on_the_eight(now)
        dx, dy = wanted[:2] - body.pose[:2]
        cos, sin = math.cos(body.pose[2]), math.sin(body.pose[2])
        body.drive(SPEED + 0.5 * (dx * cos + dy * sin), turn + 1.5 * wrapped(float(wanted[2] - body.pose[2])) + 2.0 * (dy * cos - dx * sin))
        body.step(STEP)
        assert body.touched is None
    return Sensed(np.arange(ticks + 1) * STEP, np.array(poses), readings)


def localization(floor: Floor, senses: Senses, pose: np.ndarray = START, estimation: Estimation = ESTIMATION, lidar: Lidar = LIDAR,
                 noise: DriveNoise = NOISE) -> Localization:  # fmt: skip
    matcher = ScanMatcher(floor.segments, lidar, estimation)
    return Localization(CART, noise, estimation, lidar, matcher, pose, senses=senses)


def heard(filter_: Localization, sensed: Sensed) -> None:
    """Give a filter everything, in the order in which it arrived."""
    for sensor, time, _, values in sorted(sensed.readings, key=lambda reading: reading[2]):
        getattr(filter_, sensor)(time, *values)
