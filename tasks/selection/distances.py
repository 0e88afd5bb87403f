"""Distances between the points of a scanned instance and the surface of a placed asset, compiled.

A surface is a set of discs: evenly spread samples with their normals, each standing for its share of the area, so
that a few hundred samples give the distance to a surface of square metres to the centimetre.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]


def coarse_distances(points: Array, placed: Array) -> tuple[Array, Array]:
    """Nearest distances both ways for several placements of one cloud [m].

    Points: shape (k, 3). Placed samples: shape (p, m, 3). Returns shapes (p, k), from the points to the samples, and
    (p, m), from the samples to the points.
    """
    out, back = _compiled()["_coarse"](np.ascontiguousarray(points), np.ascontiguousarray(placed))
    return np.asarray(out), np.asarray(back)


def nearest_indices(points: Array, samples: Array) -> tuple[NDArray[np.int64], Array]:
    """Index of and distance to the nearest sample of every point [m]. Shapes (k, 3) and (m, 3) to (k,) and (k,)."""
    index, distance = _compiled()["_nearest"](np.ascontiguousarray(points), np.ascontiguousarray(samples))
    return np.asarray(index), np.asarray(distance)


def disc_distances(points: Array, centers: Array, normals: Array, radius: float) -> Array:
    """Distance of every point to the nearest of flat discs [m]: shape (k,). Centers and unit normals: shape (m, 3)."""
    kernel = _compiled()["_discs"]
    return np.asarray(kernel(np.ascontiguousarray(points), np.ascontiguousarray(centers), np.ascontiguousarray(normals), float(radius)))


def spacing(points: Array) -> float:
    """Median distance of a point to its nearest neighbor [m], 0 for a single point. Shape (k, 3)."""
    if len(points) < 2:
        return 0.0
    from scipy.spatial import cKDTree

    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_coarse, _nearest, _discs)


def _coarse(points: Array, placed: Array) -> tuple[Array, Array]:
    poses, m = placed.shape[0], placed.shape[1]
    k = points.shape[0]
    out = np.full((poses, k), np.inf)
    back = np.full((poses, m), np.inf)
    for p in range(poses):
        for i in range(k):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            best = np.inf
            for j in range(m):
                a, b, c = placed[p, j, 0] - x, placed[p, j, 1] - y, placed[p, j, 2] - z
                d = a * a + b * b + c * c
                best = min(best, d)
                back[p, j] = min(back[p, j], d)
            out[p, i] = best
    return np.sqrt(out), np.sqrt(back)


def _nearest(points: Array, samples: Array) -> tuple[NDArray[np.int64], Array]:
    k, m = points.shape[0], samples.shape[0]
    index = np.zeros(k, dtype=np.int64)
    distance = np.empty(k)
    for i in range(k):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        best, at = np.inf, 0
        for j in range(m):
            a, b, c = samples[j, 0] - x, samples[j, 1] - y, samples[j, 2] - z
            d = a * a + b * b + c * c
            if d < best:
                best, at = d, j
        index[i], distance[i] = at, np.sqrt(best)
    return index, distance


def _discs(points: Array, centers: Array, normals: Array, radius: float) -> Array:
    k, m = points.shape[0], centers.shape[0]
    distance = np.empty(k)
    for i in range(k):
        best = np.inf
        for j in range(m):
            a, b, c = points[i, 0] - centers[j, 0], points[i, 1] - centers[j, 1], points[i, 2] - centers[j, 2]
            whole = a * a + b * b + c * c
            reach = np.sqrt(best) + radius
            if whole >= reach * reach:  # even the disc's rim is farther than the best so far
                continue
            off = a * normals[j, 0] + b * normals[j, 1] + c * normals[j, 2]
            along = np.sqrt(max(whole - off * off, 0.0))
            over = max(along - radius, 0.0)
            best = min(best, off * off + over * over)
        distance[i] = np.sqrt(best)
    return distance
