"""What a surface says of the nodes of a grid, compiled: how far it is from them, and which of them it encloses.

Rays from nodes are not cast one by one: those of one direction lie on few lines, so triangles are drawn onto the plane across it, each
line keeps where it meets them, and a node looks along its own.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.proximity import without_slivers
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

INSIDE_SHARE, INSIDE_SHARE_ABOVE, FRONT_SHARE = 0.5, 0.6, 0.1
"""Inside the solid, these shares of all rays, or of the level and upward ones, meet a back, and no more than that a front."""

_FINE = 5
"""Lines of a slanted direction lie so many to a step across it: it climbs by three fifths of one from node to node."""

_SLACK = 1e-9
"""Bounds are this much looser than the numbers: rounding rules nothing out."""

_WAYS: NDArray[np.int64] = np.array(
    [[0, 0, -5], [5, 0, 0], [-5, 0, 0], [0, 5, 0], [0, -5, 0], [0, 0, 5]]  # first what settles most: what is above a seat sees it
    + [[x, y, z] for x in (-5, 5) for y in (-5, 5) for z in (-3, 3)],
)  # fmt: skip
"""Directions of rays, in fifths of a step."""


@dataclasses.dataclass(frozen=True)
class NodeGrid:
    """Nodes (i, j, k) at `origin` + `step` * (i, j, k) [m], as many along the axes as `shape` says."""

    origin: Array
    step: float
    shape: tuple[int, int, int]

    @property
    def axes(self) -> list[Array]:
        """Coordinates of nodes along each axis [m]."""
        return [self.origin[i] + self.step * np.arange(self.shape[i]) for i in range(3)]


def distances(vertices: Array, faces: NDArray[np.int64], grid: NodeGrid, far: float) -> NDArray[np.float32]:
    """How far triangles are from nodes, cut off at `far` [m], of the grid's shape. vertices: shape (n, 3). faces: shape (m, 3)."""
    x, y, z = (axis.astype(np.float32).astype(np.float64) for axis in grid.axes)
    squares, reach = np.full(grid.shape, far**2), np.full(grid.shape, far)
    _compiled()["_near"](vertices[without_slivers(vertices, faces)], x, y, z, grid.origin, grid.step, squares, reach)
    return reach.astype(np.float32)


