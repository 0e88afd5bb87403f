"""What an annotation holds beside the object that it names, where the object's kind tells: things on tables, legs on rugs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import vertex_areas
from tasks.capture.instances.boxes import clumps, oriented_box
from tasks.capture.instances.naming import PROVIDER, UNKNOWN, guessed
from tasks.capture.instances.panels import panels_of
from tasks.capture.labels import OTHER_PROP, Label
from tasks.capture.reading import Group
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import vertex_normals
from tasks.mounting import mounting

LEAST_FLAT = 0.25
"""Of the cells of a rug, so many have nothing above them, whatever was annotated with it: a mattress that is called a mat has none."""

KITCHEN = ("cabinet", "cupboard", "counter", "countertop", "worktop")
"""Last words of what a worktop and the cabinets below it are annotated as."""

CABINETS = ("cabinet", "cupboard")

WORKTOP, CABINET, CABINET_CLASS = "kitchen counter", "kitchen cabinet", 3
"""What the two are then, and the class of the latter."""

WORKTOP_M = (0.75, 1.1)
"""Worktops are as high [m]."""

WORKTOP_DEEP_M, BEYOND_M, OTHERS_SHARE = 0.85, 0.45, 0.25
"""No worktop of a single row is deeper [m]; so much of it runs on beyond its cabinet [m], and over so much of that, something else
stands."""

SLAB_M, BODY_M, LEVEL_NORMAL = 0.06, 0.3, 0.8
"""A worktop is thinner, its cabinet taller than that [m], and normals of what is level are as far up."""

RAISED_M = 0.3
"""What is seen from this height above the floor on alone [m] stands on legs: beds and sofas do not."""

CORNER_SHARE, LEAST_FILLED = 0.35, 0.1
"""Each corner of a bed, so much of its sides, has points, at least this share of those in the fullest; sofas with a bend lack one."""

STANDS_M, STANDS_POINTS, STANDS_GAP_M = 0.2, 60, 0.08
"""What rises so high above a rug [m], by so many points, no two of which are farther from the next [m], stands on it."""

SHELVED = frozenset(
    (
        *("book", "books", "book stack", "binder", "folder", "mug", "cup", "glass", "wine glass", "bowl", "plate", "bottle"),
        *("can", "jar", "vase", "candle", "toy", "pot", "pan", "sculpture", "shoe"),
    )
)
"""Things of which several are on the boards of one shelf, and that have no boards themselves."""

BOARDS_M, BETWEEN_M, BETWEEN_SHARE = 0.25, 0.01, 0.3
"""Things on two boards reach over more than this in height [m]; a board is seen between them, this far from either [m], below so much of
the plan of the upper ones."""

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]

CELL_M = 0.05
"""Cells of the plan in which heights are compared."""

THICK_M = 0.06
"""Rugs and cloths are thinner."""

ROUND_M = 0.25
"""Cell of a rug [m]: it may lie on something, or on a slope, but is flat in here."""

PILE_M = 0.01
"""Above the middle of a rug's points: what is higher is noise, and would make it as thick as a step."""

LEAST_LOW = 0.1
"""Of a rug's points in a cell: where fewer are as low as that, it lies on something, and is as high there as the middle of the cell."""

LEVEL_M = 0.025
"""Points this near to a top's height are of it: the noise of a room scan."""

TOP_SHARE = 0.5
"""Of the cells of a table, from which on the height that they share is its top."""

ABOVE_SHARE = 0.3
"""Of the cells, in which more is above that height, from which on it is no top: a desk has shelves on it."""


