"""Point clouds as networks take them: points that lie apart first, scaled to radius 1, colors in 0..1."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float32]

POINT_BYTES = 15
"""Of a packed point: place and normal as half precision, color."""


@dataclasses.dataclass(frozen=True)
class ColoredCloud:
    """Points [m], shape (n, 3), of which every first few lie apart, with colors (n, 3) and, of a surface, unit normals (n, 3)."""

    points: Array
    colors: NDArray[np.uint8]
    normals: Array | None = None

    def cut(self, count: int) -> ColoredCloud:
        """Its first points alone."""
        return ColoredCloud(self.points[:count], self.colors[:count], None if self.normals is None else self.normals[:count])


def farthest_order(points: NDArray[np.floating], count: int, start: int | None = None) -> NDArray[np.int64]:
    """Indices of points each farthest from those before it, shape (min(n, count),), from points (n, 3); of equal ones the first.

    `start`: the first; without one the farthest from the middle.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if start is None:
        start = int(np.square(points - points.mean(axis=0)).sum(axis=1).argmax())
    return np.asarray(_compiled()["_farthest"](points, min(count, len(points)), start))


def spread_cloud(
    points: NDArray[np.floating], colors: NDArray[np.uint8], count: int, normals: NDArray[np.floating] | None = None
) -> ColoredCloud:
    """At most `count` of a cloud's points, those that lie apart first."""
    order = farthest_order(points, count)
    kept = None if normals is None else np.ascontiguousarray(normals[order], dtype=np.float32)
    return ColoredCloud(np.ascontiguousarray(points[order], dtype=np.float32), np.ascontiguousarray(colors[order]), kept)


def packed(cloud: ColoredCloud) -> bytes:
    """A cloud with normals in 15 bytes a point; without, in as many."""
    normals = np.zeros_like(cloud.points) if cloud.normals is None else cloud.normals
    return cloud.points.astype("<f2").tobytes() + normals.astype("<f2").tobytes() + cloud.colors.astype(np.uint8).tobytes()


def unpacked(data: bytes) -> ColoredCloud:
    """The cloud of `packed`."""
    count = len(data) // POINT_BYTES
    halves = np.frombuffer(data, dtype="<f2", count=6 * count).astype(np.float32).reshape(2, count, 3)
    return ColoredCloud(halves[0], np.frombuffer(data, dtype=np.uint8, offset=12 * count).reshape(count, 3), halves[1])


def nearest_both(scan: Array, surfaces: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of every point of a scan, (m, 3), the nearest sample of each of k surfaces, (k, n, 3), and of every sample the nearest point:
    indices of shapes (k, m) and (k, n)."""
    kernel = _compiled()["_nearest_both"]
    forth, back = kernel(np.ascontiguousarray(scan, dtype=np.float32), np.ascontiguousarray(surfaces, dtype=np.float32))
    return np.asarray(forth), np.asarray(back)


def filled(values: NDArray, count: int) -> NDArray:
    """The first `count` rows; where there are fewer, again from the first on."""
    return values[np.arange(count) % len(values)]


@cache
def _compiled() -> Kernels:
    return compile_kernels(_farthest, _nearest_both)


def _farthest(points: NDArray[np.float64], count: int, start: int) -> NDArray[np.int64]:
    n, places = points.shape[0], points.T.copy()
    nearest, chosen = np.full(n, np.inf), np.empty(count, dtype=np.int64)
    last = start
    for place in range(count):
        chosen[place] = last
        nearest[last] = -1.0
        x, y, z = places[0, last], places[1, last], places[2, last]
        far, best = -1.0, last
        for i in range(n):
            a, b, c = places[0, i] - x, places[1, i] - y, places[2, i] - z
            nearest[i] = min(nearest[i], a * a + b * b + c * c)  # what was chosen stays below zero
        for i in range(n):
            if nearest[i] > far:
                far, best = nearest[i], i
        last = best
    return chosen


def _nearest_both(scan: Array, surfaces: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    k, n, m = surfaces.shape[0], surfaces.shape[1], scan.shape[0]
    forth, back = np.zeros((k, m), dtype=np.int64), np.zeros((k, n), dtype=np.int64)
    for s in range(k):
        least = np.full(m, np.inf, dtype=np.float32)
        for j in range(n):
            x, y, z = surfaces[s, j, 0], surfaces[s, j, 1], surfaces[s, j, 2]
            best, at = np.float32(np.inf), 0
            for i in range(m):
                a, b, c = scan[i, 0] - x, scan[i, 1] - y, scan[i, 2] - z
                d = a * a + b * b + c * c
                if d < best:
                    best, at = d, i
                if d < least[i]:
                    least[i] = d
                    forth[s, i] = j
            back[s, j] = at
    return forth, back
