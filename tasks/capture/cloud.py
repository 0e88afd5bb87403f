"""The scan as points with normals and areas: what rooms and instances are estimated from."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.reading import Group
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import face_areas, face_crosses, spread, surface_area, vertex_normals

Array = NDArray[np.float64]

_SAMPLES_PER_M2 = 400
"""A point every 5 cm, the cell of the floor plan."""

_MAX_SAMPLES = 400_000


@dataclasses.dataclass(frozen=True)
class Cloud:
    """Points of a scan in the world frame.

    points: [m], shape (n, 3). normals: Unit, shape (n, 3). areas: Surface that each point stands for [m2], shape (n,).
    instance: Instance of each point, -1 for none, shape (n,).
    """

    points: Array
    normals: Array
    areas: Array
    instance: NDArray[np.int64]


def cloud_of(surface: Surface, groups: Sequence[Group], is_dense: bool, rng: np.random.Generator) -> Cloud:
    """A scan with its instances: its vertices where they lie densely enough, else points spread over it. rng: For these."""
    if is_dense:
        vertex_instance = np.full(len(surface.vertices), -1, dtype=np.int64)
        for index, group in enumerate(groups):
            vertex_instance[group.vertices] = index
        return dense_cloud(surface, vertex_instance)
    face_instance = np.full(len(surface.faces), -1, dtype=np.int64)
    for index, group in enumerate(groups):
        face_instance[group.faces] = index
    return sampled_cloud(surface, face_instance, rng)


def dense_cloud(surface: Surface, vertex_instance: NDArray[np.int64]) -> Cloud:
    """The vertices of a scan mesh. `vertex_instance`: Instance of each vertex, -1 for none, shape (n,)."""
    return Cloud(surface.vertices, vertex_normals(surface.vertices, surface.faces), vertex_areas(surface), vertex_instance)


def sampled_cloud(surface: Surface, face_instance: NDArray[np.int64], rng: np.random.Generator) -> Cloud:
    """Points spread over modelled surfaces, whose vertices lie only at corners. `face_instance`: shape (m,)."""
    total = surface_area(surface.vertices, surface.faces)
    count = int(np.clip(total * _SAMPLES_PER_M2, 1000, _MAX_SAMPLES))
    face, weights = spread(surface.vertices, surface.faces, count, rng)
    points = np.einsum("nk,nkd->nd", weights, surface.vertices[surface.faces[face]])
    crosses = face_crosses(surface.vertices, surface.faces[face])
    normals = crosses / np.maximum(np.linalg.norm(crosses, axis=1), 1e-12)[:, None]
    return Cloud(points, normals, np.full(count, total / count), face_instance[face])


def vertex_areas(surface: Surface) -> Array:
    """A third of the area of the adjoining faces [m2] of each vertex, shape (n,)."""
    areas = face_areas(surface.vertices, surface.faces)
    return np.bincount(surface.faces.ravel(), weights=np.repeat(areas / 3, 3), minlength=len(surface.vertices)).astype(np.float64)
