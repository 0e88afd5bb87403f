"""Convex pieces of all bodies of a scene as flat arrays, for compiled code, and where the bodies stand.

A body is turned about the upright axis and moved: a vertex v of its shape, given relative to its pivot, lies at
Rz(turn) v + place in the world. Whatever else its pose turns is in the vertices already.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.optimization.solids import ConvexParts

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

FLAT_COSINE = 1.0 - 1e-9
"""Triangles whose normals agree to this are one face: 0.0026 degrees, rounding of float32 files."""

FLAT_M = 0.001
"""Undersides this near in height are at the same one [m]."""


class Shapes(NamedTuple):
    """Pieces of n bodies. Body i has pieces `first_piece[i]` to `first_piece[i + 1]`; the same for vertices, planes and
    edges of a piece. vertices: relative to the body's pivot [m], shape (v, 3). normals, offsets: n.x <= d inside a
    piece, outward unit normals, shapes (f, 3) and (f,). edges: pairs of vertices between different faces, shape (e, 2).
    """

    first_piece: Integers
    first_vertex: Integers
    first_plane: Integers
    first_edge: Integers
    vertices: Array
    normals: Array
    offsets: Array
    edges: Integers


class Stand(NamedTuple):
    """Where n bodies with p pieces stand. turn: cosine and sine, shape (n, 2). place: of the pivots [m], shape (n, 3).
    low, high: world boxes of the bodies [m], shape (n, 3); piece_low, piece_high: of the pieces, shape (p, 3)."""

    turn: Array
    place: Array
    low: Array
    high: Array
    piece_low: Array
    piece_high: Array


def shapes_of(solids: Sequence[ConvexParts], poses: Array) -> Shapes:
    """Shapes of solids at their poses, 4x4 [m], shape (n, 4, 4); the pivot is the pose's translation."""
    pieces, vertices, faces = [0], [], []
    for solid, pose in zip(solids, poses, strict=True):
        turn = np.asarray(pose)[:3, :3]
        for hull in solid.hulls:
            vertices.append(hull.vertices @ turn.T)
            faces.append(hull.faces)
        pieces.append(len(vertices))
    corner_counts, face_counts = ([len(a) for a in arrays] for arrays in (vertices, faces))
    first_vertex, first_face = (np.concatenate([[0], np.cumsum(c)]).astype(np.int64) for c in (corner_counts, face_counts))
    points = np.ascontiguousarray(np.concatenate([*vertices, np.zeros((0, 3))]))
    triangles = np.ascontiguousarray(np.concatenate([*faces, np.zeros((0, 3), dtype=np.int64)])).astype(np.int64)
    normals, offsets = np.empty((len(triangles), 3)), np.empty(len(triangles))
    edges = np.empty((3 * len(triangles), 2), dtype=np.int64)
    first_plane, first_edge = np.zeros_like(first_vertex), np.zeros_like(first_vertex)
    most = max(corner_counts, default=0)
    compiled()["find_faces"](points, triangles, first_vertex, first_face, normals, offsets, edges, first_plane, first_edge, most)
    return Shapes(
        np.array(pieces, dtype=np.int64), first_vertex, first_plane, first_edge, points,
        normals[: first_plane[-1]].copy(), offsets[: first_plane[-1]].copy(), edges[: first_edge[-1]].copy(),
    )  # fmt: skip


def stand_of(shapes: Shapes, place: Array) -> Stand:
    """Bodies as their poses have them: not turned, pivots at `place` [m], shape (n, 3)."""
    n, p = len(shapes.first_piece) - 1, len(shapes.first_vertex) - 1
    stand = Stand(
        np.tile([1.0, 0.0], (n, 1)), np.array(place, dtype=np.float64).reshape(n, 3).copy(),
        np.empty((n, 3)), np.empty((n, 3)), np.empty((p, 3)), np.empty((p, 3)),
    )  # fmt: skip
    for body in range(n):
        compiled()["bound"](shapes, stand, body)
    return stand


@cache
def compiled() -> Kernels:
    """The functions below as machine code, by name."""
    functions = (find_faces, bound, piece_depth, pair_depth, span, crossing_gap, piece_gap, body_gap, least_gap, cloth_gap)
    return compile_kernels(*functions)


