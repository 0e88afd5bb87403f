"""Distances to the nearest triangle of large meshes as far as they matter, compiled: a tree of boxes that takes less to make than to ask.

Where a mesh has more faces than there are points, or nobody asks for what lies far away, most of the time of
`tasks.geometry.proximity` is its tree's; this one is made along a curve that fills space, and says distances alone.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_LEAF = 4  # faces that lie together, of which none is looked at where their box is too far
_BITS = 10  # of each coordinate, for the order of faces
_SLACK = 1e-9  # bounds are this much looser than the numbers: rounding rules nothing out
_FLATTEST = 1e-7
"""Height over longest edge below which a triangle is measured as its edges: nobody scans, or builds, as finely as that."""


def distances_within(vertices: ArrayLike, faces: ArrayLike, points: ArrayLike, reach: float) -> Array:
    """Distance of each point, shape (k, 3), to the nearest place of a mesh [m], shape (k,); infinite where that lies beyond `reach` [m].

    vertices: shape (n, 3), in the points' frame [m]. faces: shape (m, 3), in any winding.

    Raises:
        ValueError: something is not finite.
    """
    places = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    asked = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    corners = places[np.asarray(faces, dtype=np.int64).reshape(-1, 3)].reshape(-1, 9)
    if not (np.isfinite(corners).all() and np.isfinite(asked).all()):
        raise ValueError("distances: a coordinate is not finite")
    if not len(corners) or not len(asked):
        return np.full(len(asked), np.inf)
    kernels = _compiled()
    order = np.argsort(kernels["_codes"](corners), kind="stable")
    sorted_corners = corners[order]
    return np.asarray(kernels["_nearest"](sorted_corners, kernels["_boxes"](sorted_corners), asked, float(reach)))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_codes, _boxes, _gap, _segment, _face, _leaf, _nearest)


def _codes(corners: Array) -> Integers:
    """Place of each triangle's middle, shape (m, 9), along a curve that fills space, shape (m,)."""
    count = corners.shape[0]
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(count):
        for a in range(3):
            middle = corners[i, a] + corners[i, 3 + a] + corners[i, 6 + a]
            low[a], high[a] = min(low[a], middle), max(high[a], middle)
    side = max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    scale = (2**_BITS - 1) / side if side > 0.0 else 0.0
    codes = np.zeros(count, dtype=np.int64)
    for i in range(count):
        for a in range(3):
            cell = int((corners[i, a] + corners[i, 3 + a] + corners[i, 6 + a] - low[a]) * scale)
            for bit in range(_BITS):
                codes[i] |= (cell >> bit & 1) << (3 * bit + a)
    return codes


def _boxes(corners: Array) -> Array:
    """Lowest and highest corner [m] of each node, shape (2 p, 6): node i has the nodes 2 i and 2 i + 1, and the last p are leaves of
    `_LEAF` triangles each, shape (m, 9); one without any is inside out."""
    count = corners.shape[0]
    width = 1
    while width * _LEAF < count:
        width *= 2
    boxes = np.full((2 * width, 6), np.inf)
    boxes[:, 3:] = -np.inf
    for i in range(count):
        node = width + i // _LEAF
        for k in range(9):
            a = k % 3
            boxes[node, a] = min(boxes[node, a], corners[i, k])
            boxes[node, 3 + a] = max(boxes[node, 3 + a], corners[i, k])
    for node in range(width - 1, 0, -1):
        for a in range(3):
            boxes[node, a] = min(boxes[2 * node, a], boxes[2 * node + 1, a])
            boxes[node, 3 + a] = max(boxes[2 * node, 3 + a], boxes[2 * node + 1, 3 + a])
    return boxes


def _gap(boxes: Array, node: int, x: float, y: float, z: float) -> float:
    """Square of the distance from a point to a node's box, infinite to one that is inside out."""
    u = max(boxes[node, 0] - x, x - boxes[node, 3], 0.0)
    v = max(boxes[node, 1] - y, y - boxes[node, 4], 0.0)
    w = max(boxes[node, 2] - z, z - boxes[node, 5], 0.0)
    return u * u + v * v + w * w


