"""A depth frame as an organized cloud: points with noise and normals, neighbors as in the image."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.files.lenses import Intrinsics
from tasks.capture.small_objects.lifting import DepthView, depth_noise
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_WINDOW_PX = 12
"""Half the widest window that a normal is made of [px]."""

_STEPS = 4
"""Pixels that are looked at along half a window: more of them say little more, at the square of the time."""

_LEAST_NEIGHBORS = 6
"""Of a pixel, by which its normal is known."""


@dataclasses.dataclass(frozen=True)
class OrganizedFrame:
    """A frame in the camera's own frame: OpenCV axes, shape (h, w).

    points: [m], shape (h, w, 3). noise: Standard deviation of depth [m]. pixel_m: Size of a pixel at its depth [m]. normals: Unit, toward
    the camera, shape (h, w, 3); 0 where unknown. valid: Pixels with a depth. color: RGB, shape (h, w, 3).
    """

    points: Array
    noise: Array
    pixel_m: Array
    normals: Array
    valid: Bools
    color: NDArray[np.uint8]

    @property
    def has_normal(self) -> Bools:
        """Pixels with a normal, shape (h, w)."""
        return np.asarray(self.normals.any(axis=-1))


def organized_frame(view: DepthView, farthest_m: float, window_m: float, window_sigmas: float, gate_sigmas: float) -> OrganizedFrame:
    """A frame as a cloud.

    farthest_m: Depth beyond which there is no reading. window_m, window_sigmas: Radius of the window of normals: so much, or so many times
    the noise where that is more. gate_sigmas: What lies that much nearer or farther is another surface.
    """
    depth = view.depth.astype(np.float64)
    valid = np.isfinite(depth) & (depth > 0) & (depth <= farthest_m)
    depth = np.where(valid, depth, 0.0)
    points = _points(depth, view.intrinsics)
    noise, pixel_m = depth_noise(depth), depth / max(view.intrinsics[0], 1e-6)
    normals = np.zeros_like(points)
    _compiled()["_fill_normals"](points, noise, pixel_m, window_m, window_sigmas, gate_sigmas, normals)
    return OrganizedFrame(points, noise, pixel_m, normals, valid, view.color)


def _points(depth: Array, intrinsics: Intrinsics) -> Array:
    """Points of pixels in the camera's frame [m], shape (h, w, 3)."""
    fx, fy, cx, cy = intrinsics
    rows, columns = np.indices(depth.shape)
    return np.stack([(columns - cx) / fx * depth, (rows - cy) / fy * depth, depth], axis=-1)


@cache
def _compiled() -> Kernels:
    return compile_kernels(_least_direction, _fill_normals)


def _least_direction(a: float, b: float, c: float, d: float, e: float, f: float) -> tuple[float, float, float]:
    """Eigenvector of the least eigenvalue of [[a, d, e], [d, b, f], [e, f, c]], unit; zeros where there is none."""
    mean = (a + b + c) / 3.0
    p = np.sqrt(((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if p < 1e-15:
        return 0.0, 0.0, 0.0
    u, v, w = (a - mean) / p, (b - mean) / p, (c - mean) / p
    x, y, z = d / p, e / p, f / p
    half = 0.5 * (u * (v * w - z * z) - x * (x * w - z * y) + y * (x * z - v * y))
    least = mean + 2.0 * p * np.cos(np.arccos(min(1.0, max(-1.0, half))) / 3.0 + 2.0943951023931953)
    i, j, k = a - least, b - least, c - least
    best, nx, ny, nz = 0.0, 0.0, 0.0, 0.0
    for s in range(3):  # two rows of the matrix less the eigenvalue span what is perpendicular to it
        if s == 0:
            gx, gy, gz = d * f - e * j, e * d - i * f, i * j - d * d
        elif s == 1:
            gx, gy, gz = d * k - e * f, e * e - i * k, i * f - d * e
        else:
            gx, gy, gz = j * k - f * f, f * e - d * k, d * f - j * e
        size = gx * gx + gy * gy + gz * gz
        if size > best:
            best, nx, ny, nz = size, gx, gy, gz
    if best < 1e-40:
        return 0.0, 0.0, 0.0
    scale = 1.0 / np.sqrt(best)
    return nx * scale, ny * scale, nz * scale


def _fill_normals(points: Any, noise: Any, pixel_m: Any, window_m: float, window_sigmas: float, gate_sigmas: float, normals: Any) -> None:
    """The normal of the points around each pixel that lie about as deep, toward the camera."""
    height, width = noise.shape
    for v in range(height):
        for u in range(width):
            z = points[v, u, 2]
            if z <= 0.0:
                continue
            reach = int(min(max(window_m, window_sigmas * noise[v, u]) / pixel_m[v, u], _WINDOW_PX))
            reach = max(reach, 2)
            step = max(1, reach // _STEPS)
            gate = gate_sigmas * noise[v, u] + 2.0 * pixel_m[v, u]
            n, sx, sy, sz, xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(-reach, reach + 1, step):
                if v + i < 0 or v + i >= height:
                    continue
                for j in range(-reach, reach + 1, step):
                    if u + j < 0 or u + j >= width:
                        continue
                    d = points[v + i, u + j, 2]
                    if d <= 0.0 or abs(d - z) > gate:
                        continue
                    x, y, q = points[v + i, u + j, 0] - points[v, u, 0], points[v + i, u + j, 1] - points[v, u, 1], d - z
                    n += 1.0
                    sx, sy, sz = sx + x, sy + y, sz + q
                    xx, yy, zz, xy, xz, yz = xx + x * x, yy + y * y, zz + q * q, xy + x * y, xz + x * q, yz + y * q
            if n < _LEAST_NEIGHBORS:
                continue
            a, b, c = sx / n, sy / n, sz / n
            nx, ny, nz = _least_direction(xx / n - a * a, yy / n - b * b, zz / n - c * c, xy / n - a * b, xz / n - a * c, yz / n - b * c)
            if nx * points[v, u, 0] + ny * points[v, u, 1] + nz * z > 0.0:
                nx, ny, nz = -nx, -ny, -nz
            normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = nx, ny, nz
