"""Where a carried object may stand: every shift of its base over a grid of what carries and of what is in its way."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.optimization.support.heights import occupancy, plan_view

if TYPE_CHECKING:
    from tasks.optimization.support.supports import PlacedAsset, SupportConfig

Cells = NDArray[np.int64]

MOST_CELLS = 2500
"""Along a side of a grid: 25 m at a centimetre."""

MOST_TESTED = 200
"""Cells of an object that are tried at every shift."""

BLOCKED_SHARE = 0.02
"""As much more of an object may meet its carrier than at its place: cells at the edge of a side are marked by chance."""


def standing_map(
    obj: PlacedAsset, carrier: PlacedAsset, gap: float, cell: float, per_step: int, reach: int, config: SupportConfig
) -> NDArray[np.bool_]:
    """Where a carried object may be shifted to, in steps of `per_step` cells [m] along x and y: shape (2 reach + 1,
    2 reach + 1).

    It may where `carried_share` of its base, or as much as at its place, has its carrier's surface below it at the height
    at which it stands, and where no more of it meets the carrier than at its place. An object whose grid would be
    unreasonably large may stand where it is.
    """
    if float((obj.high - obj.low)[:2].max()) > MOST_CELLS * cell:
        return np.pad(np.ones((1, 1), dtype=np.bool_), reach)
    rest, level = float(obj.low[2]) - gap, config.base_m
    cells, heights = obj.footprint(cell)
    rise = heights - obj.low[2]
    margin = reach * per_step * cell + cell
    low, high = obj.low[:2] - margin, obj.high[:2] + margin
    base, lowest = rise <= level, 0.0
    floor = plan_view(carrier.surface, low, high, rest + level, cell, carrier.closed, carrier.blocks)
    if not base.any() or (np.abs(floor.at(cells[base]) - rest) <= level).mean() < config.share:
        # its lowest part is past the carrier's edge: what stands is what touches
        under = plan_view(carrier.surface, low, high, rest + float(rise.max()) + level, cell, carrier.closed, carrier.blocks).at(cells)
        touches = np.abs(under - rest - rise) <= level
        if touches.any():
            lowest = float(np.median(rise[touches]))
            base = np.abs(rise - lowest) <= level
            floor = plan_view(carrier.surface, low, high, rest + lowest + level, cell, carrier.closed, carrier.blocks)
    top = rest + max(obj.height - config.cell_m, lowest + level)
    blocking = occupancy(carrier.surface, low, high, rest + lowest + level, top, cell, carrier.blocks)
    stood, body = (some[kept_cells(some, MOST_TESTED)] - np.array(floor.first) for some in (cells[base], cells))
    allowed = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.bool_)
    carries, blocks = np.abs(floor.heights - rest - lowest) <= level, np.isfinite(blocking.heights)
    _compiled()["_fill"](carries, blocks, stood, body, per_step, reach, config.carried_share, BLOCKED_SHARE, allowed)
    return allowed


def kept_cells(cells: Cells, most: int) -> NDArray[np.int64]:
    """Places of about `most` cells in a list of cells, scattered over the grid: shares are needed to a percent."""
    parts = -(-len(cells) // most)
    if parts <= 1:
        return np.arange(len(cells))
    scattered = np.flatnonzero((cells[:, 0] * 73856093 ^ cells[:, 1] * 19349663) % 9973 * parts < 9973)
    return scattered if 2 * len(scattered) > most else np.arange(0, len(cells), parts)


@cache
def _compiled() -> Kernels:
    return compile_kernels(_fill)


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