def set_apart(groups: Sequence[Group], meanings: Sequence[Label], world: Surface) -> tuple[tuple[Group, ...], list[Label], list[str]]:
    """The instances of a scan, with what was annotated together with another as instances of their own, and a line for each: furniture
    with the rug that it stands on, its category guessed from its size; a worktop with one of the cabinets below it; things on several
    boards of a shelf; doors and windows in different planes."""
    normals = vertex_normals(world.vertices, world.faces)
    made, labels, notes, areas = list(groups), list(meanings), [], np.zeros(0)
    for at, (group, label) in enumerate(zip(groups, meanings, strict=True)):
        points = world.vertices[group.vertices]
        if label.is_structure or len(points) < STANDS_POINTS:
            continue
        parts: list[tuple[str, Integers]] = []
        is_let_in = mounting(label.category).kind == "let_in"
        if is_let_in:
            panels = panels_of(points, normals[group.vertices])
            parts = [(label.category, group.vertices[own]) for own in panels[1:]]
        elif mounting(label.category).kind == "covering":
            standing = [group.vertices[own] for own in _standing_on(points)]
            floor = float(np.quantile(points[:, 2], 0.05))
            areas = vertex_areas(world) if standing and not len(areas) else areas
            parts = [(_guessed(world.vertices[own], normals[own], areas[own], floor), own) for own in standing]
            parts = [part for part in parts if part[0] != UNKNOWN]
        elif label.category.split(" ")[-1] in KITCHEN:
            neighbors = [other.vertices for k, other in enumerate(groups) if k != at and not meanings[k].is_structure]
            slab = _worktop(points, normals[group.vertices], world.vertices[np.concatenate([[], *neighbors]).astype(np.int64)])
            parts = [(WORKTOP, group.vertices[slab])] if slab.any() else []
            if parts and label.category.split(" ")[-1] not in CABINETS:
                labels[at] = Label(CABINET, CABINET_CLASS, is_known=True)
        elif label.category in SHELVED and float(np.ptp(points[:, 2])) > BOARDS_M:
            neighbors = [other.vertices for k, other in enumerate(groups) if k != at and not meanings[k].is_structure]
            beside = world.vertices[np.concatenate([np.zeros(0, dtype=np.int64), *neighbors])]
            parts = [(label.category, group.vertices[own]) for own in _on_other_boards(points, beside)]
        for number, (category, own) in enumerate(parts, start=1):
            is_own = np.isin(world.faces[made[at].faces], own).all(axis=1)
            name = f"{group.source_id}.{number}"
            made.append(Group(name, group.raw_label if is_let_in else f"{PROVIDER}:{category}", own, made[at].faces[is_own], group.origin))
            labels.append(label if is_let_in else Label(category, OTHER_PROP, is_known=True))
            rest = np.setdiff1d(made[at].vertices, own, assume_unique=True)
            made[at] = dataclasses.replace(made[at], vertices=rest, faces=made[at].faces[~is_own])
            if is_let_in:
                relation = f"is two, of which {name} is the other"
            else:
                relation = f"has a {category} {'on another board' if category == label.category else 'on it'}, which is {name} now"
            notes.append(f"{group.origin or group.source_id}: {group.raw_label!r} {group.source_id} {relation}")
    return tuple(made), labels, notes


def _guessed(points: Array, normals: Array, areas: Array, floor: float) -> str:
    """Category of what stands at a height [m], whether its legs were seen or not; `unknown` when it looks like nothing that is known."""
    feet = points * [1.0, 1.0, 0.0] + [0.0, 0.0, floor]
    category = guessed(np.concatenate([points, feet]), np.concatenate([normals, 0.0 * normals]), np.concatenate([areas, 0.0 * areas]))
    if category in ("bed", "sofa") and points[:, 2].min() > floor + RAISED_M:
        return "table"
    pose, size = oriented_box(points)
    across = (points - pose[:3, 3]) @ pose[:3, :2] / size[:2]
    corner = (np.abs(across) > 0.5 - CORNER_SHARE).all(axis=1)
    counts = np.bincount((across[corner] > 0.0) @ np.array([1, 2]), minlength=4)
    return "sofa" if category == "bed" and counts.min() < LEAST_FILLED * counts.max() else category


def _standing_on(points: Array) -> list[Integers]:
    """What stands on a rug: which points are of each, the largest first; points of the rug and of all that is annotated with it, shape
    (n, 3) [m]."""
    heights = points[:, 2]
    low = float(np.quantile(heights, 0.05))
    high = np.flatnonzero(heights > low + THICK_M)
    cells = np.floor(points[:, :2] / CELL_M).astype(np.int64)
    covered = len(np.unique(cells[high], axis=0))
    if not covered or 1.0 - covered / len(np.unique(cells, axis=0)) < LEAST_FLAT:
        return []
    clump, _ = clumps(points[high], STANDS_GAP_M)
    standing = [high[clump == k] for k in range(int(clump.max()) + 1)]
    standing = [own for own in standing if len(own) >= STANDS_POINTS and heights[own].max() >= low + STANDS_M]
    return sorted(standing, key=lambda own: (-len(own), int(own[0])))


def _on_other_boards(points: Array, beside_points: Array) -> list[Integers]:
    """Which points of things that were annotated as one are on other boards of a shelf than most of them: those of each board, the largest
    first; none where nothing is seen between. points: shape (n, 3); beside_points: of all other objects, shape (m, 3) [m]."""
    low, high = points.min(axis=0), points.max(axis=0)
    beside = beside_points[((beside_points >= low) & (beside_points <= high)).all(axis=1)]
    clump, _ = clumps(points, STANDS_GAP_M)
    layers: list[Integers] = []  # from below, each with all that no board parts from it
    for own in sorted((np.flatnonzero(clump == k) for k in range(int(clump.max()) + 1)), key=lambda own: float(points[own, 2].min())):
        for at, layer in enumerate(layers):
            if not _is_between(points[layer], points[own], beside):
                layers[at] = np.concatenate([layer, own])
                break
        else:
            layers.append(own)
    layers.sort(key=lambda own: (-len(own), int(own.min())))
    return [np.sort(own) for own in layers[1:] if len(own) >= STANDS_POINTS]


