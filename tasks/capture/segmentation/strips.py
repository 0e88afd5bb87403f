"""Long narrow regions: folds of one curtain, tubes of a chair, and what is flush with a wall."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.segmentation.convexity import contacts_of
from tasks.capture.segmentation.organized import OrganizedFrame
from tasks.capture.segmentation.planes import FramePlane, Plane
from tasks.capture.segmentation.vessels import bridged
from tasks.settings import Config, Positive, Share

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]

_LOW, _HIGH = 2, 98
"""Percentiles that stand for the lowest and the highest: stray pixels are beyond."""


@dataclasses.dataclass(frozen=True)
class StripConfig(Config):
    """What is a fold of a curtain, a tube of furniture, and flush with a wall."""

    flush_m: Positive = 0.06  # skirting boards, frames and sockets stand out of a wall no farther
    flush_share: Share = 0.9  # of a region's pixels so near to a wall
    tall_m: Positive = 0.5  # of a fold that is seen; what is lower may be books, or a chair's legs
    upright: Share = 0.35  # mean of the vertical part of its normals, by noise; a chair's back leans
    narrow_m: Positive = 0.4  # its mean width; doors of wardrobes are wider
    depth_m: Positive = 0.15  # between a fold and the next one
    color: Positive = 50.0  # between their mean colors, 0 to 255: one cloth in light and in shade
    side_share: Share = 0.4  # of the lower one's height along which they touch
    tube_m: Positive = 0.09  # mean width of tubes, slats and legs, which lie before and behind what they carry
    long_m: Positive = 0.4  # and their length: pens and bottles are shorter


@dataclasses.dataclass(frozen=True)
class _Shapes:
    """Of regions. low, high: Heights over the support [m], shape (n,). length: Of the diagonal [m], shape (n,). area: Surface [m2], shape
    (n,). upright: Mean vertical part of unit normals, shape (n,). paint: Mean color, shape (n, 3). pixel_m: Mean size of pixels [m], shape
    (n,)."""

    low: Array
    high: Array
    length: Array
    area: Array
    upright: Array
    paint: Array
    pixel_m: Array

    @classmethod
    def of(cls, region: Indices, count: int, support: Plane, frame: OrganizedFrame) -> _Shapes:
        """Of all regions of a frame."""
        heights = support.heights(frame.points).ravel()
        points, normals = frame.points.reshape(-1, 3), frame.normals.reshape(-1, 3)
        slant = np.abs((normals * points).sum(axis=1)) / np.maximum(np.linalg.norm(points, axis=1), 1e-9)
        areas, colors = frame.pixel_m.ravel() ** 2 / np.maximum(slant, 0.1), frame.color.reshape(-1, 3)
        order = np.argsort(region, axis=None, kind="stable")
        bounds = np.searchsorted(region.ravel()[order], np.arange(count + 1))
        rows = np.zeros((count, 9))
        for number in range(count):
            own = order[bounds[number] : bounds[number + 1]]
            low, high = np.percentile(heights[own], [_LOW, _HIGH])
            length = np.linalg.norm(np.ptp(np.percentile(points[own], [_LOW, _HIGH], axis=0), axis=0))
            upright, pixel_m = np.abs(normals[own] @ support.normal).mean(), frame.pixel_m.ravel()[own].mean()
            rows[number] = (low, high, length, areas[own].sum(), upright, pixel_m, *colors[own].mean(axis=0))
        low, high, length, area, upright, pixel_m = rows[:, :6].T
        return cls(low, high, length, area, upright, rows[:, 6:], pixel_m)


def flush_with(region: Indices, walls: Sequence[FramePlane], frame: OrganizedFrame, config: StripConfig) -> Bools:
    """Pixels of regions that hardly stand out of a wall, shape (h, w): they are a part of it."""
    count = int(region.max(initial=-1)) + 1
    member = region >= 0
    sizes = np.bincount(region[member], minlength=count)
    is_flush = np.zeros(count + 1, dtype=bool)
    for wall in walls:
        near = member & (np.abs(wall.plane.heights(frame.points)) < np.maximum(config.flush_m, frame.noise))
        is_flush[:count] |= np.bincount(region[near], minlength=count) >= config.flush_share * np.maximum(sizes, 1)
    return np.asarray(is_flush[region] & member)


def with_strips(region: Indices, support: Plane, frame: OrganizedFrame, bridge_px: int, config: StripConfig) -> Indices:
    """Regions, numbered anew without gaps, after folds that hang side by side have become one, and tubes a part of what they touch."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = int(region.max(initial=-1)) + 1
    if count < 2:
        return region
    shapes = _Shapes.of(region, count, support, frame)
    a, b, side_m = _sides(region, frame, bridge_px, config.depth_m, shapes.pixel_m)
    height = shapes.high - shapes.low
    is_fold = (height >= config.tall_m) & (shapes.upright <= config.upright) & (shapes.area <= config.narrow_m * height)
    alike = np.linalg.norm(shapes.paint[a] - shapes.paint[b], axis=1) <= config.color
    is_one = is_fold[a] & is_fold[b] & alike & (side_m >= config.side_share * np.minimum(height[a], height[b]))
    is_tube = (shapes.length >= config.long_m) & (shapes.area <= config.tube_m * shapes.length)
    near = np.zeros((count, count))
    near[a, b] = near[b, a] = np.where(side_m > 0, side_m, 0.0)
    near[:, is_tube | is_fold] = 0.0
    tubes = np.flatnonzero(is_tube & near.any(axis=1))
    a, b = np.concatenate([a[is_one], tubes]), np.concatenate([b[is_one], near[tubes].argmax(axis=1)])
    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count))
    owner = connected_components(graph, directed=False)[1]
    return np.asarray(np.where(region >= 0, owner[region], -1), dtype=np.int64)


def _sides(region: Indices, frame: OrganizedFrame, bridge_px: int, step_m: float, pixel_m: Array) -> tuple[Indices, Indices, Array]:
    """Pairs of regions that touch in the image, and the length [m] along which the step in depth is no more than `step_m`; each of shape
    (k,)."""
    whole, place = bridged(region, bridge_px)
    depth = np.ascontiguousarray(frame.points[place[0], place[1], 2])
    contacts = contacts_of(whole, depth, np.full(depth.shape, step_m), 1)
    a, b = contacts.first, contacts.second
    return a, b, np.asarray(contacts.passing * np.minimum(pixel_m[a], pixel_m[b]), dtype=np.float64)
