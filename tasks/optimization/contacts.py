"""Contacts: which convex pieces of placed solids penetrate, how deep, and which way parts them.

FCL says whether two pieces overlap; that is right. The depth that its solvers give for convex polyhedra is not: libccd's
is one upper bound among many (up to thrice the depth when one piece is deep in the other), the other solver's is no bound at all. So
the depth is computed here, exactly: the least shift that parts two convex polyhedra is along a normal of the boundary of
their Minkowski difference, which is a face of the one, of the other, or spanned by an edge of each whose arcs cross on
the sphere of normals (Gregorius, "The Separating Axis Test between Convex Polyhedra", GDC 2013).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.pieces import Hull
from tasks.kernels import compile_kernels
from tasks.optimization.search.descent import TOUCH_M
from tasks.optimization.solids import ConvexParts

Array = NDArray[np.float64]

FLOOR = "floor"
"""Name of the floor, the half-space below z = 0."""


@dataclasses.dataclass(frozen=True)
class Penetration:
    """Two solids, or a solid and a part of the room, that are in each other.

    a, b: names; index_a, index_b: places in the solids, or in the fixed parts after them; the floor comes last. depth_m:
    penetration depth of the deepest pair of pieces [m], above `TOUCH_M`. direction: unit vector in the world frame; `a`
    moved along it by the depth parts that pair of pieces.
    """

    a: str
    b: str
    index_a: int
    index_b: int
    depth_m: float
    direction: tuple[float, float, float]


class Colliders:
    """Solids and the fixed parts of a room, prepared once for tests at many poses.

    solids: pieces in their own frames [m]. fixed_parts: in the world frame [m]; they are not tested against each other.
    """

    def __init__(self, solids: Sequence[ConvexParts], fixed_parts: Sequence[ConvexParts] = ()) -> None:
        everything = (*solids, *fixed_parts)
        self.names = [solid.name for solid in everything]
        self.movable_count = len(solids)
        pieces = [hull for solid in everything for hull in solid.hulls]
        counts = np.array([len(solid.hulls) for solid in everything], dtype=np.int64)
        self._first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self._owner = np.repeat(np.arange(len(everything)), counts)
        known: dict[tuple[bytes, bytes], int] = {}
        self._shape = np.zeros(len(pieces), dtype=np.int64)
        distinct: list[Hull] = []
        for i, hull in enumerate(pieces):
            key = (hull.vertices.tobytes(), hull.faces.tobytes())
            if key not in known:
                known[key] = len(distinct)
                distinct.append(hull)
            self._shape[i] = known[key]
        self._distinct = distinct
        self._geometries: dict[int, Any] = {}
        self._shapes: dict[int, tuple[Array, Array, Array]] = {}
        self._points = np.concatenate([hull.vertices for hull in pieces]) if pieces else np.zeros((0, 3))
        sizes = np.array([len(hull.vertices) for hull in pieces], dtype=np.int64)
        self._point_first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self._point_owner = np.repeat(self._owner, sizes)

    def penetrations(self, poses: Array) -> list[Penetration]:
        """Pairs that penetrate, by the solids' order, when the solids stand at rigid poses, solid to world [m], shape (n, 4, 4).

        Every pair of solids, and every solid with every fixed part and with the floor. Exact to rounding, some 1e-14 m.

        Raises:
            ValueError: a pose is not finite: nothing can be said of it.
        """
        total, movable = len(self.names), self.movable_count
        placed = np.tile(np.eye(4), (total, 1, 1))
        placed[:movable] = np.asarray(poses, dtype=np.float64).reshape(movable, 4, 4)
        if not np.isfinite(placed).all():
            bad = self.names[int(np.argmin(np.isfinite(placed).all(axis=(1, 2))))]
            raise ValueError(f"pose of {bad}: must be finite")
        if not len(self._points):
            return []
        turned = np.einsum("nij,nj->ni", placed[self._point_owner, :3, :3], self._points) + placed[self._point_owner, :3, 3]
        low, high = np.minimum.reduceat(turned, self._point_first[:-1]), np.maximum.reduceat(turned, self._point_first[:-1])
        deepest: dict[tuple[int, int], tuple[float, Array]] = {}
        objects: dict[int, Any] = {}
        depth = _compiled_depth()
        for p, q, bound in self._near_pieces(low, high):
            a, b = int(self._owner[p]), int(self._owner[q])
            if bound <= deepest.get((a, b), (TOUCH_M,))[0] or not self._overlap(p, q, placed, objects):
                continue
            rotation = placed[a, :3, :3].T @ placed[b, :3, :3]
            shift = placed[a, :3, :3].T @ (placed[b, :3, 3] - placed[a, :3, 3])
            deep, x, y, z = depth(*self._shape_of(p), *self._shape_of(q), rotation, shift)
            if deep > deepest.get((a, b), (TOUCH_M,))[0]:
                deepest[a, b] = (deep, placed[a, :3, :3] @ np.array([x, y, z]))
        for i in range(movable):
            if self._first[i] < self._first[i + 1]:
                sunk = -float(low[self._first[i] : self._first[i + 1], 2].min())
                if sunk > TOUCH_M:
                    deepest[i, total] = (sunk, np.array([0.0, 0.0, 1.0]))
        names = [*self.names, FLOOR]
        return [
            Penetration(names[a], names[b], a, b, float(deep), (float(way[0]), float(way[1]), float(way[2])))
            for (a, b), (deep, way) in sorted(deepest.items(), key=lambda item: item[0])
        ]

    def _near_pieces(self, low: Array, high: Array) -> list[tuple[int, int, float]]:
        """Pairs of pieces whose axis-aligned boxes, shape (m, 3), overlap, with how far moving along the best of the axes
        parts the boxes [m]: no such pair is deeper. The deepest boxes come first."""
        firsts = self._first[:-1]
        filled = np.flatnonzero(np.diff(self._first))
        whole_low, whole_high = np.minimum.reduceat(low, firsts[filled]), np.maximum.reduceat(high, firsts[filled])
        order = np.argsort(whole_low[:, 0], kind="stable")
        pairs: list[tuple[Array, Array, Array]] = []
        for k, at in enumerate(order):
            stop = int(np.searchsorted(whole_low[order, 0], whole_high[at, 0] - TOUCH_M))
            for other in order[k + 1 : stop]:
                i, j = min(filled[at], filled[other]), max(filled[at], filled[other])
                if i >= self.movable_count:
                    continue
                if (np.minimum(whole_high[at], whole_high[other]) - np.maximum(whole_low[at], whole_low[other])).min() <= TOUCH_M:
                    continue
                a, b = slice(self._first[i], self._first[i + 1]), slice(self._first[j], self._first[j + 1])
                apart = np.minimum(high[a, None] - low[None, b], high[None, b] - low[a, None]).min(axis=2)
                p, q = np.nonzero(apart > TOUCH_M)
                pairs.append((p + a.start, q + b.start, apart[p, q]))
        if not pairs:
            return []
        p, q, bound = (np.concatenate(column) for column in zip(*pairs, strict=True))
        order = np.lexsort((q, p, -bound))
        return list(zip(p[order].tolist(), q[order].tolist(), bound[order].tolist(), strict=True))

    def _shape_of(self, piece: int) -> tuple[Array, Array, Array]:
        """Vertices, normals and edges of a piece, at the first need: most pieces never come near another object's."""
        shape = int(self._shape[piece])
        if shape not in self._shapes:
            self._shapes[shape] = _shape(self._distinct[shape])
        return self._shapes[shape]

    def _overlap(self, p: int, q: int, poses: Array, objects: dict[int, Any]) -> bool:
        """Whether two pieces overlap, by FCL. libccd's solver: the other one misses some."""
        import fcl

        for piece in (p, q):
            if piece not in objects:
                pose, shape = poses[self._owner[piece]], int(self._shape[piece])
                if shape not in self._geometries:
                    self._geometries[shape] = _fcl_convex(self._distinct[shape])
                objects[piece] = fcl.CollisionObject(self._geometries[shape], fcl.Transform(pose[:3, :3], pose[:3, 3]))
        request = fcl.CollisionRequest(gjk_solver_type=fcl.GJKSolverType.GST_LIBCCD)
        return bool(fcl.collide(objects[p], objects[q], request, fcl.CollisionResult()))


