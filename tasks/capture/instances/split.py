"""Objects that were annotated in two parts: two refrigerators in each other's place are one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.boxes import oriented_box
from tasks.capture.instances.merged import own_part
from tasks.capture.instances.rows import InstancePoints
from tasks.capture.labels import Label
from tasks.capture.reading import Group
from tasks.geometry.boxes import oriented_overlap
from tasks.mounting import mounting

LEAST_SHARED = 0.25
"""Of the smaller of two boxes. Bodies that stand beside each other, or one on the other, share a few percent: the noise of their sides."""

NEAR_M, LEAST_NEAR = 0.05, 0.35
"""Of the points of one of them, so many are this near to points of the other [m]: what stands in its bend is in its box alone."""

LEVEL_M = 0.04
"""Tops of parts of one table are no farther apart [m]: one of them may hold what stands on it, a nest of tables is of several heights."""

Array = NDArray[np.float64]


def rejoined(
    groups: Sequence[Group], meanings: Sequence[Label], solids: Sequence[InstancePoints]
) -> tuple[tuple[Group, ...], list[Label], list[str]]:
    """The instances of a scan, parts of one body put together, and a line for each part. Only of what fills its box can be told that it
    was parted, and of tables: chairs are pushed below tables, and into each other's boxes."""
    boxes = {
        i: oriented_box(solid.points[own_part(solid.points, label.category)], is_noisy=not solid.is_exact)
        for i, (label, solid) in enumerate(zip(meanings, solids, strict=True))
        if not label.is_structure and _fills_its_box(label.category) and len(solid.points)
    }
    whole = {i: i for i in boxes}
    order = sorted(boxes, key=lambda i: (-len(groups[i].vertices), i))
    for at, i in enumerate(order):
        for j in order[:at]:
            volume = min(float(np.prod(boxes[i][1])), float(np.prod(boxes[j][1])))
            is_alike = whole[j] == j and _is_alike(meanings[i].category, meanings[j].category, boxes[i], boxes[j])
            if not is_alike or volume <= 0.0 or oriented_overlap(*boxes[i], *boxes[j]) < LEAST_SHARED * volume:
                continue
            if max(_near_share(solids[a].points, solids[b].points) for a, b in ((i, j), (j, i))) >= LEAST_NEAR:
                whole[i] = j
                break
    parts = {i: [j for j in order if whole[j] == i] for i in boxes if whole[i] == i}
    kept = [i for i in range(len(groups)) if whole.get(i, i) == i]
    notes = [
        f"{groups[j].origin or groups[j].source_id}: {groups[j].raw_label!r} {groups[j].source_id} is a part of {groups[i].source_id}, in "
        "whose place it is"
        for i in kept
        for j in parts.get(i, ())
        if j != i
    ]
    return tuple(_joined([groups[j] for j in parts.get(i, [i])]) for i in kept), [meanings[i] for i in kept], notes


def _near_share(points: Array, another: Array) -> float:
    """Share of points, shape (n, 3), with one of another such, shape (m, 3), near by [m]."""
    from scipy.spatial import cKDTree

    distances, _ = cKDTree(another).query(points, distance_upper_bound=NEAR_M)
    return float(np.isfinite(distances).mean())


def _fills_its_box(category: str) -> bool:
    return mounting(category).is_boxy or mounting(category).is_flat_topped


def _is_alike(category: str, other: str, box: tuple[Array, Array], other_box: tuple[Array, Array]) -> bool:
    """Whether two objects may be parts of one: bodies of a category, and tables of any kind with their tops at one height."""
    if mounting(category).is_boxy:
        return category == other
    tops = [float(pose[2, 3] + 0.5 * size[2]) for pose, size in (box, other_box)]
    return category.split(" ")[-1] == other.split(" ")[-1] and abs(tops[0] - tops[1]) <= LEVEL_M


def _joined(parts: Sequence[Group]) -> Group:
    """Parts of an instance as one, named as the first."""
    if len(parts) == 1:
        return parts[0]
    vertices, faces = (np.unique(np.concatenate([getattr(part, name) for part in parts])) for name in ("vertices", "faces"))
    return dataclasses.replace(parts[0], vertices=vertices, faces=faces)
