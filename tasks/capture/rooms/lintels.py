"""Lintels: what was seen of walls over the doorways between walls inside a room, and between one of them and an outer wall."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud
from tasks.capture.rooms.separation import doorways
from tasks.capture.rooms.slabs import Slab

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LOWEST_M = 1.8
"""No lintel is lower: people pass below."""

ABOVE_FLOOR_M = 0.3
"""Skirting and thresholds are lower [m]: what is called wall there closes no doorway."""

LEAST_M = 0.1
"""Less wall than this over a doorway is its frame [m]."""

CELL_M = 0.1
"""Step along a lintel [m]: a vertex or two of a coarse mesh."""

NEAR_M = 0.08
"""Points this near to a wall's faces are its own [m]."""

FACING = 0.7
"""Cosine of what normals of a lintel's faces may be off the wall's: 45 degrees, as at its edges."""

SEEN_SHARE = 0.5
"""Of a doorway's width over which wall was seen above it."""

OPEN_SHARE = 0.5
"""Of its width over which wall was seen below that: it is no doorway."""

LEAF_SHARE = 0.3
"""Of a door's points that lie in a doorway, from which on it fills it."""

FREE_M = 0.01
"""A lintel begins so far over the leaf below it [m]."""


def lintels(
    cloud: Cloud, is_wall: Mask, polygon: Array, interior_walls: Array, leaves: Sequence[Array] = ()
) -> tuple[tuple[float, ...], ...]:
    """Lintels as rows x0, y0, x1, y1, thickness, bottom, top [m]: center lines from the end of the wall that goes on.

    is_wall: which points of the cloud are of walls, shape (n,). polygon: floor's corners, counter-clockwise, shape (n, 2).
    interior_walls: rows x0, y0, x1, y1, thickness, height, shape (k, 6) [m]. leaves: points of every door, shape (m, 3) [m].
    """
    points, normals = cloud.points[is_wall], cloud.normals[is_wall]
    rows = []
    for gap in doorways(polygon, interior_walls):
        along = (gap.end - gap.start) / gap.length
        across = np.array([-along[1], along[0]])
        own = (np.abs((points[:, :2] - gap.start) @ across) < 0.5 * gap.thickness + NEAR_M) & (np.abs(normals[:, :2] @ across) > FACING)
        place, z = (points[own, :2] - gap.start) @ along, points[own, 2]
        cells = max(int(gap.length / CELL_M), 1)
        cell = np.floor(place / gap.length * cells).astype(np.int64)
        inside = (cell >= 0) & (cell < cells) & (z < gap.height + NEAR_M)
        above, below = inside & (z > LOWEST_M), inside & (z > ABOVE_FLOOR_M) & (z <= LOWEST_M)
        if len(np.unique(cell[above])) < SEEN_SHARE * cells or len(np.unique(cell[below])) >= OPEN_SHARE * cells:
            continue
        lowest = np.full(cells, np.inf)
        np.minimum.at(lowest, cell[above], z[above])
        bottom = max(float(np.median(lowest[np.isfinite(lowest)])), *(top + FREE_M for top in _tops(gap, leaves)), LOWEST_M)
        if gap.height - bottom >= LEAST_M:
            rows.append((*map(float, (*gap.start, *gap.end)), gap.thickness, bottom, gap.height))
    return tuple(rows)


def _tops(gap: Slab, leaves: Sequence[Array]) -> list[float]:
    """Where the doors end that fill a doorway [m]."""
    import shapely

    around = gap.polygon(NEAR_M)
    return [
        float(np.percentile(points[:, 2], 99))
        for points in leaves
        if len(points) and shapely.contains_xy(around, points[:, 0], points[:, 1]).mean() >= LEAF_SHARE
    ]
