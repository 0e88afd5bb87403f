"""Areas, normals and volumes of triangle meshes. Vertices: [m], shape (n, 3). Faces: vertex indices, shape (m, 3).

Normals at vertices and corners are libigl's; sums over faces that other figures hang on are NumPy's, to the bit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

WELD_DECIMALS = 6
"""Corners whose coordinates agree to a micrometre are at one place: textures and parts split vertices without moving them."""

MOST_FACES = 64
"""Corners at a place with more faces are flat: every face there is compared with every other one."""


def face_crosses(vertices: ArrayLike, faces: ArrayLike) -> Array:
    """Cross product of two edges of each face: its normal, twice its area long [m2], shape (m, 3)."""
    a, b, c = _corners(vertices, faces)
    return crosses(b - a, c - a)


def _corners(vertices: ArrayLike, faces: ArrayLike) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Positions of the first, second and third corner of each face, shapes (m, 3): taken row by row, in a fraction of the time of an
    index of two axes."""
    places, corners = np.asarray(vertices), np.asarray(faces)
    return places.take(corners[:, 0], axis=0), places.take(corners[:, 1], axis=0), places.take(corners[:, 2], axis=0)


def crosses(first: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """Cross products of vectors, shapes (m, 3), as NumPy's to the bit and in a fraction of its time where they are few."""
    x, y, z = first.T
    u, v, w = other.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def face_areas(vertices: ArrayLike, faces: ArrayLike) -> Array:
    """Area of each face [m2], shape (m,)."""
    return 0.5 * np.linalg.norm(face_crosses(vertices, faces), axis=1)


def surface_area(vertices: ArrayLike, faces: ArrayLike) -> float:
    """Area of all faces [m2]."""
    return float(0.5 * np.linalg.norm(face_crosses(vertices, faces), axis=1).sum())


def enclosed_volume(vertices: ArrayLike, faces: ArrayLike) -> float:
    """Volume inside a closed surface [m3], negative where faces look inward: sum over tetrahedra to the origin."""
    return float(signed_volumes(vertices, faces).sum() / 6.0)


def signed_volumes(vertices: ArrayLike, faces: ArrayLike) -> Array:
    """Six times the volume between each face and the origin [m3], negative where it looks there, shape (m,)."""
    a, b, c = _corners(vertices, faces)
    return np.asarray(np.einsum("ij,ij->i", a, crosses(b, c)))


def is_closed(faces: ArrayLike) -> bool:
    """Whether every edge has two faces."""
    corners = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    if not len(edges) or len(edges) % 2:
        return False
    keys = np.sort(edges[:, 0] * (edges.max() + 1) + edges[:, 1])
    return bool((keys[::2] == keys[1::2]).all() and (keys[1:-1:2] != keys[2::2]).all())


def openness(faces: ArrayLike) -> str | None:
    """Why faces, corners by number, shape (m, 3), enclose nothing: how many edges have one face, or more than two; None where none has."""
    corners = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    if not len(corners):
        return "no faces"
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges[:, 0] * (edges.max() + 1) + edges[:, 1], return_counts=True)
    single, many = int((counts == 1).sum()), int((counts > 2).sum())
    parts = [f"{single} edges of one face"] * bool(single) + [f"{many} of more than two"] * bool(many)
    return ", ".join(parts) or None


def spread(vertices: Array, faces: Integers, count: int, rng: np.random.Generator) -> tuple[Integers, Array]:
    """Places spread evenly over a surface: face, shape (count,), sorted, and barycentric weights of its corners, shape (count, 3)."""
    return spread_by(np.linalg.norm(face_crosses(vertices, faces), axis=1), count, rng)


def spread_by(area: Array, count: int, rng: np.random.Generator) -> tuple[Integers, Array]:
    """As `spread`, given the area of each face in any unit, shape (m,)."""
    total = area.sum()
    area, total = (area, total) if total > 0 else (np.ones(len(area)), float(len(area)))
    steps = (np.arange(count) + rng.random(count)) / count * total
    face = np.minimum(np.searchsorted(np.cumsum(area), steps), len(area) - 1)
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return face.astype(np.int64), np.stack([1 - u - v, u, v], axis=1)


