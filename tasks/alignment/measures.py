"""How well an asset in a pose fits a scanned instance."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.alignment.distances import coarse_distances, disc_distances, nearest_indices
from tasks.alignment.samples import Fit, Sample
from tasks.alignment.targets import ScannedInstance

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
    scan = disc_distances(target.points, placed, normals, radius)
    _, back = nearest_indices(placed, target.points)
    back = np.maximum(back - target.spacing, 0.0)
    limit = config.truncation * target.diagonal
    weights = target.weights(placed, normals, config)
    return Distances(
        scan=float(np.minimum(scan, limit).mean()),
        asset=float(_seen_means(np.minimum(back, limit)[None], weights[None], config.seen_share)[0]),
        chamfer=0.5 * float(scan.mean() + back.mean()),
        coverage=float((scan <= threshold).mean()),
    )


def coarse_costs(target: ScannedInstance, sample: Sample, fits: Sequence[Fit], config: AlignmentConfig) -> Array:
    """Cost of every pose by a part of the points and samples [m], shape (p,)."""
    part = dataclasses.replace(sample, points=sample.points[: config.coarse], normals=sample.normals[: config.coarse])
    placed, normals, radii = part.placed_all(fits)
    out, back = coarse_distances(target.points[: config.coarse], placed)
    limit = config.truncation * target.diagonal
    weights = target.weights(placed, normals, config)
    near = np.minimum(np.maximum(out - 0.5 * radii[:, None], 0.0), limit).mean(axis=1)
    return near + 0.5 * _seen_means(np.minimum(back, limit), weights, config.seen_share)


def _seen_means(distances: Array, weights: Array, share: float) -> Array:
    """Weighted means of the smallest distances that hold `share` of the weight, of each row: shapes (p, m) to (p,)."""
    order = np.argsort(distances, axis=1, kind="stable")
    nearest, first = np.take_along_axis(distances, order, axis=1), np.take_along_axis(weights, order, axis=1)
    reached = np.cumsum(first, axis=1)
    counts = (reached < share * reached[:, -1:]).sum(axis=1) + 1
    sums = [(float((d[:n] * w[:n]).sum()), float(w[:n].sum())) for d, w, n in zip(nearest, first, counts.tolist(), strict=True)]
    return np.array([distance / weight for distance, weight in sums])
