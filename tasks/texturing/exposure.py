"""How bright each of several images is: from what they show of the same points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_POINTS = 20_000
"""More points say no more about some hundred exposures."""

_DARKEST, _BRIGHTEST = 16.0, 245.0
"""Levels between which a camera's answer follows the exposure: below is noise, above is cut off."""

_TOLERANCE = 0.1
"""Looks that differ by more of their color than that show something else, and count less, by Huber's weights."""

_PRIOR = 1e-3
"""Weight of an exposure of 1, over that of all its looks: it decides only what the looks leave open, as is the mean of all."""

_ROUNDS = 4
"""Of weighting anew: by then exposures move by less than a thousandth."""

_MOST = 2.0
"""An exposure beyond that, or its inverse, is no camera's but an error's."""

_DECIMALS = 6
"""Of exposures: what lies below hangs on the order of sums."""


def gains_of(color: NDArray[np.float32], weight: NDArray[np.float32], view: NDArray[np.int32], views: int) -> Array:
    """Exposure of each view over the usual one, shape (views,); 1 for those that share no point with another.

    color: Looks at points, shape (t, k, 3), 0..255. weight: shape (t, k), 0 for none. view: of each look, shape (t, k).

    Solves log(color) = log(gain of its view) + log(color of its point) in the sense of least squares, with points eliminated.
    """
    shade = color.mean(axis=2).astype(np.float64)
    usable = (weight > 0) & (shade >= _DARKEST) & (color.max(axis=2) <= _BRIGHTEST)
    rows = np.flatnonzero(usable.sum(axis=1) >= 2)
    rows = rows[:: max(-(-len(rows) // _POINTS), 1)]
    if not len(rows) or views < 2:
        return np.ones(views)
    log = np.log(np.where(usable[rows], shade[rows], 1.0))
    base = np.where(usable[rows], weight[rows], 0.0).astype(np.float64)
    base /= base.sum(axis=1, keepdims=True)
    of, gain, trust = view[rows].astype(np.int64), np.zeros(views), np.ones(base.shape)
    for _ in range(_ROUNDS):
        gain = _solved(log, base * trust, of, views)
        level = log - gain[of]
        apart = np.abs(level - (base * trust * level).sum(axis=1, keepdims=True) / (base * trust).sum(axis=1, keepdims=True))
        trust = _TOLERANCE / np.maximum(apart, _TOLERANCE)
    return np.round(np.clip(np.exp(gain), 1 / _MOST, _MOST), _DECIMALS)


def _solved(log: Array, weight: Array, view: NDArray[np.int64], views: int) -> Array:
    """Log gains: least squares over looks, of which points take their own mean, shape (views,)."""
    total = weight.sum(axis=1, keepdims=True)
    around = log - (weight * log).sum(axis=1, keepdims=True) / total
    count = np.bincount(view.ravel(), weight.ravel(), minlength=views)
    joint = (weight[:, :, None] * weight[:, None, :] / total[..., None]).ravel()
    pairs = (view[:, :, None] * views + view[:, None, :]).ravel()
    normal = np.diag(count * (1 + _PRIOR) + 1e-12) - np.bincount(pairs, joint, minlength=views * views).reshape(views, views)
    return np.asarray(np.linalg.solve(normal, np.bincount(view.ravel(), (weight * around).ravel(), minlength=views)))
