"""How good scores are against what annotators chose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.selection.model.examples import Example
from tasks.selection.model.features import EVIDENCE

OWN = EVIDENCE.index("own")


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
