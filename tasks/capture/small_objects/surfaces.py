"""Surfaces in a frame, pixel by pixel: which neighbors lie on one, how they are turned, where they are hollow, what is connected.

Machine code, to the bit what NumPy gives: sums of three go from the first to the last.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]


def steps(points: Array, valid: Bools, pixel_m: Array, gap_m: float, gap_pixels: float) -> tuple[Bools, Bools]:
    """Pairs of valid neighbors along either axis that lie on one surface, shapes (h - 1, w) and (h, w - 1): no farther from each other than
    `gap_m`, or `gap_pixels` sizes of a pixel there. points: [m], shape (h, w, 3). valid: shape (h, w). pixel_m: [m], shape (h, w)."""
    down, right = _compiled()["_steps"](points, valid, pixel_m, gap_m, gap_pixels)
    return down, right


def smoothed(points: Array, down: Bools, right: Bools) -> Array:
    """Points, shape (h, w, 3), averaged with those neighbors, up to 4, that lie on the same surface. down, right: See `steps`."""
    return np.asarray(_compiled()["_smoothed"](points, down, right))


def hollows(points: Array, toward: Array, stands: Bools, down: Bools, right: Bools, reach: int, crease: float) -> Bools:
    """Pixels where the surface bends away from the eye, shape (h, w): normals `reach` pixels to both sides, each where all neighbors that
    make it lie on one surface, lean towards each other by more than `crease`.

    points: Smooth [m], shape (h, w, 3). toward: From each point to the camera, unit, shape (h, w, 3). stands: Pixels with a normal, shape
    (h, w). down, right: See `steps`. crease: Difference of the normals along their connection.
    """
    return np.asarray(_compiled()["_hollows"](points, toward, stands, down, right, reach, crease))


def connected(smooth: Bools, tint: Array, down: Bools, right: Bools, luma: float, chroma: float) -> Indices:
    """Connected pixels as numbers from 0, in the order of the first pixel of each, shape (h, w); -1 for those that are not `smooth`.

    Neighbors on one surface are connected unless their tints, shape (h, w, 3), differ by more than `luma` in the first channel or by more
    than `chroma` in another. down, right: See `steps`.
    """
    return np.asarray(_compiled()["_connected"](smooth, tint, down, right, luma, chroma))


def grown(patch: Indices, stands: Bools, down: Bools, right: Bools) -> Indices:
    """Patches, shape (h, w), -1 for none, grown over the pixels between them that stand, along surfaces: each pixel to the patch that
    reaches it first, of several at once to that from below, above, the right or the left, in this order. down, right: See `steps`."""
    return np.asarray(_compiled()["_grown"](patch, stands, down, right))


def median_heights(height: Array, inside: Bools) -> Array:
    """The median of 3 x 3 pixels, of those inside alone, shape (h, w); 0 outside."""
    return np.asarray(_compiled()["_median_heights"](height, inside))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_difference, _length, _steps, _smoothed, _normal, _hollows, _root, _connected, _grown, _median_heights)


def _steps(points: Array, valid: Bools, pixel_m: Array, gap_m: float, gap_pixels: float) -> tuple[Bools, Bools]:
    h, w = valid.shape
    down, right = np.zeros((max(h - 1, 0), w), dtype=np.bool_), np.zeros((h, max(w - 1, 0)), dtype=np.bool_)
    for y in range(h):
        for x in range(w):
            if not valid[y, x]:
                continue
            limit = max(gap_m, gap_pixels * pixel_m[y, x])
            if y + 1 < h and valid[y + 1, x]:
                down[y, x] = _length(*_difference(points[y, x], points[y + 1, x])) <= limit
            if x + 1 < w and valid[y, x + 1]:
                right[y, x] = _length(*_difference(points[y, x], points[y, x + 1])) <= limit
    return down, right


def _smoothed(points: Array, down: Bools, right: Bools) -> Array:
    h, w = points.shape[:2]
    means = np.empty_like(points)
    for y in range(h):
        for x in range(w):
            below, above = y + 1 < h and down[y, x], y > 0 and down[y - 1, x]
            after, before = x + 1 < w and right[y, x], x > 0 and right[y, x - 1]
            weight = 1.0 + below + above + after + before
            for k in range(3):
                total = points[y, x, k]
                total += points[y + 1, x, k] if below else 0.0
                total += points[y - 1, x, k] if above else 0.0
                total += points[y, x + 1, k] if after else 0.0
                total += points[y, x - 1, k] if before else 0.0
                means[y, x, k] = total / weight
    return means


def _difference(first: Array, second: Array) -> tuple[float, float, float]:
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


def _length(a: float, b: float, c: float) -> float:
    return np.sqrt((a * a + b * b) + c * c)


def _normal(points: Array, toward: Array, y: int, x: int, normal: Array) -> bool:
    """Put the unit normal of an inner pixel, towards the camera, into `normal`; whether it has one."""
    a, b, c = _difference(points[y + 1, x], points[y - 1, x])
    d, e, f = _difference(points[y, x + 1], points[y, x - 1])
    i, j, k = b * f - c * e, c * d - a * f, a * e - b * d
    length = _length(i, j, k)
    divisor = max(length, 1e-12)
    i, j, k = i / divisor, j / divisor, k / divisor
    sign = -1.0 if (i * toward[y, x, 0] + j * toward[y, x, 1]) + k * toward[y, x, 2] < 0 else 1.0
    normal[0], normal[1], normal[2] = i * sign, j * sign, k * sign
    return length > 0


def _hollows(points: Array, toward: Array, stands: Bools, down: Bools, right: Bools, reach: int, crease: float) -> Bools:
    h, w = stands.shape
    hollow, sure, normals = np.zeros((h, w), dtype=np.bool_), np.zeros((h, w), dtype=np.bool_), np.empty((h, w, 3))
    for y in range(1, h - 1):
        for x in range(1, w - 1):
            if stands[y, x] and down[y - 1, x] and down[y, x] and right[y, x - 1] and right[y, x]:
                sure[y, x] = _normal(points, toward, y, x, normals[y, x])
    for dy, dx in ((2 * reach, 0), (0, 2 * reach)):
        for y in range(h - dy):
            for x in range(w - dx):
                if not (sure[y, x] and sure[y + dy, x + dx]):
                    continue
                a, b, c = _difference(points[y + dy, x + dx], points[y, x])
                d, e, f = _difference(normals[y + dy, x + dx], normals[y, x])
                bend = (d * a + e * b) + f * c
                if bend / max(_length(a, b, c), 1e-9) < -crease:
                    hollow[y + dy // 2, x + dx // 2] = True
    return hollow


def _root(parents: Indices, index: int) -> int:
    while parents[index] != index:
        parents[index] = parents[parents[index]]
        index = parents[index]
    return index


def _connected(smooth: Bools, tint: Array, down: Bools, right: Bools, luma: float, chroma: float) -> Indices:
    h, w = smooth.shape
    parents = np.arange(h * w)
    for y in range(h):
        for x in range(w):
            if not smooth[y, x]:
                continue
            for dy, dx in ((1, 0), (0, 1)):
                v, u = y + dy, x + dx
                if v >= h or u >= w or not smooth[v, u] or not (down[y, x] if dy else right[y, x]):
                    continue
                if abs(tint[y, x, 0] - tint[v, u, 0]) > luma:
                    continue
                if max(abs(tint[y, x, 1] - tint[v, u, 1]), abs(tint[y, x, 2] - tint[v, u, 2])) > chroma:
                    continue
                first, second = _root(parents, y * w + x), _root(parents, v * w + u)
                parents[max(first, second)] = min(first, second)  # so that a root is the first pixel of its patch
    label, count = np.full((h, w), -1, dtype=np.int64), 0
    for y in range(h):
        for x in range(w):
            if smooth[y, x]:
                root = _root(parents, y * w + x)
                if root == y * w + x:
                    label[y, x] = count
                    count += 1
                else:
                    label[y, x] = label[root // w, root % w]
    return label


def _grown(patch: Indices, stands: Bools, down: Bools, right: Bools) -> Indices:
    h, w = patch.shape
    patch, still = patch.copy(), np.empty(h * w, dtype=np.int64)
    count = 0
    for place in range(h * w):
        if stands[place // w, place % w] and patch[place // w, place % w] < 0:
            still[count] = place
            count += 1
    reached = np.empty(count, dtype=np.int64)
    while True:
        for i in range(count):
            y, x = still[i] // w, still[i] % w
            reached[i] = -1
            if y + 1 < h and down[y, x] and patch[y + 1, x] >= 0:
                reached[i] = patch[y + 1, x]
            elif y > 0 and down[y - 1, x] and patch[y - 1, x] >= 0:
                reached[i] = patch[y - 1, x]
            elif x + 1 < w and right[y, x] and patch[y, x + 1] >= 0:
                reached[i] = patch[y, x + 1]
            elif x > 0 and right[y, x - 1] and patch[y, x - 1] >= 0:
                reached[i] = patch[y, x - 1]
        left = 0
        for i in range(count):  # only now: nothing grows two pixels at once
            if reached[i] >= 0:
                patch[still[i] // w, still[i] % w] = reached[i]
            else:
                still[left] = still[i]
                left += 1
        if left == count:
            return patch
        count = left


def _median_heights(height: Array, inside: Bools) -> Array:
    h, w = height.shape
    medians, near = np.zeros((h, w)), np.empty(9)
    for y in range(h):
        for x in range(w):
            if not inside[y, x]:
                continue
            count = 0
            for v in range(max(y - 1, 0), min(y + 2, h)):
                for u in range(max(x - 1, 0), min(x + 2, w)):
                    if inside[v, u]:
                        place = count
                        while place > 0 and near[place - 1] > height[v, u]:
                            near[place] = near[place - 1]
                            place -= 1
                        near[place] = height[v, u]
                        count += 1
            medians[y, x] = (near[(count - 1) // 2] + near[count // 2]) / 2
    return medians
