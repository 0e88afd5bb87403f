"""How alike two sets of colors are: histograms in CIELAB, compared by the Jensen-Shannon distance."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.captions.colors import lab
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

LIGHTNESS_BINS, HUE_BINS = 4, 7
"""Lightness is coarse, for shade changes it most; seven bins along a and b tell the basic colors apart."""

HUE_REACH = 56.0
"""Furniture and walls lie within this a and b; more saturated colors count with the last bin."""

COMPARED_POINTS = 1500
"""Points that are compared with the surface next to them, one by one: 5 cm apart on a rug of 4 m2."""

MAX_COLORS = 4000
"""Colors that a histogram is made of: every n-th beyond; shares settle to a percent long before."""


def color_histogram(rgb: ArrayLike) -> Array:
    """Shares of colors, shape (n, 3) uint8, in bins of L, a, b: shape (bins,), sum 1. Every color is split between its
    neighboring bins, so that a small shift of the light changes the shares a little."""
    colors = np.asarray(rgb).reshape(-1, 3)
    values = lab(colors[:: max(1, len(colors) // MAX_COLORS)])
    position = np.column_stack(
        [
            np.clip(values[:, 0] / 100.0, 0, 1) * (LIGHTNESS_BINS - 1),
            np.clip((values[:, 1:] + HUE_REACH) / (2 * HUE_REACH), 0, 1) * (HUE_BINS - 1),
        ]
    )
    histogram = _compiled()["_shared"](position, np.array([LIGHTNESS_BINS, HUE_BINS, HUE_BINS]))
    return np.asarray(histogram / max(histogram.sum(), 1e-12))


def is_uncolored(rgb: ArrayLike) -> bool:
    """True if all colors, shape (n, 3) uint8, are one gray: that of a scan without colors."""
    colors = np.asarray(rgb).reshape(-1, 3)
    return bool((colors == colors[:1, :1]).all())


@cache
def _compiled() -> Kernels:
    return compile_kernels(_shared)


def _shared(position: Array, shape: NDArray[np.int64]) -> Array:
    """How much of points falls to each bin of a grid, shape (bins,), corner by corner of the cells that they are in."""
    histogram = np.zeros(shape[0] * shape[1] * shape[2])
    for corner in range(8):
        part = np.zeros(len(histogram))
        for i in range(len(position)):
            weight, bin_ = 1.0, 0
            for d in range(3):
                base = min(np.floor(position[i, d]), shape[d] - 2.0)
                far = corner >> (2 - d) & 1
                share = position[i, d] - base
                weight *= share if far else 1.0 - share
                bin_ = bin_ * shape[d] + int(base) + far
            part[bin_] += weight
        histogram += part
    return histogram


def color_error(points: Array, colors: NDArray[np.uint8], placed: Array, shown: NDArray[np.uint8]) -> float:
    """Mean distance in CIELAB of the colors of points and of the surface next to them, apart from light that changes all of them alike.

    Unlike histograms, it tells a pattern from a plain color, and from another pattern.

    Args:
        points: scanned points [m], shape (n, 3).
        colors: their colors, shape (n, 3).
        placed: samples of a surface [m], shape (m, 3).
        shown: their colors, shape (m, 3).
    """
    from scipy.spatial import cKDTree

    stride = max(1, len(points) // COMPARED_POINTS)
    nearest = cKDTree(placed).query(points[::stride])[1]
    apart = lab(colors[::stride]) - lab(shown[nearest])
    apart[:, 0] -= np.median(apart[:, 0])
    return float(np.linalg.norm(apart, axis=1).mean())


def color_similarity(first: Array, second: Array) -> float:
    """1 minus the Jensen-Shannon distance (base 2) of two histograms, in 0..1."""
    from scipy.special import rel_entr

    middle = 0.5 * (first + second)
    divergence = 0.5 * float(rel_entr(first, middle).sum() + rel_entr(second, middle).sum()) / np.log(2)
    return 1.0 - float(np.sqrt(min(max(divergence, 0.0), 1.0)))
