"""Boxes: axis-aligned ones as corner arrays, and oriented ones that are turned about +Z.

An axis-aligned box is its lowest and highest corner [m]; many of them are two arrays of shape (n, 3). An oriented box
is a pose with its origin at the box center, and extents along its own axes [m], as rows of `instances` hold it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

UPRIGHT_TOLERANCE = 1e-6
"""How far the z axis of an oriented box may lean: rounding of a stored matrix, nothing more."""


def aabb_overlaps(low: ArrayLike, high: ArrayLike) -> Array:
    """Volume of the overlap of every two boxes [m3], shape (n, n), zero on the diagonal. Corners: shape (n, 3)."""
    sides = _overlap_sides(np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64))
    volumes = np.prod(np.maximum(sides, 0.0), axis=2)
    np.fill_diagonal(volumes, 0.0)
    return volumes


def box_footprint(pose: ArrayLike, size: ArrayLike) -> Array:
    """Corners of an oriented box in plan [m], shape (4, 2), counter-clockwise.

    Raises:
        ValueError: the box is not upright.
    """
    m, s = np.asarray(pose, dtype=np.float64).reshape(4, 4), np.asarray(size, dtype=np.float64)
    if abs(m[2, 2] - 1.0) > UPRIGHT_TOLERANCE:
        raise ValueError("an oriented box is turned about +Z only")
    corners = 0.5 * s[:2] * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return corners @ m[:2, :2].T + m[:2, 3]


def grown_box(pose: ArrayLike, size: ArrayLike, sides: ArrayLike | None) -> tuple[Array, Array]:
    """An oriented box grown on its sides (-x, +x, -y, +y, -z, +z) [m], shape (6,), or as it is without any: its pose, shape (4, 4),
    and extents, shape (3,)."""
    m, grown = np.array(pose, dtype=np.float64).reshape(4, 4), np.zeros((3, 2))
    if sides is not None:
        grown = np.asarray(sides, dtype=np.float64).reshape(3, 2)
    m[:3, 3] += m[:3, :3] @ (0.5 * (grown[:, 1] - grown[:, 0]))
    return m, np.asarray(size, dtype=np.float64) + grown.sum(axis=1)


def oriented_overlap(pose_a: ArrayLike, size_a: ArrayLike, pose_b: ArrayLike, size_b: ArrayLike) -> float:
    """Volume of the intersection of two oriented boxes [m3], exact: clipped footprints times the shared height.

    Raises:
        ValueError: a box is not upright.
    """
    a, b = np.asarray(pose_a, dtype=np.float64).reshape(4, 4), np.asarray(pose_b, dtype=np.float64).reshape(4, 4)
    half_a, half_b = 0.5 * float(np.asarray(size_a)[2]), 0.5 * float(np.asarray(size_b)[2])
    height = min(a[2, 3] + half_a, b[2, 3] + half_b) - max(a[2, 3] - half_a, b[2, 3] - half_b)
    first, second = box_footprint(a, size_a), box_footprint(b, size_b)
    if height <= 0 or (first.max(axis=0) <= second.min(axis=0)).any() or (second.max(axis=0) <= first.min(axis=0)).any():
        return 0.0
    return float(height) * convex_overlap_area(first, second)


def oriented_iou(pose_a: ArrayLike, size_a: ArrayLike, pose_b: ArrayLike, size_b: ArrayLike) -> float:
    """Intersection over union of two oriented boxes, exact, in 0..1; 0 for two boxes without volume.

    Raises:
        ValueError: a box is not upright.
    """
    inside = oriented_overlap(pose_a, size_a, pose_b, size_b)
    union = float(np.prod(np.asarray(size_a, dtype=np.float64)) + np.prod(np.asarray(size_b, dtype=np.float64))) - inside
    return min(max(inside / union, 0.0), 1.0) if union > 0 else 0.0


def convex_overlap_area(ring_a: ArrayLike, ring_b: ArrayLike) -> float:
    """Area shared by two convex rings [m2], shapes (n, 2) and (m, 2); 0 for a ring without area."""
    import shapely

    # relative to the first corner, so that a room far from the origin costs no digits; a ring without area has a line as its hull
    origin = np.asarray(ring_a, dtype=np.float64)[0]
    first, second = (shapely.MultiPoint(np.asarray(ring, dtype=np.float64) - origin).convex_hull for ring in (ring_a, ring_b))
    return float(first.intersection(second).area)


def _overlap_sides(low: Array, high: Array) -> Array:
    """Signed side lengths of the overlap of every two boxes [m], shape (n, n, 3)."""
    sides: Array = np.minimum(high[:, None], high[None]) - np.maximum(low[:, None], low[None])
    return sides
