"""Which models of a library are the same: the same bytes, or the same vertices up to order, place, unit and a turn about the up axis."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.library.entry import IndexEntry

Array = NDArray[np.float64]

QUANTILES = 16
"""Of heights and of distances from the axis, in a signature: two models that share 34 numbers to three digits are most often one."""

NEAR = 2e-3
"""Numbers of two signatures differ by less where the geometry may be the same: single precision and other units change less."""

EXACT = 1e-4
"""Of a model's size: so near to each other lie vertices of the same geometry."""

FEW = 24
"""Vertices by which most turns are ruled out."""

MOST_TURNS = 64
"""Turns that are tried. What is round has as many as it has vertices in a ring, and each of them fits."""


def normalized(vertices: ArrayLike) -> Array:
    """Distinct vertices, shape (n, 3), +Z up, around their mean, of root mean square distance 1, sorted."""
    points = _scaled(np.asarray(vertices, dtype=np.float64))
    return _scaled(np.unique(np.round(points, 5), axis=0))


def _scaled(points: Array) -> Array:
    centered = points - points.mean(axis=0)
    return np.asarray(centered / max(float(np.sqrt((centered**2).sum(axis=1).mean())), 1e-12))


def signature_of(vertices: ArrayLike) -> NDArray[np.float32]:
    """What does not change with order, place, unit and a turn about +Z: quantiles of heights and of distances from the axis, and the mean
    of both, shape (34,)."""
    points = normalized(vertices)
    heights, radii = points[:, 2], np.linalg.norm(points[:, :2], axis=1)
    shares = np.linspace(0.0, 1.0, QUANTILES)
    values = [np.quantile(heights, shares), np.quantile(radii, shares), [np.abs(heights).mean()], [radii.mean()]]
    return np.concatenate(values).astype(np.float32)


def is_same(first: ArrayLike, other: ArrayLike) -> bool:
    """Whether two sets of vertices, shapes (n, 3) and (m, 3), +Z up, are the same up to order, place, unit and a turn about +Z."""
    from scipy.spatial import cKDTree

    a, b = normalized(first), normalized(other)
    tree, back = cKDTree(b), cKDTree(a)
    radius_b = np.linalg.norm(b[:, :2], axis=1)
    start = _rarest(a)
    if start is None:  # all on the axis: no turn changes it
        return bool((tree.query(a)[0] < EXACT).all() and (back.query(b)[0] < EXACT).all())
    radius = float(np.linalg.norm(a[start, :2]))
    few = a[:: max(len(a) // FEW, 1)]
    for partner in np.flatnonzero((np.abs(radius_b - radius) < EXACT) & (np.abs(b[:, 2] - a[start, 2]) < EXACT))[:MOST_TURNS]:
        angle = np.arctan2(b[partner, 1], b[partner, 0]) - np.arctan2(a[start, 1], a[start, 0])
        cos, sin = np.cos(angle), np.sin(angle)
        turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        if all((there.query(points)[0] < 2 * EXACT).all() for there, points in ((tree, few @ turn), (tree, a @ turn), (back, b @ turn.T))):
            return True
    return False


def _rarest(points: Array) -> int | None:
    """A vertex far from the axis that few others share height and distance with; None where all lie on the axis."""
    radii = np.linalg.norm(points[:, :2], axis=1)
    if radii.max() < EXACT:
        return None
    rings = np.round(np.column_stack([radii, points[:, 2]]), 3)
    _, which, times = np.unique(rings, axis=0, return_inverse=True, return_counts=True)
    return int(np.argmin(np.where(radii > 0.3 * radii.max(), times[which.reshape(-1)], len(points) + 1)))


def marked(entries: Sequence[IndexEntry], vertices_of: Callable[[IndexEntry], Array | None]) -> list[IndexEntry]:
    """Entries by file, in the order of their names, those that hold what an earlier one holds named as its duplicates.

    vertices_of: Canonical vertices of an entry, shape (n, 3) [m], None where they cannot be had any more; asked for only where the
    signatures of two entries leave room for doubt.
    """
    ordered = sorted(entries, key=lambda entry: entry.file)
    first_of: dict[str, str] = {}  # by content
    groups: dict[tuple[int, int], list[IndexEntry]] = {}
    made: list[IndexEntry] = []
    for entry in ordered:
        owner, way = first_of.get(entry.content, ""), "bytes"
        if not owner:
            group = groups.setdefault((entry.face_count, entry.vertex_count), [])
            owner, way = _same(entry, group, vertices_of), "geometry"
            if not owner:
                group.append(entry)
            first_of[entry.content] = entry.file
        made.append(dataclasses.replace(entry, duplicate_of=owner, duplicate_by=way if owner else ""))
    return made


def _same(entry: IndexEntry, group: Sequence[IndexEntry], vertices_of: Callable[[IndexEntry], Array | None]) -> str:
    """The file of the first of a group that has the same geometry; ''."""
    near = [other for other in group if float(np.abs(other.signature - entry.signature).max()) < NEAR]
    mine = vertices_of(entry) if near else None
    for other in near:
        theirs = vertices_of(other) if mine is not None else None
        if mine is not None and theirs is not None and is_same(mine, theirs):
            return other.file
    return ""
