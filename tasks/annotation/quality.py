"""Quality control of a batch: which answers are drawn, what a sample says of all, and what becomes of the batch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

T = TypeVar("T")

CONFIDENCE = 0.95
"""Of intervals."""


def drawn(answers: Sequence[T], count: int, rng: np.random.Generator) -> list[T]:
    """`count` of the answers, every such choice equally likely, in the order in which they were drawn."""
    return [answers[index] for index in rng.permutation(len(answers))[:count]]


def pass_interval(passed: int, sampled: int, answers: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Least and greatest share of right answers among all that a sample without replacement leaves possible.

    Exact, after Clopper and Pearson, with the hypergeometric distribution of the finite batch in place of the binomial: the true number
    is outside on either side with a chance of at most (1 - confidence) / 2. A sample of all answers leaves one share.

    Raises:
        ValueError: more passed than were sampled, or more were sampled than there are; none was sampled.
    """
    from scipy.stats import hypergeom

    if not 0 <= passed <= sampled <= answers or sampled < 1:
        raise ValueError(f"{passed} of {sampled} sampled of {answers} answers")
    tail = (1.0 - confidence) / 2.0 - 1e-12  # a tail of exactly that much is possible, whatever floats make of it
    right = np.arange(passed, answers - (sampled - passed) + 1)  # as many as are not ruled out outright
    at_most = hypergeom.cdf(passed, answers, right, sampled)
    at_least = hypergeom.sf(passed - 1, answers, right, sampled)
    possible = right[(at_most >= tail) & (at_least >= tail)]
    return float(possible[0] / answers), float(possible[-1] / answers)


def in_words(sampled: int, answers: int, share: float, least: int, pass_share: float) -> str:
    """How large a sample is, and why, for people."""
    asked = math.ceil(share * answers - 1e-9)
    if sampled <= asked:
        return f"{sampled} of {answers} answers are reviewed ({share:.0%})"
    why = f"{share:.0%} of {answers} answers are {asked}, and under {least} answers cannot tell {pass_share:.0%}"
    return f"{why}: {'all of them' if sampled == answers else sampled} are reviewed"
