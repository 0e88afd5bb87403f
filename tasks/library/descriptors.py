"""What shapes are compared by when nothing is known of their front: distances, heights, extents, colors."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.captions.colors import lab

Array = NDArray[np.float64]

DISTANCE_BINS, HEIGHT_BINS = 48, 16
"""Bins of the two shape histograms: fine enough to tell a chair from a stool, coarse enough for 20,000 pairs."""

PAIRS = 20_000
"""Pairs of points per D2 histogram: its noise (1 percent per bin) is far below the difference between two categories."""

_LAB_EDGES = (np.linspace(0, 100, 6), np.linspace(-60, 60, 8), np.linspace(-60, 60, 8))


@dataclasses.dataclass(frozen=True)
class Descriptor:
    """Histograms that sum to one, none of which changes with yaw or size.

    distances: D2, distances between random pairs over the mean distance (Osada et al., "Shape distributions", ACM TOG
    2002), shape (48,). heights: Share of the surface per sixteenth of the height, shape (16,). colors: Joint histogram
    over CIELAB, shape (245,). extents: Of the box along x, y, z [m], shape (3,).
    """

    distances: Array
    heights: Array
    colors: Array
    extents: Array


def describe(points: ArrayLike, colors: ArrayLike, extents: ArrayLike, rng: np.random.Generator) -> Descriptor:
    """Descriptor of surface points (n, 3) [m] with colors (n, 3) uint8, +Z up, of an object of `extents` [m], shape (3,)."""
    p = np.asarray(points, dtype=np.float64)
    first, second = rng.integers(0, len(p), (2, PAIRS))
    distance = np.linalg.norm(p[first] - p[second], axis=1)
    relative = distance / max(float(distance.mean()), 1e-9)
    distances = np.histogram(np.minimum(relative, 2.999), bins=DISTANCE_BINS, range=(0, 3))[0]
    low, high = p[:, 2].min(), p[:, 2].max()
    heights = np.histogram((p[:, 2] - low) / max(high - low, 1e-9), bins=HEIGHT_BINS, range=(0, 1))[0]
    clipped = np.clip(lab(colors), [0, -59.9, -59.9], [99.9, 59.9, 59.9])
    joint = np.histogramdd(clipped, bins=_LAB_EDGES)[0].ravel()
    return Descriptor(_normalized(distances), _normalized(heights), _normalized(joint), np.asarray(extents, dtype=np.float64))


def _normalized(counts: ArrayLike) -> Array:
    values = np.asarray(counts, dtype=np.float64)
    return values / max(float(values.sum()), 1.0)


def similarity(first: Array, other: Array) -> float:
    """1 - Jensen-Shannon distance (base 2) of two histograms that sum to one: 1 for equal, 0 for disjoint ones."""
    middle = (first + other) / 2
    divergence = 0.0
    for histogram in (first, other):
        some = histogram > 0
        divergence += 0.5 * float((histogram[some] * np.log2(histogram[some] / middle[some])).sum())
    return float(1 - np.sqrt(np.clip(divergence, 0.0, 1.0)))


def extents_similarity(first: ArrayLike, other: ArrayLike) -> float:
    """exp(-sum of |log ratio|) over the three axes, the better of both ways to lay the horizontal axes; in (0, 1]."""
    a, b = np.maximum(np.asarray(first, dtype=np.float64), 0.01), np.maximum(np.asarray(other, dtype=np.float64), 0.01)
    return float(max(np.exp(-np.abs(np.log(a / b[order])).sum()) for order in ([0, 1, 2], [1, 0, 2])))


def shape_similarity(first: Descriptor, other: Descriptor) -> float:
    """Mean of the similarities of both shape histograms, 0..1."""
    return 0.5 * (similarity(first.distances, other.distances) + similarity(first.heights, other.heights))
