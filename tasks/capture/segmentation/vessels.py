"""What regions of an image are a part of: scraps of what they touch, and insides of vessels of their outsides."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.segmentation.convexity import contacts_of
from tasks.capture.segmentation.organized import OrganizedFrame
from tasks.settings import Config, Count, NonNegative, Positive, Share

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_HIGH = 98
"""Percentile of heights that stands for the highest: stray pixels are above."""


@dataclasses.dataclass(frozen=True)
class VesselConfig(Config):
    """When a region is a part of another one."""

    scrap_m2: Positive = 20e-4  # seen head on; what is smaller and touches another is a part of it: rims, knobs, necks of bottles
    bridge_px: Count = 3  # across which two regions are neighbors: edges lose their depth
    outline_share: Share = 0.4  # of a region's outline along another one: it is that one's inside
    rim_share: Share = 0.15  # or so much of it, where one of the two is hollow and both are as high: they share a rim
    hollow: NonNegative = 0.08  # mean turn of normals towards the middle, over 1: the walls of a box that is seen from above
    above_sigmas: NonNegative = 2.0  # of depth noise: an inside is no higher over the support than its rim ...
    above_m: NonNegative = 0.005  # ... which may be a little askew
    times: Positive = 2.0  # the outside: an inside is not larger
    bulge: NonNegative = 0.1  # mean turn of normals away from the middle, over 1: what bulges lies in a vessel and is no inside


def without_parts(
    region: Indices, background: Indices, frame: OrganizedFrame, step: Array, heights: Array | None, config: VesselConfig
) -> Indices:
    """Regions from 0, -1 for none, shape (h, w), after parts have joined their wholes.

    background: What else is in the image, from 0, -1 for none, shape (h, w). heights: Over the support [m], shape (h, w); None where there
    is no support, and then nothing is a vessel.
    """
    region = _with_scraps(region, frame, step, config)
    if heights is None:
        return region
    count = int(region.max(initial=-1)) + 1
    seen, place = bridged(np.where(background >= 0, count + background, region), config.bridge_px)
    return _with_insides(region, seen, frame, heights, heights[place[0], place[1]], config)


def bridged(label: Indices, reach: int) -> tuple[Indices, Indices]:
    """Labels of an image from 0, shape (h, w), with pixels of -1 given to the nearest label within so many pixels: edges lose their
    depth; and row and column of the pixel that each is given by, shape (2, h, w)."""
    from scipy.ndimage import distance_transform_edt

    distance, place = distance_transform_edt(label < 0, return_indices=True)
    return np.asarray(np.where(distance <= reach, label[place[0], place[1]], label)), np.asarray(place)


def _with_scraps(region: Indices, frame: OrganizedFrame, step: Array, config: VesselConfig) -> Indices:
    """Small regions joined to those that they touch most, the smallest first."""
    count = int(region.max(initial=-1)) + 1
    contacts = contacts_of(region, np.ascontiguousarray(frame.points[..., 2]), step, 1)
    touch = np.zeros((count, count), dtype=np.int64)
    touch[contacts.first, contacts.second] = contacts.passing
    touch += touch.T
    sizes = np.bincount(region[region >= 0], weights=frame.pixel_m[region >= 0] ** 2, minlength=count)
    owner = np.arange(count)
    for small in np.lexsort((np.arange(count), sizes)):
        if sizes[small] >= config.scrap_m2 or owner[small] != small or not touch[small].any():
            continue
        target = int(touch[small].argmax())
        owner[owner == small] = target
        sizes[target] += sizes[small]
        touch[target] += touch[small]
        touch[:, target] += touch[:, small]
        touch[small], touch[:, small] = 0, 0
        touch[target, target] = 0
    return _renumbered(region, owner)


def _with_insides(
    region: Indices, seen: Indices, frame: OrganizedFrame, heights: Array, nearest: Array, config: VesselConfig
) -> Indices:  # fmt: skip
    """Hollow regions and what has their rim as one, the smallest first.

    seen: Regions, and what else is in the image as numbers above them, without gaps, shape (h, w). nearest: Heights of the pixels that
    these are of [m], shape (h, w).
    """
    count = int(region.max(initial=-1)) + 1
    labels = int(seen.max(initial=-1)) + 1
    table = outlines(seen, labels)
    table, total = table[:count, :count], table[:count].sum(axis=1)
    rise = rises(seen, nearest, labels)[:count, :count]
    order = np.argsort(region, axis=None, kind="stable")
    members = np.split(order, np.searchsorted(region.ravel()[order], np.arange(count + 1)))[1:-1]
    owner = np.arange(count)
    shapes = [_Shape.of(own, frame, heights) for own in members]
    queue = sorted(range(count), key=lambda index: (len(members[index]), index))
    while queue:
        small = queue.pop(0)
        whole = _whole(small, table, rise, total, shapes, config)
        if whole is None:
            continue
        owner[owner == small] = whole
        members[whole] = np.concatenate([members[whole], members[small]])
        shapes[whole] = _Shape.of(members[whole], frame, heights)
        total[whole] += total[small] - 2 * table[small, whole]
        table[whole] += table[small]
        table[:, whole] += table[:, small]
        rise[whole] += rise[small]
        rise[:, whole] += rise[:, small]
        table[small], table[:, small], total[small] = 0, 0, 0
        table[whole, whole] = 0
        queue = sorted({index for index in queue if index != whole} | {whole}, key=lambda index: (len(members[index]), index))
    return _renumbered(region, owner)


def _whole(small: int, table: Indices, rise: Array, total: Indices, shapes: list[_Shape], config: VesselConfig) -> int | None:
    """The region that a smaller one is the inside or the outside of; None where there is none."""
    if not total[small] or not table[small].any():
        return None
    shape = shapes[small]
    for whole in np.lexsort((np.arange(len(total)), -table[small]))[:3]:
        other = shapes[whole]
        share = table[small, whole] / total[small]
        if whole == small or share < config.rim_share:
            continue
        slack = config.above_sigmas * max(shape.noise, other.noise) + config.above_m
        # what lies in a vessel stands out of it all around; its bottom lies below what is around it
        is_inside = shape.bulge <= config.bulge and shape.top <= other.top + slack and rise[small, whole] > 0
        is_inside &= shape.pixels <= config.times * other.pixels
        has_rim = min(shape.bulge, other.bulge) <= -config.hollow and abs(shape.top - other.top) <= slack
        if has_rim or (is_inside and share >= config.outline_share):
            return int(whole)
    return None


@dataclasses.dataclass(frozen=True)
class _Shape:
    """Of a region: pixels, height of its top over the support [m], depth noise [m], and `bulge`."""

    pixels: int
    top: float
    noise: float
    bulge: float

    @staticmethod
    def of(own: Indices, frame: OrganizedFrame, heights: Array) -> _Shape:
        """Of pixels by their places in the image."""
        points, normals = frame.points.reshape(-1, 3)[own], frame.normals.reshape(-1, 3)[own]
        top, noise = float(np.percentile(heights.ravel()[own], _HIGH)), float(np.median(frame.noise.ravel()[own]))
        return _Shape(len(own), top, noise, bulge(points, normals))


def bulge(points: Array, normals: Array) -> float:
    """How far normals turn away from the middle of their points, both of shape (n, 3), -1 to 1: above 0 for a ball, 0 for a plane, below
    it for the inside of a bowl."""
    off = points - points.mean(axis=0)
    direction = normals.mean(axis=0)
    direction /= max(float(np.linalg.norm(direction)), 1e-12)
    flat = off - (off @ direction)[:, None] * direction  # along the surface alone: depth itself says nothing of its turn
    length = np.linalg.norm(flat, axis=1)
    far = length > 0.25 * length.max(initial=0.0)
    return float(((normals * flat).sum(axis=1)[far] / np.maximum(length[far], 1e-12)).mean()) if far.any() else 0.0


def rises(label: Indices, heights: Array, count: int) -> Array:
    """Sum over pairs of neighboring pixels of two labels, from the first one's to the second one's, of the step in height [m], shape
    (count, count): above 0 where the second one is higher."""
    table = np.zeros((count + 1, count + 1))
    whole, first, last = slice(None), slice(None, -1), slice(1, None)
    for here, there in (((first, whole), (last, whole)), ((whole, first), (whole, last))):
        differ = label[here] != label[there]
        a, b, step = label[here][differ], label[there][differ], (heights[there] - heights[here])[differ]
        np.add.at(table, (a, b), step)
        np.add.at(table, (b, a), -step)
    return table[:count, :count]


def outlines(region: Indices, count: int) -> Indices:
    """Pairs of neighboring pixels of two regions, shape (count, count + 1); the last column counts those of none."""
    table = np.zeros((count + 1, count + 1), dtype=np.int64)
    for here, there in ((region[:-1], region[1:]), (region[:, :-1], region[:, 1:])):
        differ = here != there
        a, b = here[differ], there[differ]
        np.add.at(table, (a, b), 1)
        np.add.at(table, (b, a), 1)
    return table[:count]


def _renumbered(region: Indices, owner: Indices) -> Indices:
    """Regions under the numbers of their owners, without gaps."""
    numbers = np.unique(owner, return_inverse=True)[1]
    return np.asarray(np.where(region >= 0, numbers[region], -1)) if len(owner) else region