def enclosed(vertices: Array, faces: NDArray[np.int64], grid: NodeGrid, asked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the nodes that are asked for rays tell to be inside, both of the grid's shape.

    Whichever side of a triangle a ray meets first counts: its back, or its front. Nodes that cannot be inside any more are not looked at.
    """
    corners = ((vertices - grid.origin) / grid.step)[faces]
    shares = INSIDE_SHARE, INSIDE_SHARE_ABOVE, FRONT_SHARE
    inside = np.zeros(grid.shape, dtype=np.bool_)
    inside[tuple(_compiled()["_enclosed"](corners, np.argwhere(asked), np.array(grid.shape), _WAYS, *shares).T)] = True
    return inside


@cache
def _compiled() -> Kernels:
    return compile_kernels(_to_edge, _to_triangle, _near, _meetings, _enclosed)


def _to_edge(px: float, py: float, pz: float, a: Any, b: Any) -> float:
    """Squared distance from a point to a stretch from a to b."""
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    u, v, w = px - a[0], py - a[1], pz - a[2]
    long = x * x + y * y + z * z
    share = min(max((u * x + v * y + w * z) / long, 0.0), 1.0) if long > 0.0 else 0.0
    u, v, w = u - share * x, v - share * y, w - share * z
    return u * u + v * v + w * w


def _to_triangle(px: float, py: float, pz: float, a: Any, b: Any, c: Any, normal: Any, long: float) -> float:
    """Squared distance from a point to a triangle whose normal has a length, squared."""
    if long > 0.0:
        within = 0
        for k in range(3):
            p, q = (a, b) if k == 0 else (b, c) if k == 1 else (c, a)
            x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            u, v, w = px - p[0], py - p[1], pz - p[2]
            if normal[0] * (y * w - z * v) + normal[1] * (z * u - x * w) + normal[2] * (x * v - y * u) >= 0.0:
                within += 1
        if within == 3:
            off = normal[0] * (px - a[0]) + normal[1] * (py - a[1]) + normal[2] * (pz - a[2])
            return off * off / long
    return min(_to_edge(px, py, pz, a, b), min(_to_edge(px, py, pz, b, c), _to_edge(px, py, pz, c, a)))


def _near(triangles: Array, x: Array, y: Array, z: Array, origin: Array, step: float, squares: Array, reach: Array) -> None:
    """Squared distances to nodes where they are less than they were, and their roots."""
    first, last = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    normal, middle, far = np.empty(3), np.empty(3), reach[0, 0, 0]
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        for d in range(3):
            low, high = min(a[d], min(b[d], c[d])), max(a[d], max(b[d], c[d]))
            middle[d] = 0.5 * (low + high)
            first[d] = max(int(np.ceil((low - far - origin[d]) / step - _SLACK)), 0)
            last[d] = min(int(np.floor((high + far - origin[d]) / step + _SLACK)), squares.shape[d] - 1)
        for d in range(3):
            e, g = (d + 1) % 3, (d + 2) % 3
            normal[d] = (b[e] - a[e]) * (c[g] - a[g]) - (b[g] - a[g]) * (c[e] - a[e])
        long, around = normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2, 0.0
        for k in range(3):
            p = triangles[f, k]
            around = max(around, (p[0] - middle[0]) ** 2 + (p[1] - middle[1]) ** 2 + (p[2] - middle[2]) ** 2)
        around = np.sqrt(around) * (1.0 + _SLACK) + _SLACK * step
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                flat = (x[i] - middle[0]) ** 2 + (y[j] - middle[1]) ** 2
                for k in range(first[2], last[2] + 1):
                    # a triangle is no nearer than the sphere around it, nor than its plane
                    if flat + (z[k] - middle[2]) ** 2 > (reach[i, j, k] + around) ** 2:
                        continue
                    off = normal[0] * (x[i] - a[0]) + normal[1] * (y[j] - a[1]) + normal[2] * (z[k] - a[2])
                    if off * off > squares[i, j, k] * long * (1.0 + _SLACK):
                        continue
                    square = _to_triangle(x[i], y[j], z[k], a, b, c, normal, long)
                    if square < squares[i, j, k]:
                        squares[i, j, k], reach[i, j, k] = square, np.sqrt(square)


def _meetings(corners: Array, axis: int, sign: int, slopes: Any, fine: Any, low: Any, counts: Any) -> tuple[Any, Any, Any, Any]:
    """Where lines of one direction meet triangles: the last meeting of each line, and of each meeting the one before it, its place along
    the line in steps, and which side the line comes from, 1 the back and -1 the front; -1 for no meeting."""
    heads, room, n = np.full(counts[0] * counts[1], -1, dtype=np.int64), 4096, 0
    before, places, sides = np.empty(room, dtype=np.int64), np.empty(room), np.empty(room, dtype=np.int8)
    t, u, v = np.empty(3), np.empty(3), np.empty(3)
    b, c = (axis + 1) % 3, (axis + 2) % 3
    for f in range(len(corners)):
        for k in range(3):
            t[k] = sign * corners[f, k, axis]
            u[k] = fine[0] * corners[f, k, b] - slopes[0] * t[k] - low[0]
            v[k] = fine[1] * corners[f, k, c] - slopes[1] * t[k] - low[1]
        twice = (u[1] - u[0]) * (v[2] - v[0]) - (v[1] - v[0]) * (u[2] - u[0])
        if twice == 0.0:  # seen from its edge
            continue
        turn = 1.0 if twice > 0.0 else -1.0
        for i in range(max(int(np.ceil(u.min())), 0), min(int(np.floor(u.max())), counts[0] - 1) + 1):
            for j in range(max(int(np.ceil(v.min())), 0), min(int(np.floor(v.max())), counts[1] - 1) + 1):
                first = (u[2] - u[1]) * (j - v[1]) - (v[2] - v[1]) * (i - u[1])
                second = (u[0] - u[2]) * (j - v[2]) - (v[0] - v[2]) * (i - u[2])
                third = (u[1] - u[0]) * (j - v[0]) - (v[1] - v[0]) * (i - u[0])
                if turn * first < 0.0 or turn * second < 0.0 or turn * third < 0.0:
                    continue
                if n == room:
                    room *= 2
                    before, places, sides = (
                        np.concatenate((before, np.empty(n, dtype=np.int64))),
                        np.concatenate((places, np.empty(n))),
                        np.concatenate((sides, np.empty(n, dtype=np.int8))),
                    )
                line = i * counts[1] + j
                places[n], sides[n] = (first * t[0] + second * t[1] + third * t[2]) / twice, int(sign * turn)
                before[n], heads[line] = heads[line], n
                n += 1
    return heads, before, places, sides


def _enclosed(
    corners: Array, asked: Any, shape: Any, ways: Any, inside_share: float, inside_share_above: float, front_share: float
) -> Any:  # fmt: skip
    count, above = len(ways), 0
    for w in range(count):
        above += ways[w, 2] >= 0
    left, left_above, n = count, above, len(asked)
    kept, votes = asked.copy(), np.zeros((n, 3), dtype=np.int64)  # backs, backs of level and upward rays, fronts
    slopes, fine = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    low, counts = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    for w in range(count):
        way = ways[w]
        axis = 0 if way[0] != 0 else 1 if way[1] != 0 else 2
        b, c, sign = (axis + 1) % 3, (axis + 2) % 3, 1 if way[axis] > 0 else -1
        for d in range(2):
            across = b if d == 0 else c
            fine[d] = 5 if way[across] % 5 != 0 else 1
            slopes[d] = way[across] * fine[d] // 5
            low[d] = min(0, -sign * slopes[d] * (shape[axis] - 1))
            counts[d] = fine[d] * (shape[across] - 1) + abs(slopes[d]) * (shape[axis] - 1) + 1
        heads, before, places, sides = _meetings(corners, axis, sign, slopes, fine, low, counts)
        is_above = way[2] >= 0
        left, left_above, still = left - 1, left_above - is_above, 0
        for m in range(n):
            t = sign * kept[m, axis]
            i = fine[0] * kept[m, b] - slopes[0] * t - low[0]
            j = fine[1] * kept[m, c] - slopes[1] * t - low[1]
            meeting, side, nearest = heads[i * counts[1] + j], 0, np.inf
            while meeting >= 0:
                if t < places[meeting] < nearest:
                    nearest, side = places[meeting], sides[meeting]
                meeting = before[meeting]
            backs, backs_above, fronts = votes[m, 0] + (side > 0), votes[m, 1] + (is_above and side > 0), votes[m, 2] + (side < 0)
            closed_in = backs + left >= inside_share * count or backs_above + left_above >= inside_share_above * above
            if closed_in and fronts <= front_share * count:
                votes[still, 0], votes[still, 1], votes[still, 2] = backs, backs_above, fronts
                for d in range(3):
                    kept[still, d] = kept[m, d]
                still += 1
        n = still
    return kept[:n]
