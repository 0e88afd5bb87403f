"""Over-segmentation of a graph (Felzenszwalb and Huttenlocher, IJCV 2004), as ScanNet's scans have it of the edges of their meshes.

Joining starts from the lightest edges; a region takes an edge as long as it is not heavier than the region's own spread plus
threshold / size. Regions that are too small join their best neighbor in the end.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import compile_kernels


def edges_of(faces: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Every edge of a mesh with `count` vertices once, lower vertex first, sorted, shape (k, 2)."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    keys = np.sort(pairs.min(axis=1) * count + pairs.max(axis=1))  # a tenth of what numpy.unique takes, which hashes integers
    keys = keys[np.concatenate([[True], keys[1:] != keys[:-1]])] if len(keys) else keys
    return np.stack([keys // count, keys % count], axis=1)


def graph_segments(edges: NDArray[np.int64], weights: NDArray[np.float64], count: int, threshold: float, least: int) -> NDArray[np.int64]:
    """Segment of each of `count` vertices, shape (n,); a segment's number is its lowest vertex.

    edges: Shape (k, 2). weights: Of them, shape (k,); of equal ones the first goes first. least: Vertices of a segment, where it has a
    neighbor at all.
    """
    order = np.argsort(weights, kind="stable")
    root = _compiled()(edges[order], weights[order], count, threshold, least)
    lowest = np.full(len(root), len(root), dtype=np.int64)
    np.minimum.at(lowest, root, np.arange(len(root)))
    return lowest[root]


@cache
def _compiled() -> Callable[..., Any]:
    """The joining loop, compiled on first use."""
    return compile_kernels(_joined)["_joined"]


def _joined(edges: Any, weight: Any, count: int, threshold: float, least: int) -> Any:
    """Region per vertex after joining along edges in their order; the second round takes in what is too small."""
    parent = np.arange(count)
    size = np.ones(count, dtype=np.int64)
    limit = np.full(count, threshold)
    for late in range(2):
        for k in range(len(edges)):
            a, b = edges[k, 0], edges[k, 1]
            while parent[a] != a:
                parent[a] = parent[parent[a]]
                a = parent[a]
            while parent[b] != b:
                parent[b] = parent[parent[b]]
                b = parent[b]
            if a == b:
                continue
            if (late == 1 and (size[a] < least or size[b] < least)) or (late == 0 and weight[k] <= limit[a] and weight[k] <= limit[b]):
                parent[b] = a
                size[a] += size[b]
                limit[a] = weight[k] + threshold / size[a]
    for v in range(count):
        while parent[v] != parent[parent[v]]:
            parent[v] = parent[parent[v]]
    return parent