def _is_between(lower: Array, upper: Array, beside_points: Array) -> bool:
    """Whether points beside it, shape (m, 3) [m], are seen between what is one above the other, in its plan."""
    top, bottom = float(lower[:, 2].max()), float(upper[:, 2].min())
    board = beside_points[(beside_points[:, 2] > top + BETWEEN_M) & (beside_points[:, 2] < bottom + BETWEEN_M)]
    plan, under = (set(map(tuple, np.floor(cloud[:, :2] / CELL_M).astype(np.int64).tolist())) for cloud in (upper, board))
    return len(plan & under) >= BETWEEN_SHARE * len(plan)


def _worktop(points: Array, normals: Array, rest: Array) -> Booleans:
    """Which points are of a worktop that runs on beyond the cabinet that it is annotated with, over what else stands there, shape (n, 3)
    to (n,); none where none does. rest: points of all other objects, shape (m, 3) [m]."""
    heights = points[:, 2]
    level = (normals[:, 2] > LEVEL_NORMAL) & (heights >= WORKTOP_M[0]) & (heights <= WORKTOP_M[1])
    nothing = np.zeros(len(points), dtype=np.bool_)
    if level.sum() < STANDS_POINTS:
        return nothing
    bins = np.floor(heights[level] / LEVEL_M).astype(np.int64)
    values, counts = np.unique(bins, return_counts=True)
    top = float(np.median(heights[level][np.abs(bins - values[np.argmax(counts)]) <= 1]))
    slab = level & (np.abs(heights - top) <= SLAB_M)
    body = (heights < top - SLAB_M) & (heights > THICK_M)
    if body.sum() < STANDS_POINTS or np.ptp(heights[body]) < BODY_M:
        return nothing
    pose, size = oriented_box(points[slab])
    along = int(np.argmax(size[:2]))
    if size[1 - along] > WORKTOP_DEEP_M:  # round a corner: one cannot tell which way each part of the front looks
        return nothing
    local, below = ((cloud - pose[:3, 3]) @ pose[:3, :3] for cloud in (points, rest))
    is_below = (rest[:, 2] < top - SLAB_M) & (rest[:, 2] > THICK_M) & (np.abs(below[:, 1 - along]) <= 0.5 * size[1 - along] + CELL_M)
    steps = round(float(size[along]) / CELL_M)
    covered, elsewhere = (
        np.bincount(places[(places >= 0) & (places < steps)], minlength=steps) > 0
        for places in (
            np.floor((line + 0.5 * size[along]) / CELL_M).astype(np.int64) for line in (local[body, along], below[is_below, along])
        )
    )
    alone = ~(covered | np.roll(covered, 1) | np.roll(covered, -1))
    if alone.sum() * CELL_M < BEYOND_M or (alone & elsewhere).sum() < OTHERS_SHARE * alone.sum():
        return nothing
    is_over = (np.abs(local[:, :2]) <= 0.5 * size[:2] + CELL_M).all(axis=1)
    return np.asarray((heights >= top - SLAB_M) & is_over)


def own_size(points: Array, category: str) -> Array:
    """Extents along the world's axes [m], shape (3,), of what is an object's own if it is of a category. points: shape (n, 3) [m]."""
    own = points[own_part(points, category)] if len(points) else points
    return np.ptp(own, axis=0) if len(own) else np.zeros(3)


def own_part(points: Array, category: str) -> Booleans:
    """Which points of an annotated object are its own, shape (n, 3) to (n,): of rugs what is flat, of tables nothing above the top."""
    kind = mounting(category)
    heights = points[:, 2]
    if kind.kind == "covering":
        low = float(np.quantile(heights, 0.05))
        flat = heights <= low + THICK_M
        if flat.mean() < TOP_SHARE:
            return np.ones(len(points), dtype=np.bool_)
        from scipy.ndimage import median

        _, cell = np.unique(np.floor(points[:, :2] / ROUND_M).astype(np.int64), axis=0, return_inverse=True)
        cell, is_low = cell.ravel(), flat & (heights <= float(np.median(heights[flat])) + PILE_M)
        counts = np.bincount(cell, flat)
        is_lost = np.bincount(cell, is_low) < LEAST_LOW * counts
        middles = median(heights[flat], cell[flat], np.arange(len(counts)))
        return np.asarray(is_low | (flat & is_lost[cell] & (heights <= middles[cell] + PILE_M)))
    if kind.is_flat_topped:
        _, cell = np.unique(np.floor(points[:, :2] / CELL_M).astype(np.int64), axis=0, return_inverse=True)
        highest = np.full(int(cell.max()) + 1, -np.inf)
        np.maximum.at(highest, cell.ravel(), heights)
        bins = np.floor(highest / LEVEL_M).astype(np.int64)
        values, counts = np.unique(bins, return_counts=True)
        top = float(np.median(highest[np.abs(bins - values[np.argmax(counts)]) <= 1]))
        above = highest > top + LEVEL_M
        if (np.abs(highest - top) <= LEVEL_M).mean() >= TOP_SHARE and above.mean() <= ABOVE_SHARE:
            return np.asarray(heights <= top + LEVEL_M)
    return np.ones(len(points), dtype=np.bool_)
