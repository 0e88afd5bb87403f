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


def aabb(points: ArrayLike) -> tuple[Array, Array]:
    """Lowest and highest corner [m], shape (3,) each, of points, shape (n, 3), n >= 1."""
    p = np.asarray(points, dtype=np.float64)
    return p.min(axis=0), p.max(axis=0)


def aabb_overlaps(low: ArrayLike, high: ArrayLike) -> Array:
    """Volume of the overlap of every two boxes [m3], shape (n, n), zero on the diagonal. Corners: shape (n, 3)."""
    sides = _overlap_sides(np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64))
    volumes = np.prod(np.maximum(sides, 0.0), axis=2)
    np.fill_diagonal(volumes, 0.0)
    return volumes


def aabb_penetrations(low: ArrayLike, high: ArrayLike) -> Array:
    """Least movement along one axis that parts two boxes [m], shape (n, n); zero for boxes that do not overlap."""
    a, b = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    reach = np.minimum(b[:, None] - a[None], b[None] - a[:, None]).min(axis=2)
    penetrations = np.maximum(reach, 0.0)
    np.fill_diagonal(penetrations, 0.0)
    return penetrations


def aabb_iou(low_a: ArrayLike, high_a: ArrayLike, low_b: ArrayLike, high_b: ArrayLike) -> float:
    """Intersection over union of two axis-aligned boxes, 0 for two boxes without volume. Corners: shape (3,)."""
    a0, a1, b0, b1 = (np.asarray(v, dtype=np.float64) for v in (low_a, high_a, low_b, high_b))
    inside = float(np.prod(np.maximum(np.minimum(a1, b1) - np.maximum(a0, b0), 0.0)))
    union = float(np.prod(a1 - a0) + np.prod(b1 - b0)) - inside
    return inside / union if union > 0 else 0.0


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
    """Area shared by two convex counter-clockwise rings [m2], shapes (n, 2) and (m, 2) (Sutherland and Hodgman, 1974)."""
    clipped = [(float(x), float(y)) for x, y in np.asarray(ring_a, dtype=np.float64)]
    cutter = [(float(x), float(y)) for x, y in np.asarray(ring_b, dtype=np.float64)]
    for (ax, ay), (bx, by) in zip(cutter, [*cutter[1:], cutter[0]], strict=True):
        kept: list[tuple[float, float]] = []
        sides = [(bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in clipped]
        for index, (point, side) in enumerate(zip(clipped, sides, strict=True)):
            before, side_before = clipped[index - 1], sides[index - 1]
            if (side >= 0) != (side_before >= 0):
                t = side_before / (side_before - side)
                kept.append((before[0] + t * (point[0] - before[0]), before[1] + t * (point[1] - before[1])))
            if side >= 0:
                kept.append(point)
        clipped = kept
        if len(clipped) < 3:
            return 0.0
    # relative to the first corner, so that a room far from the origin costs no digits
    x0, y0 = clipped[0]
    area = 0.0
    for (ax, ay), (bx, by) in zip(clipped, [*clipped[1:], clipped[0]], strict=True):
        area += (ax - x0) * (by - y0) - (bx - x0) * (ay - y0)
    return max(0.5 * area, 0.0)


def _overlap_sides(low: Array, high: Array) -> Array:
    """Signed side lengths of the overlap of every two boxes [m], shape (n, n, 3)."""
    sides: Array = np.minimum(high[:, None], high[None]) - np.maximum(low[:, None], low[None])
    return sides
