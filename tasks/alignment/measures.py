"""How well an asset in a pose fits a scanned instance."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.alignment.distances import back_distances, coarse_distances, compiled, disc_distances, discs, pairwise_sum
from tasks.alignment.samples import Fit, Sample
from tasks.alignment.targets import ScannedInstance
from tasks.kernels import Kernels, compile_kernels

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Distances:
    """How a placed asset fits [m]. `scan`: mean distance of the points to the surface. `asset`: mean distance of the
    surface that could have been seen to the points. `chamfer`: mean of both plain means. `coverage`: share of the
    points within the threshold."""

    scan: float
    asset: float
    chamfer: float
    coverage: float

    @property
    def cost(self) -> float:
        """What alignment minimizes. Surface without points counts half: the scan is partial, the asset is not."""
        return self.scan + 0.5 * self.asset


def measure(target: ScannedInstance, sample: Sample, fit: Fit, threshold: float, config: AlignmentConfig) -> Distances:
    """How a placed asset fits. `threshold`: distance within which a point counts as covered [m]."""
    placed, normals, radius = sample.placed(fit)
    weights = target.weights(placed, normals, config)
    limits = radius, target.spacing, config.truncation * target.diagonal, threshold, config.seen_share
    return Distances(*_compiled()["_measured"](np.ascontiguousarray(target.points), placed, normals, weights, *map(float, limits)))


def f_score(target: ScannedInstance, sample: Sample, fit: Fit, within: float, config: AlignmentConfig) -> float:
    """Harmonic mean of the share of points within a distance [m] of a placed asset, and of the share of its surface that could have been
    seen within that distance of the points."""
    placed, normals, radius = sample.placed(fit)
    could_be_seen = target.weights(placed, normals, config) >= 1.0
    complete = float((disc_distances(target.points, placed, normals, radius) <= within).mean())
    near = _compiled()["back_distances"](placed, np.ascontiguousarray(target.points)) - target.spacing <= within
    accurate = float(near[could_be_seen].mean()) if could_be_seen.any() else 0.0
    return 2.0 * complete * accurate / (complete + accurate) if complete + accurate > 0.0 else 0.0


def coarse_costs(target: ScannedInstance, sample: Sample, fits: Sequence[Fit], config: AlignmentConfig) -> Array:
    """Cost of every pose by a part of the points and samples [m], shape (p,)."""
    part = dataclasses.replace(sample, points=sample.points[: config.coarse], normals=sample.normals[: config.coarse])
    placed, normals, radii = part.placed_all(fits)
    out, back = coarse_distances(target.points[: config.coarse], placed)
    limit = config.truncation * target.diagonal
    weights = target.weights(placed, normals, config)
    near = np.minimum(np.maximum(out - 0.5 * radii[:, None], 0.0), limit).mean(axis=1)
    return near + 0.5 * np.asarray(_compiled()["_seen_means"](np.minimum(back, limit), weights, float(config.seen_share)))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_seen_mean, _seen_means, _measured, known=compiled())


def _seen_mean(distances: Array, weights: Array, share: float) -> float:
    """Weighted mean of the smallest distances that hold `share` of the weight, both of shape (m,)."""
    order = np.argsort(distances, kind="mergesort")
    near, first, reached = distances[order], weights[order], np.cumsum(weights[order])
    count = 1
    for each in reached:
        count += each < share * reached[-1]
    return pairwise_sum(near[:count] * first[:count]) / pairwise_sum(first[:count])


def _seen_means(distances: Array, weights: Array, share: float) -> Array:
    """The same of each row, shapes (p, m) to (p,)."""
    means = np.empty(len(distances))
    for row in range(len(distances)):
        means[row] = _seen_mean(distances[row], weights[row], share)
    return means


def _measured(
    points: Array,
    placed: Array,
    normals: Array,
    weights: Array,
    radius: float,
    spacing: float,
    limit: float,
    threshold: float,
    share: float,
) -> tuple[float, float, float, float]:
    """Values of `Distances`."""
    scan = discs(points, placed, normals, radius)
    back = np.maximum(back_distances(placed, points) - spacing, 0.0)
    count = 0
    for each in scan:
        count += each <= threshold
    near = pairwise_sum(np.minimum(scan, limit)) / len(scan)
    chamfer = 0.5 * (pairwise_sum(scan) / len(scan) + pairwise_sum(back) / len(back))
    return near, _seen_mean(np.minimum(back, limit), weights, share), chamfer, count / len(scan)
