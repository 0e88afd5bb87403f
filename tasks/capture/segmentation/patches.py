"""Small patches of one surface: what is compared in place of pixels, whose normals are noise.

After supervoxels (Papon et al., "Voxel Cloud Connectivity Segmentation", CVPR 2013), on the image instead of a grid of voxels.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.segmentation.organized import OrganizedFrame
from tasks.kernels import Kernels, compile_kernels
from tasks.settings import Config, Count, NonNegative, Positive

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]

_GROWTH = 1.5
"""Between the sizes of patches: those of a depth have one size."""


@dataclasses.dataclass(frozen=True)
class SurfacePatchConfig(Config):
    """How pixels become patches."""

    side_m: Positive = 0.02  # of a patch: 1.2 or 4 cm cost some percent of the objects
    side_sigmas: Positive = 8.0  # or so many times the noise: the mean normal of less is off by more than ten degrees
    side_px: Positive = 4.0  # or so many pixels: fewer are edge alone
    normal_weight: NonNegative = 1.0  # of the difference of unit normals, against distance in sides
    color_weight: NonNegative = 0.7  # of the difference of colors from 0 to 1, likewise: a little
    rounds: Count = 5  # of moving borders: after that few pixels move
    step_sigmas: Positive = 6.0  # a step in depth of more than so many times the noise ...
    step_px: Positive = 2.0  # ... and so many pixels' size, a slant of 63 degrees, is the edge of a surface
    least_px: Count = 8  # smaller patches become a part of a neighbor

    def step(self, frame: OrganizedFrame) -> Array:
        """Steps in depth [m] up to which neighbors are of one surface, shape (h, w)."""
        return np.asarray(self.step_sigmas * frame.noise + self.step_px * frame.pixel_m)


@dataclasses.dataclass(frozen=True)
class SurfacePatches:
    """label: Patch of each pixel from 0, -1 for none, shape (h, w). points: Their middles [m], shape (n, 3). normals: Mean, unit, shape
    (n, 3). sizes: Pixels, shape (n,)."""

    label: Indices
    points: Array
    normals: Array
    sizes: Indices


def patches_of(frame: OrganizedFrame, free: Bools, config: SurfacePatchConfig) -> SurfacePatches:
    """The pixels in `free` that have a normal, shape (h, w), as patches."""
    kernels = _compiled()
    free = free & frame.has_normal
    step = config.step(frame)
    side = np.maximum(np.maximum(config.side_m, config.side_sigmas * frame.noise), config.side_px * frame.pixel_m)
    label = _cells(frame, free, side)
    color = frame.color.astype(np.float64) / 255.0
    for _ in range(config.rounds):
        middles = _means(label, frame.points, frame.normals, color)
        label = kernels["_moved_borders"](
            label, frame.points, frame.normals, color, side, step, *middles[:3], config.normal_weight, config.color_weight
        )
    label = kernels["_connected"](label, np.ascontiguousarray(frame.points[..., 2]), step)
    label = _without_specks(label, frame, step, config.least_px)
    points, normals, _, sizes = _means(label, frame.points, frame.normals, color)
    return SurfacePatches(label, points, normals, sizes)


def _cells(frame: OrganizedFrame, free: Bools, side: Array) -> Indices:
    """Pixels by cells of their size and the axis that their normals are nearest to: patches to begin with."""
    label = np.full(free.shape, -1, dtype=np.int64)
    if not free.any():
        return label
    points, normals = frame.points[free], frame.normals[free]
    level = np.round(np.log(side[free] / side[free].min()) / np.log(_GROWTH)).astype(np.int64)
    cell = np.floor(points / (side[free].min() * _GROWTH**level)[:, None]).astype(np.int64)
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (normals[np.arange(len(normals)), axis] > 0)
    key = np.column_stack([level, facing, cell])
    key -= key.min(axis=0)
    spans = key.max(axis=0) + 1
    flat = np.ravel_multi_index(tuple(key.T), tuple(int(span) for span in spans))
    label[free] = np.unique(flat, return_inverse=True)[1]
    return label


def _means(label: Indices, points: Array, normals: Array, color: Array) -> tuple[Array, Array, Array, Indices]:
    """Middles, unit mean normals and colors of patches, and their sizes."""
    member = label >= 0
    own, count = label[member], int(label.max(initial=-1)) + 1
    sizes = np.bincount(own, minlength=count)

    def mean(values: Array) -> Array:
        sums = [np.bincount(own, values[..., i][member], count) for i in range(3)]
        return np.asarray(np.stack(sums, axis=1) / np.maximum(sizes, 1)[:, None])

    direction = mean(normals)
    length = np.linalg.norm(direction, axis=1)
    return mean(points), direction / np.maximum(length, 1e-12)[:, None], mean(color), sizes


def _without_specks(label: Indices, frame: OrganizedFrame, step: Array, least: int) -> Indices:
    """SurfacePatches of enough pixels, numbered anew; what is of smaller ones goes to the neighbor whose normal is most like its own."""
    sizes = np.bincount(label[label >= 0], minlength=1)
    kept = sizes >= least
    numbers = np.where(kept, np.cumsum(kept) - 1, -1)
    open_ = (label >= 0) & ~np.where(label >= 0, kept[label], False)
    label = np.where(label >= 0, numbers[label], -1)
    return np.asarray(_compiled()["_grown"](label, open_, frame.points[..., 2].copy(), frame.normals, step))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_moved_borders, _connected, _grown)


def _moved_borders(
    label: Any, points: Any, normals: Any, color: Any, side: Any, step: Any, middles: Any, directions: Any, paints: Any,
    normal_weight: float, color_weight: float,
) -> Any:  # fmt: skip
    """Each pixel of the patch, its own or a neighbor's, that it is most like."""
    height, width = label.shape
    moved = label.copy()
    for v in range(height):
        for u in range(width):
            own = label[v, u]
            if own < 0:
                continue
            best, choice = -1.0, own
            for s in range(5):
                i = v + (s == 1) - (s == 2)
                j = u + (s == 3) - (s == 4)
                if i < 0 or j < 0 or i >= height or j >= width:
                    continue
                other = label[i, j]
                if other < 0 or (s > 0 and (other == own or abs(points[i, j, 2] - points[v, u, 2]) > step[v, u])):
                    continue
                off = 0.0
                for k in range(3):
                    x = (points[v, u, k] - middles[other, k]) / side[v, u]
                    n = normals[v, u, k] - directions[other, k]
                    c = color[v, u, k] - paints[other, k]
                    off += x * x + normal_weight * n * n + color_weight * c * c
                if best < 0.0 or off < best:
                    best, choice = off, other
            moved[v, u] = choice
    return moved


