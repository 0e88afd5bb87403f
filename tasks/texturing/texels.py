"""Which texels of an image triangles cover. Textures have their origin at the lower left; the first line of an image is on top."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_TOUCH_PX = 1e-6
"""A texel's center this near to an edge lies on it [px]: two triangles leave no gap at the edge that they share."""

_WITHIN_PX = 1e-3
"""A center counts as covered twice only if it lies this deep in both triangles [px]: shared edges and touching corners do not."""

_FARTHEST = 1e6
"""Places in a texture beyond this are cut: their products would lose what lies within the image."""


@dataclasses.dataclass(frozen=True)
class Coverage:
    """What triangles cover of an image, shape (height, width) each.

    owner: The first triangle that covers the center of a texel, -1 for none. depth: How many triangles hold it in their inside, at most
    255.
    """

    owner: Integers
    depth: NDArray[np.uint8]


@dataclasses.dataclass(frozen=True)
class Texels:
    """Covered texels, line by line. row, column: shape (t,). face: which triangle, shape (t,). weights: barycentric, of the triangle's
    corners at the texel's center, shape (t, 3), none negative."""

    row: Integers
    column: Integers
    face: Integers
    weights: Array


def coverage_of(uv: Array, faces: Integers, shape: tuple[int, int]) -> Coverage:
    """Coverage of an image of a shape (height, width) by triangles at places `uv`, shape (n, 2), by corners, shape (m, 3).

    What lies outside of the unit square covers nothing.
    """
    at = _pixels(uv, shape)
    owner, depth = np.full(shape, -1, dtype=np.int64), np.zeros(shape, dtype=np.uint8)
    _kernels()["_cover"](at, np.ascontiguousarray(faces, dtype=np.int64), owner, depth)
    return Coverage(owner, depth)


def texels_of(uv: Array, faces: Integers, shape: tuple[int, int]) -> Texels:
    """The texels of an image of a shape (height, width) that triangles cover; of several the first one has it."""
    owner = coverage_of(uv, faces, shape).owner
    row, column = np.nonzero(owner >= 0)
    face = owner[row, column]
    a, b, c = _pixels(uv, shape)[faces[face]].transpose(1, 0, 2)
    point = np.column_stack([column, row]).astype(np.float64)
    weights = np.stack([_twice(b, c, point), _twice(c, a, point), _twice(a, b, point)], axis=1)
    weights = np.maximum(weights * np.sign(weights.sum(axis=1))[:, None], 0.0)
    return Texels(row, column, face, weights / weights.sum(axis=1, keepdims=True))


def _pixels(uv: Array, shape: tuple[int, int]) -> Array:
    """Places in pixels (column, row), whose centers are whole numbers, shape (n, 2)."""
    height, width = shape
    near = np.clip(np.asarray(uv, dtype=np.float64), -_FARTHEST, _FARTHEST)
    return np.column_stack([near[:, 0] * width - 0.5, (1.0 - near[:, 1]) * height - 0.5])


def _twice(a: Array, b: Array, c: Array) -> Array:
    """Twice the signed area of triangles [px2], shape (t,)."""
    (x, y), (u, v) = (b - a).T, (c - a).T
    return np.asarray(x * v - y * u)


def _cover(at: Any, faces: Any, owner: Any, depth: Any) -> None:
    height, width = owner.shape
    for face in range(len(faces)):
        a, b, c = faces[face]
        ax, ay, bx, by, cx, cy = at[a, 0], at[a, 1], at[b, 0], at[b, 1], at[c, 0], at[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        if area < 0.0:
            bx, by, cx, cy = cx, cy, bx, by
        first, second, third = np.hypot(bx - ax, by - ay), np.hypot(cx - bx, cy - by), np.hypot(ax - cx, ay - cy)
        left = int(max(np.ceil(min(ax, bx, cx) - _TOUCH_PX), 0.0))
        right = int(min(np.floor(max(ax, bx, cx) + _TOUCH_PX), width - 1.0))
        top = int(max(np.ceil(min(ay, by, cy) - _TOUCH_PX), 0.0))
        bottom = int(min(np.floor(max(ay, by, cy) + _TOUCH_PX), height - 1.0))
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                nearest = min(
                    ((bx - ax) * (row - ay) - (by - ay) * (column - ax)) / first,
                    ((cx - bx) * (row - by) - (cy - by) * (column - bx)) / second,
                    ((ax - cx) * (row - cy) - (ay - cy) * (column - cx)) / third,
                )
                if nearest >= -_TOUCH_PX and owner[row, column] < 0:
                    owner[row, column] = face
                if nearest > _WITHIN_PX and depth[row, column] < 255:
                    depth[row, column] += 1


@cache
def _kernels() -> Kernels:
    return compile_kernels(_cover)
