"""Instances found in the geometry of a scan that names none: planes of the room first, then what stands on its supports.

No learned model is asked. Categories are guesses from size and place by the rules below, and the raw label says so:
`geometry:table`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import vertex_areas
from tasks.capture.instances.boxes import clumps, oriented_box
from tasks.capture.reading import Group, groups_of
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import vertex_normals

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

PROVIDER = "geometry"

_FLOOR_BAND_M = 0.05
"""Height up to which level surface counts as floor: fused floors are some two centimetres thick, rugs one more."""

_SLIVER_M = 0.07
"""What rises no higher than this is floor whose surface is too rough, or lies too low or high, to count as level."""

_CEILING_M = 1.9
_MIN_CEILING_M2 = 1.0

_WALL_BAND_M = 0.06
_MIN_WALL_M2 = 1.0
_MIN_WALL_SPAN_M = 1.0
_BEHIND_SHARE = 0.04
"""A wall has next to nothing behind it; the front of a cupboard has the wall."""

_OBJECT_GAP_M = 0.04
"""Objects closer than this to each other are one: two voxels of the fused mesh."""

_ITEM_GAP_M = 0.025
_ITEM_CLEARANCE_M = 0.015
"""A support's own surface is about this rough; what rises above it is an item on it."""

_MIN_SUPPORT_M2 = 0.08
_MIN_SUPPORT_HEIGHT_M = 0.2
_ITEM_HEIGHT_M = 0.6
_BACK_SHARE = 0.35
"""What stands on a seat and is at least this share of its length wide is its back or arm, not an item."""

_SEAT_SHARE = 0.5
"""What covers more of a seat than this is its cushion."""

_MIN_POINTS = 40
_MIN_AREA_M2 = 0.008
"""Half the visible surface of a mug; smaller pieces are noise."""


@dataclasses.dataclass(frozen=True)
class _Rule:
    """Sizes [m] that make a guess: length >= width of the box in plan, its height, and the height of its bottom."""

    category: str
    bottom: tuple[float, float]
    height: tuple[float, float]
    length: tuple[float, float]
    width: tuple[float, float]
    top_share: float = 0.0


_RULES = (
    # Standing on the floor. `top_share`: least share of the plan that a level surface in the upper half fills.
    _Rule("bed", (-1, 0.3), (0.3, 0.95), (1.7, 2.6), (1.1, 2.3)),
    _Rule("sofa", (-1, 0.3), (0.6, 1.15), (1.3, 3.2), (0.65, 1.8), 0.0),
    _Rule("coffee table", (-1, 0.3), (0.25, 0.58), (0.6, 1.7), (0.4, 1.2), 0.35),
    _Rule("table", (-1, 0.5), (0.58, 1.1), (0.75, 3.5), (0.5, 2.0), 0.25),
    _Rule("chair", (-1, 0.45), (0.65, 1.3), (0.35, 0.95), (0.25, 0.85)),
    _Rule("stool", (-1, 0.3), (0.35, 0.75), (0.25, 0.6), (0.25, 0.6), 0.3),
    _Rule("nightstand", (-1, 0.3), (0.35, 0.75), (0.3, 0.75), (0.25, 0.6)),
    _Rule("floor lamp", (-1, 0.5), (1.2, 2.1), (0.1, 0.6), (0.1, 0.6)),
    _Rule("wardrobe", (-1, 0.3), (1.6, 2.6), (0.8, 3.0), (0.35, 0.9)),
    _Rule("bookshelf", (-1, 0.4), (1.1, 2.6), (0.5, 3.0), (0.1, 0.6)),
    _Rule("cabinet", (-1, 0.4), (0.5, 2.6), (0.5, 3.5), (0.2, 1.0)),
    _Rule("box", (-1, 0.2), (0.08, 0.5), (0.1, 0.8), (0.05, 0.6)),
    # On a wall or below the ceiling.
    _Rule("picture", (0.7, 2.2), (0.2, 1.5), (0.2, 2.0), (0.0, 0.15)),
    _Rule("lamp", (1.5, 3.0), (0.1, 1.0), (0.1, 1.2), (0.05, 1.2)),
    # On a support.
    _Rule("monitor", (0.5, 1.2), (0.25, 0.7), (0.35, 1.3), (0.0, 0.28)),
    _Rule("book", (0.3, 1.6), (0.0, 0.07), (0.1, 0.4), (0.05, 0.3)),
    _Rule("bottle", (0.3, 1.8), (0.15, 0.4), (0.0, 0.15), (0.0, 0.15)),
    _Rule("cup", (0.3, 1.8), (0.04, 0.15), (0.0, 0.16), (0.0, 0.14)),
    _Rule("vase", (0.3, 1.8), (0.15, 0.6), (0.08, 0.35), (0.08, 0.35)),
    _Rule("box", (0.2, 1.8), (0.04, 0.5), (0.05, 0.7), (0.03, 0.6)),
)
"""Sizes of furniture as shops sell it, with room for parts that no camera saw. The first rule that fits decides."""

