"""How alike two sets of colors are: histograms in CIELAB, compared by the Jensen-Shannon distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.captions.colors import lab

Array = NDArray[np.float64]

LIGHTNESS_BINS, HUE_BINS = 4, 7
"""Lightness is coarse, for shade changes it most; seven bins along a and b tell the basic colors apart."""

HUE_REACH = 56.0
"""Furniture and walls lie within this a and b; more saturated colors count with the last bin."""

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
    shape = np.array([LIGHTNESS_BINS, HUE_BINS, HUE_BINS])
    base = np.minimum(np.floor(position).astype(np.int64), shape - 2)
    part = position - base
    histogram = np.zeros(int(shape.prod()))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, part, 1 - part), axis=1)
        cell = base + np.array(corner)
        histogram += np.bincount((cell[:, 0] * HUE_BINS + cell[:, 1]) * HUE_BINS + cell[:, 2], weight, histogram.size)
    return np.asarray(histogram / max(histogram.sum(), 1e-12))


def color_similarity(first: Array, second: Array) -> float:
    """1 minus the Jensen-Shannon distance (base 2) of two histograms, in 0..1."""
    from scipy.special import rel_entr

    middle = 0.5 * (first + second)
    divergence = 0.5 * float(rel_entr(first, middle).sum() + rel_entr(second, middle).sum()) / np.log(2)
    return 1.0 - float(np.sqrt(min(max(divergence, 0.0), 1.0)))
