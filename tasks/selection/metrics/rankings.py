"""Where a method puts the candidate that is the truth."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

DIGITS = 9
"""Scores that agree so far are equal, as in the stage."""


def ranking_of(scores: ArrayLike, slots: Sequence[int]) -> list[int]:
    """Slots from the best score to the worst, shape (k,) both; equal scores by slot, as the stage ranks."""
    values = np.round(np.asarray(scores, dtype=np.float64), DIGITS)
    return [slot for _, slot in sorted(zip((-values).tolist(), slots, strict=True))]


def place_of(ranking: Sequence[int], truth: Collection[int], without: Collection[int] = ()) -> int | None:
    """Place of the first of some slots in a ranking, from 1; None where none of them is in it.

    without: Slots that do not compete: they take no place, and are no truth.
    """
    rest = [slot for slot in ranking if slot not in without]
    return next((place for place, slot in enumerate(rest, start=1) if slot in truth), None)


def hits(places: Sequence[int | None], top: int) -> NDArray[np.float64]:
    """1 where the truth is among the `top` best, else 0, shape (n,); NaN where it did not compete."""
    return np.array([np.nan if place is None else float(place <= top) for place in places])
