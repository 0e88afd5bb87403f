"""A frame's pixels over a board as patches of one surface and color, and patches as objects: by what holds them up, and how they meet.

Two patches that meet in a convex edge and have one color are one object, as the top and a side of a box; a patch that does not reach the
board is a part of what carries it. Source of the rule of convexity: Stein et al., "Object Partitioning using Local Convexity", CVPR 2014.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.small_objects import surfaces
from tasks.settings import Config, Count, Positive, Share

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]


_SAME_PAINT = 0.6
"""Of the difference that makes two paints: what is as like as this is one."""


@dataclasses.dataclass(frozen=True)
class PatchConfig(Config):
    """What parts pixels, and what joins patches."""

    gap_m: Positive = 0.015  # neighbors farther from each other in space are on two surfaces: what a sensor blurs at 1 m
    gap_pixels: Positive = 5.0  # or so many times a pixel's size there: a surface that is seen at 12 degrees
    crease: Positive = 0.5  # of the difference of normals along their connection: hollows of 30 degrees and more
    reach_px: Count = 2  # between the normals that are compared: noise of depth tilts nearer ones by 10 degrees
    chroma: Positive = 0.14  # log ratio of channels: paint of another hue, twice what noise and light do
    luma: Positive = 0.45  # log ratio of brightness: light alone makes a side of a box a third darker than its top
    least_pixels: Count = 12  # smaller patches are noise of depth along edges
    least_contact: Count = 3  # pixels of a border, fewer are chance
    hollow_share: Share = 0.5  # of a border in a hollow: the two do not belong together
    inside_share: Share = 0.7  # of a patch's plan within that of another one: the inside of a mug
    plan_gap_m: Positive = 0.025  # in plan, between parts of one object that touch nowhere in the image
    object_pixels: Count = 30  # 5 cm at 3 m, at 320 px of width


@dataclasses.dataclass(frozen=True)
class BoardPixels:
    """Pixels of a frame over one board.

    points: In the board's frame [m], z over its surface, shape (h, w, 3). toward: From each point to the camera, unit, shape (h, w, 3).
    stands: Pixels of what stands on the board, shape (h, w). is_board: Pixels of its surface, shape (h, w). color: RGB, shape (h, w, 3).
    pixel_m: Size of a pixel at each point [m], shape (h, w).
    """

    points: Array
    toward: Array
    stands: Bools
    is_board: Bools
    color: NDArray[np.uint8]
    pixel_m: Array


@dataclasses.dataclass(frozen=True)
class _Border:
    """Pairs of patches that touch: first < second, number of pixel pairs, share of them in a hollow; each of shape (n,)."""

    first: Indices
    second: Indices
    length: Array
    hollow: Array


def objects_of(pixels: BoardPixels, config: PatchConfig) -> Indices:
    """Object of each pixel, shape (h, w), -1 for none."""
    steps = surfaces.steps(pixels.points, pixels.stands | pixels.is_board, pixels.pixel_m, config.gap_m, config.gap_pixels)
    smooth = surfaces.smoothed(surfaces.smoothed(pixels.points, *steps), *steps)
    hollow = surfaces.hollows(smooth, pixels.toward, pixels.stands, *steps, config.reach_px, config.crease)
    tint = _tints(pixels)
    patch = _patches(pixels.stands, hollow, tint, steps, config)
    count = int(patch.max(initial=-1)) + 1
    if not count:
        return patch
    group = _grouped(pixels, patch, count, hollow, tint, steps, config)
    return _sizable(np.where(patch >= 0, group[patch], -1), config.object_pixels)


def _pair(axis: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of an image that give pixels and their neighbors along an axis."""
    near, far, full = slice(None, -1), slice(1, None), slice(None)
    return ((near, full), (far, full)) if axis == 0 else ((full, near), (full, far))


def _tints(pixels: BoardPixels) -> Array:
    """Brightness and two ratios of channels, logarithmic, of colors averaged over 3 x 3 pixels; shape (h, w, 3)."""
    from scipy.ndimage import uniform_filter

    weight = np.maximum(uniform_filter(pixels.stands.astype(np.float64), 3), 1e-9)
    color = np.where(pixels.stands[..., None], pixels.color.astype(np.float64), 0)
    mean = np.stack([uniform_filter(color[..., i], 3) / weight for i in range(3)], axis=-1)
    return tints_of(mean)


