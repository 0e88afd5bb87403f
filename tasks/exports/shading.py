"""How surfaces look: normals that keep creases, and colors in the space that renderers compute in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def face_normals(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Unit normals of triangles, shape (m, 3); +Z for triangles without area."""
    cross = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.where(length > 1e-20, cross / np.maximum(length, 1e-20), [0.0, 0.0, 1.0])


def corner_normals(vertices: NDArray[np.float64], faces: NDArray[np.int64], crease: float) -> NDArray[np.float64]:
    """Unit normal per corner of every triangle, shape (m, 3, 3).

    A corner's normal is the area-weighted mean of the faces around its position [m] that turn away from its own face
    by less than `crease` [rad]: round things are smooth, edges stay edges. Corners shared by more than 64 faces are flat.
    """
    flat = face_normals(vertices, faces)
    cross = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    _, position = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    corner = position.reshape(-1)[faces].reshape(-1)
    order = np.argsort(corner, kind="stable")
    count = np.bincount(corner)
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    around = np.where(count[corner] <= 64, count[corner], 1)
    mine = np.repeat(np.arange(len(corner)), around)
    step = np.arange(len(mine)) - np.repeat(np.cumsum(around) - around, around)
    other = np.where(around[mine] > 1, order[np.minimum(start[corner[mine]] + step, len(order) - 1)], mine) // 3
    near = np.einsum("ij,ij->i", flat[mine // 3], flat[other]) > np.cos(crease)
    total = np.stack([np.bincount(mine[near], weights=cross[other[near], axis], minlength=len(corner)) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    own = np.repeat(flat, 3, axis=0)
    return np.where(length > 1e-20, total / np.maximum(length, 1e-20), own).reshape(-1, 3, 3)


def linear_colors(colors: NDArray[np.uint8]) -> NDArray[np.float64]:
    """sRGB bytes, shape (n, 3), as linear values in 0..1 (IEC 61966-2-1)."""
    values = np.arange(256) / 255.0
    table = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return np.asarray(table[colors])
