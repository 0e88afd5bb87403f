"""A lidar in the plane: how far it is to the first thing along each ray."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.robot.configuration import Lidar

Array = NDArray[np.float64]


def ray_angles(lidar: Lidar) -> Array:
    """Directions of the rays in the cart's frame [rad], counterclockwise from straight ahead, shape (rays,)."""
    return np.arange(lidar.rays, dtype=np.float64) * (2 * math.pi / lidar.rays)


def lidar_returns(segments: ArrayLike, pose: ArrayLike, lidar: Lidar, rng: np.random.Generator | None = None) -> Array:
    """Distances that a lidar reads [m], shape (rays,); infinite where nothing returns.

    Args:
        segments: What it may see: x, y of both ends, world frame [m], shape (n, 4).
        pose: Of the lidar: x, y [m] and yaw [rad], world frame, shape (3,).
        lidar: Its rays, range and errors.
        rng: Draws errors and lost returns; None for a perfect one.
    """
    lines = np.ascontiguousarray(segments, dtype=np.float64).reshape(-1, 4)
    x, y, yaw = np.asarray(pose, dtype=np.float64)
    ranges: Array = _kernels()["_cast"](lines, float(x), float(y), float(yaw), lidar.rays, lidar.range_m)[0]
    if rng is not None:
        ranges = ranges + rng.normal(0.0, lidar.noise_m, lidar.rays)
        ranges[rng.random(lidar.rays) < lidar.dropped] = np.inf
    ranges[(ranges < lidar.least_m) | (ranges > lidar.range_m)] = np.inf
    return ranges


def visible(segments: ArrayLike, pose: ArrayLike, lidar: Lidar) -> NDArray[np.int64]:
    """Numbers of the segments, shape (n, 4), that some ray of a lidar at a pose, shape (3,), meets first; sorted."""
    lines = np.ascontiguousarray(segments, dtype=np.float64).reshape(-1, 4)
    x, y, yaw = np.asarray(pose, dtype=np.float64)
    met: NDArray[np.int64] = _kernels()["_cast"](lines, float(x), float(y), float(yaw), lidar.rays, lidar.range_m)[1]
    return np.unique(met[met >= 0])


@cache
def _kernels() -> Kernels:
    return compile_kernels(_cast)


def _cast(lines: Array, x: float, y: float, yaw: float, rays: int, reach: float) -> tuple[Array, NDArray[np.int64]]:
    """Distances along rays around a point, and the segment that each ends at. A segment is held against the rays between its ends."""
    ranges, met = np.full(rays, np.inf), np.full(rays, -1)
    step = 2.0 * math.pi / rays
    for i in range(len(lines)):
        ax, ay, bx, by = lines[i, 0] - x, lines[i, 1] - y, lines[i, 2] - x, lines[i, 3] - y
        if max(ax, bx) < -reach or min(ax, bx) > reach or max(ay, by) < -reach or min(ay, by) > reach:
            continue
        cross = ax * by - ay * bx
        if cross < 0.0:  # so that the segment is passed counterclockwise
            ax, ay, bx, by, cross = bx, by, ax, ay, -cross
        begin = (math.atan2(ay, ax) - yaw) / step
        width = math.atan2(cross, ax * bx + ay * by) / step
        # A ray more on either side: rounding must not lose one that just meets an end.
        first, last = math.ceil(begin - 1e-9), math.floor(begin + width + 1e-9)
        ex, ey = bx - ax, by - ay
        for k in range(first, last + 1):
            angle = yaw + k * step
            cos, sin = math.cos(angle), math.sin(angle)
            across = cos * ey - sin * ex
            if abs(across) < 1e-12:  # seen from its end, as wide as nothing
                continue
            distance = (ax * ey - ay * ex) / across
            if distance >= 0.0:
                ray = k % rays
                if distance < ranges[ray]:
                    ranges[ray], met[ray] = distance, i
    return ranges, met
