"""Oriented boxes of instances: upright, of least area in plan, deaf to stray points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.transforms import yaw_pose
from tasks.geometry.triangles import distinct_rows

Array = NDArray[np.float64]

_STRAY_GAP_M = 0.08
"""Points farther than this from the rest are not connected to it: more than the gaps that depth sensors leave in a thin leg."""

_STRAY_SHARE = 0.02
"""A separate clump smaller than this share of the instance is segment bleed or flying pixels."""

_TRIM_SHARE = 0.003
"""Share of points cut at either end of each axis: noise reaches beyond the surface on both sides."""

_AXIS_SLACK = 1.05
"""A box along the room's axes is preferred while its plan is at most this much larger than the smallest one: noise alone
makes the smallest box of a round or partly seen object lean by any angle."""

_EXACT_SLACK = 1.0001
"""The same of exact points whose outline is a rectangle: it is the box, up to one part in ten thousand of its area."""


def oriented_box(points: Array, is_noisy: bool = True, yaw: float | None = None) -> tuple[Array, Array]:
    """Pose (4x4, rotation about +Z, origin at the center [m]) and extents along its own axes [m], shape (3,).

    points: World frame [m], shape (n, 3), n >= 1. is_noisy: Leave out stray points and trim noise; not for exact geometry.
    The x axis is the one within 45 degrees of the world's, or turned by `yaw` [rad].
    """
    kept = without_stray_points(points) if is_noisy else points
    trim = _TRIM_SHARE if is_noisy and len(kept) > 300 else 0.0
    bottom, top = _range(kept[:, 2], trim)
    yaw = _yaw_of_least_area(kept[:, :2], is_noisy) if yaw is None else yaw
    axes = yaw_pose(yaw)[:2, :2]
    plan = kept[:, :2] @ axes
    (x0, x1), (y0, y1) = _range(plan[:, 0], trim), _range(plan[:, 1], trim)
    center = axes @ np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    return yaw_pose(yaw, [*center, (bottom + top) / 2]), np.array([x1 - x0, y1 - y0, top - bottom])


def without_stray_points(points: Array) -> Array:
    """Points, shape (n, 3), without clumps that are small and lie apart from the rest."""
    if len(points) < 50:
        return points
    labels, sizes = clumps(points, _STRAY_GAP_M)
    keep = sizes >= max(_STRAY_SHARE * len(points), 5)
    return points[keep[labels]] if keep.any() else points


def clumps(points: Array, gap: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Clump of each point, shape (n,), and points per clump: two points are together when a chain of cells of edge
    `gap` [m] that touch (also at corners) joins them."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    cells = np.floor((points - points.min(axis=0)) / gap).astype(np.int64)
    spans = cells.max(axis=0) + 3
    code = ((cells[:, 0] + 1) * spans[1] + cells[:, 1] + 1) * spans[2] + cells[:, 2] + 1
    unique, inverse = np.unique(code, return_inverse=True)
    rows, columns = [], []
    for dx, dy, dz in _HALF_NEIGHBORS:
        shifted = unique + (dx * spans[1] + dy) * spans[2] + dz
        place = np.minimum(np.searchsorted(unique, shifted), len(unique) - 1)
        match = np.flatnonzero(unique[place] == shifted)
        rows.append(match)
        columns.append(place[match])
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(len(unique), len(unique)))
    _, component = connected_components(graph, directed=False)
    labels = component[inverse].astype(np.int64)
    return labels, np.bincount(labels)


_HALF_NEIGHBORS = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)]


def _yaw_of_least_area(plan: Array, is_noisy: bool) -> float:
    """Turn [rad], in (-pi/4, pi/4], of the smallest rectangle around points, shape (n, 2): one side lies on their hull."""
    hull = _hull(plan)
    if len(hull) < 3:
        if len(hull) < 2:
            return 0.0
        edge = hull[1] - hull[0]
        return _folded(float(np.arctan2(edge[1], edge[0]))) if np.linalg.norm(edge) > 0.05 else 0.0
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.unique(np.round(np.append(np.arctan2(edges[:, 1], edges[:, 0]) % (np.pi / 2), 0.0), 6))
    c, s = np.cos(angles), np.sin(angles)
    u = hull @ np.stack([c, s])
    v = hull @ np.stack([-s, c])
    area = np.ptp(u, axis=0) * np.ptp(v, axis=0)
    best = int(np.argmin(area))
    upright = int(np.argmin(np.abs(angles)))
    is_rectangle = not is_noisy and area[best] <= _EXACT_SLACK * _area(hull)
    if area[upright] <= (_EXACT_SLACK if is_rectangle else _AXIS_SLACK) * area[best]:
        return 0.0
    return _folded(float(angles[best]))


def _area(hull: Array) -> float:
    """Area of a polygon [m2] by its corners in order, shape (n, 2)."""
    x, y = (hull - hull[0]).T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _hull(plan: Array) -> Array:
    from scipy.spatial import ConvexHull, QhullError

    unique = plan[distinct_rows(plan)[0]]
    if len(unique) < 3:
        return unique
    try:
        return unique[ConvexHull(unique).vertices]
    except QhullError:
        # All on one line: its two ends.
        center = unique.mean(axis=0)
        along = np.linalg.svd(unique - center, full_matrices=False)[2][0]
        reach = (unique - center) @ along
        return unique[[int(np.argmin(reach)), int(np.argmax(reach))]]


def _folded(angle: float) -> float:
    return (angle + np.pi / 4) % (np.pi / 2) - np.pi / 4


def _range(values: Array, trim: float) -> tuple[float, float]:
    low, high = np.quantile(values, [trim, 1 - trim]) if trim else (values.min(), values.max())
    return float(low), float(high)
