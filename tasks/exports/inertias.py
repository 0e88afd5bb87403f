"""Whether masses and inertias as files state them are those that a solid can have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray


def impossible(entries: Sequence[float]) -> Iterator[str]:
    """What is wrong with an inertia, given as xx, xy, xz, yy, yz, zz [kg m2]: a moment below zero or larger than the others together."""
    xx, xy, xz, yy, yz, zz = entries
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not moments[0] > 0.0:
        yield f"principal moments are {moments.tolist()}"
    elif moments[2] > (moments[0] + moments[1]) * (1 + 1e-6):
        yield f"{moments.tolist()}: one moment exceeds the sum of the others"


def too_large(mass: float, entries: Sequence[float], reach: NDArray[np.float64]) -> Iterator[str]:
    """Whether an inertia, as above, is more than a mass [kg] could have that reaches so far from its center along the axes [m], (3,)."""
    most, stated = float(mass * (reach @ reach)), max(entries[0], entries[3], entries[5])
    if mass > 0.0 and stated > 2.0 * most:
        yield f"{stated:.3g} is more than its mass could have in its farthest corner, {most:.3g}"
