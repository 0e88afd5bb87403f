"""How good scores are against what annotators chose, with intervals over rooms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.selection.model.examples import Example
from tasks.selection.model.features import EVIDENCE

OWN = EVIDENCE.index("own")
DRAWS = 1000
"""Of the bootstrap."""


def hits(examples: Sequence[Example], scores: Sequence[NDArray], top: int, *, without_own: bool = False) -> NDArray[np.float64]:
    """1 for every example whose choice is among its `top` best, else 0, shape (n,); equal scores count against it.

    without_own: Candidates made of the scan itself do not compete; NaN where the choice is one.
    """
    made = []
    for example, values in zip(examples, scores, strict=True):
        own = np.array([candidate.evidence[OWN] > 0.5 for candidate in example.candidates])
        if without_own and own[example.choice]:
            made.append(np.nan)
            continue
        rivals = np.delete(values, example.choice)[~np.delete(own, example.choice)] if without_own else np.delete(values, example.choice)
        made.append(float((rivals >= values[example.choice]).sum() < top))
    return np.array(made, dtype=np.float64)


def interval(values: NDArray[np.float64], rooms: Sequence[str], seed: int) -> tuple[float, float, float]:
    """Mean and its interval of 95 % by drawing rooms with repetition; NaN counts for nothing. Without any value, NaN thrice."""
    kept = np.isfinite(values)
    if not kept.any():
        return (np.nan,) * 3
    _, room = np.unique(np.array(rooms)[kept], return_inverse=True)
    sums, counts = np.bincount(room, weights=values[kept]), np.bincount(room)
    drawn = np.random.default_rng(seed).integers(len(sums), size=(DRAWS, len(sums)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(values[kept].mean()), float(low), float(high)
