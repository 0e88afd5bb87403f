"""Over-segmentation of a mesh, as ScanNet's segmentator does it: graph-based, on normals.

Felzenszwalb and Huttenlocher, "Efficient Graph-Based Image Segmentation", IJCV 2004, on the edges of the mesh.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.meshes import Surface

THRESHOLD = 0.01
"""k of the predicate, ScanNet's own setting (the `0.010000` in its file names)."""

MIN_VERTICES = 20
"""Smaller segments join a neighbor; ScanNet's own setting."""

COLOR_WEIGHT = 0.02
"""Difference of normals that a full difference of color counts for: a white sheet of paper on a white desk stays one,
a mouse on a pad becomes two."""


def segments(surface: Surface, owner: NDArray[np.int64]) -> NDArray[np.int64]:
    """Segment per vertex, shape (n,), numbered by their smallest vertex. No segment holds vertices of two owners, shape (n,).

    The published aggregations were drawn on segments that fit the objects; joining across owners would only blur the truth.
    """
    normals = np.asarray(surface.to_trimesh().vertex_normals)
    corners, n = surface.faces, len(surface.vertices)
    pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    keys = np.unique(pairs.min(axis=1) * n + pairs.max(axis=1))  # one number per edge: sorts ten times as fast as rows
    a, b = keys // n, keys % n
    turn = 1.0 - np.einsum("ed,ed->e", normals[a], normals[b])
    convex = np.einsum("ed,ed->e", normals[b], surface.vertices[b] - surface.vertices[a]) > 0
    weight = np.where(convex, turn**2, turn)
    weight = weight + COLOR_WEIGHT * np.linalg.norm((surface.colors[a].astype(float) - surface.colors[b]) / 255, axis=1)
    weight[owner[a] != owner[b]] = np.inf
    order = np.argsort(weight, kind="stable")
    labels = _merge(len(surface.vertices), a[order], b[order], weight[order], THRESHOLD, MIN_VERTICES)
    return labels


def _merge(
    count: int, a: NDArray[np.int64], b: NDArray[np.int64], weight: NDArray[np.float64], threshold: float, min_size: int
) -> NDArray[np.int64]:
    return np.asarray(_compiled()(count, a, b, weight, threshold, min_size), dtype=np.int64)


_KERNEL: list[Any] = []


def _compiled() -> Any:
    """The union-find loop, compiled on first use."""
    if not _KERNEL:
        from numba import njit

        _KERNEL.append(njit(cache=True)(_union))
    return _KERNEL[0]


def _union(count, a, b, weight, threshold, min_size):  # type: ignore[no-untyped-def]  # compiled
    parent = np.arange(count)
    size = np.ones(count, dtype=np.int64)
    limit = np.full(count, threshold)
    for small in range(2):
        for e in range(len(a)):
            if not np.isfinite(weight[e]):
                continue
            x = a[e]
            while parent[x] != x:
                parent[x] = parent[parent[x]]
                x = parent[x]
            y = b[e]
            while parent[y] != y:
                parent[y] = parent[parent[y]]
                y = parent[y]
            if x == y:
                continue
            similar = weight[e] <= limit[x] and weight[e] <= limit[y]
            tiny = size[x] < min_size or size[y] < min_size
            if (similar and small == 0) or (tiny and small == 1):
                if y < x:
                    x, y = y, x
                parent[y] = x
                size[x] += size[y]
                limit[x] = weight[e] + threshold / size[x]
    for v in range(count):
        x = v
        while parent[x] != x:
            x = parent[x]
        parent[v] = x
    return parent