RULED = tuple(dict.fromkeys(rule.category for rule in _RULES))
"""Categories that are guessed."""


def geometry_groups(world: Surface) -> tuple[tuple[Group, ...], list[str]]:
    """Instances of an aligned scan (floor at z = 0): floor, walls, ceiling, objects and the items on them; and a note."""
    normals, areas = vertex_normals(world.vertices, world.faces), vertex_areas(world)
    owner = np.full(len(world.vertices), -1, dtype=np.int64)
    groups: list[tuple[str, Indices]] = []

    def take(category: str, members: Indices) -> None:
        owner[members] = len(groups)
        groups.append((category, members))

    z = world.vertices[:, 2]
    level = np.abs(normals[:, 2]) > 0.8
    floor = np.flatnonzero((np.abs(z) < _FLOOR_BAND_M) & level)
    has_floor = areas[floor].sum() > 0.1
    if has_floor:
        take("floor", floor)
    ceiling = np.flatnonzero((z > _CEILING_M) & level)
    if areas[ceiling].sum() > _MIN_CEILING_M2:
        top = np.median(z[ceiling])
        take("ceiling", ceiling[np.abs(z[ceiling] - top) < 0.15])
    for wall in _walls(world.vertices, normals, areas, owner < 0):
        take("wall", wall[owner[wall] < 0])
    # What lies below the floor was seen in a mirror, or is noise.
    rest = np.flatnonzero((owner < 0) & (z > -_FLOOR_BAND_M))
    for members in _clusters(world.vertices, areas, rest, _OBJECT_GAP_M):
        if has_floor and np.percentile(np.abs(z[members]), 95) < _SLIVER_M:
            # Floor that the alignment leaves a little askew at its far end, or that drift has doubled.
            owner[members] = 0
            groups[0] = ("floor", np.concatenate([groups[0][1], members]))
            continue
        support, items = _items(world.vertices, normals, areas, members)
        for part in (support, *items):
            if len(part) >= _MIN_POINTS:
                take(guessed(world.vertices[part], normals[part], areas[part]), part)
    objects = sum(category not in ("floor", "wall", "ceiling") for category, _ in groups)
    rows = [(str(index), f"{PROVIDER}:{category}", np.sort(members)) for index, (category, members) in enumerate(groups)]
    note = f"instances found in the geometry: {objects} objects, categories guessed from their sizes"
    return groups_of(rows, owner, world), [note]


def _walls(points: Array, normals: Array, areas: Array, free: NDArray[np.bool_]) -> list[Indices]:
    """Vertices of each wall: upright planes, in any direction, with the whole scan on one side."""
    upright = free & (np.abs(normals[:, 2]) < 0.25)
    angle = np.arctan2(normals[:, 1], normals[:, 0]) % np.pi
    walls: list[Indices] = []
    left = upright.copy()
    for yaw in _directions(angle[upright], areas[upright]):
        direction = np.array([np.cos(yaw), np.sin(yaw)])
        turned = np.abs((angle - yaw + np.pi / 2) % np.pi - np.pi / 2) < np.deg2rad(15)
        offset = points[:, :2] @ direction
        for position in _planes(offset[left & turned], areas[left & turned]):
            member = np.flatnonzero(left & turned & (np.abs(offset - position) < _WALL_BAND_M))
            span = float(np.ptp(np.percentile(points[member, 2], [2, 98])))
            behind = min(areas[offset > position + 0.15].sum(), areas[offset < position - 0.15].sum()) / areas.sum()
            if span >= _MIN_WALL_SPAN_M and behind < _BEHIND_SHARE:
                # Door and picture frames, skirting: whatever lies flat on the wall is part of it here.
                flat_on = np.flatnonzero(free & (np.abs(offset - position) < 0.6 * _WALL_BAND_M))
                walls.append(np.union1d(member, flat_on))
                left[walls[-1]] = False
                free = free.copy()
                free[walls[-1]] = False
    return walls


def _directions(angle: Array, areas: Array) -> list[float]:
    """Directions [rad], in [0, pi), that upright surfaces face most, strongest first, at least 12 degrees apart."""
    bins = 90
    histogram = np.bincount((angle / np.pi * bins).astype(np.int64) % bins, weights=areas, minlength=bins)
    smooth = histogram + np.roll(histogram, 1) + np.roll(histogram, -1)
    chosen: list[float] = []
    for peak in np.argsort(-smooth, kind="stable"):
        yaw = (int(peak) + 0.5) / bins * np.pi
        if smooth[peak] < _MIN_WALL_M2 or len(chosen) == 6:
            break
        if all(abs((yaw - other + np.pi / 2) % np.pi - np.pi / 2) > np.deg2rad(12) for other in chosen):
            chosen.append(yaw)
    return chosen


