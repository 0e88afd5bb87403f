"""Doors and windows that were annotated together: flat upright panels in different planes, each of which fills an opening of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]

UPRIGHT = 0.4
"""Of what stands upright, the vertical part of a normal is no larger."""

TURNS = 36
"""Directions that panels are looked for in: every 5 degrees."""

FACING = 0.94
"""Cosine of what a panel's normals may be off its own: 20 degrees, as fused noise is."""

THICK_M = 0.05
"""Points this near to a panel's middle plane are its own [m]: both faces of a leaf, with noise."""

STEP_M = 0.02
"""Between places of planes that are tried [m]."""

CELL_M = 0.1
"""Cells of a panel in which points are counted [m]: a few vertices of a coarse mesh."""

LEAST_M = (0.4, 0.6)
"""No panel is narrower or lower where it was seen [m]."""

LEAST_SHARE = 0.2
"""Of the points of an annotation, from which on they may be a panel of their own."""

FILLED = 0.5
"""Of the cells of a panel's rectangle: the lining around a doorway fills a third, what is left of the wall around a pane less."""

EXPLAINED = 0.8
"""Share of the points that panels explain together: else the annotation is something else."""

MOST = 3
"""Of one annotation."""


def panels_of(points: Array, normals: Array) -> list[Integers]:
    """Which points are of each panel of an annotated door or window, the largest first, all of them in one; one panel, where no other
    is in another plane. points, unit normals: shape (n, 3) [m]."""
    upright = np.abs(normals[:, 2]) <= UPRIGHT
    left = upright.copy()
    planes: list[tuple[Array, float, float, float]] = []
    while len(planes) < MOST and left.sum() >= LEAST_SHARE * len(points):
        plane = _plane(points[left], normals[left])
        if plane is None:
            break
        normal, offset = plane
        own = left & _is_near(points, normal, offset)
        left &= ~own
        if own.sum() < LEAST_SHARE * len(points):
            break
        facing = own & (np.abs(normals[:, :2] @ normal) >= FACING)
        if not facing.any():
            break
        if _is_panel(points[facing], normal):
            low, high = np.percentile(points[facing, :2] @ np.array([-normal[1], normal[0]]), [1, 99])
            planes.append((normal, offset, float(low), float(high)))
    if len(planes) < 2:
        return [np.arange(len(points))]
    away = np.column_stack([_distances(points, *plane) for plane in planes])
    if (away.min(axis=1) <= THICK_M).mean() < EXPLAINED:
        return [np.arange(len(points))]
    nearest = away.argmin(axis=1)
    parts = [np.flatnonzero(nearest == k) for k in range(len(planes))]
    return sorted(parts, key=lambda own: (-len(own), int(own[0])))


def _plane(points: Array, normals: Array) -> tuple[Array, float] | None:
    """The upright plane that most points lie on and face: its normal, shape (2,), and offset [m]. None where no point faces any: normals
    are tilted by more than `FACING` allows, or are zero, as those of degenerate triangles."""
    best: tuple[int, Array, float] | None = None
    for turn in np.pi * np.arange(TURNS) / TURNS:
        normal = np.array([np.cos(turn), np.sin(turn)])
        places = np.sort(points[np.abs(normals[:, :2] @ normal) >= FACING, :2] @ normal)
        if not len(places):
            continue
        middles = np.arange(places[0], places[-1] + STEP_M, STEP_M)
        counts = np.searchsorted(places, middles + THICK_M) - np.searchsorted(places, middles - THICK_M)
        at = int(np.argmax(counts))
        if best is None or counts[at] > best[0]:
            near = places[np.abs(places - middles[at]) <= THICK_M]
            best = int(counts[at]), normal, float(near.mean())
    return None if best is None else best[1:]


def _distances(points: Array, normal: Array, offset: float, low: float, high: float) -> Array:
    """How far points are, seen from above, from a panel that reaches from low to high along its plane, shape (n, 3) to (n,) [m]."""
    along = points[:, :2] @ np.array([-normal[1], normal[0]])
    return np.asarray(np.hypot(points[:, :2] @ normal - offset, np.maximum(np.maximum(low - along, along - high), 0.0)))


def _is_near(points: Array, normal: Array, offset: float) -> Booleans:
    return np.asarray(np.abs(points[:, :2] @ normal - offset) <= THICK_M)


def _is_panel(points: Array, normal: Array) -> bool:
    """Whether points on an upright plane fill a rectangle of it that is as large as a door or window."""
    along = points[:, :2] @ np.array([-normal[1], normal[0]])
    (low, bottom), (high, top) = np.percentile(np.column_stack([along, points[:, 2]]), [2, 98], axis=0)
    if high - low < LEAST_M[0] or top - bottom < LEAST_M[1]:
        return False
    columns, rows = max(round((high - low) / CELL_M), 1), max(round((top - bottom) / CELL_M), 1)
    i = np.floor((along - low) / (high - low) * columns).astype(np.int64)
    j = np.floor((points[:, 2] - bottom) / (top - bottom) * rows).astype(np.int64)
    inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
    return len(np.unique(i[inside] * rows + j[inside])) >= FILLED * columns * rows
