"""Undersides: what an object stands on, where the scan did not see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.hulls import Hull
from tasks.optimization.colliders.cutting import without

Array = NDArray[np.float64]

DOWN = np.array([0.0, 0.0, -1.0])

LOWER_SHARE = 0.33
"""Of the height of an object: a plate is as wide as that much of it."""

LEAST_MARGIN_M = 0.01
"""The center of mass lies so far within a plate [m], if the object is wide enough: less, and a nudge throws it over."""

PLATE_M = 0.006
"""Thickness of a plate under an object [m]."""


def base_ring(points: Array, center: Array) -> Array | None:
    """Corners of the base of an object in plan, shape (n, 2) [m]: the convex hull of points of its lower part, shape (k, 2), and of what is
    below its center of mass, shape (2,). What was scanned at rest had its base there. None where these lie on a line."""
    from scipy.spatial import ConvexHull, QhullError

    if not len(points):
        return None
    margin = min(LEAST_MARGIN_M, 0.25 * float(np.ptp(points, axis=0).min())) + 0.001
    points = np.concatenate([points, center + margin * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])])
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        return None


def holds(ring: Array, center: Array) -> bool:
    """True if a center of mass, shape (2,), lies well within the convex hull of points in plan, shape (n, 2) [m]."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        plan = ConvexHull(ring)
    except (QhullError, ValueError):
        return False
    margin = -float((plan.equations[:, :2] @ center + plan.equations[:, 2]).max())
    return margin >= min(LEAST_MARGIN_M, 0.25 * plan.volume / max(plan.area, 1e-9))


def apart_from(hull: Hull | None, around: Sequence[Hull], clear: float) -> list[Hull]:
    """Convex parts of a hull that lie in none of several other hulls; none if there is no hull."""
    if hull is None:
        return []
    parts = [hull]
    for other in around:
        top = float(other.vertices[:, 2].max())
        if top <= float(hull.vertices[:, 2].min()) + 1e-5:
            continue  # it carries the plate
        parts = [part for each in parts for part in without(each, other, clear)]
    return parts
