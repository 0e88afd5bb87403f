"""Which objects of two scans in one frame are the same, and what became of each: unchanged, moved, added, removed, or nobody can say."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.rescans import Change
from tasks.geometry.transforms import transform_points
from tasks.rescans.configuration import MatchingConfig
from tasks.rescans.motion import ObjectMotion, motion_between, shares_in_place
from tasks.rescans.surfaces import RoomScan, ScannedObject

Array = NDArray[np.float64]

_FORBIDDEN = 1e6
"""Cost of what is no pair."""

_ALONE = 2.0
"""Cost of an object without a counterpart, more than that of any pair that may be: moved far is likelier than gone and come."""

_IN_PLACE = 0.7
"""Share of both surfaces that agree where objects are the same whatever they are called."""

_PART = 0.85
"""Share of the surface of one that the other shows in its place, where it has not moved: the rest is what one scan saw more of it."""

_CELL_M = 0.1
"""Of the plan in which it is told what was seen [m]."""

_THIN_M = 0.08
"""What is thinner lies on a surface that scans at 2 cm show in its place, with or without it [m]: a rug, a picture."""

_HUNG_M, _HUNG_ABOVE_M = 0.15, 0.3
"""What is thinner in plan, and higher above the floor, may hang on a wall [m]."""

_ON_M = 0.05
"""Within which a surface is where an object's was, as far as thinned points lie apart [m]."""


@dataclasses.dataclass(frozen=True)
class MatchedObject:
    """What became of an object. reference: As the earlier scan has it; later: as this one does, in the frame of the earlier.

    motion: From the earlier to the later scan, of what both have. seen_share: Share of its place that the other scan saw, of what only one
    has.
    """

    change: Change
    reference: ScannedObject | None
    later: ScannedObject | None
    motion: ObjectMotion | None = None
    seen_share: float | None = None


def placed(room: RoomScan, pose: Array) -> RoomScan:
    """A scan in another frame, by the pose of its own in that one, 4x4 [m]."""
    objects = [
        dataclasses.replace(each, pose=pose @ each.pose, points=transform_points(each.points, pose)) for each in room.objects
    ]  # fmt: skip
    return dataclasses.replace(
        room, points=transform_points(room.points, pose), normals=room.normals @ pose[:3, :3].T, objects=tuple(objects)
    )


def matched(room: RoomScan, reference: RoomScan, config: MatchingConfig) -> list[MatchedObject]:
    """What became of every object of two scans, both in the frame of the reference: those of the reference first, then those added."""
    pairs = _paired(room.objects, reference.objects, config)
    rows = []
    for index, old in enumerate(reference.objects):
        if index in pairs:
            new = room.objects[pairs[index]]
            is_part = max(shares_in_place(old.points, new.points)) >= _PART
            motion = ObjectMotion(np.zeros(3), 0.0) if is_part else motion_between(old, new)
            is_same = motion.distance_m < config.moved_m and abs(motion.turn_radians) < config.turned_radians
            rows.append(MatchedObject("unchanged" if is_same else "moved", old, new, motion))
        else:
            change, seen = _alone(old, room, "removed", config)
            rows.append(MatchedObject(change, old, None, seen_share=seen))
    for index, new in enumerate(room.objects):
        if index not in pairs.values():
            change, seen = _alone(new, reference, "added", config)
            rows.append(MatchedObject(change, None, new, seen_share=seen))
    return rows


def _paired(later: Sequence[ScannedObject], earlier: Sequence[ScannedObject], config: MatchingConfig) -> dict[int, int]:
    """Later objects by the earlier ones that they are, by number: the cheapest assignment."""
    from scipy.optimize import linear_sum_assignment

    if not later or not earlier:
        return {}
    cost = np.array([[_cost(old, new, config) for new in later] for old in earlier])
    rows, columns = cost.shape
    whole = np.full((rows + columns, rows + columns), _FORBIDDEN)
    whole[:rows, :columns] = cost
    whole[:rows, columns:][np.eye(rows, dtype=bool)] = _ALONE
    whole[rows:, :columns][np.eye(columns, dtype=bool)] = _ALONE
    whole[rows:, columns:] = 0.0
    chosen = zip(*linear_sum_assignment(whole), strict=True)
    return {int(row): int(column) for row, column in chosen if row < rows and column < columns}