def _connected(label: Any, depth: Any, step: Any) -> Any:
    """Parts of labels that hang together in the image without a step in depth, numbered in the order of their first pixels."""
    height, width = label.shape
    part = np.full((height, width), -1, np.int64)
    stack = np.empty(height * width, np.int64)
    count = 0
    for start in range(height * width):
        v, u = start // width, start % width
        if label[v, u] < 0 or part[v, u] >= 0:
            continue
        part[v, u] = count
        stack[0] = start
        top = 1
        while top:
            top -= 1
            i, j = stack[top] // width, stack[top] % width
            for s in range(4):
                k = i + (s == 0) - (s == 1)
                m = j + (s == 2) - (s == 3)
                if k < 0 or m < 0 or k >= height or m >= width or part[k, m] >= 0 or label[k, m] != label[i, j]:
                    continue
                if abs(depth[k, m] - depth[i, j]) <= max(step[i, j], step[k, m]):
                    part[k, m] = count
                    stack[top] = k * width + m
                    top += 1
        count += 1
    return part


def _grown(label: Any, open_: Any, depth: Any, normals: Any, step: Any) -> Any:
    """Labels grown over open pixels, along surfaces, layer by layer, each pixel to the neighbor with the normal nearest to its own."""
    height, width = label.shape
    grown = label.copy()
    changed = True
    while changed:
        changed = False
        before = grown.copy()
        for v in range(height):
            for u in range(width):
                if not open_[v, u] or before[v, u] >= 0:
                    continue
                best = -2.0
                for s in range(4):
                    i = v + (s == 0) - (s == 1)
                    j = u + (s == 2) - (s == 3)
                    if i < 0 or j < 0 or i >= height or j >= width or before[i, j] < 0:
                        continue
                    if abs(depth[i, j] - depth[v, u]) > max(step[i, j], step[v, u]):
                        continue
                    alike = 0.0
                    for k in range(3):
                        alike += normals[v, u, k] * normals[i, j, k]
                    if alike > best:
                        best = alike
                        grown[v, u] = before[i, j]
                        changed = True
    return grown
