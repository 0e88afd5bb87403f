"""Tests of paired outcomes: is one of two policies better in the same episodes, or is it chance?"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

EXACT = 16
"""Of so many differences all flips of signs are tried, 65,536; of more some are drawn."""

_AT_ONCE = 2000
"""Flips that are drawn in one go: some hundred pairs by as many are a few MB."""

_ALIKE = 1e-9
"""Sums that differ by less of the largest one count as equal: the order of adding changes the last digits."""


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact two-sided p value of McNemar's test (McNemar 1947): pairs in which one alone succeeded fall to either side by a fair coin.

    Pairs with the same outcome for both say nothing.
    """
    count = only_first + only_second
    tail = sum(math.comb(count, k) for k in range(min(only_first, only_second) + 1))
    return min(1.0, 2 * tail / 2**count)


def sign_flips(differences: ArrayLike, rng: np.random.Generator, draws: int) -> float:
    """Two-sided p value of the paired permutation test (Fisher 1935) of differences of pairs, shape (n,), from a mean of 0.

    The share of flips of signs whose sum is as far from 0 as the one that was seen: of all flips where few differences are not 0, else of
    `draws` and the one that was seen.
    """
    values = np.asarray(differences, dtype=np.float64)
    values = np.sort(values[values != 0])  # the order of pairs is nobody's
    if not len(values):
        return 1.0
    least = abs(values.sum()) - _ALIKE * np.abs(values).sum()
    if len(values) <= EXACT:
        flips = (np.arange(2 ** len(values))[:, None] >> np.arange(len(values))) & 1
        return float((_sums(values, flips) >= least).mean())
    beyond, left = 0, draws
    while left:
        flips = rng.integers(0, 2, size=(min(left, _AT_ONCE), len(values)), dtype=np.int8)
        beyond += int((_sums(values, flips) >= least).sum())
        left -= len(flips)
    return (beyond + 1) / (draws + 1)


def _sums(values: NDArray[np.float64], flips: NDArray[np.integer]) -> NDArray[np.float64]:
    """How far sums with flipped signs are from 0, shape (flips,)."""
    return np.abs(values.sum() - 2 * (flips @ values))