def penetrations(solids: Sequence[ConvexParts], poses: Array, fixed_parts: Sequence[ConvexParts] = ()) -> list[Penetration]:
    """`Colliders.penetrations` for poses that are tested once."""
    return Colliders(solids, fixed_parts).penetrations(poses)


def _fcl_convex(hull: Hull) -> Any:
    """A hull as FCL's convex polyhedron."""
    import fcl

    faces = np.column_stack([np.full(len(hull.faces), 3), hull.faces]).ravel()
    return fcl.Convex(np.ascontiguousarray(hull.vertices), len(hull.faces), faces.astype(np.int32))


def _shape(hull: Hull) -> tuple[Array, Array, Array]:
    """Vertices (v, 3), outward unit normals of the faces (f, 3), and edges of one hull.

    Edges: one end, the other end, and the normals of the two faces that meet there, shape (e, 4, 3). Triangles of one
    plane are one face, and lines between them are no edges. The planes are qhull's: those of its slivers are exact, too.
    """
    from scipy.spatial import ConvexHull

    convex = ConvexHull(hull.vertices, qhull_options="Qt Pp")
    planes = convex.equations[:, :3]
    edges = []
    for k in range(3):  # the neighbor opposite to a triangle's corner shares the two others
        here, there = np.arange(len(planes)), convex.neighbors[:, k]
        bent = (here < there) & (np.linalg.norm(np.cross(planes, planes[there]), axis=1) > 1e-12)
        ends = np.delete(convex.simplices, k, axis=1)[bent]
        edges.append(np.stack([hull.vertices[ends[:, 0]], hull.vertices[ends[:, 1]], planes[bent], planes[there[bent]]], axis=1))
    return np.ascontiguousarray(hull.vertices), np.unique(planes, axis=0), np.concatenate(edges)