def find_faces(
    points: Array, triangles: Integers, first_vertex: Integers, first_face: Integers, normals: Array, offsets: Array, edges: Integers,
    first_plane: Integers, first_edge: Integers, most: int,
) -> None:  # fmt: skip
    """Planes and edges of convex pieces from their triangles; those in one plane are one face."""
    owner = np.empty((most, most), dtype=np.int64)  # the face on the left of an edge from one vertex to another
    planes, lines = 0, 0
    for p in range(len(first_vertex) - 1):
        base, count = first_vertex[p], first_vertex[p + 1] - first_vertex[p]
        owner[:count, :count] = -1
        start = planes
        for f in range(first_face[p], first_face[p + 1]):
            a, b, c = triangles[f]
            u, v = points[base + b] - points[base + a], points[base + c] - points[base + a]
            nx, ny, nz = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if length < 1e-14:  # a sliver says nothing about a direction; its neighbors do
                continue
            nx, ny, nz = nx / length, ny / length, nz / length
            face = -1
            for q in range(start, planes):
                if normals[q, 0] * nx + normals[q, 1] * ny + normals[q, 2] * nz >= FLAT_COSINE:
                    face = q
                    break
            if face < 0:
                face = planes
                normals[face, 0], normals[face, 1], normals[face, 2] = nx, ny, nz
                planes += 1
            owner[a, b] = owner[b, c] = owner[c, a] = face
        for q in range(start, planes):
            offsets[q] = -np.inf
            for v in range(base, base + count):
                offsets[q] = max(offsets[q], normals[q, 0] * points[v, 0] + normals[q, 1] * points[v, 1] + normals[q, 2] * points[v, 2])
        for a in range(count):
            for b in range(a + 1, count):
                if (owner[a, b] >= 0 or owner[b, a] >= 0) and owner[a, b] != owner[b, a]:
                    edges[lines, 0], edges[lines, 1] = base + a, base + b
                    lines += 1
        first_plane[p + 1], first_edge[p + 1] = planes, lines


def bound(shapes: Shapes, stand: Stand, body: int) -> None:
    """World boxes of a body and its pieces, from where it stands."""
    c, s = stand.turn[body, 0], stand.turn[body, 1]
    tx, ty, tz = stand.place[body, 0], stand.place[body, 1], stand.place[body, 2]
    for k in range(3):
        stand.low[body, k], stand.high[body, k] = np.inf, -np.inf
    for p in range(shapes.first_piece[body], shapes.first_piece[body + 1]):
        x0, y0, z0, x1, y1, z1 = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
        for v in range(shapes.first_vertex[p], shapes.first_vertex[p + 1]):
            a, b, z = shapes.vertices[v, 0], shapes.vertices[v, 1], shapes.vertices[v, 2]
            x, y = c * a - s * b, s * a + c * b
            x0, x1, y0, y1, z0, z1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y), min(z0, z), max(z1, z)
        low, high = stand.piece_low[p], stand.piece_high[p]
        low[0], low[1], low[2] = x0 + tx, y0 + ty, z0 + tz
        high[0], high[1], high[2] = x1 + tx, y1 + ty, z1 + tz
        for k in range(3):
            stand.low[body, k] = min(stand.low[body, k], low[k])
            stand.high[body, k] = max(stand.high[body, k], high[k])


def piece_depth(shapes: Shapes, stand: Stand, a: int, b: int, p: int, q: int, slop: float) -> float:
    """Penetration of piece p of body a with piece q of body b [m]: the least overlap along the world's axes and the
    normals of both (separating axis test, without the cross products of edges, which can only make it smaller).
    Zero as soon as it is known not to exceed `slop`."""
    best = np.inf
    for k in range(3):
        best = min(best, stand.piece_high[p, k] - stand.piece_low[q, k], stand.piece_high[q, k] - stand.piece_low[p, k])
    if best <= slop:
        return 0.0
    for _ in range(2):
        ca, sa, cb, sb = stand.turn[a, 0], stand.turn[a, 1], stand.turn[b, 0], stand.turn[b, 1]
        c, s = ca * cb + sa * sb, sa * cb - ca * sb  # from a's frame to b's
        dx, dy, dz = stand.place[b, 0] - stand.place[a, 0], stand.place[b, 1] - stand.place[a, 1], stand.place[b, 2] - stand.place[a, 2]
        ex, ey = ca * dx + sa * dy, ca * dy - sa * dx  # b's pivot in a's frame
        for f in range(shapes.first_plane[p], shapes.first_plane[p + 1]):
            nx, ny, nz = shapes.normals[f, 0], shapes.normals[f, 1], shapes.normals[f, 2]
            mx, my = c * nx - s * ny, s * nx + c * ny
            level = shapes.offsets[f] - (nx * ex + ny * ey + nz * dz)
            depth = -np.inf
            for v in range(shapes.first_vertex[q], shapes.first_vertex[q + 1]):
                d = level - (mx * shapes.vertices[v, 0] + my * shapes.vertices[v, 1] + nz * shapes.vertices[v, 2])
                if d > depth:
                    depth = d
                    if depth >= best:
                        break
            if depth < best:
                best = depth
                if best <= slop:
                    return 0.0
        a, b, p, q = b, a, q, p
    return best


