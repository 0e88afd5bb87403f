"""How far one surface is from another: Chamfer distance, its enhancement by normals and curvature, boxes and colors."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.boxes import oriented_iou
from tasks.geometry.meshes import Surface, sample_surface
from tasks.geometry.transforms import transform_points

Array = NDArray[np.float64]

SAMPLES = 4096
"""Of each surface, evenly over its area (specs C.5)."""

NEIGHBORS = 16
"""Samples that a sample's curvature is taken from, itself among them (specs C.5)."""

ENHANCEMENT = 0.1
"""Weight of a full turn of normals, and of a full difference in curvature, in diagonals of the object (specs C.5)."""

COLOR_BINS = 8
"""Along each of red, green and blue (specs C.5)."""

COLOR_FLOOR = 1e-6
"""Added to every bin before they are made to sum to 1 again, so that colors that are missing have a finite price (specs C.5)."""


@dataclasses.dataclass(frozen=True)
class ShapeSamples:
    """What a placed surface is compared by, in a frame with +Z up that it shares with others.

    points: Even samples of the surface [m], shape (n, 3). normals: Unit, shape (n, 3). variations: Of the surface around each sample,
    0..1/3, shape (n,). colors: Share of samples by bin of red, green and blue, shape (512,). low, high: Corners of the box along the axes
    of the frame [m]. box_pose, box_size: The oriented box, 4x4 and extents [m].
    """

    points: Array
    normals: Array
    variations: Array
    colors: Array
    low: Array
    high: Array
    box_pose: Array
    box_size: Array

    @property
    def diagonal(self) -> float:
        """Of the oriented box [m]."""
        return float(np.linalg.norm(self.box_size))


@dataclasses.dataclass(frozen=True)
class Agreement:
    """How near a placed surface is to the true one (specs C.5).

    chamfer_m: Half of both mean nearest distances [m]. chamfer_m2: Half of both mean squared nearest distances [m2]; publications mean
    either. ecd_m: As chamfer_m, with what normals and curvature differ by. box_iou: Of boxes along the axes of the frame. oriented_iou: Of
    boxes turned about +Z. color_kl: Divergence of its colors from the true ones, in nats.
    """

    chamfer_m: float
    chamfer_m2: float
    ecd_m: float
    box_iou: float
    oriented_iou: float
    color_kl: float


METRICS = tuple(field.name for field in dataclasses.fields(Agreement))
HIGHER_IS_BETTER = frozenset({"box_iou", "oriented_iou"})


def samples_of(surface: Surface, pose: ArrayLike, scale: ArrayLike, rng: np.random.Generator, count: int = SAMPLES) -> ShapeSamples:
    """Samples of a surface that is stretched along its own axes by `scale`, shape (3,), then placed by a rigid pose, 4x4 [m].

    The oriented box is that of the surface's own axes.

    Raises:
        ValueError: it has no area.
    """
    matrix, stretch = np.asarray(pose, dtype=np.float64).reshape(4, 4), np.asarray(scale, dtype=np.float64)
    stretched = Surface(surface.vertices * stretch, surface.faces, surface.colors)
    used = stretched.vertices[np.unique(stretched.faces)]
    own_low, own_high = used.min(axis=0), used.max(axis=0)
    points, colors, normals = sample_surface(stretched, count, rng)
    box = matrix.copy()
    box[:3, 3] = transform_points([0.5 * (own_low + own_high)], matrix)[0]
    placed = transform_points(used, matrix)
    at = transform_points(points, matrix)
    return ShapeSamples(
        at, normals @ matrix[:3, :3].T, surface_variations(at), color_shares(colors), placed.min(axis=0), placed.max(axis=0), box,
        own_high - own_low,
    )  # fmt: skip


def surface_variations(points: Array, neighbors: int = NEIGHBORS) -> Array:
    """How far the surface around each sample is from flat, shape (n, 3) to (n,): l0 / (l0 + l1 + l2), the eigenvalues of the covariance of
    its nearest samples in rising order (Pauly et al., "Efficient simplification of point-sampled surfaces", 2002). 0 flat, 1/3 a ball."""
    from scipy.spatial import cKDTree

    _, index = cKDTree(points).query(points, k=min(neighbors, len(points)))
    near = points[index.reshape(len(points), -1)]
    near = near - near.mean(axis=1, keepdims=True)
    values = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", near, near))
    return np.asarray(np.maximum(values[:, 0], 0.0) / np.maximum(values.sum(axis=1), 1e-300))


def color_shares(rgb: ArrayLike) -> Array:
    """Share of colors, shape (n, 3) uint8, by joint bin of red, green and blue: shape (512,), sum 1; every bin is above 0."""
    bins = np.asarray(rgb).reshape(-1, 3).astype(np.int64) * COLOR_BINS // 256
    counts = np.bincount((bins[:, 0] * COLOR_BINS + bins[:, 1]) * COLOR_BINS + bins[:, 2], minlength=COLOR_BINS**3)
    shares = counts / max(counts.sum(), 1) + COLOR_FLOOR
    return np.asarray(shares / shares.sum())


def agreement(truth: ShapeSamples, other: ShapeSamples) -> Agreement:
    """How near a surface is to the true one."""
    there, at = _nearest(truth.points, other.points)
    back, of = _nearest(other.points, truth.points)
    bent = ENHANCEMENT * truth.diagonal
    ecd = 0.5 * float(
        (there + bent * _differences(truth, other, at)).mean() + (back + bent * _differences(other, truth, of)).mean()
    )  # fmt: skip
    return Agreement(
        chamfer_m=0.5 * float(there.mean() + back.mean()),
        chamfer_m2=0.5 * float(np.square(there).mean() + np.square(back).mean()),
        ecd_m=ecd,
        box_iou=aligned_iou(truth.low, truth.high, other.low, other.high),
        oriented_iou=oriented_iou(truth.box_pose, truth.box_size, other.box_pose, other.box_size),
        color_kl=divergence(other.colors, truth.colors),
    )


def divergence(first: Array, second: Array) -> float:
    """Kullback-Leibler divergence of the first from the second, in nats; shares above 0 that sum to 1, of one shape."""
    return max(float((first * np.log(first / second)).sum()), 0.0)


def aligned_iou(low: Array, high: Array, other_low: Array, other_high: Array) -> float:
    """Intersection over union of two boxes along the axes of a frame, by their corners [m]; 0 for two without volume."""
    inside = float(np.prod(np.maximum(np.minimum(high, other_high) - np.maximum(low, other_low), 0.0)))
    union = float(np.prod(high - low) + np.prod(other_high - other_low)) - inside
    return min(max(inside / union, 0.0), 1.0) if union > 0 else 0.0


def regret(values: Sequence[float], chosen: int, metric: str) -> float:
    """How much worse the chosen candidate is than the best of all: not below 0. The oracle is not perfect either, and its regret is 0."""
    best = max(values) if metric in HIGHER_IS_BETTER else min(values)
    return abs(values[chosen] - best)


def _nearest(points: Array, targets: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distance [m] to the nearest of other points, and which that is, shape (n,)."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(targets).query(points)
    return np.asarray(distance), np.asarray(index)


def _differences(of: ShapeSamples, to: ShapeSamples, nearest: NDArray[np.int64]) -> Array:
    """By what normals and curvature differ at samples and those nearest to them, shape (n,): the turn, whatever side a normal is on, and
    the difference of variations."""
    turn = 1.0 - np.abs((of.normals * to.normals[nearest]).sum(axis=1))
    return np.asarray(np.clip(turn, 0.0, 1.0) + np.abs(of.variations - to.variations[nearest]))
