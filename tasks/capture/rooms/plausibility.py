"""Sizes of scans that no room has: most often a file in another unit than it states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MIN_SPAN_M, MAX_SPAN_M = 0.6, 30.0
"""Longest side of a scan: a single view of a desk spans more than the one, a room or dwelling less than the other."""

_OUTLIER_PERCENT = 0.5
"""Vertices on each side that count for nothing: stray depth."""


def size_notes(vertices: NDArray[np.float64], scan: str) -> list[str]:
    """A line that asks about the unit if a scan is much smaller or larger than a room.

    Args:
        vertices: of the scan in the world frame [m], shape (n, 3).
        scan: name of the scan.
    """
    if not len(vertices):
        return []
    low, high = np.percentile(vertices, [_OUTLIER_PERCENT, 100 - _OUTLIER_PERCENT], axis=0)
    span = float((high - low).max())
    if MIN_SPAN_M <= span <= MAX_SPAN_M:
        return []
    size = " x ".join(f"{side:.2f}" for side in high - low)
    line = f"{scan}: the scan measures {size} m, a room {MIN_SPAN_M:g} to {MAX_SPAN_M:g} m: are its coordinates in meters?"
    return [f"{line} If not, scale the file or correct depth_scale, and run again"]
