"""Clusters of triangles that can be left out of a picture as a whole, in the order in which machine code looks at many at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.triangles import crosses
from tasks.simulation.soups import Soup

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Indices = NDArray[np.int64]

CLUSTER = 64
"""Triangles of a cluster at most: fewer cost more tests, more are seldom left out as a whole."""

LANES = 16
"""Triangles, or spheres of clusters, that are looked at at once: as many 32-bit numbers as the widest registers hold."""

SOLID, SHEET, GAP = 0.0, np.inf, -np.inf
"""How far behind a triangle's plane a camera may be and see it [m]: one that has a solid behind it, any other one, and none."""

EVERY_WAY = 2.0
"""In the place of the sine of a cone: a cluster that may be seen from behind."""

_NARROW = 0.1
"""A cluster whose normals lie within a cone of a smaller cosine is turned every way, and never looks away."""

_MORTON_BITS = 10


class Clusters(NamedTuple):
    """p packets of `LANES` triangles each, and s of the spheres around c clusters. World frame [m].

    triangles: Shape (p, 13, `LANES`): corners, unit normal, and `SOLID`, `SHEET`, or `GAP` where there is no triangle. The index of a face
    is its packet times `LANES`, and its lane; the first packet has none, so that 0 is no face. starts: First packet of each cluster, shape
    (c + 1,). spheres: Shape (s, 8, `LANES`): center and radius, mean normal, and sine of the angle within which normals lie, or
    `EVERY_WAY`. reach: Largest coordinate.
    """

    triangles: Floats
    starts: Indices
    spheres: Floats
    reach: float


def cluster(soup: Soup) -> tuple[Clusters, Indices]:
    """Clusters of triangles of one part that look much the same way and lie near each other.

    Returns:
        The clusters, and the triangle of the soup of each of their faces, -1 for none, shape (p * `LANES`,).
    """
    normals, middles = unit_normals(soup.corners), soup.corners.mean(axis=1, dtype=np.float64)
    main = np.abs(normals).argmax(axis=1)
    side = 2 * main + (normals[np.arange(len(main)), main] > 0)
    order = np.lexsort((_morton(middles), side, soup.double_sided, soup.part))
    order = order[np.linalg.norm(normals[order], axis=1) > 0.5]  # the others have no area
    starts = _starts(np.column_stack([soup.part, soup.double_sided, side])[order])
    packets = -(-np.diff(starts) // LANES)
    firsts = 1 + np.concatenate([[0], np.cumsum(packets)]).astype(np.int64)
    faces = np.full(int(firsts[-1]) * LANES, -1, dtype=np.int64)
    faces[np.arange(len(order)) + np.repeat(LANES * firsts[:-1] - starts[:-1], np.diff(starts))] = order
    values = np.zeros((len(faces), 13), dtype=np.float32)
    is_there = faces >= 0
    values[is_there, :9], values[is_there, 9:12] = soup.corners[order].reshape(-1, 9), normals[order]
    values[:, 12] = GAP
    values[is_there, 12] = np.where(soup.double_sided[faces[is_there]], SHEET, SOLID)
    reach = float(np.abs(soup.corners).max(initial=0.0))
    spheres = _spheres(soup.corners[order].astype(np.float64), normals[order], soup.double_sided[order], starts)
    return Clusters(_packed(values), firsts, _packed(spheres), reach), faces


def _packed(values: Doubles | Floats) -> Floats:
    """Rows, shape (n, k), as packets of lanes, shape (p, k, `LANES`); the last one is filled up with zeros."""
    count = -(-len(values) // LANES)
    filled = np.zeros((count * LANES, values.shape[1]), dtype=np.float32)
    filled[: len(values)] = values
    return np.ascontiguousarray(filled.reshape(count, LANES, values.shape[1]).transpose(0, 2, 1))


def _starts(keys: NDArray[np.int64]) -> Indices:
    """Where clusters begin in sorted triangles, and the last one ends, shape (c + 1,): where keys, shape (n, k), change, and clusters are
    full."""
    firsts = np.flatnonzero(np.concatenate([np.ones(min(len(keys), 1), dtype=bool), (keys[1:] != keys[:-1]).any(axis=1)]))
    lengths = np.diff(np.append(firsts, len(keys)))
    pieces = -(-lengths // CLUSTER)
    within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    return np.append(np.repeat(firsts, pieces) + CLUSTER * within, len(keys)).astype(np.int64)


def _spheres(corners: Doubles, normals: Doubles, double_sided: NDArray[np.bool_], starts: Indices) -> Doubles:
    """Spheres and cones of clusters of triangles, shape (c, 8), from these one after another: corners, shape (n, 3, 3) [m], and normals."""
    firsts = starts[:-1]
    if not len(firsts):
        return np.zeros((0, 8))
    owner = np.repeat(np.arange(len(firsts)), np.diff(starts))
    low, high = np.minimum.reduceat(corners.min(axis=1), firsts), np.maximum.reduceat(corners.max(axis=1), firsts)
    center = (low + high) / 2
    away = np.linalg.norm(corners - center[owner][:, None], axis=2).max(axis=1)
    axis = np.add.reduceat(normals, firsts)
    axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-9)[:, None]
    cosine = np.minimum.reduceat(np.einsum("nd,nd->n", normals, axis[owner]), firsts)
    turns_away = (cosine > _NARROW) & ~double_sided[firsts]
    sine = np.where(turns_away, np.sqrt(np.clip(1 - cosine**2, 0, 1)), EVERY_WAY)
    return np.column_stack([center, np.maximum.reduceat(away, firsts), axis, sine])


def unit_normals(corners: Floats) -> Doubles:
    """Normals of triangles by their winding, shape (n, 3) from (n, 3, 3); zero for those without area."""
    wide = corners.astype(np.float64)
    normals = crosses(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0])
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None])


def _morton(points: Doubles) -> Indices:
    """Places along a curve that keeps near what is near, shape (n,)."""
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    cells = ((points - low) / (high - low + 1e-9) * (2**_MORTON_BITS - 1)).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(_MORTON_BITS):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
