"""A scan held against the map: the pose from which it looks as it does (point-to-line, after Censi, An ICP variant, 2008)."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.robot.configuration import Estimation, Lidar
from tasks.robot.lidar import visible

Array = NDArray[np.float64]

HUBER_SIGMAS = 2.0
"""Returns farther than so many deviations from the line count less and less."""

REACH_SIGMAS = 5.0
"""Returns farther than so many deviations of the lidar see what the map does not have, once the pose is nearly right."""

LEAST_SIGMA_M = 1e-4
"""Of a return across the line that it lies on: a ray along a perfect wall would say everything."""

LEAST_SHARE = 0.02
"""A direction across which fewer returns than this share lie is left as it is: a corridor's axis."""

LEAST_RETURNS = 20
"""Fewer returns on the map say nothing."""

STILL_M = 1e-5
"""Steps shorter than this [m, rad] end the alignment."""


@dataclasses.dataclass(frozen=True)
class Match:
    """A pose that a scan says.

    pose: World frame, shape (3,). directions: Unit vectors of x [m], y [m] and yaw [rad] that it says something of, by rows, shape (k, 3).
    covariance: Of the pose along them, shape (k, k). share: Of the returns that lie on the map. residual_m: Their root mean square distance
    from it. is_used: Whether it says anything at all.
    """

    pose: Array
    directions: Array
    covariance: Array
    share: float
    residual_m: float
    is_used: bool


class ScanMatcher:
    """Aligns scans with a map.

    segments: The map as the lidar sees it, world frame [m], shape (n, 4).
    """

    def __init__(self, segments: ArrayLike, lidar: Lidar, estimation: Estimation) -> None:
        self._segments = np.ascontiguousarray(segments, dtype=np.float64).reshape(-1, 4)
        self._lidar, self._estimation = lidar, estimation

    def match(self, returns: ArrayLike, guess: ArrayLike) -> Match:
        """Where a scan was taken.

        Args:
            returns: Where its rays ended, in the frame of the cart [m], shape (k, 2).
            guess: The pose that is believed, world frame, shape (3,); the truth has to be within `match_reach_m`.
        """
        points = np.asarray(returns, dtype=np.float64).reshape(-1, 2)
        pose = np.array(guess, dtype=np.float64)
        settings = self._estimation
        nothing = Match(pose.copy(), np.zeros((0, 3)), np.zeros((0, 0)), 0.0, 0.0, False)
        lines = self._segments[visible(self._segments, pose, self._lidar)]
        if len(points) < LEAST_RETURNS or not len(lines):
            return nothing
        nearest = REACH_SIGMAS * math.hypot(self._lidar.noise_m, settings.map_sigma_m, LEAST_SIGMA_M)
        reach = max(settings.match_reach_m, nearest)
        for _ in range(settings.match_steps):
            seen = self._residuals(points, pose, lines, reach)
            if len(seen.distances) < LEAST_RETURNS:
                return nothing
            kept, values = _informed_directions(seen)
            step = -kept.T @ ((kept @ (seen.rows.T @ (seen.weights * seen.distances))) / values)
            pose = pose + step
            if reach == nearest and np.abs(step).max() < STILL_M:
                break
            reach = max(0.7 * reach, nearest)  # near the pose only what lies on the map counts
        seen = self._residuals(points, pose, lines, nearest)
        share = len(seen.distances) / len(points)
        if len(seen.distances) < max(LEAST_RETURNS, settings.match_share * len(points)):
            return dataclasses.replace(nothing, share=share)
        kept, values = _informed_directions(seen)
        excess = max(1.0, float((seen.weights * seen.distances**2).mean()))  # the map is worse than it is taken for
        residual = float(np.sqrt((seen.distances**2).mean()))
        pose[2] = math.remainder(pose[2], 2 * math.pi)
        return Match(pose, kept, np.diag(excess / values), share, residual, len(kept) > 0)

    def _residuals(self, points: Array, pose: Array, lines: Array, reach: float) -> _Residuals:
        """Of the returns on the map. A lidar errs along its ray: one that grazes a wall says precisely how far the wall is aside."""
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        turned = points @ np.array([[cos, sin], [-sin, cos]])
        normals, distances = _kernels()["_pair"](turned + pose[:2], lines, reach)
        near = np.isfinite(distances)
        turned, normals, distances = turned[near], normals[near], distances[near]
        lever = normals[:, 1] * turned[:, 0] - normals[:, 0] * turned[:, 1]
        across = (normals * turned).sum(axis=1) / np.maximum(np.hypot(turned[:, 0], turned[:, 1]), 1e-9)
        variances = (self._lidar.noise_m * across) ** 2 + self._estimation.map_sigma_m**2 + LEAST_SIGMA_M**2
        weights = np.minimum(1.0, HUBER_SIGMAS * np.sqrt(variances) / np.maximum(np.abs(distances), 1e-12)) / variances
        return _Residuals(np.column_stack([normals, lever]), distances, weights)


@dataclasses.dataclass(frozen=True)
class _Residuals:
    """Returns on the map.

    rows: Jacobian of the distances by the pose, shape (k, 3). distances: From the nearest line [m], shape (k,). weights: What each counts
    [1/m^2], shape (k,).
    """

    rows: Array
    distances: Array
    weights: Array


def _informed_directions(seen: _Residuals) -> tuple[Array, Array]:
    """Directions that enough returns say something of, by rows, shape (k, 3), and how much they say, shape (k,)."""
    values, vectors = np.linalg.eigh((seen.rows * seen.weights[:, None]).T @ seen.rows)
    enough = ((seen.rows @ vectors) ** 2).mean(axis=0) > LEAST_SHARE
    return vectors[:, enough].T, values[enough]


@cache
def _kernels() -> Kernels:
    return compile_kernels(_pair)


def _pair(points: Array, lines: Array, reach: float) -> tuple[Array, Array]:
    """For each point, shape (k, 2), the normal of the nearest of lines, shape (n, 4), shape (k, 2), and the distance along it, shape (k,).

    The distance is signed: the point less the line. Infinite where no line is within reach, and where the end of one is nearest.
    """
    normals, distances = np.zeros((len(points), 2)), np.full(len(points), np.inf)
    for k in range(len(points)):
        best = reach
        for i in range(len(lines)):
            dx, dy = lines[i, 2] - lines[i, 0], lines[i, 3] - lines[i, 1]
            length = math.hypot(dx, dy)
            if length < 1e-9:
                continue
            px, py = points[k, 0] - lines[i, 0], points[k, 1] - lines[i, 1]
            along = (px * dx + py * dy) / length
            across = (dx * py - dy * px) / length
            over = max(-along, along - length, 0.0)
            away = math.hypot(across, over)
            if away < best:
                best = away
                if over > 0.0:  # beyond an end: which way to go is not known
                    distances[k] = np.inf
                else:
                    normals[k, 0], normals[k, 1] = -dy / length, dx / length
                    distances[k] = across
    return normals, distances
