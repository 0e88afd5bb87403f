"""Objects that were annotated in two parts: two refrigerators in each other's place are one, and a plant on a plant."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.boxes import oriented_box
from tasks.capture.instances.merged import own_part
from tasks.capture.instances.rows import InstancePoints
from tasks.capture.labels import Label, is_of_size
from tasks.capture.reading import Group
from tasks.furniture import canonical_category, is_known, typical_extents
from tasks.geometry.boxes import oriented_overlap
from tasks.mounting import mounting

LEAST_SHARED = 0.25
"""Of the smaller of two boxes. Bodies that stand beside each other, or one on the other, share a few percent: the noise of their sides."""

NEAR_M, LEAST_NEAR = 0.05, 0.04
"""Of the points of one of them, so many are this near to points of the other [m]: what was parted touches where it was parted."""

LEAST_NEAR_OF_TABLES, LEAST_NEAR_OF_MODULES = 0.15, 0.35
"""The same of tables and of cabinets: what stands in the bend of one is in its box, and may touch it along two sides. Tables that were
parted along a line have no bend, however little they touch: `LEAST_NEAR`."""

LEAST_SIDE = 0.5
"""Along so much of the shorter side of either, two parts of a rug touch."""

MOST_BEYOND = 0.11
"""Of the points of two parts, so many may lie on the wrong side of the line between them: islands of one in the other. Of a table around
a corner, and what stands in its bend, more do (12 to 16 %)."""

RIDGE = 1e-4
"""Where a line parts them wholly, this keeps its regression from growing without end."""

MODULES = ("cabinet", "counter", "cupboard", "worktop", "countertop")
"""Last words of what stands side by side, one on the other and around corners, each of its own."""

SINGLE = (
    "bed",
    "sofa",
    "armchair",
    "plant",
    "table lamp",
    "floor lamp",
    "desk lamp",
    "tv",
    "monitor",
    "microwave",
    "curtain",
    "picture",
    "mirror",
    "backpack",
)
"""What is as little in a like object's place, beside what fills its box: nobody piles or nests it."""

UPRIGHT = ("plant", "table lamp", "floor lamp", "desk lamp")
"""What never stands on its like: where one does, it is the upper part of it."""

STACKED_M = 0.1
"""The lower end of the upper part is this near to the upper end of the lower one, or in it [m]."""

LARGE_M = 1.4
"""Of categories whose longest side is usually larger [m], two parts that touch are told by the size of the whole."""

LEAST_FILLED = 0.85
"""Of a rug in two parts, that much of the rectangle around both is theirs: rugs that overlap leave its corners bare."""

LEVEL_M = 0.04
"""Tops of parts of one table are no farther apart [m]: one of them may hold what stands on it, a nest of tables is of several heights."""

Array = NDArray[np.float64]
Box = tuple[Array, Array]


class _Part(NamedTuple):
    """What may be a part of an object: its points [m], shape (n, 3), and its box."""

    points: Array
    box: Box


def rejoined(
    groups: Sequence[Group], meanings: Sequence[Label], solids: Sequence[InstancePoints]
) -> tuple[tuple[Group, ...], list[Label], list[str]]:
    """The instances of a scan, parts of one body put together, and a line for each part. Of what is piled, nested or pushed into each
    other (chairs, books, pillows) nobody can tell that it was parted."""
    boxes = {
        i: oriented_box(solid.points[own_part(solid.points, label.category)], is_noisy=not solid.is_exact)
        for i, (label, solid) in enumerate(zip(meanings, solids, strict=True))
        if not label.is_structure and _is_whole_by_itself(label.category) and len(solid.points)
    }
    whole = {i: i for i in boxes}
    order = sorted(boxes, key=lambda i: (-len(groups[i].vertices), i))
    for at, i in enumerate(order):
        for j in order[:at]:
            is_alike = whole[j] == j and _is_alike(meanings[i].category, meanings[j].category, boxes[i], boxes[j])
            if is_alike and _are_parts(meanings[j].category, *(_Part(solids[k].points, boxes[k]) for k in (i, j))):
                whole[i] = j
                break
    parts = {i: [j for j in order if whole[j] == i] for i in boxes if whole[i] == i}
    kept = [i for i in range(len(groups)) if whole.get(i, i) == i]
    notes = [
        f"{groups[j].origin or groups[j].source_id}: {groups[j].raw_label!r} {groups[j].source_id} is a part of {groups[i].source_id}, by "
        "where it is"
        for i in kept
        for j in parts.get(i, ())
        if j != i
    ]
    return tuple(_joined([groups[j] for j in parts.get(i, [i])]) for i in kept), [meanings[i] for i in kept], notes


def _near_share(points: Array, another: Array) -> float:
    """Share of points, shape (n, 3), with one of another such, shape (m, 3), near by [m]."""
    return float(_is_near(points, another).mean())


def _is_near(points: Array, another: Array) -> NDArray[np.bool_]:
    """Which points, shape (n, 3), have one of another such, shape (m, 3), near by [m], shape (n,)."""
    from scipy.spatial import cKDTree

    distances, _ = cKDTree(another).query(points, distance_upper_bound=NEAR_M)
    return np.isfinite(distances)


