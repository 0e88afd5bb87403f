"""The closest point of a triangle mesh to each of many points: exact, over a tree of boxes, compiled.

The tree halves the triangles at the median of their centers along the longest side, down to a handful. A query goes down
the nearer child first and starts from the distance to the triangle that the query before it found, so that points which
lie next to each other in the list cost little. Of triangles at the same distance, the first in the list is taken.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_LEAF = 4
"""Triangles per leaf: fewer cost more boxes, more cost more triangle tests; 2 to 8 differ by a tenth."""


@dataclasses.dataclass(frozen=True)
class Closest:
    """Closest points of a mesh. distance: [m], shape (k,). face: index, shape (k,). point: on the mesh [m], shape (k, 3)."""

    distance: Array
    face: Integers
    point: Array


def closest_points(vertices: ArrayLike, faces: ArrayLike, points: ArrayLike) -> Closest:
    """The closest point of a mesh to each point, all in one frame [m].

    vertices: shape (n, 3). faces: shape (m, 3), in any winding; triangles without area count as what they shrank to.
    points: shape (k, 3).

    Raises:
        ValueError: the mesh has no triangle, or something is not finite.
    """
    corners = np.ascontiguousarray(np.asarray(vertices, dtype=np.float64)[np.asarray(faces, dtype=np.int64)])
    asked = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    if not len(corners):
        raise ValueError("closest points: the mesh has no triangle")
    if not (np.isfinite(corners).all() and np.isfinite(asked).all()):
        raise ValueError("closest points: a coordinate is not finite")
    kernels = _compiled()
    order = np.arange(len(corners), dtype=np.int64)
    boxes, right, first, count = kernels["_tree"](corners.mean(axis=1), corners.min(axis=1), corners.max(axis=1), order, _LEAF)
    distance, face, point = kernels["_search"](corners, order, boxes, right, first, count, asked)
    return Closest(np.asarray(distance), np.asarray(face), np.asarray(point))


@cache
def _compiled() -> dict[str, Callable[..., Any]]:
    """The kernels as machine code. Compiled code calls only compiled code, so what it calls is compiled in place first."""
    import numba

    compiled = numba.njit(cache=True, nogil=True, error_model="numpy")
    for function in (_split, _tree, _on_segment, _on_triangle, _gap, _search):
        globals()[function.__name__] = compiled(function)
    return {name: globals()[name] for name in ("_tree", "_search")}


def _split(centers: Array, order: Integers, start: int, end: int, middle: int, axis: int) -> None:
    """Reorder order[start:end] so that no center before `middle` lies above one from it on (Hoare's selection)."""
    low, high = start, end - 1
    while low < high:
        pivot = centers[order[(low + high) // 2], axis]
        i, j = low, high
        while i <= j:
            while centers[order[i], axis] < pivot:
                i += 1
            while centers[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


def _tree(centers: Array, lows: Array, highs: Array, order: Integers, leaf: int) -> Any:
    """Boxes (nodes, 6), right children, and first triangle and count of leaves (count 0 otherwise). A left child follows
    its parent; `order` is sorted in place."""
    most = 2 * (len(order) // max((leaf + 1) // 2, 1) + 1)
    boxes = np.empty((most, 6))
    right, first, count = np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most, np.int64)
    stack = np.empty((64, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = -1, 0, len(order)
    depth, nodes = 1, 0
    spread = np.empty(6)
    while depth:
        depth -= 1
        parent, start, end = stack[depth]
        node = nodes
        nodes += 1
        if parent >= 0:
            right[parent] = node
        for a in range(3):
            boxes[node, a], boxes[node, 3 + a], spread[a], spread[3 + a] = np.inf, -np.inf, np.inf, -np.inf
        for k in range(start, end):
            t = order[k]
            for a in range(3):
                boxes[node, a] = min(boxes[node, a], lows[t, a])
                boxes[node, 3 + a] = max(boxes[node, 3 + a], highs[t, a])
                spread[a] = min(spread[a], centers[t, a])
                spread[3 + a] = max(spread[3 + a], centers[t, a])
        if end - start <= leaf:
            first[node], count[node] = start, end - start
            continue
        axis = 0
        for a in range(1, 3):
            if spread[3 + a] - spread[a] > spread[3 + axis] - spread[axis]:
                axis = a
        middle = (start + end) // 2
        _split(centers, order, start, end, middle, axis)
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = node, middle, end
        stack[depth + 1, 0], stack[depth + 1, 1], stack[depth + 1, 2] = -1, start, middle
        depth += 2
    return boxes[:nodes], right[:nodes], first[:nodes], count[:nodes]


def _on_segment(x: float, y: float, z: float, a: Array, b: Array) -> Any:
    """Squared distance and closest point of a segment."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    along = dx * (x - a[0]) + dy * (y - a[1]) + dz * (z - a[2])
    length = dx * dx + dy * dy + dz * dz
    t = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    px, py, pz = a[0] + t * dx, a[1] + t * dy, a[2] + t * dz
    return (x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2, px, py, pz


def _on_triangle(x: float, y: float, z: float, corners: Array) -> Any:
    """Squared distance and closest point of a triangle: the foot on its plane when inside, else the nearest edge's."""
    a = corners[0]
    ux, uy, uz = corners[1, 0] - a[0], corners[1, 1] - a[1], corners[1, 2] - a[2]
    vx, vy, vz = corners[2, 0] - a[0], corners[2, 1] - a[1], corners[2, 2] - a[2]
    wx, wy, wz = x - a[0], y - a[1], z - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    square = nx * nx + ny * ny + nz * nz
    if square > 0.0:
        # barycentric coordinates of the foot times the squared normal
        second = (uy * wz - uz * wy) * nx + (uz * wx - ux * wz) * ny + (ux * wy - uy * wx) * nz
        first = (wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz
        if first >= 0.0 and second >= 0.0 and first + second <= square:
            off = (wx * nx + wy * ny + wz * nz) / square
            return off * off * square, x - off * nx, y - off * ny, z - off * nz
    best, px, py, pz = _on_segment(x, y, z, a, corners[1])
    for e in range(1, 3):
        d, qx, qy, qz = _on_segment(x, y, z, corners[e], corners[(e + 1) % 3])
        if d < best:
            best, px, py, pz = d, qx, qy, qz
    return best, px, py, pz


def _gap(x: float, y: float, z: float, box: Array) -> float:
    """Squared distance of a point to a box, 0 inside."""
    dx = max(box[0] - x, x - box[3], 0.0)
    dy = max(box[1] - y, y - box[4], 0.0)
    dz = max(box[2] - z, z - box[5], 0.0)
    return dx * dx + dy * dy + dz * dz


def _search(corners: Array, order: Integers, boxes: Array, right: Integers, first: Integers, count: Integers, points: Array) -> Any:
    """Distance, triangle and closest point of every query."""
    asked = len(points)
    distance, face, closest = np.empty(asked), np.empty(asked, np.int64), np.empty((asked, 3))
    stack, gaps = np.empty(64, np.int64), np.empty(64)
    found = order[0]
    for q in range(asked):
        x, y, z = points[q]
        best, px, py, pz = _on_triangle(x, y, z, corners[found])
        stack[0], gaps[0] = 0, _gap(x, y, z, boxes[0])
        depth = 1
        while depth:
            depth -= 1
            if gaps[depth] > best:
                continue
            node = stack[depth]
            if count[node]:
                for k in range(first[node], first[node] + count[node]):
                    t = order[k]
                    d, qx, qy, qz = _on_triangle(x, y, z, corners[t])
                    if d < best or (d == best and t < found):
                        best, px, py, pz, found = d, qx, qy, qz, t
                continue
            near, far = node + 1, right[node]
            near_gap, far_gap = _gap(x, y, z, boxes[near]), _gap(x, y, z, boxes[far])
            if far_gap < near_gap:
                near, far, near_gap, far_gap = far, near, far_gap, near_gap
            if far_gap <= best:
                stack[depth], gaps[depth] = far, far_gap
                depth += 1
            if near_gap <= best:
                stack[depth], gaps[depth] = near, near_gap
                depth += 1
        distance[q], face[q] = np.sqrt(best), found
        closest[q, 0], closest[q, 1], closest[q, 2] = px, py, pz
    return distance, face, closest