@cache
def _compiled_depth() -> Callable[..., tuple[float, float, float, float]]:
    """The depth of two pieces as machine code."""
    return compile_kernels(_width, _depth)["_depth"]


def _width(a: Array, b: Array, x: float, y: float, z: float) -> float:
    """How far points b, shape (n, 3), must move along a unit vector until all lie beyond points a, shape (m, 3) [m]."""
    top, bottom = -np.inf, np.inf
    for v in range(a.shape[0]):
        top = max(top, a[v, 0] * x + a[v, 1] * y + a[v, 2] * z)
    for v in range(b.shape[0]):
        bottom = min(bottom, b[v, 0] * x + b[v, 1] * y + b[v, 2] * z)
    return top - bottom


def _depth(
    a: Array, normals: Array, edges: Array, local: Array, other_normals: Array, other_edges: Array, rotation: Array, shift: Array
) -> tuple[float, float, float, float]:
    """Penetration depth of two hulls' vertices, normals and edges [m], and the direction in the first one's frame along
    which it moves out of the other; 0 when they are apart.

    rotation (3, 3), shift (3,): the second hull's frame to the first's. Every direction gives an upper bound, so a wrong
    one cannot harm; among all faces and all crossing pairs of edges is the least.
    """
    b = np.empty_like(local)
    for v in range(local.shape[0]):
        for k in range(3):
            b[v, k] = rotation[k, 0] * local[v, 0] + rotation[k, 1] * local[v, 1] + rotation[k, 2] * local[v, 2] + shift[k]
    best, bx, by, bz = np.inf, 0.0, 0.0, 0.0
    for f in range(normals.shape[0]):
        x, y, z = normals[f, 0], normals[f, 1], normals[f, 2]
        width = _width(a, b, x, y, z)
        if width < best:
            best, bx, by, bz = width, x, y, z
    for f in range(other_normals.shape[0]):
        n = other_normals[f]
        x = -(rotation[0, 0] * n[0] + rotation[0, 1] * n[1] + rotation[0, 2] * n[2])
        y = -(rotation[1, 0] * n[0] + rotation[1, 1] * n[1] + rotation[1, 2] * n[2])
        z = -(rotation[2, 0] * n[0] + rotation[2, 1] * n[1] + rotation[2, 2] * n[2])
        width = _width(a, b, x, y, z)
        if width < best:
            best, bx, by, bz = width, x, y, z
    other_pairs: Array = np.empty(other_edges.shape)
    for e in range(other_pairs.shape[0]):
        for row in range(4):
            p = other_edges[e, row]
            for k in range(3):
                turned = rotation[k, 0] * p[0] + rotation[k, 1] * p[1] + rotation[k, 2] * p[2]
                other_pairs[e, row, k] = turned + shift[k] if row < 2 else -turned
    for e in range(edges.shape[0]):
        if best <= 0.0:
            break
        p, q, m, n = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
        ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        for o in range(other_pairs.shape[0]):
            r, s, c, d = other_pairs[o, 0], other_pairs[o, 1], other_pairs[o, 2], other_pairs[o, 3]
            fx, fy, fz = s[0] - r[0], s[1] - r[1], s[2] - r[2]
            # the arcs m-n and c-d cross: an edge's direction is the normal of its arc's great circle
            ce, de = c[0] * ex + c[1] * ey + c[2] * ez, d[0] * ex + d[1] * ey + d[2] * ez
            if ce * de > 0.0:
                continue
            mf, nf = m[0] * fx + m[1] * fy + m[2] * fz, n[0] * fx + n[1] * fy + n[2] * fz
            if mf * nf > 0.0:
                continue
            x, y, z = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
            length = np.sqrt(x * x + y * y + z * z)
            if length <= 1e-12 * np.sqrt((ex * ex + ey * ey + ez * ez) * (fx * fx + fy * fy + fz * fz)):
                continue
            first, two = (
                x * (m[0] + n[0]) + y * (m[1] + n[1]) + z * (m[2] + n[2]),
                x * (c[0] + d[0]) + y * (c[1] + d[1]) + z * (c[2] + d[2]),
            )
            if first * two < 0.0:  # on opposite sides of the sphere
                continue
            length = length if first + two > 0.0 else -length
            x, y, z = x / length, y / length, z / length
            width = x * (p[0] - r[0]) + y * (p[1] - r[1]) + z * (p[2] - r[2])
            if width < best:
                width = _width(a, b, x, y, z)
                if width < best:
                    best, bx, by, bz = width, x, y, z
    return max(best, 0.0), -bx, -by, -bz
