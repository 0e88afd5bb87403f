"""Point clouds thinned by voxels: each voxel keeps the mean of its points."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.point_cloud.points import Points

Array = NDArray[np.float64]

SAMPLES = 20_000
"""Points whose distance to others is measured; the median is then known to a percent."""

NEIGHBOR = 4
"""The neighbor whose distance is the spacing: the nearest ones of scan lines lie on one line."""

STRAY_PERCENT = 0.1
"""Share of points at either end of an axis that may be reflections: floors and walls have more."""

CHUNK = 200_000
"""Points whose neighbors are sought at once: they take 16 MB."""


def spacing_of(positions: Array) -> float:
    """Median distance of points to their neighbors, in the unit of the positions (n, 3)."""
    from scipy.spatial import cKDTree

    chosen = positions[np.linspace(0, len(positions) - 1, min(len(positions), SAMPLES)).astype(np.int64)]
    distances = cKDTree(positions).query(chosen, NEIGHBOR + 1)[0][:, NEIGHBOR]
    finite = distances[np.isfinite(distances)]
    return float(np.median(finite)) if len(finite) else 0.0


def extents_of(positions: Array) -> Array:
    """Extents of the room in which nearly all points lie, shape (3,): stray points do not count."""
    low = np.percentile(positions, STRAY_PERCENT, axis=0, method="higher")
    return np.asarray(np.percentile(positions, 100 - STRAY_PERCENT, axis=0, method="lower") - low)


def lonely_points(positions: Array, distance: float) -> NDArray[np.bool_]:
    """True for points with fewer than `NEIGHBOR` others in a distance, shape (n,)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(positions)
    is_lonely = np.zeros(len(positions), dtype=bool)
    for start in range(0, len(positions), CHUNK):
        part = positions[start : start + CHUNK]
        is_lonely[start : start + CHUNK] = ~np.isfinite(tree.query(part, NEIGHBOR + 1, distance_upper_bound=distance)[0][:, NEIGHBOR])
    return is_lonely


def thinned(points: Points, side: float) -> Points:
    """Means of the points in each voxel of some side; points of different objects and sensors have voxels of their own.

    The order follows the voxels, so that it does not depend on that of the file.
    """
    key = _voxels(points.positions, side)
    owners = () if points.objects is None else (points.objects.owner,)
    keys = [*owners, *(() if points.sensor_of is None else (points.sensor_of,)), key]
    order = np.lexsort(keys) if len(keys) > 1 else np.argsort(key, kind="stable")
    is_first = np.zeros(len(order), dtype=bool)
    is_first[:1] = True
    for numbers in keys:
        ascending = numbers[order]
        is_first[1:] |= ascending[1:] != ascending[:-1]
    starts = np.flatnonzero(is_first)
    count = np.diff(np.append(starts, len(order)))
    del key, keys

    def means(values: NDArray[np.generic]) -> Array:
        columns = [np.add.reduceat(values[order, i].astype(np.float64), starts) / count for i in range(3)]
        return np.stack(columns, axis=1)

    first = order[starts]
    colors = None if points.colors is None else np.rint(means(points.colors)).astype(np.uint8)
    normals = None if points.normals is None else means(points.normals).astype(np.float32)
    kept = points.at(first)
    return dataclasses.replace(kept, positions=means(points.positions), colors=colors, normals=normals)


def first_in_voxels(positions: Array, side: float) -> NDArray[np.int64]:
    """The first point in each voxel of some side, sorted."""
    return np.sort(np.unique(_voxels(positions, side), return_index=True)[1])


def _voxels(positions: Array, side: float) -> NDArray[np.int64]:
    """Number of the voxel of each point, shape (n,)."""
    cells = np.floor((positions - positions.min(axis=0)) / side).astype(np.int64)
    extents = cells.max(axis=0) + 1
    return np.asarray((cells[:, 0] * extents[1] + cells[:, 1]) * extents[2] + cells[:, 2])
