"""The nearest face of a triangle mesh to each of many points, exact, by libigl's tree of boxes."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

FLATTEST = 1e-12
"""Height over longest edge below which a triangle counts as that edge: libigl loses the distance to triangles below 1e-14."""


@dataclasses.dataclass(frozen=True)
class Closest:
    """Closest points of a mesh. distance: [m], shape (k,). face: index, shape (k,). point: on the mesh [m], shape (k, 3)."""

    distance: Array
    face: Integers
    point: Array


def closest_points(vertices: ArrayLike, faces: ArrayLike, points: ArrayLike) -> Closest:
    """The closest point of a mesh to each point, all in one frame [m].

    vertices: shape (n, 3). faces: shape (m, 3), in any winding; triangles without area count as what they shrank to.
    points: shape (k, 3). Which of several faces at the same distance is named hangs on the mesh alone.

    Raises:
        ValueError: the mesh has no triangle, or something is not finite.
    """
    import igl

    places = np.asarray(vertices, dtype=np.float64)
    triangles = np.asarray(faces, dtype=np.int64)
    asked = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    if not len(triangles):
        raise ValueError("closest points: the mesh has no triangle")
    if not (np.isfinite(places[triangles]).all() and np.isfinite(asked).all()):
        raise ValueError("closest points: a coordinate is not finite")
    square, face, point = igl.point_mesh_squared_distance(asked, places, without_slivers(places, triangles))
    return Closest(np.sqrt(square), face, point)


def without_slivers(vertices: Array, faces: Integers) -> Integers:
    """Faces with those that are flat but for rounding replaced by their longest edge: two corners, the second one twice."""
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    squares = np.einsum("nij,nij->ni", edges, edges)
    longest = squares.argmax(axis=1)
    flat = np.flatnonzero(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) <= FLATTEST * squares.max(axis=1))
    if not len(flat):
        return faces
    start, end = faces[flat, longest[flat]], faces[flat, (longest[flat] + 1) % 3]
    kept = faces.copy()
    kept[flat] = np.stack([start, end, end], axis=1)
    return kept