def tints_of(color: NDArray[np.floating | np.uint8]) -> Array:
    """Brightness and two ratios of channels, logarithmic, of colors RGB 0 to 255; shapes (..., 3)."""
    logs = np.log(np.maximum(color, 0) + 12.0)  # of dark paint, noise is all there is to see
    return np.stack([logs.mean(axis=-1), logs[..., 0] - logs[..., 1], logs[..., 2] - logs[..., 1]], axis=-1)


def other_color(first: Array, second: Array, config: PatchConfig, slack: float = 1.0) -> Bools:
    """Where two tints, shapes (..., 3), are two paints."""
    step = np.abs(first - second)
    return np.asarray((step[..., 0] > slack * config.luma) | (np.maximum(step[..., 1], step[..., 2]) > slack * config.chroma))


def _patches(stands: Bools, hollow: Bools, tint: Array, steps: tuple[Bools, Bools], config: PatchConfig) -> Indices:
    """Patch of each pixel that stands, shape (h, w), -1 for others: of one surface, one color, no hollow within."""
    component = surfaces.connected(stands & ~hollow, tint, *steps, 0.5 * config.luma, 0.5 * config.chroma)
    return surfaces.grown(_sizable(component, config.least_pixels), stands, *steps)


def _sizable(label: Indices, least: int) -> Indices:
    """Labels of an image, numbered from 0, without those of too few pixels; -1 is none."""
    kept = np.bincount(label.ravel() + 1, minlength=1) >= max(least, 1)
    kept[0] = False
    return np.asarray(np.where(kept, np.cumsum(kept) - 1, -1)[label + 1], dtype=np.int64)


def _borders(patch: Indices, hollow: Bools, steps: tuple[Bools, Bools], config: PatchConfig) -> _Border:
    """Where patches touch."""
    from scipy.ndimage import binary_dilation

    near_hollow = binary_dilation(hollow)
    rows = []
    for axis, step in enumerate(steps):
        here, there = _pair(axis)
        touch = step & (patch[here] >= 0) & (patch[there] >= 0) & (patch[here] != patch[there])
        a, b = patch[here][touch], patch[there][touch]
        rows.append(np.stack([np.minimum(a, b), np.maximum(a, b), (near_hollow[here] | near_hollow[there])[touch]], axis=1))
    table = np.concatenate(rows)
    pairs, inverse = _pairs(table[:, 0], table[:, 1])
    length = np.bincount(inverse, minlength=len(pairs)).astype(np.float64)
    hollows = np.bincount(inverse, table[:, 2], len(pairs)) / np.maximum(length, 1)
    kept = length >= config.least_contact
    return _Border(pairs[kept, 0], pairs[kept, 1], length[kept], hollows[kept])


def _pairs(first: Indices, second: Indices) -> tuple[Indices, Indices]:
    """Different pairs of numbers from 0, sorted, shape (n, 2), and which of them each pair is, shape (k,)."""
    base = int(second.max(initial=0)) + 1
    keys, inverse = np.unique(first * base + second, return_inverse=True)
    return np.stack(np.divmod(keys, base), axis=1), inverse


def _grounded(pixels: BoardPixels, patch: Indices, count: int, steps: tuple[Bools, Bools], config: PatchConfig) -> Bools:
    """Patches that meet the board, shape (count,)."""
    contact = np.zeros(count)
    for axis, step in enumerate(steps):
        here, there = _pair(axis)
        for target, source in ((here, there), (there, here)):
            meets = step & (patch[target] >= 0) & pixels.is_board[source]
            contact += np.bincount(patch[target][meets], minlength=count)
    return np.asarray(contact >= config.least_contact)


def _grouped(
    pixels: BoardPixels, patch: Indices, count: int, hollow: Bools, tint: Array, steps: tuple[Bools, Bools], config: PatchConfig
) -> Indices:
    """Object of each patch, shape (count,)."""
    border = _borders(patch, hollow, steps, config)
    grounded = _grounded(pixels, patch, count, steps, config)
    member = patch >= 0
    sizes = np.bincount(patch[member], minlength=count).astype(np.float64)
    totals = [np.bincount(patch[member], tint[..., i][member], count) for i in range(3)]
    tints: Array = np.stack(totals, axis=1) / np.maximum(sizes, 1.0)[:, None]
    group = np.arange(count)
    first, second = tints[border.first], tints[border.second]
    # a hollow between parts of one paint is a limb more often than another object
    alike = ~other_color(first, second, config, _SAME_PAINT)
    alike |= ~other_color(first, second, config) & (border.hollow < config.hollow_share)
    for a, b in zip(border.first[alike], border.second[alike], strict=True):
        _unite(group, grounded, int(a), int(b))
    _carry(group, grounded, border)
    plans = _plans(pixels.points, patch, count, config)
    _enclose(group, grounded, plans, config)
    _bridge(group, grounded, plans, config)
    return group


