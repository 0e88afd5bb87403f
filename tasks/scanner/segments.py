"""Over-segmentation of a scan's mesh, as ScanNet's scans have it: an edge weighs little where normals and colors agree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import vertex_normals
from tasks.segments import edges_of, graph_segments


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
    return graph_segments(edges, weight, len(surface.vertices), threshold, least)