def _cost(old: ScannedObject, new: ScannedObject, config: MatchingConfig) -> float:
    """How unlikely it is that two are one, 0 to 2: by distance, ever less so (one chair that went far, not all by one place), and size."""
    away = float(np.linalg.norm(new.center - old.center))
    shares = shares_in_place(old.points, new.points) if away < 0.5 * float(np.linalg.norm(old.size + new.size)) else (0.0, 0.0)
    is_named_alike = new.category == old.category
    if min(shares) < _IN_PLACE and not (is_named_alike and (_fits(old.size, new.size, config) or max(shares) >= _IN_PLACE)):
        return _FORBIDDEN
    sides = np.abs(_sides(old.size) - _sides(new.size)) / np.maximum(np.maximum(_sides(old.size), _sides(new.size)), config.size_m)
    return away / (away + 1.0) + 0.5 * float(sides.mean()) + (0.0 if is_named_alike else 0.5)


def _sides(size: Array) -> Array:
    """Sides of a box with those in plan sorted: which of them is x depends on how it was found."""
    return np.array([*np.sort(size[:2]), size[2]])


def _fits(old: Array, new: Array, config: MatchingConfig) -> bool:
    """Whether two boxes may be of one object that stands as it did."""
    first, second = _sides(old), _sides(new)
    return bool((np.abs(first - second) <= np.maximum(config.size_m, config.size_share * np.maximum(first, second))).all())


def _alone(lost: ScannedObject, other: RoomScan, change: Change, config: MatchingConfig) -> tuple[Change, float]:
    """What an object is that the other scan has no counterpart of, and the share of its place that that scan saw."""
    seen = _seen_share(lost, other)
    if seen < config.seen_share:
        return "not_seen", seen
    if float(lost.size.min()) >= _THIN_M and _still_share(lost, other) >= config.still_share:
        return "unnamed", seen
    return change, seen


def _still_share(lost: ScannedObject, other: RoomScan) -> float:
    """Share of an object's surface, above what it stands on, that another scan shows as well, whatever that is said to be of."""
    from scipy.spatial import cKDTree

    near = min(_ON_M, 0.35 * float(lost.size.min()))  # of a mug less, else the top below it would do
    points = lost.points[lost.points[:, 2] > lost.points[:, 2].min() + near]
    if not len(points) or not len(other.points):
        return 0.0
    distance, index = cKDTree(other.points).query(points)
    away = np.abs(np.einsum("nk,nk->n", points - other.points[index], other.normals[index]))
    return float(((away < near) & (distance < _ON_M + near)).mean())


def _seen_share(lost: ScannedObject, other: RoomScan) -> float:
    """Share of an object's cells in plan of whose place another scan shows what is below; of what hangs, what is behind or beside it."""
    bottom, top = float(lost.points[:, 2].min()), float(lost.points[:, 2].max())
    height = other.points[:, 2]
    known = _cells(other.points[height <= bottom + _ON_M])
    if float(lost.size[:2].min()) < _HUNG_M and bottom > _HUNG_ABOVE_M:
        behind = _cells(other.points[(height >= bottom - _ON_M) & (height <= top + _ON_M)])
        known = np.concatenate([known, *(behind + np.array([i, j]) for i in (-1, 0, 1) for j in (-1, 0, 1))])
    seen = {(int(x), int(y)) for x, y in known}
    cells = np.unique(_cells(lost.points), axis=0)
    return sum((int(x), int(y)) in seen for x, y in cells) / len(cells)


def _cells(points: Array) -> NDArray[np.int64]:
    """Cells of the plan that points lie in, shape (n, 2)."""
    return np.floor(points[:, :2] / _CELL_M).astype(np.int64)