def pair_depth(shapes: Shapes, stand: Stand, a: int, b: int, slop: float) -> tuple[float, float]:
    """Penetrations of the pieces of two bodies beyond `slop` [m]: their sum, and the deepest."""
    total, deepest = 0.0, 0.0
    for k in range(3):
        if stand.low[a, k] >= stand.high[b, k] - slop or stand.low[b, k] >= stand.high[a, k] - slop:
            return 0.0, 0.0
    for p in range(shapes.first_piece[a], shapes.first_piece[a + 1]):
        apart = False
        for k in range(3):
            apart = apart or stand.piece_low[p, k] >= stand.high[b, k] - slop or stand.low[b, k] >= stand.piece_high[p, k] - slop
        if apart:
            continue
        for q in range(shapes.first_piece[b], shapes.first_piece[b + 1]):
            depth = piece_depth(shapes, stand, a, b, p, q, slop)
            if depth > slop:
                total += depth - slop
                deepest = max(deepest, depth)
    return total, deepest


def span(shapes: Shapes, piece: int, x: float, y: float) -> tuple[float, float]:
    """Lowest and highest point of a piece on the upright line through (x, y) in its own frame; low > high where none."""
    low, high = -np.inf, np.inf
    for f in range(shapes.first_plane[piece], shapes.first_plane[piece + 1]):
        nz = shapes.normals[f, 2]
        rest = shapes.offsets[f] - shapes.normals[f, 0] * x - shapes.normals[f, 1] * y
        if nz > 1e-9:
            high = min(high, rest / nz)
        elif nz < -1e-9:
            low = max(low, rest / nz)
        elif rest < -1e-9:
            return 1.0, -1.0
    return low, high


def crossing_gap(shapes: Shapes, p: int, q: int, c: float, s: float, ex: float, ey: float, dz: float) -> tuple[float, float]:
    """Least height of an edge of piece p over a crossing edge of q [m], and of q over p; q turned by (c, s) and moved
    by (ex, ey, dz) into p's frame."""
    above, below = np.inf, np.inf
    for e in range(shapes.first_edge[q], shapes.first_edge[q + 1]):
        u, v = shapes.edges[e, 0], shapes.edges[e, 1]
        x0 = c * shapes.vertices[u, 0] - s * shapes.vertices[u, 1] + ex
        y0 = s * shapes.vertices[u, 0] + c * shapes.vertices[u, 1] + ey
        x1 = c * shapes.vertices[v, 0] - s * shapes.vertices[v, 1] + ex
        y1 = s * shapes.vertices[v, 0] + c * shapes.vertices[v, 1] + ey
        z0, z1 = shapes.vertices[u, 2] + dz, shapes.vertices[v, 2] + dz
        wx, wy = x1 - x0, y1 - y0
        for g in range(shapes.first_edge[p], shapes.first_edge[p + 1]):
            i, j = shapes.edges[g, 0], shapes.edges[g, 1]
            ax, ay = shapes.vertices[i, 0], shapes.vertices[i, 1]
            bx, by = shapes.vertices[j, 0] - ax, shapes.vertices[j, 1] - ay
            cross = bx * wy - by * wx
            if abs(cross) < 1e-15:
                continue
            t = ((x0 - ax) * wy - (y0 - ay) * wx) / cross
            r = ((x0 - ax) * by - (y0 - ay) * bx) / cross
            if 0.0 <= t <= 1.0 and 0.0 <= r <= 1.0:
                height = shapes.vertices[i, 2] + t * (shapes.vertices[j, 2] - shapes.vertices[i, 2]) - (z0 + r * (z1 - z0))
                above, below = min(above, height), min(below, -height)
    return above, below


