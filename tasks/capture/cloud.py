"""The scan as points with normals and areas: what rooms and instances are estimated from."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.meshes import Surface

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


def dense_cloud(surface: Surface, vertex_instance: NDArray[np.int64]) -> Cloud:
    """The vertices of a scan mesh. `vertex_instance`: Instance of each vertex, -1 for none, shape (n,)."""
    normals, areas = vertex_normals(surface)
    return Cloud(surface.vertices, normals, areas, vertex_instance)


def sampled_cloud(surface: Surface, face_instance: NDArray[np.int64], rng: np.random.Generator) -> Cloud:
    """Points spread over modelled surfaces, whose vertices lie only at corners. `face_instance`: shape (m,)."""
    corners = surface.vertices[surface.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = float(0.5 * np.linalg.norm(cross, axis=1).sum())
    count = int(np.clip(total * _SAMPLES_PER_M2, 1000, _MAX_SAMPLES))
    face, weights = spread(surface, count, rng)
    points = np.einsum("nk,nkd->nd", weights, corners[face])
    normals = cross[face] / np.maximum(np.linalg.norm(cross[face], axis=1), 1e-12)[:, None]
    return Cloud(points, normals, np.full(count, total / count), face_instance[face])


def spread(surface: Surface, count: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array]:
    """Places spread evenly over a surface: face, shape (n,), sorted, and barycentric weights of its corners, shape (n, 3)."""
    corners = surface.vertices[surface.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    area = np.where(area.sum() > 0, area, 1.0)
    steps = (np.arange(count) + rng.random(count)) / count * area.sum()
    face = np.minimum(np.searchsorted(np.cumsum(area), steps), len(area) - 1)
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return face.astype(np.int64), np.stack([1 - u - v, u, v], axis=1)


def vertex_normals(surface: Surface) -> tuple[Array, Array]:
    """Unit normal, shape (n, 3), and a third of the area of the adjoining faces [m2], shape (n,), of each vertex."""
    corners = surface.vertices[surface.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    count = len(surface.vertices)
    flat_faces = surface.faces.ravel()
    normals = np.stack([np.bincount(flat_faces, weights=np.repeat(cross[:, axis], 3), minlength=count) for axis in range(3)], axis=1)
    areas = np.bincount(flat_faces, weights=np.repeat(np.linalg.norm(cross, axis=1) / 6, 3), minlength=count)
    length = np.linalg.norm(normals, axis=1)
    return (normals / np.maximum(length, 1e-12)[:, None]).astype(np.float64), areas.astype(np.float64)
