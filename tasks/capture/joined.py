"""Nodes that hold more than their name says: floors and ceilings that a program joined with walls and furniture of the same material.

`gltf-transform optimize` joins meshes of one material under the name of the first. The names of the others are lost, their pieces are
not: pieces that are shaped like walls are walls, and all others are objects without a label.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.reading import Group
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import welded

Array = NDArray[np.float64]

FLAT = ("floor", "ceiling")
"""Labels of nodes that have no upright pieces of their own."""

MAX_RELIEF_M = 0.3
"""Height of a piece that is still part of a floor or a ceiling, and above or below it [m]: steps, skirting boards, beams."""

MIN_WALL_HEIGHT_M, MIN_WALL_LENGTH_M, MAX_WALL_DEPTH_M = 1.5, 1.0, 0.3
"""Size of a wall [m]: a door is shorter, a wardrobe is deeper."""

MAX_GAP_M = 0.02
"""Distance between the boxes of pieces of one object, such as a table's top and legs [m]."""

MAX_PIECES = 1000
"""Pieces of a node that are looked at: boxes are compared pair by pair."""


def split_joined(groups: tuple[Group, ...], surface: Surface, file: str) -> tuple[tuple[Group, ...], tuple[str, ...]]:
    """Groups with joined floors and ceilings in their pieces, and a note on each that was split."""
    split_groups: list[Group] = []
    notes = []
    for group in groups:
        pieces = _pieces(group, surface) if group.raw_label.strip().lower() in FLAT else [group]
        split_groups += pieces
        if len(pieces) > 1:
            walls = sum(piece.raw_label == "wall" for piece in pieces)
            object_count = len(pieces) - 1 - walls
            notes.append(
                f"{file}: node {group.source_id!r:.60} also holds {walls} walls and {object_count} other objects, "
                "which have lost their names: a program joined meshes of one material "
                "(gltf-transform optimize keeps them with --join false)"
            )
    return tuple(split_groups), tuple(notes)


def _pieces(group: Group, surface: Surface) -> list[Group]:
    """The floor or ceiling of a group first, then its walls and its objects; the group alone if it holds nothing else."""
    piece = _connected(surface.vertices, surface.faces[group.faces])
    count = int(piece.max(initial=-1)) + 1
    if not 1 < count <= MAX_PIECES:
        return [group]
    corners = surface.vertices[surface.faces[group.faces]]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece, corners.min(axis=1))
    np.maximum.at(high, piece, corners.max(axis=1))
    sizes = high - low
    largest = int(np.argmax(sizes[:, 0] * sizes[:, 1]))
    # The largest piece keeps the name of its node, whatever its shape: a shell in one piece is not taken apart.
    is_floor = group.raw_label.strip().lower() == "floor"
    distance = high[:, 2] - high[largest, 2] if is_floor else low[largest, 2] - low[:, 2]
    is_own = (sizes[:, 2] <= MAX_RELIEF_M) & (distance <= MAX_RELIEF_M)
    is_own[largest] = True
    depth, length = np.sort(sizes[:, :2], axis=1).T
    is_wall = ~is_own & (sizes[:, 2] >= MIN_WALL_HEIGHT_M) & (length >= MIN_WALL_LENGTH_M) & (depth <= MAX_WALL_DEPTH_M)
    labels = np.where(is_own, 0, -1)
    labels[is_wall] = 1 + np.arange(is_wall.sum())
    labels[labels < 0] = 1 + is_wall.sum() + _touching(low[labels < 0], high[labels < 0])
    if not labels.any():
        return [group]
    split_groups = []
    for number in range(int(labels.max()) + 1):
        faces = group.faces[labels[piece] == number]
        word = group.raw_label if number == 0 else "wall" if number <= is_wall.sum() else "unnamed"
        source = group.source_id if number == 0 else f"{group.source_id}_joined_{number}"
        split_groups.append(
            dataclasses.replace(group, source_id=source, raw_label=word, faces=faces, vertices=np.unique(surface.faces[faces]))
        )  # fmt: skip
    return split_groups


def _connected(vertices: Array, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the connected piece of each face, shape (m,).

    Vertices at one place are one. Edges of more than two faces do not connect: there, bodies touch.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    used, corners = np.unique(faces, return_inverse=True)
    place = welded(vertices[used])[1][corners.reshape(-1, 3)]
    edges = np.sort(np.concatenate([place[:, [0, 1]], place[:, [1, 2]], place[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    _, edge, times = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(edge.ravel(), kind="stable")
    pairs = owner[order][times[edge.ravel()[order]] == 2].reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(faces), len(faces)))
    numbers: NDArray[np.int64] = connected_components(graph, directed=False)[1].astype(np.int64)
    return numbers


def _touching(low: Array, high: Array) -> NDArray[np.int64]:
    """Number of the object of each piece, shape (k,): pieces whose boxes touch are one object."""
    from scipy.sparse.csgraph import connected_components

    gaps = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(axis=2)
    numbers: NDArray[np.int64] = connected_components(gaps <= MAX_GAP_M, directed=False)[1].astype(np.int64)
    return numbers
