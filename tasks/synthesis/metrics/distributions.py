"""Shares of categories in layouts, and how far two such distributions are apart."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping

from tasks.synthesis.layout import Layout

EPSILON = 1e-6
"""Added to shares under the logarithm, so that what is never drawn costs much, and not everything."""


def category_shares(layouts: Iterable[Layout]) -> dict[str, float]:
    """Share of each category among all small objects; empty where there is none."""
    counts = Counter(category for layout in layouts for category in layout.categories)
    total = sum(counts.values())
    return {category: count / total for category, count in sorted(counts.items())}


def presence_shares(layouts: Iterable[Layout]) -> dict[str, float]:
    """Share of the layouts in which a category is present at least once."""
    counts: Counter[str] = Counter()
    total = 0
    for layout in layouts:
        counts.update(set(layout.categories))
        total += 1
    return {category: count / total for category, count in sorted(counts.items())}


def kl_divergence(truth: Mapping[str, float], drawn: Mapping[str, float]) -> float:
    """Sum over the truth's categories of p (ln(p + 1e-6) - ln(q + 1e-6)) [nat]; shares that a side does not name are 0."""
    return sum(p * (math.log(p + EPSILON) - math.log(drawn.get(name, 0.0) + EPSILON)) for name, p in truth.items())


def category_kl(truth: Iterable[Layout], drawn: Iterable[Layout]) -> float:
    """CKL: divergence of the drawn categories of small objects from the true ones [nat]; NaN where one side has no object."""
    p, q = category_shares(truth), category_shares(drawn)
    return kl_divergence(p, q) if p and q else math.nan


def total_variation(p: Mapping[str, float], q: Mapping[str, float]) -> float:
    """Half of the sum of absolute differences of shares, in 0..1; shares that a side does not name are 0."""
    return 0.5 * sum(abs(p.get(name, 0.0) - q.get(name, 0.0)) for name in {*p, *q})


def distinct_share(layouts: Iterable[Layout]) -> float:
    """Share of layouts whose set of categories, with how many of each, no earlier one has; NaN without any."""
    sets = [tuple(sorted(layout.categories)) for layout in layouts]
    return len(set(sets)) / len(sets) if sets else math.nan