def face_planes(vertices: Array, faces: Integers, least: float = 0.0) -> tuple[Array, Array]:
    """Unit normals, shape (k, 3), and offsets along them [m], shape (k,), of faces of more than `least` twice the area [m2]."""
    crosses = face_crosses(vertices, faces)
    lengths = np.linalg.norm(crosses, axis=1)
    solid = lengths > least
    normals = crosses[solid] / lengths[solid, None]
    return normals, np.einsum("ij,ij->i", normals, vertices[faces[solid, 0]])


def face_normals(vertices: Array, faces: Integers) -> Array:
    """Unit normals of faces, shape (m, 3); +Z for faces without area."""
    import igl

    return np.asarray(igl.per_face_normals(vertices, faces, np.array([0.0, 0.0, 1.0])))


def vertex_normals(vertices: Array, faces: Integers) -> Array:
    """Area-weighted unit normals at vertices, shape (n, 3); zero where no face with area is."""
    import igl

    weighting: Any = igl.PerVertexNormalsWeightingType.PER_VERTEX_NORMALS_WEIGHTING_TYPE_AREA
    return np.nan_to_num(igl.per_vertex_normals(vertices, faces, weighting))


def corner_normals(vertices: Array, faces: Integers, crease: float) -> Array:
    """Unit normal per corner of every face, shape (m, 3, 3).

    A corner's normal is the area-weighted mean of the faces around its place that turn away from its own face by less than
    `crease` [rad]: round objects are smooth, edges stay edges. Corners shared by more than `MOST_FACES` faces are flat.
    """
    import igl

    first, place = welded(vertices)
    corner = place[faces]
    crowded = np.bincount(corner.ravel(), minlength=len(first))[corner] > MOST_FACES
    loose = vertices[faces[crowded]]
    corner[crowded] = len(first) + np.arange(len(loose))
    smooth = igl.per_corner_normals(np.concatenate([vertices[first], loose]), corner, np.degrees(crease)).reshape(-1, 3, 3)
    is_unit = np.einsum("mck,mck->mc", smooth, smooth) > 0.5
    return np.where(is_unit[:, :, None], smooth, face_normals(vertices, faces)[:, None])


def used_vertices(faces: Integers, count: int) -> tuple[Integers, Integers]:
    """Which of `count` vertices some faces use, ascending, shape (k,), and the faces as indices into these, shape (m, 3)."""
    is_used = np.zeros(count, dtype=bool)
    is_used[faces] = True
    return np.flatnonzero(is_used), (np.cumsum(is_used) - 1)[faces]


def welded(vertices: Array, decimals: int = WELD_DECIMALS) -> tuple[Integers, Integers]:
    """The first vertex at each place, shape (k,), and the place of each vertex, shape (n,)."""
    return distinct_rows(np.round(vertices, decimals))


def distinct_rows(rows: NDArray[Any]) -> tuple[Integers, Integers]:
    """The first of each of the distinct rows in ascending order, shape (k,), and which of them each row is, shape (n,). Rows: shape
    (n, d)."""
    if not len(rows):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    order = _ascending(rows)
    ascending = rows[order]
    begins = np.concatenate([[True], (ascending[1:] != ascending[:-1]).any(axis=1)])
    place = np.empty(len(rows), dtype=np.int64)
    place[order] = np.cumsum(begins) - 1
    return order[begins], place


def _ascending(rows: NDArray[Any]) -> Integers:
    """Rows in ascending order, shape (n,), equal ones as they come; whole numbers within a small range are sorted as one."""
    if np.issubdtype(rows.dtype, np.integer) and rows.dtype != np.uint64:
        rows = rows.astype(np.int64)  # spans of shorter ones may leave their type
        low = rows.min(axis=0)
        spans = [int(high) - int(least) + 1 for high, least in zip(rows.max(axis=0), low, strict=True)]
        if math.prod(spans) < 2**62:
            keys = np.zeros(len(rows), dtype=np.int64)
            for column, span in zip((rows - low).T, spans, strict=True):
                keys = keys * span + column
            return np.argsort(keys, kind="stable")
    return np.lexsort(rows.T[::-1])
