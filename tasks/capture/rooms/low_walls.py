"""Half-height walls: what one looks over, told by its level top with the sides below it.

Walls that are seen high up are found by their faces alone. Of one that ends at a person's waist or chest so little is seen that its
top has to speak for it: a narrow level strip of wall, with wall right below and floor, or the other side, behind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud
from tasks.capture.rooms.slabs import Slab

if TYPE_CHECKING:
    from shapely import Polygon

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LOWEST_M, HIGHEST_M = 0.6, 1.7
"""Heights of tops: a lower one is a step or the rim of a tub, a higher one is found by its faces."""

THICK_M, THIN_M = 0.26, 0.04
"""Thicknesses: shelves are deeper, and thinner is no wall."""

LEAST_LENGTH_M = 0.4

_LEVEL = 0.5
"""Normals of a top, and of its edges where a coarse mesh rounds them off, look up by as much."""

_CELL_M = 0.1
"""Parts of a top are as near to one another; cells along a side."""

_FACE_M = 0.06
"""Points of a side lie this near to the edge of the top: noise and drift."""

_SIDE_SHARE = 0.5
"""Of the cells along a side, and in height, in which wall is seen, from which on it is a side."""

_STRAIGHT = 0.15
"""A top nearer to an axis than this [rad] runs along it."""

_FLOOR_BEHIND = 0.2
"""Share of the strip beside a side that nobody has seen, that is seen floor."""

_MORE_ABOVE = 0.1
"""Of the cells above a top, in which wall is seen, from which on the wall goes on: it was a sill, or a board on it."""


def low_walls(cloud: Cloud, is_wall: Mask, floor: Polygon, slabs: Sequence[Slab], is_floor: Callable[[Array], Mask]) -> list[Slab]:
    """Half-height walls inside of a floor polygon that are none of the slabs, sorted by their ends.

    is_wall: which points of the scan are wall, shape (n,). is_floor: where floor was seen, of places shape (m, 2) [m].
    """
    import shapely

    points, normals = cloud.points, cloud.normals
    level = is_wall & (normals[:, 2] > _LEVEL) & (points[:, 2] > LOWEST_M) & (points[:, 2] < HIGHEST_M)
    level[level] = shapely.contains_xy(floor, points[level, :2])
    for slab in slabs:
        level[level] &= ~shapely.contains_xy(slab.polygon(0.05), points[level, :2])
    upright = is_wall & (np.abs(normals[:, 2]) < _LEVEL)
    slabs_below = [_slab(top, cloud, upright, floor, is_floor) for top in _parts(points[level])]
    return sorted((slab for slab in slabs_below if slab is not None), key=lambda slab: slab.row)


def _parts(points: Array) -> list[Array]:
    """Points of level tops, parted by gaps and steps, shape (m, 3) each [m]."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(points) < 2:
        return []
    pairs = cKDTree(points * [1.0, 1.0, 2.0]).query_pairs(_CELL_M, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    owner = connected_components(links, directed=False)[1]
    return [points[owner == part] for part in np.unique(owner)]


def _slab(top: Array, cloud: Cloud, upright: Mask, floor: Polygon, is_floor: Callable[[Array], Mask]) -> Slab | None:
    """The wall below a level top, points of shape (m, 3) [m]; None where there is none."""
    import shapely

    if len(top) < 8:
        return None
    along = _direction(top[:, :2])
    across = np.array([along[1], -along[0]])
    height = float(np.median(top[:, 2]))
    (low, start), (high, end) = np.percentile(top[:, :2] @ np.column_stack([across, along]), [2, 98], axis=0)
    if end - start < LEAST_LENGTH_M or high - low > THICK_M or end - start < 2.0 * (high - low):
        return None
    plan = cloud.points[upright, :2] @ np.column_stack([across, along])
    z, facing = cloud.points[upright, 2], cloud.normals[upright, :2] @ across
    beside = (plan[:, 0] > low - _FACE_M) & (plan[:, 0] < high + _FACE_M) & (plan[:, 1] > start - _CELL_M) & (plan[:, 1] < end + _CELL_M)
    if (
        _share(plan[beside & (z > height + 0.15), 1], z[beside & (z > height + 0.15)], start, end, height + 0.15, height + 0.75)
        > _MORE_ABOVE
    ):
        return None
    edges, is_side = [low, high], [False, False]
    members = []
    for side, sign in ((0, -1.0), (1, 1.0)):
        own = beside & (sign * facing > 0.7) & (np.abs(plan[:, 0] - edges[side]) < 2 * _FACE_M) & (z < height + 0.05)
        is_side[side] = _share(plan[own, 1], z[own], start, end, 0.0, height) > _SIDE_SHARE
        if own.sum() > 5:
            edges[side] = float(np.median(plan[own, 0]))
            members.append(plan[own, 1])
    thickness = edges[1] - edges[0]
    if not any(is_side) or not THIN_M <= thickness <= THICK_M:
        return None
    start, end = (float(v) for v in np.percentile(np.concatenate([*members, top[:, :2] @ along]), [1, 99]))
    middle = 0.5 * (edges[0] + edges[1])
    steps = np.linspace(0.05, 0.95, 10)
    for side, sign in ((0, -1.0), (1, 1.0)):
        reach = np.arange(0.15, 0.66, 0.05)
        near = np.array([(edges[side] + sign * r) * across + (start + s * (end - start)) * along for s in steps for r in reach])
        if shapely.contains_xy(floor, near).mean() < 0.5:
            return None
        if not is_side[side] and (is_floor(near) & shapely.contains_xy(floor, near)).mean() < _FLOOR_BEHIND:
            return None
    return Slab(middle * across + start * along, middle * across + end * along, thickness, height)


def _direction(plan: Array) -> Array:
    """Unit vector along which points, shape (m, 2) [m], reach farthest; an axis where they nearly run along it."""
    values, vectors = np.linalg.eigh(np.cov(plan.T))
    along = vectors[:, int(np.argmax(values))]
    angle = float(np.arctan2(along[1], along[0])) % np.pi
    nearest = 0.5 * np.pi * round(angle / (0.5 * np.pi))
    angle = nearest if abs(angle - nearest) < _STRAIGHT else angle
    return np.array([np.cos(angle), np.sin(angle)])


def _share(v: Array, z: Array, start: float, end: float, low: float, high: float) -> float:
    """Share of the cells from start to end along a side, and between two heights, with points in them (along, height) [m]."""
    rows, columns = max(round((high - low) / 0.2), 1), max(round((end - start) / 0.2), 1)
    i = np.floor((z - low) / (high - low) * rows).astype(np.int64)
    j = np.floor((v - start) / (end - start) * columns).astype(np.int64)
    ok = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
    return len(np.unique(i[ok] * columns + j[ok])) / (rows * columns)