def piece_gap(shapes: Shapes, stand: Stand, a: int, b: int, p: int, q: int) -> tuple[float, float]:
    """How far piece p of body a may be lowered until it touches piece q of body b, and how far it may be raised [m].

    Exact: the least height of the one's underside over the other's top lies at a vertex of either or where two edges
    cross in plan. Negative where they overlap; infinite where no upright line meets both.
    """
    lower, raise_ = np.inf, np.inf
    first, second, i, j = p, q, a, b
    for side in range(2):
        ca, sa, cb, sb = stand.turn[i, 0], stand.turn[i, 1], stand.turn[j, 0], stand.turn[j, 1]
        c, s = ca * cb + sa * sb, ca * sb - sa * cb  # from j's frame to i's
        dx, dy, dz = stand.place[j, 0] - stand.place[i, 0], stand.place[j, 1] - stand.place[i, 1], stand.place[j, 2] - stand.place[i, 2]
        ex, ey = ca * dx + sa * dy, ca * dy - sa * dx
        for v in range(shapes.first_vertex[second], shapes.first_vertex[second + 1]):
            x = c * shapes.vertices[v, 0] - s * shapes.vertices[v, 1] + ex
            y = s * shapes.vertices[v, 0] + c * shapes.vertices[v, 1] + ey
            z = shapes.vertices[v, 2] + dz
            low, high = span(shapes, first, x, y)
            if low > high:
                continue
            if side == 0:  # a vertex of q in p's frame
                lower, raise_ = min(lower, low - z), min(raise_, z - high)
            else:
                lower, raise_ = min(lower, z - high), min(raise_, low - z)
        if side == 0:
            above, below = crossing_gap(shapes, first, second, c, s, ex, ey, dz)
            lower, raise_ = min(lower, above), min(raise_, below)
        first, second, i, j = second, first, j, i
    return lower, raise_


def body_gap(shapes: Shapes, stand: Stand, a: int, b: int, reach: float, least: float) -> float:
    """How far body a may be lowered until it stands on body b [m], or `least` where that is less; negative when it must be raised.

    Pieces of b that are nearer to being above a piece of a than below it, or overlap it by more than `reach`, do not
    carry it: the board over a book, the side of a shelf.
    """
    if stand.low[a, 2] - stand.high[b, 2] >= least or stand.low[a, 0] >= stand.high[b, 0] or stand.low[b, 0] >= stand.high[a, 0]:
        return least
    if stand.low[a, 1] >= stand.high[b, 1] or stand.low[b, 1] >= stand.high[a, 1] or stand.low[b, 2] >= stand.high[a, 2]:
        return least
    for p in range(shapes.first_piece[a], shapes.first_piece[a + 1]):
        for q in range(shapes.first_piece[b], shapes.first_piece[b + 1]):
            if stand.piece_low[p, 2] - stand.piece_high[q, 2] >= least or stand.piece_low[q, 2] >= stand.piece_high[p, 2]:
                continue
            apart = False
            for k in range(2):
                apart = apart or stand.piece_low[p, k] >= stand.piece_high[q, k] or stand.piece_low[q, k] >= stand.piece_high[p, k]
            if apart:
                continue
            lower, raise_ = piece_gap(shapes, stand, a, b, p, q)
            if lower >= -reach and lower >= raise_ and lower < least:
                least = lower
    return least


def least_gap(shapes: Shapes, stand: Stand, body: int, among: Any, reach: float) -> tuple[float, int]:
    """How far a body may be lowered until it stands on any of the bodies marked in `among`, shape (n,) [m], and on which.

    Infinite and -1 when none of them is below it.
    """
    least, which = np.inf, -1
    for other in range(len(among)):
        if among[other] and other != body:
            gap = body_gap(shapes, stand, body, other, reach, least)
            if gap < least:
                least, which = gap, other
    return least, which


def cloth_gap(shapes: Shapes, stand: Stand, body: int, among: Any, reach: float) -> float:
    """How far a body may be lowered until it stands on any of the cloths and rugs marked in `among`, shape (n,) [m]; negative
    when it must be raised, infinite when none is below it.

    Other than for `least_gap`, a piece of a rug that starts no higher than the body carries it however thin the body's own
    lowest pieces are: nothing that stands has a rug above its bottom plate.
    """
    least, _ = least_gap(shapes, stand, body, among, reach)
    for other in range(len(among)):
        if not among[other] or other == body or stand.low[other, 2] > stand.low[body, 2] + FLAT_M:
            continue
        for p in range(shapes.first_piece[body], shapes.first_piece[body + 1]):
            for q in range(shapes.first_piece[other], shapes.first_piece[other + 1]):
                if stand.piece_low[q, 2] > stand.low[body, 2] + FLAT_M or stand.piece_low[p, 2] - stand.piece_high[q, 2] >= least:
                    continue
                apart = False
                for k in range(2):
                    apart = apart or stand.piece_low[p, k] >= stand.piece_high[q, k] or stand.piece_low[q, k] >= stand.piece_high[p, k]
                if not apart:
                    lower, _ = piece_gap(shapes, stand, body, other, p, q)
                    if lower >= -reach and lower < least:
                        least = lower
    return least