def _planes(offset: Array, areas: Array) -> list[float]:
    """Offsets [m] at which much surface lies, largest first."""
    if not len(offset):
        return []
    start = float(offset.min()) - 0.1
    bins = np.floor((offset - start) / 0.02).astype(np.int64)
    smooth = np.convolve(np.bincount(bins, weights=areas, minlength=int(bins.max()) + 6), np.ones(5), mode="same")
    chosen: list[float] = []
    for peak in np.argsort(-smooth, kind="stable"):
        if smooth[peak] < _MIN_WALL_M2:
            break
        position = start + (int(peak) + 0.5) * 0.02
        if all(abs(position - other) > 2 * _WALL_BAND_M for other in chosen):
            chosen.append(position)
    return chosen


def _clusters(points: Array, areas: Array, members: Indices, gap: float) -> list[Indices]:
    """Members in connected clumps that are large enough, largest first."""
    if not len(members):
        return []
    labels, sizes = clumps(points[members], gap)
    surface = np.bincount(labels, weights=areas[members])
    order = [int(k) for k in np.argsort(-sizes, kind="stable") if sizes[k] >= _MIN_POINTS and surface[k] >= _MIN_AREA_M2]
    return [members[labels == k] for k in order]


def _items(points: Array, normals: Array, areas: Array, members: Indices) -> tuple[Indices, list[Indices]]:
    """A cluster parted into the support and the items that stand on its level surfaces."""
    items: list[Indices] = []
    rest = members
    for height in _support_heights(points[members, 2], normals[members, 2], areas[members]):
        z = points[rest, 2]
        top = rest[(np.abs(z - height) < 0.025) & (normals[rest, 2] > 0.8)]
        if areas[top].sum() < _MIN_SUPPORT_M2:
            continue
        above = rest[(z > height + _ITEM_CLEARANCE_M) & (z < height + _ITEM_HEIGHT_M + 0.3)]
        above = above[_over(points[above], points[top])]
        extent = np.ptp(points[top, :2], axis=0)
        length, plan = float(extent.max()), float(np.prod(extent))
        taken = []
        for item in _clusters(points, areas, above, _ITEM_GAP_M):
            reach = np.ptp(points[item], axis=0)
            is_back = reach[:2].max() > _BACK_SHARE * length and reach[2] > 0.2 and height < 0.65
            is_seat = np.prod(reach[:2]) > _SEAT_SHARE * plan and height < 0.65
            is_rim = reach[2] < 0.05 and reach[:2].min() < 0.08
            if reach[2] <= _ITEM_HEIGHT_M and points[item, 2].min() < height + 0.08 and not (is_back or is_seat or is_rim):
                taken.append(item)
        if taken:
            items += taken
            rest = np.setdiff1d(rest, np.concatenate(taken), assume_unique=True)
    return rest, items


def _support_heights(z: Array, up: Array, areas: Array) -> list[float]:
    """Heights [m] of level, upward surfaces large enough to put objects on, from the top down."""
    level = (up > 0.8) & (z > _MIN_SUPPORT_HEIGHT_M)
    if areas[level].sum() < _MIN_SUPPORT_M2:
        return []
    bins = np.floor(z[level] / 0.01).astype(np.int64)
    smooth = np.convolve(np.bincount(bins, weights=areas[level], minlength=int(bins.max()) + 6), np.ones(5), mode="same")
    chosen: list[float] = []
    for peak in np.argsort(-smooth, kind="stable"):
        if smooth[peak] < _MIN_SUPPORT_M2:
            break
        height = (int(peak) + 0.5) * 0.01
        if all(abs(height - other) > 0.1 for other in chosen):
            chosen.append(height)
    return sorted(chosen, reverse=True)


def _over(points: Array, top: Array) -> NDArray[np.bool_]:
    """Which points lie above a level surface, up to 5 cm beyond its edge, shape (n,)."""
    from scipy.spatial import cKDTree

    if not len(points):
        return np.zeros(0, dtype=bool)
    distance, _ = cKDTree(top[:, :2]).query(points[:, :2], distance_upper_bound=0.05)
    return np.isfinite(distance)


def guessed(points: Array, normals: Array, areas: Array) -> str:
    """Category by the first rule that fits; `object` when none does."""
    pose, size = oriented_box(points)
    length, width, height = float(size[:2].max()), float(size[:2].min()), float(size[2])
    bottom = float(pose[2, 3] - height / 2)
    upper = (normals[:, 2] > 0.8) & (points[:, 2] > bottom + 0.5 * height)
    share = float(areas[upper].sum() / max(length * width, 1e-6))
    for rule in _RULES:
        fits = all(
            low <= value <= high
            for value, (low, high) in ((bottom, rule.bottom), (height, rule.height), (length, rule.length), (width, rule.width))
        )
        if fits and share >= rule.top_share:
            return rule.category
    return "object"
