"""Over-segmentation of a mesh by a graph of its edges (Felzenszwalb and Huttenlocher, IJCV 2004), as ScanNet's scans have it.

An edge weighs little where normals and colors agree. Joining starts from the lightest edges; a region takes an edge
as long as it is not heavier than the region's own spread plus threshold / size. Regions below `least` vertices join
their best neighbor in the end.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import vertex_normals
from tasks.kernels import compile_kernels


def edges_of(faces: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Every edge of a mesh with `count` vertices once, lower vertex first, sorted, shape (k, 2)."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    keys = np.sort(pairs.min(axis=1) * count + pairs.max(axis=1))  # a tenth of what numpy.unique takes, which hashes integers
    keys = keys[np.concatenate([[True], keys[1:] != keys[:-1]])] if len(keys) else keys
    return np.stack([keys // count, keys % count], axis=1)


def segment(
    surface: Surface, threshold: float, least: int, color_weight: float, owner: NDArray[np.int64], owner_weight: float
) -> NDArray[np.int64]:
    """Segment per vertex, shape (n,); a segment's number is its lowest vertex.

    owner: The object each vertex truly belongs to, shape (n,); an edge between two weighs `owner_weight` more: 0 leaves
    flat contacts to geometry and color alone, 1 hardly lets a segment cross.
    """
    edges = edges_of(surface.faces, len(surface.vertices))
    i, j = edges.T
    normals = vertex_normals(surface.vertices, surface.faces)
    bend = 1.0 - np.einsum("nd,nd->n", normals[i], normals[j])
    # a concave crease parts objects, a convex one is an object's own edge: half as heavy
    convex = np.einsum("nd,nd->n", normals[j], surface.vertices[j] - surface.vertices[i]) > 0
    bend = np.where(convex, 0.5 * bend, bend)
    colors = surface.colors.astype(np.float64) / 255
    weight = bend + color_weight * np.linalg.norm(colors[i] - colors[j], axis=1) + owner_weight * (owner[i] != owner[j])
    order = np.argsort(weight, kind="stable")
    root = _compiled()(edges[order], weight[order], len(surface.vertices), threshold, least)
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
