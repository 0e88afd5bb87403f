"""Snapshots of surfaces and points: orthographic, each as large as its square lets it be, compiled.

A view looks from an azimuth (about +Z, from +X) and an elevation at whatever is there. Its right is horizontal; depths grow
away from the viewer.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

WHITE = 255.0


@dataclasses.dataclass(frozen=True)
class OrthographicView:
    """What is seen from a direction. depth: Over the side of the square, shape (side, side), inf where nothing is; color: shape
    (side, side, 3) uint8, white where nothing is. size: Width and height of the box around it in the view, shape (2,) [m]; middle: of
    that box along the view's right and up, shape (2,) [m]."""

    depth: Array
    color: NDArray[np.uint8]
    size: Array
    middle: Array

    @property
    def silhouette(self) -> NDArray[np.bool_]:
        """Pixels that show it, shape (side, side)."""
        return np.isfinite(self.depth)


def view_axes(azimuth: float, elevation: float) -> Array:
    """Right, up and toward the viewer, as rows, shape (3, 3)."""
    ca, sa, ce, se = math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation)
    return np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])


def surface_snapshot(surface: Surface, azimuth: float, elevation: float, side: int) -> OrthographicView:
    """A snapshot of triangles; shaded a little, so that edges show."""
    seen = surface.vertices @ view_axes(azimuth, elevation).T
    at, size, middle = _in_square(seen, side)
    depth, color = _compiled()["_drawn"](at, surface.faces, surface.colors.astype(np.float64), side)
    return OrthographicView(np.asarray(depth) / side, np.asarray(color), size, middle)


def points_snapshot(points: Array, gap: float, azimuth: float, elevation: float, side: int) -> OrthographicView:
    """A snapshot of points, shape (n, 3) [m], that lie about `gap` [m] apart: holes between them are closed, and it grows by nothing."""
    from scipy.ndimage import binary_erosion, grey_erosion

    seen = points @ view_axes(azimuth, elevation).T
    at, size, middle = _in_square(seen, side)
    reach = max(1, math.ceil(0.6 * gap * _pixels_per_meter(size, side)))
    depth = np.asarray(_compiled()["_splat"](at, side + 2 * reach, reach))
    window = np.ones((2 * reach + 1, 2 * reach + 1), dtype=bool)
    closed = binary_erosion(np.isfinite(depth), window)
    nearest = grey_erosion(np.where(np.isfinite(depth), depth, 1e6), footprint=np.ones((3, 3), dtype=bool))
    inner = slice(reach, reach + side)
    where, near = closed[inner, inner], nearest[inner, inner]
    color = np.where(where[..., None], np.uint8(128), np.uint8(WHITE)) * np.ones(3, dtype=np.uint8)
    return OrthographicView(np.where(where, near / side, np.inf), color, size, middle)


def differences(reference: OrthographicView, rest: list[OrthographicView], depth_weight: float) -> Array:
    """How much snapshots of one side differ from a reference, shape (n,): what their silhouettes do not share, plus the mean
    difference of their depths, both without their means, where both show something."""
    silhouettes = np.stack([other.silhouette for other in rest])
    shared = silhouettes & reference.silhouette
    together = shared.sum(axis=(1, 2))
    union = (silhouettes | reference.silhouette).sum(axis=(1, 2))
    depths = np.stack([other.depth for other in rest])
    with np.errstate(invalid="ignore"):
        apart = np.where(shared, depths - reference.depth, 0.0)
    count = np.maximum(together, 1)
    apart -= np.where(shared, (apart.sum(axis=(1, 2)) / count)[:, None, None], 0.0)
    return 1.0 - together / np.maximum(union, 1) + depth_weight * np.abs(apart).sum(axis=(1, 2)) / count


def hull_corners(points: Array) -> Array:
    """Those of points, shape (n, 3), that a box in some view may touch, shape (m, 3)."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[np.sort(ConvexHull(points).vertices)]
    except QhullError:  # all of them in a plane
        return points


def box_in_view(points: Array, azimuth: float, elevation: float) -> tuple[Array, Array]:
    """Size and middle, along right and up, of the box around points in a view, both shape (2,) [m]."""
    seen = points @ view_axes(azimuth, elevation)[:2].T
    low, high = seen.min(axis=0), seen.max(axis=0)
    return high - low, 0.5 * (low + high)


def _pixels_per_meter(size: Array, side: int) -> float:
    return (side - 2) / max(float(size.max()), 1e-6)


def _in_square(seen: Array, side: int) -> tuple[Array, Array, Array]:
    """Pixels (column, row, depth) of points along a view's axes, shape (n, 3), in the middle of a square; size and middle [m]."""
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    middle, scale = 0.5 * (low + high), _pixels_per_meter(high - low, side)
    flat = (seen[:, :2] - middle) * scale * [1.0, -1.0] + 0.5 * side
    return np.column_stack([flat, -scale * seen[:, 2]]), high - low, middle


@cache
def _compiled() -> Kernels:
    return compile_kernels(_drawn, _splat)


def _drawn(at: Array, faces: NDArray[np.int64], colors: Array, side: int) -> tuple[Array, NDArray[np.uint8]]:
    depth = np.full((side, side), np.inf)
    color = np.full((side, side, 3), 255, dtype=np.uint8)
    for f in range(faces.shape[0]):
        a, b, c = at[faces[f, 0]], at[faces[f, 1]], at[faces[f, 2]]
        twice = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(twice) < 1e-9:  # seen from its edge
            continue
        left = max(int(np.floor(min(a[0], b[0], c[0]) - 0.5)), 0)
        right = min(int(np.ceil(max(a[0], b[0], c[0]) - 0.5)), side - 1)
        top = max(int(np.floor(min(a[1], b[1], c[1]) - 0.5)), 0)
        bottom = min(int(np.ceil(max(a[1], b[1], c[1]) - 0.5)), side - 1)
        # the part of the normal that looks at the viewer: 1 for what faces it, 0 for what is seen from its edge
        nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
        light = 0.6 + 0.4 * abs(twice) / np.sqrt(nx * nx + ny * ny + twice * twice)
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                x, y = column + 0.5, row + 0.5
                v = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / twice
                w = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / twice
                u = 1.0 - v - w
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                z = u * a[2] + v * b[2] + w * c[2]
                if z < depth[row, column]:
                    depth[row, column] = z
                    for k in range(3):
                        shade = u * colors[faces[f, 0], k] + v * colors[faces[f, 1], k] + w * colors[faces[f, 2], k]
                        color[row, column, k] = np.uint8(min(max(shade * light, 0.0), 255.0))
    return depth, color


def _splat(at: Array, side: int, reach: int) -> Array:
    """Depth of squares of so many pixels around points whose middle is that of a square without its rim of `reach` pixels."""
    depth = np.full((side, side), np.inf)
    for i in range(at.shape[0]):
        column, row = int(np.floor(at[i, 0])) + reach, int(np.floor(at[i, 1])) + reach
        for y in range(max(row - reach, 0), min(row + reach, side - 1) + 1):
            for x in range(max(column - reach, 0), min(column + reach, side - 1) + 1):
                depth[y, x] = min(depth[y, x], at[i, 2])
    return depth
