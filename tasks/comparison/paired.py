"""Tests of paired outcomes: is one of two policies better in the same episodes, or is it chance?"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

EXACT = 16
"""Of so many differences all flips of signs are tried, 65,536; of more some are drawn."""

_AT_ONCE = 2000
"""Flips that are drawn in one go: some hundred pairs by as many are a few MB."""


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact two-sided p value of McNemar's test (McNemar 1947): pairs in which one alone succeeded fall to either side by a fair coin.

    Pairs with the same outcome for both say nothing.
    """
    from scipy.stats import binomtest

    count = only_first + only_second
    return float(binomtest(only_first, count).pvalue) if count else 1.0


def sign_flips(differences: ArrayLike, rng: np.random.Generator, draws: int) -> float:
    """Two-sided p value of the paired permutation test (Fisher 1935) of differences of pairs, shape (n,), from a mean of 0.

    Twice the smaller share of flips of signs whose sum is as far to either side as the one that was seen: of all flips where few
    differences are not 0, else of `draws` and the one that was seen.
    """
    from scipy.stats import permutation_test

    values = np.asarray(differences, dtype=np.float64)
    values = np.sort(values[values != 0])  # the order of pairs is nobody's
    if len(values) < 2:  # one alone is as far from 0 either way
        return 1.0
    count = 2**EXACT if len(values) <= EXACT else draws
    tested = permutation_test(
        (values,), np.sum, permutation_type="samples", n_resamples=count, batch=_AT_ONCE, vectorized=True, rng=rng
    )  # fmt: skip
    return min(1.0, float(tested.pvalue))


def whole_flips(differences: ArrayLike, units: ArrayLike, rng: np.random.Generator, draws: int) -> float | None:
    """`sign_flips` where all differences of one unit, a scene or a seed, keep their signs or change them together.

    `units`, shape (n,), are the units of the differences, by number from 0. None where there is but one: it says nothing of others.
    """
    sums = np.bincount(np.asarray(units), np.asarray(differences, dtype=np.float64))
    return sign_flips(sums, rng, draws) if len(sums) > 1 else None
