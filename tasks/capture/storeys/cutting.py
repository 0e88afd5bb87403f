"""Triangles cut at heights: what of a mesh is below, between and above, with new vertices where edges cross. No area is lost or added."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Crossings:
    """New vertices of a cut. ends: The vertices of the edge that each is on, shape (k, 2). share: Of the way from the first to the second,
    0 to 1, shape (k,)."""

    ends: Integers
    share: Array

    def extended(self, column: NDArray[Any]) -> NDArray[Any]:
        """A column of vertices, shape (n, ...), with what the new ones have: between their ends, rounded where it is whole."""
        first, second = (column[self.ends[:, side]].astype(np.float64) for side in (0, 1))
        share = self.share.reshape(-1, *[1] * (column.ndim - 1))
        between = first + share * (second - first)
        return np.concatenate([column, (np.round(between) if column.dtype.kind in "iu" else between).astype(column.dtype)])

    def extended_owner(self, owner: Integers) -> Integers:
        """Owners of vertices, shape (n,), with those of the new ones: that of both ends, -1 where the two differ."""
        first, second = owner[self.ends[:, 0]], owner[self.ends[:, 1]]
        return np.concatenate([owner, np.where(first == second, first, -1)])


@dataclasses.dataclass(frozen=True)
class Strips:
    """A mesh cut at some heights. crossings: New vertices of each cut, which may be on edges that an earlier cut made. faces: Of each
    strip, the lowest first, corners among all vertices, shape (m, 3). origins: The face that each is of, shape (m,)."""

    crossings: tuple[Crossings, ...]
    faces: tuple[Integers, ...]
    origins: tuple[Integers, ...]

    def extended(self, column: NDArray[Any]) -> NDArray[Any]:
        """A column of the mesh's vertices with what all new ones have."""
        for crossing in self.crossings:
            column = crossing.extended(column)
        return column

    def extended_owner(self, owner: Integers) -> Integers:
        """Owners of the mesh's vertices with those of all new ones."""
        for crossing in self.crossings:
            owner = crossing.extended_owner(owner)
        return owner


def strips(height: Array, faces: Integers, cuts: Sequence[float]) -> Strips:
    """A mesh cut at ascending heights [m]. height: Of each vertex [m], shape (n,). faces: Shape (m, 3)."""
    rest, origin = faces, np.arange(len(faces))
    crossings, parts, origins = [], [], []
    for at in cuts:
        crossing, (below, below_of), (rest, above_of) = _halves(height, rest, at)
        height = crossing.extended(height)
        crossings.append(crossing)
        parts.append(below)
        origins.append(origin[below_of])
        origin = origin[above_of]
    return Strips(tuple(crossings), (*parts, rest), (*origins, origin))


def _halves(height: Array, faces: Integers, at: float) -> tuple[Crossings, tuple[Integers, Integers], tuple[Integers, Integers]]:
    """What of faces is below and above a height, each with the face that it is of; the new vertices come after all others."""
    side = np.sign(height[faces] - at)
    crossing = (side < 0).any(axis=1) & (side > 0).any(axis=1)
    is_above = side.sum(axis=1) > 0  # of those that do not cross; what lies in the plane is the ceiling of what is below
    whole = np.flatnonzero(~crossing)
    cut = np.flatnonzero(crossing)
    upper = side[cut] > 0
    alone_above = upper.sum(axis=1) == 1
    lone = np.where(alone_above, upper.argmax(axis=1), (~upper).argmax(axis=1))
    corners = faces[cut[:, None], (lone[:, None] + np.arange(3)) % 3]  # the corner that is alone on its side comes first
    edges = np.stack([corners[:, [0, 1]], corners[:, [0, 2]]], axis=1).reshape(-1, 2)
    ends, place = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True) if len(edges) else (edges, np.zeros(0, dtype=np.int64))
    low, high = height[ends[:, 0]], height[ends[:, 1]]
    is_new = (low != at) & (high != at)  # else the edge has a vertex there already
    number = np.where(low == at, ends[:, 0], ends[:, 1])
    number[is_new] = len(height) + np.arange(int(is_new.sum()))
    share = ((at - low) / np.where(high == low, 1.0, high - low))[is_new]
    new = number[place].reshape(-1, 2)
    tip = np.stack([corners[:, 0], new[:, 0], new[:, 1]], axis=1)
    base = np.concatenate([
        np.stack([new[:, 0], corners[:, 1], corners[:, 2]], axis=1), np.stack([new[:, 0], corners[:, 2], new[:, 1]], axis=1),
    ])  # fmt: skip
    twice, alone_twice = np.concatenate([cut, cut]), np.concatenate([alone_above, alone_above])
    below = _gathered((faces, whole[~is_above[whole]]), (tip, cut, ~alone_above), (base, twice, alone_twice))
    above = _gathered((faces, whole[is_above[whole]]), (tip, cut, alone_above), (base, twice, ~alone_twice))
    return Crossings(ends[is_new], share), below, above


def _gathered(whole: tuple[Integers, Integers], *pieces: tuple[Integers, Integers, NDArray[np.bool_]]) -> tuple[Integers, Integers]:
    """Faces that stay whole and pieces of others that have three corners, with the face that each is of, in the order of those."""
    faces, origins = [whole[0][whole[1]]], [whole[1]]
    for part, origin, chosen in pieces:
        kept = chosen & (part != np.roll(part, 1, axis=1)).all(axis=1)
        faces.append(part[kept])
        origins.append(origin[kept])
    of = np.concatenate(origins)
    order = np.argsort(of, kind="stable")
    return np.concatenate(faces)[order], of[order]
