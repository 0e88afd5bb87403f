"""Meshes whose triangles are of very different sizes, with vertices put in until a graph of them says something of every surface."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import face_areas, welded
from tasks.segments import edges_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

COARSE_M = 0.12
"""Longer edges than these pass over what a region is to be told by [m]: the side of a mug, the gap below a table."""

COARSE_SHARE = 0.1
"""Of the surface in faces with such edges, from which on a mesh is uneven: sensors leave none, who saves triangles has walls of two."""

EDGE_M = 0.05
"""Longest edges after vertices were put in [m]."""

MOST_VERTICES = 400_000
"""About so many vertices are put in at most; of a surface of 600 m2 they are 6 cm apart, and regions take seconds."""


@dataclasses.dataclass(frozen=True)
class Evened:
    """A mesh to find regions in. surface: Welded: one vertex at a place, whatever splits them in the file (seams of textures, corners).
    place: Its vertex for each vertex of the file, shape (n,). parent: The file's face that each of its faces is a part of, shape (m,)."""

    surface: Surface
    place: Indices
    parent: Indices


def is_uneven(surface: Surface) -> bool:
    """Whether much of a surface is in triangles that are too large for its vertices to stand for it."""
    areas = face_areas(surface.vertices, surface.faces)
    return float(areas[longest_edges(surface) > COARSE_M].sum()) > COARSE_SHARE * float(areas.sum())


def longest_edges(surface: Surface) -> Array:
    """Of each face [m], shape (m,)."""
    corners = surface.vertices[surface.faces]
    return np.asarray(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1), dtype=np.float64)


def evened(surface: Surface, is_refined: bool) -> Evened:
    """A mesh welded and, where it is to be refined, with edges of no more than `EDGE_M`, or what `MOST_VERTICES` allow."""
    first, place = welded(surface.vertices)
    joined = Surface(surface.vertices[first], place[surface.faces], surface.colors[first])
    parent = np.arange(len(surface.faces), dtype=np.int64)
    if is_refined:
        area = float(face_areas(joined.vertices, joined.faces).sum())
        joined, parent = refined(joined, max(EDGE_M, float(np.sqrt(2.5 * area / MOST_VERTICES))))
    return Evened(joined, place, parent)


def refined(surface: Surface, longest: float) -> tuple[Surface, Indices]:
    """The same surface with edges of no more than `longest` [m], and the face of it that each face is a part of. Edges are halved for
    all their faces at once, so that no vertex lies on an edge of another face; vertices that there were come first."""
    vertices, faces, colors = surface.vertices, surface.faces, surface.colors.astype(np.float64)
    parent = np.arange(len(faces), dtype=np.int64)
    while len(faces):
        edges = edges_of(faces, len(vertices))
        long = edges[np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) > longest]
        if not len(long):
            break
        keys, count = long[:, 0] * len(vertices) + long[:, 1], len(vertices)
        vertices = np.concatenate([vertices, vertices[long].mean(axis=1)])
        colors = np.concatenate([colors, colors[long].mean(axis=1)])
        middle = np.stack([_middle(faces[:, k], faces[:, (k + 1) % 3], keys, count) for k in range(3)], axis=1)
        parts, owners = [], []
        for made, whose in _halved(faces, middle):
            parts.append(made)
            owners.append(parent[whose])
        faces, parent = np.concatenate(parts), np.concatenate(owners)
    return Surface(vertices, faces, np.round(colors).astype(np.uint8)), parent


def _middle(a: Indices, b: Indices, keys: Indices, count: int) -> Indices:
    """Number of the vertex in the middle of each edge between `a` and `b`, -1 where it is not halved. keys: Of halved edges, sorted."""
    key = np.minimum(a, b) * count + np.maximum(a, b)
    place = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    return np.where(keys[place] == key, place + count, -1)


def _halved(faces: Indices, middle: Indices) -> list[tuple[Indices, Indices]]:
    """Triangles of faces whose edges 0-1, 1-2 and 2-0 are halved where `middle` says so, shape (m, 3), and which face each is of."""
    cut = middle >= 0
    number = cut.sum(axis=1)
    whole = np.flatnonzero(number == 0)
    made = [(faces[whole], whole)]
    for count in (1, 2, 3):
        which = np.flatnonzero(number == count)
        # turned so that the first edge is halved and, of two, the second
        lead = cut[which].argmax(axis=1) if count != 2 else (np.argmin(cut[which], axis=1) + 1) % 3
        turn = (lead[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(faces[which], turn, axis=1).T
        ab, bc, ca = np.take_along_axis(middle[which], turn, axis=1).T
        pieces = {
            1: ((a, ab, c), (ab, b, c)),
            2: ((a, ab, c), (ab, b, bc), (ab, bc, c)),
            3: ((a, ab, ca), (ab, b, bc), (bc, c, ca), (ab, bc, ca)),
        }[count]
        made += [(np.stack(piece, axis=1), which) for piece in pieces]
    return made
