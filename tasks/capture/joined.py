"""Nodes that hold more than their name says: floors and ceilings that a program joined with walls and furniture of the same material.

`gltf-transform optimize` joins meshes of one material under the name of the first. The names of the others are lost, their pieces are
not: pieces that are shaped like walls are walls, and all others are objects without a label. A node without upright pieces is left
alone, and large flat pieces keep its label at any height: floors of several levels, platforms, lowered ceilings.
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

MAX_PLATFORM_HEIGHT_M, MIN_PLATFORM_WIDTH_M, MIN_PLATFORM_AREA_M2 = 0.5, 1.5, 6.0
"""Size of a piece that is a floor or a ceiling at any height [m, m2]: a bed or a table is smaller, a sofa is higher."""

MIN_FILLED_SHARE = 0.5
"""Share of its box in the plan that such a piece covers: a ring of moldings covers less."""

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
                f"{file}: node {group.source_id!r:.60} also has the shapes of {walls} walls and {object_count} other objects, "
                "read as these: perhaps a program joined meshes of one material and dropped their names "
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
    areas = np.bincount(piece, weights=_plan_areas(corners), minlength=count).astype(np.float64)
    has_label = _platforms(sizes, areas)
    has_label[largest] = True
    is_floor = group.raw_label.strip().lower() == "floor"
    level = high[:, 2] if is_floor else -low[:, 2]
    rise = level[:, None] - level[has_label]
    is_near = (np.abs(rise) <= MAX_RELIEF_M).any(axis=1) | (rise <= MAX_RELIEF_M).all(axis=1)
    is_low = sizes[:, 2] <= MAX_RELIEF_M
    is_own = has_label | (is_low & is_near)
    # Without upright pieces nothing tells of another object: boards and steps are part of what the node says.
    if (is_own | is_low).all():
        return [group]
    depth, length = np.sort(sizes[:, :2], axis=1).T
    is_wall = ~is_own & (sizes[:, 2] >= MIN_WALL_HEIGHT_M) & (length >= MIN_WALL_LENGTH_M) & (depth <= MAX_WALL_DEPTH_M)
    labels = np.where(is_own, 0, -1)
    labels[is_wall] = 1 + np.arange(is_wall.sum())
    labels[labels < 0] = 1 + is_wall.sum() + _touching(low[labels < 0], high[labels < 0])
    split_groups = []
    for number in range(int(labels.max()) + 1):
        faces = group.faces[labels[piece] == number]
        word = group.raw_label if number == 0 else "wall" if number <= is_wall.sum() else "unnamed"
        source = group.source_id if number == 0 else f"{group.source_id}_joined_{number}"
        split_groups.append(
            dataclasses.replace(group, source_id=source, raw_label=word, faces=faces, vertices=np.unique(surface.faces[faces]))
        )  # fmt: skip
    return split_groups


def _platforms(sizes: Array, areas: Array) -> NDArray[np.bool_]:
    """True for pieces that are floors or ceilings by their own shape. sizes: of boxes [m], shape (k, 3). areas: in the plan [m2], (k,)."""
    plan = sizes[:, 0] * sizes[:, 1]
    is_flat = (sizes[:, 2] <= MAX_PLATFORM_HEIGHT_M) & (sizes[:, :2].min(axis=1) >= MIN_PLATFORM_WIDTH_M)
    result: NDArray[np.bool_] = is_flat & (plan >= MIN_PLATFORM_AREA_M2) & (areas >= MIN_FILLED_SHARE * plan)
    return result


def _plan_areas(corners: Array) -> Array:
    """Area of each triangle in the plan [m2], shape (m,). corners: shape (m, 3, 3)."""
    first, second = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    areas: Array = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    return areas


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