def _are_parts(category: str, part: _Part, other: _Part) -> bool:
    """Whether two alike objects of a category are parts of one: in each other's place, one the upper end of the other, or together as
    large as one usually is where one of them is not."""
    if _is_rug(category):
        return _touch_along(part, other) and _is_parted_by_line(part, other) and _is_rectangle(part, other)
    volume = min(float(np.prod(part.box[1])), float(np.prod(other.box[1])))
    near = max(_near_share(part.points, other.points), _near_share(other.points, part.points))
    if volume <= 0.0 or near == 0.0:
        return False
    is_module = category.split(" ")[-1] in MODULES
    is_table = mounting(category).is_flat_topped and not mounting(category).is_boxy
    is_bent = is_table and not (_is_parted_by_line(part, other) and _is_plan_of_whole(category, part, other))
    least = LEAST_NEAR_OF_MODULES if is_module else LEAST_NEAR_OF_TABLES if is_bent else LEAST_NEAR
    if near >= least and oriented_overlap(*part.box, *other.box) >= LEAST_SHARED * volume:
        return True
    return not is_module and (_is_upper_end(category, part, other) or _is_large_whole(category, part, other))


def _is_upper_end(category: str, part: _Part, other: _Part) -> bool:
    """Whether one of two parts stands on the other and is therefore its upper end."""
    lower, upper = sorted((part.points, other.points), key=lambda cloud: float(cloud[:, 2].min()))
    if not _is_named(category, UPRIGHT) or upper[:, 2].min() < lower[:, 2].min() + STACKED_M:
        return False
    middle = np.median(upper[:, :2], axis=0)
    is_above = bool((np.abs(middle - np.median(lower[:, :2], axis=0)) <= 0.5 * np.ptp(lower[:, :2], axis=0) + NEAR_M).all())
    return is_above and float(upper[:, 2].min() - lower[:, 2].max()) <= STACKED_M and float(upper[:, 2].max()) > float(lower[:, 2].max())


def _is_large_whole(category: str, part: _Part, other: _Part) -> bool:
    """Whether two parts that touch are together as large as one object of their category, and not each of them."""
    usual = typical_extents(category)
    if not is_known(category) or max(usual) < LARGE_M or (is_of_size(part.box[1], usual) and is_of_size(other.box[1], usual)):
        return False
    return is_of_size(oriented_box(np.concatenate([part.points, other.points]), is_noisy=True)[1], usual)


def _is_parted_by_line(part: _Part, other: _Part) -> bool:
    """Whether a straight line in plan has one part on its one side and the other on its other: that of a logistic regression, which weighs
    both alike."""
    from scipy.optimize import minimize

    plans = [points[:, :2] for points in (part.points, other.points)]
    joined, counts = np.concatenate(plans), [len(plan) for plan in plans]
    rows = np.column_stack([(joined - joined.mean(axis=0)) / max(float(joined.std()), 1e-9), np.ones(len(joined))])
    signs, weights = np.repeat([-1.0, 1.0], counts), np.repeat([0.5 / count for count in counts], counts)

    def loss(line: Array) -> float:
        return float(weights @ np.logaddexp(0.0, -signs * (rows @ line)) + 0.5 * RIDGE * line @ line)

    is_beyond = signs * (rows @ minimize(loss, np.zeros(3)).x) <= 0.0
    return max(float(is_beyond[signs == side].mean()) for side in (-1.0, 1.0)) <= MOST_BEYOND


def _is_plan_of_whole(category: str, part: _Part, other: _Part) -> bool:
    """Whether two parts are together as long and as deep as one object of their category: of a table's legs, a scan may show none."""
    usual = typical_extents(category)
    size = oriented_box(np.concatenate([part.points, other.points]), is_noisy=True)[1]
    return is_known(category) and is_of_size(np.array([*size[:2], usual[2]]), usual)


def _touch_along(part: _Part, other: _Part) -> bool:
    """Whether two parts touch along a good part of a side, however large they are."""
    near = part.points[_is_near(part.points, other.points)][:, :2]
    if not len(near):
        return False
    length = float(np.hypot(*np.ptp(near, axis=0)))
    return length >= LEAST_SIDE * min(float(box[1][:2].min()) for box in (part.box, other.box))


def _is_rectangle(part: _Part, other: _Part) -> bool:
    """Whether two parts fill the rectangle around them in plan."""
    (pose, size), (other_pose, other_size) = (_flat(box) for box in (part.box, other.box))
    shared = oriented_overlap(pose, size, other_pose, other_size)
    around = oriented_box(np.concatenate([part.points, other.points]), is_noisy=True)[1]
    return float(np.prod(size) + np.prod(other_size) - shared) >= LEAST_FILLED * float(around[0] * around[1])


def _flat(box: Box) -> Box:
    """The plan of a box, as a box of unit height about the ground."""
    pose, size = box[0].copy(), box[1].copy()
    pose[2, 3], size[2] = 0.0, 1.0
    return pose, size


def _is_rug(category: str) -> bool:
    return canonical_category(category) == "rug"


def _is_whole_by_itself(category: str) -> bool:
    return _is_rug(category) or mounting(category).is_boxy or mounting(category).is_flat_topped or _is_named(category, SINGLE)


def _is_named(category: str, names: Sequence[str]) -> bool:
    usual = canonical_category(category) or category
    return any(f" {text}".endswith(f" {name}") for name in names for text in (category, usual))


def _is_alike(category: str, other: str, box: Box, other_box: Box) -> bool:
    """Whether two objects may be parts of one: of one category, by whichever of its words, and tables of any kind with their tops at one
    height."""
    if not mounting(category).is_flat_topped or mounting(category).is_boxy:
        return (canonical_category(category) or category) == (canonical_category(other) or other)
    tops = [float(pose[2, 3] + 0.5 * size[2]) for pose, size in (box, other_box)]
    return category.split(" ")[-1] == other.split(" ")[-1] and abs(tops[0] - tops[1]) <= LEVEL_M


def _joined(parts: Sequence[Group]) -> Group:
    """Parts of an instance as one, named as the first."""
    if len(parts) == 1:
        return parts[0]
    vertices, faces = (np.unique(np.concatenate([getattr(part, name) for part in parts])) for name in ("vertices", "faces"))
    return dataclasses.replace(parts[0], vertices=vertices, faces=faces)