def _unite(group: Indices, grounded: Bools, a: int, b: int) -> None:
    """Make the groups of two patches one, in place; it stands on the board when one of them does."""
    low, high = sorted((int(group[a]), int(group[b])))
    if low != high:
        group[group == high] = low
        grounded[low] |= grounded[high]


def _carry(group: Indices, grounded: Bools, border: _Border) -> None:
    """Join groups that do not reach the board to what they touch most, in place: what is not in a hollow counts twice."""
    weight = border.length * (2 - border.hollow)
    while True:
        a, b = group[border.first], group[border.second]
        loose = (a != b) & ~(grounded[a] & grounded[b])
        if not loose.any():
            return
        low, high = np.minimum(a, b)[loose], np.maximum(a, b)[loose]
        pairs, inverse = _pairs(low, high)
        total = np.bincount(inverse, weight[loose])
        best = int(np.lexsort((pairs[:, 1], pairs[:, 0], -total))[0])
        _unite(group, grounded, int(pairs[best, 0]), int(pairs[best, 1]))


def _plans(points: Array, patch: Indices, count: int, config: PatchConfig) -> list[Array]:
    """Points of each patch in plan [m], one per cell, shapes (n, 2)."""
    order = np.argsort(patch, axis=None, kind="stable")
    label = patch.ravel()[order]
    start = np.searchsorted(label, np.arange(count + 1))
    flat = points.reshape(-1, 3)[order]
    cell = 0.5 * config.plan_gap_m
    plans = []
    for index in range(count):
        own = flat[start[index] : start[index + 1], :2]
        cells = np.floor(own / cell).astype(np.int64)
        cells -= cells.min(axis=0, initial=0)
        plans.append(own[np.unique(cells[:, 0] * (cells[:, 1].max(initial=0) + 1) + cells[:, 1], return_index=True)[1]])
    return plans


def _groups(group: Indices, plans: list[Array]) -> dict[int, Array]:
    """Plans of groups by their numbers."""
    return {int(root): np.concatenate([plans[i] for i in np.flatnonzero(group == root)]) for root in np.unique(group)}


def _enclose(group: Indices, grounded: Bools, plans: list[Array], config: PatchConfig) -> None:
    """Join groups whose plan lies within that of another one, in place: the inside of a mug, the keys of a keyboard."""
    outlines = {root: _outline(plan) for root, plan in _groups(group, plans).items()}
    for small in sorted(outlines, key=lambda root: (len(outlines[root][1]), root)):
        for large in sorted(outlines, key=lambda root: (-len(outlines[root][1]), root)):
            if small == large or group[small] == group[large] or len(outlines[small][1]) >= len(outlines[large][1]):
                continue
            if _inside(outlines[small][1], outlines[large][0]).mean() >= config.inside_share:
                _unite(group, grounded, small, large)
                break


def _outline(plan: Array) -> tuple[Array, Array]:
    """The hull of points in plan as lines a x + b y + c <= 0, shape (k, 3), and the points."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(ConvexHull(plan).equations), plan
    except (QhullError, ValueError):
        return np.array([[0.0, 0.0, 1.0]]), plan  # nothing lies inside of a line


def _inside(plan: Array, lines: Array) -> Bools:
    return np.asarray((plan @ lines[:, :2].T + lines[:, 2] <= 1e-9).all(axis=1))


def _bridge(group: Indices, grounded: Bools, plans: list[Array], config: PatchConfig) -> None:
    """Join groups that neither reach the board nor touch anything to what is right below them, in place: a shade on a thin stem."""
    from scipy.spatial import cKDTree

    for root, plan in _groups(group, plans).items():
        if grounded[root] or group[root] != root:
            continue
        near = []
        for other, below in _groups(group, plans).items():
            if other != group[root]:
                distance = float(cKDTree(below).query(plan)[0].min())
                if distance <= config.plan_gap_m:
                    near.append((distance, other))
        if near:
            _unite(group, grounded, root, min(near)[1])


def hull_overlap(first: Array, second: Array) -> float:
    """Share of the smaller one of two hulls of points in plan, shapes (n, 2) and (m, 2), that lies in the other; 0 for lines."""
    from shapely.geometry import MultiPoint

    a, b = (MultiPoint(points).convex_hull for points in (first, second))
    least = min(a.area, b.area)
    return float(a.intersection(b).area / least) if least > 0 else 0.0
