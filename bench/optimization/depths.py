"""Depths: how deep convex pieces are in each other, by every axis tried one by one, in numpy alone.

Slow, plain, and without a line of the optimization's contacts: what those are checked against, on a sample of pairs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.optimization.measures import FLOOR
from tasks.optimization.solids import ConvexParts

Array = NDArray[np.float64]
Pair = tuple[str, str]

SAMPLED = 8
"""Pairs of objects that are drawn from a state to be measured by every axis."""

DEEPEST = 4
"""So many of the deepest pairs of the rows are measured beside those."""

AXES = 8192
"""Axes that are tried at once: a few tens of MB."""

TOLERANCE_M = 1e-4
"""Depths that differ by less are the same depth [m]."""


@dataclasses.dataclass(frozen=True)
class Polyhedron:
    """A convex piece. vertices: [m], shape (n, 3). normals: of its faces, shape (f, 3). edges: directions of its edges and
    of the lines that cut its faces into triangles, shape (e, 3). Unit vectors, each axis once."""

    vertices: Array
    normals: Array
    edges: Array

    @classmethod
    def of(cls, vertices: Array) -> Polyhedron:
        """The convex hull of points, shape (n, 3) [m]."""
        from scipy.spatial import ConvexHull

        hull = ConvexHull(vertices, qhull_options="Qt Pp")
        ends = np.unique(np.sort(np.concatenate([hull.simplices[:, [k, k - 1]] for k in range(3)]), axis=1), axis=0)
        return cls(vertices[hull.vertices], _axes(hull.equations[:, :3]), _axes(vertices[ends[:, 0]] - vertices[ends[:, 1]]))

    def placed(self, pose: Array) -> Polyhedron:
        """The same at a rigid pose, 4x4 [m]."""
        turn = pose[:3, :3].T
        return Polyhedron(self.vertices @ turn + pose[:3, 3], self.normals @ turn, self.edges @ turn)


def depth_of_pair(a: Polyhedron, b: Polyhedron) -> float:
    """Penetration depth of two convex polyhedra [m]; 0 when they are apart. Exact to rounding.

    The least overlap of their shadows over all face normals and all cross products of an edge of each: the separating
    axis test without any of its shortcuts.
    """
    best = _least_overlap(a, b, np.concatenate([a.normals, b.normals]))
    if best <= 0.0:
        return 0.0
    crosses = _axes(np.cross(a.edges[:, None], b.edges[None]).reshape(-1, 3))
    for first in range(0, len(crosses), AXES):
        best = min(best, _least_overlap(a, b, crosses[first : first + AXES]))
    return max(best, 0.0)


def depth_of_objects(first: Sequence[Polyhedron], other: Sequence[Polyhedron]) -> float:
    """Depth of the deepest pair of pieces of two objects [m]; 0 when they are apart."""
    low, high = _bounds(first)
    other_low, other_high = _bounds(other)
    # no pair is deeper than the way that parts their boxes
    most = np.minimum(high[:, None] - other_low[None], other_high[None] - low[:, None]).min(axis=2)
    deepest = 0.0
    for flat in np.argsort(-most, axis=None, kind="stable"):
        p, q = divmod(int(flat), len(other))
        if most[p, q] <= deepest:
            break
        deepest = max(deepest, depth_of_pair(first[p], other[q]))
    return deepest


def disagreeing(
    rows: Mapping[Pair, float], solids: Sequence[ConvexParts], walls: Sequence[ConvexParts], poses: Mapping[str, Array],
    pieces_of: Callable[[str], Sequence[Array]],
) -> tuple[list[tuple[str, str, float]], int]:  # fmt: skip
    """Pairs of objects, and of objects and walls, of which rows have another depth, with the difference [m]; and how many
    pairs were measured. The floor is looked at for every object, and not counted among those.

    rows: depths by pair, the object before the wall and objects in their order [m]; what is missing is 0. pieces_of:
    vertices of an object's pieces in its own frame, or of a wall's in the world frame [m]. Measured are the deepest
    `DEEPEST` of the rows, and `SAMPLED` of all pairs whose boxes overlap, drawn by one fixed rule.
    """
    at = {**poses, **{wall.name: np.eye(4) for wall in walls}}
    names = [*sorted(solid.name for solid in solids), *(wall.name for wall in walls)]
    by_name = {solid.name: solid for solid in (*solids, *walls)}
    corners = [np.concatenate([hull.vertices for hull in by_name[name].placed(at[name])]) for name in names]
    low = np.array([c.min(axis=0) for c in corners]).reshape(-1, 3)
    high = np.array([c.max(axis=0) for c in corners]).reshape(-1, 3)
    overlap = (np.minimum(high[:, None], high[None]) > np.maximum(low[:, None], low[None])).all(axis=2)
    near = [(names[i], names[j]) for i, j in np.argwhere(np.triu(overlap, 1)).tolist() if i < len(solids)]
    known = [pair for pair in rows if pair[0] in by_name and pair[1] in by_name]
    chosen = sorted(known, key=lambda pair: (-rows[pair], pair))[:DEEPEST]
    if near:
        drawn = np.random.default_rng(0).choice(len(near), min(SAMPLED, len(near)), replace=False)
        chosen += [near[i] for i in sorted(drawn.tolist())]
    placed: dict[str, list[Polyhedron]] = {}
    floor = [(name, FLOOR, abs(max(-float(low[i, 2]), 0.0) - rows.get((name, FLOOR), 0.0))) for i, name in enumerate(names[: len(solids)])]
    wrong = [contact for contact in floor if contact[2] > TOLERANCE_M]
    for pair in dict.fromkeys(chosen):
        for name in pair:
            if name not in placed:
                placed[name] = [Polyhedron.of(vertices).placed(at[name]) for vertices in pieces_of(name)]
        difference = abs(depth_of_objects(placed[pair[0]], placed[pair[1]]) - rows.get(pair, 0.0))
        if difference > TOLERANCE_M:
            wrong.append((*pair, difference))
    return wrong, len(dict.fromkeys(chosen))


def _axes(vectors: Array) -> Array:
    """Directions of vectors that have one, shape (n, 3), opposite ones as one; unit vectors, shape (m, 3)."""
    lengths = np.linalg.norm(vectors, axis=1)
    units = vectors[lengths > 1e-12] / lengths[lengths > 1e-12, None]
    leading = np.take_along_axis(units, np.abs(units).argmax(axis=1)[:, None], axis=1)
    units = units * np.sign(leading)
    _, first = np.unique(np.round(units, 12), axis=0, return_index=True)
    return np.asarray(units[first])


def _least_overlap(a: Polyhedron, b: Polyhedron, axes: Array) -> float:
    """The least way that parts two shadows over axes, shape (n, 3), either way along each [m]; negative when apart."""
    first, other = a.vertices @ axes.T, b.vertices @ axes.T
    if not len(axes):
        return float("inf")
    return float(np.minimum(first.max(axis=0) - other.min(axis=0), other.max(axis=0) - first.min(axis=0)).min())


def _bounds(pieces: Sequence[Polyhedron]) -> tuple[Array, Array]:
    """Corners of the boxes around pieces [m], shape (n, 3) each."""
    low = np.array([piece.vertices.min(axis=0) for piece in pieces]).reshape(-1, 3)
    return low, np.array([piece.vertices.max(axis=0) for piece in pieces]).reshape(-1, 3)