def _segment(x: float, y: float, z: float, u: float, v: float, w: float) -> float:
    """Square of the distance from a point to a segment from the origin to (u, v, w)."""
    square = u * u + v * v + w * w
    along = min(max((x * u + y * v + z * w) / square, 0.0), 1.0) if square > 0.0 else 0.0
    p, q, r = x - along * u, y - along * v, z - along * w
    return p * p + q * q + r * r


def _face(corners: Array, i: int, x: float, y: float, z: float) -> float:
    """Square of the distance from a point to a triangle: to its plane where the point lies above it, else to its nearest edge."""
    px, py, pz = x - corners[i, 0], y - corners[i, 1], z - corners[i, 2]
    bx, by, bz = corners[i, 3] - corners[i, 0], corners[i, 4] - corners[i, 1], corners[i, 5] - corners[i, 2]
    cx, cy, cz = corners[i, 6] - corners[i, 0], corners[i, 7] - corners[i, 1], corners[i, 8] - corners[i, 2]
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    ex, ey, ez = cx - bx, cy - by, cz - bz
    longest = max(bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz, ex * ex + ey * ey + ez * ez)
    square = nx * nx + ny * ny + nz * nz
    qx, qy, qz = px - bx, py - by, pz - bz
    if square > (_FLATTEST * longest) ** 2:
        ab = (by * pz - bz * py) * nx + (bz * px - bx * pz) * ny + (bx * py - by * px) * nz
        bc = (ey * qz - ez * qy) * nx + (ez * qx - ex * qz) * ny + (ex * qy - ey * qx) * nz
        ca = (py * cz - pz * cy) * nx + (pz * cx - px * cz) * ny + (px * cy - py * cx) * nz
        if ab >= 0.0 and bc >= 0.0 and ca >= 0.0:
            off = px * nx + py * ny + pz * nz
            return off * off / square
    return min(_segment(px, py, pz, bx, by, bz), _segment(px, py, pz, cx, cy, cz), _segment(qx, qy, qz, ex, ey, ez))


def _leaf(corners: Array, first: int, x: float, y: float, z: float, best: float) -> float:
    """The smaller of `best` and the square of the distance from a point to the triangles of a leaf."""
    for i in range(first, min(first + _LEAF, corners.shape[0])):
        best = min(best, _face(corners, i, x, y, z))
    return best


def _nearest(corners: Array, boxes: Array, points: Array, reach: float) -> Array:
    width = boxes.shape[0] // 2
    distance = np.empty(points.shape[0])
    waiting, gaps = np.empty(64, dtype=np.int64), np.empty(64)
    last = 0  # where the nearest face of the point before lay: points come surface by surface
    for k in range(points.shape[0]):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        best = _leaf(corners, last, x, y, z, np.inf)
        limit = min(best, reach * reach) * (1.0 + _SLACK) + _SLACK**2
        waiting[0], gaps[0], depth = 1, _gap(boxes, 1, x, y, z), 1
        while depth > 0:
            depth -= 1
            node = waiting[depth]
            if gaps[depth] > limit:
                continue
            if node >= width:
                first = (node - width) * _LEAF
                nearer = _leaf(corners, first, x, y, z, best)
                if nearer < best:
                    best, last = nearer, first
                    limit = min(best, reach * reach) * (1.0 + _SLACK) + _SLACK**2
                continue
            left, right = _gap(boxes, 2 * node, x, y, z), _gap(boxes, 2 * node + 1, x, y, z)
            near = 0 if left <= right else 1
            for turn in range(2):  # the nearer one is looked at first: it comes last
                child = near if turn == 1 else 1 - near
                gap = left if child == 0 else right
                if gap <= limit:
                    waiting[depth], gaps[depth] = 2 * node + child, gap
                    depth += 1
        distance[k] = np.sqrt(best) if best <= reach * reach else np.inf
    return distance
