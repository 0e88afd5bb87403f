"""What an annotation holds beside the object that it names, where the object's kind tells: things on tables, legs on rugs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.mounting import mounting

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]

CELL_M = 0.05
"""Cells of the plan in which heights are compared."""

THICK_M = 0.06
"""Rugs and cloths are thinner."""

LEVEL_M = 0.025
"""Points this near to a top's height are of it: the noise of a room scan."""

TOP_SHARE = 0.5
"""Of the cells of a table, from which on the height that they share is its top."""

ABOVE_SHARE = 0.3
"""Of the cells, in which more is above that height, from which on it is no top: a desk has shelves on it."""


def own_size(points: Array, category: str) -> Array:
    """Extents along the world's axes [m], shape (3,), of what is an object's own if it is of a category. points: shape (n, 3) [m]."""
    own = points[own_part(points, category)] if len(points) else points
    return np.ptp(own, axis=0) if len(own) else np.zeros(3)


def own_part(points: Array, category: str) -> Booleans:
    """Which points of an annotated object are its own, shape (n, 3) to (n,): of rugs what is flat, of tables nothing above the top."""
    kind = mounting(category)
    heights = points[:, 2]
    if kind.kind == "covering":
        low = float(np.quantile(heights, 0.05))
        flat = heights <= low + THICK_M
        return np.asarray(flat if flat.mean() >= TOP_SHARE else np.ones(len(points), dtype=np.bool_))
    if kind.is_flat_topped:
        _, cell = np.unique(np.floor(points[:, :2] / CELL_M).astype(np.int64), axis=0, return_inverse=True)
        highest = np.full(int(cell.max()) + 1, -np.inf)
        np.maximum.at(highest, cell.ravel(), heights)
        bins = np.floor(highest / LEVEL_M).astype(np.int64)
        values, counts = np.unique(bins, return_counts=True)
        top = float(np.median(highest[np.abs(bins - values[np.argmax(counts)]) <= 1]))
        above = highest > top + LEVEL_M
        if (np.abs(highest - top) <= LEVEL_M).mean() >= TOP_SHARE and above.mean() <= ABOVE_SHARE:
            return np.asarray(heights <= top + LEVEL_M)
    return np.ones(len(points), dtype=np.bool_)
