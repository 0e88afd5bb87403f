"""Where a carried thing may stand: every shift of its base over a grid of what carries and of what is in its way."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.optimization.heights import PlanView

Cells = NDArray[np.int64]

BLOCKED_SHARE = 0.02
"""As much more of a thing may meet its carrier than at its place: cells at the edge of a side are marked by chance."""


def standing_map(
    carrying: PlanView, blocking: PlanView, height: float, level: float, base: Cells, body: Cells, per_step: int, reach: int, share: float
) -> NDArray[np.bool_]:
    """Where a thing may be shifted to, in steps of `per_step` cells along x and y: shape (2 reach + 1, 2 reach + 1).

    It may where `share` of its `base`, or as much as at its place, has the carrying surface within `level` of `height`
    [m] below it, and where no more of its `body` meets a blocked cell than at its place. Cells: shape (n, 2). Both views
    have one window.
    """
    carries = np.abs(carrying.heights - height) <= level
    blocks = np.isfinite(blocking.heights)
    first = np.array(carrying.first)
    allowed = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.bool_)
    _compiled()["fill"](carries, blocks, base - first, body - first, per_step, reach, share, BLOCKED_SHARE, allowed)
    return allowed


@cache
def _compiled() -> dict[str, Callable[..., Any]]:
    import numba

    return {f.__name__.strip("_"): numba.njit(cache=True, nogil=True, error_model="numpy")(f) for f in (_fill,)}


def _fill(
    carries: NDArray[np.bool_], blocks: NDArray[np.bool_], base: Cells, body: Cells, per_step: int, reach: int, share: float,
    blocked_share: float, allowed: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Try every shift, the place itself first, and give one up as soon as too little carries or too much blocks."""
    nx, ny = carries.shape
    most_missed, most_blocked = len(base), len(body)
    tries = (2 * reach + 1) ** 2
    for number in range(-1, tries):
        i, j = (0, 0) if number < 0 else (number // (2 * reach + 1) - reach, number % (2 * reach + 1) - reach)
        missed, blocked = 0, 0
        for k in range(len(base)):
            x, y = base[k, 0] + i * per_step, base[k, 1] + j * per_step
            if not (0 <= x < nx and 0 <= y < ny and carries[x, y]):
                missed += 1
                if missed > most_missed:
                    break
        if missed > most_missed:
            continue
        for k in range(len(body)):
            x, y = body[k, 0] + i * per_step, body[k, 1] + j * per_step
            if 0 <= x < nx and 0 <= y < ny and blocks[x, y]:
                blocked += 1
                if blocked > most_blocked:
                    break
        if number < 0:
            most_missed = max(missed, int(np.floor((1.0 - share) * len(base) + 1e-9)))
            most_blocked = int(np.floor(blocked + blocked_share * len(body) + 1e-9))
        allowed[i + reach, j + reach] = blocked <= most_blocked
