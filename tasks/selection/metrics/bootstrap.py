"""Intervals of means over instances that come in rooms: what stands in one room is no independent evidence."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import ArrayLike

DRAWS = 2000
"""Of rooms with repetition; ends of intervals are then known to some hundredths of their width."""

LEVEL = 0.95


@dataclasses.dataclass(frozen=True)
class ConfidenceInterval:
    """A mean with its interval of 95 %. examples: That it is over; without any, the others are NaN."""

    value: float
    low: float
    high: float
    examples: int


def interval(values: ArrayLike, rooms: Sequence[Hashable], seed: int, draws: int = DRAWS) -> ConfidenceInterval:
    """Mean of values, shape (n,), and its interval by the cluster bootstrap: rooms are drawn with repetition, each with all that is in it.

    NaN counts for nothing. The order of values and the names of rooms change nothing but the draws: rooms are taken by name.
    """
    numbers = np.asarray(values, dtype=np.float64)
    kept = np.isfinite(numbers)
    if not kept.any():
        return ConfidenceInterval(np.nan, np.nan, np.nan, 0)
    sums: dict[str, list[float]] = {}
    for value, room in sorted((float(value), str(room)) for value, room, use in zip(numbers, rooms, kept, strict=True) if use):
        sums.setdefault(room, []).append(value)
    names = sorted(sums)
    totals, counts = np.array([sum(sums[name]) for name in names]), np.array([len(sums[name]) for name in names])
    drawn = np.random.default_rng(seed).integers(len(names), size=(draws, len(names)))
    means = totals[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return ConfidenceInterval(float(totals.sum() / counts.sum()), float(low), float(high), int(counts.sum()))


def difference(first: ArrayLike, second: ArrayLike, rooms: Sequence[Hashable], seed: int, draws: int = DRAWS) -> ConfidenceInterval:
    """Mean of first minus second, shapes (n,), of the same instances: rooms are drawn once for both."""
    return interval(np.asarray(first, dtype=np.float64) - np.asarray(second, dtype=np.float64), rooms, seed, draws)
