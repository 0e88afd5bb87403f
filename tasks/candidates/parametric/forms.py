"""Which templates a category has, and what an instance's points say of their boards and cut-outs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.candidates.parametric.cases import Level, Rectangle, counters, shelves, tables
from tasks.candidates.parametric.drawing import Extents, FurnitureTemplate
from tasks.candidates.parametric.seats import chairs, sofas
from tasks.captions.physics import known_name
from tasks.geometry.boxes import box_footprint, grown_box
from tasks.geometry.transforms import inverse, transform_points

if TYPE_CHECKING:
    from tasks.candidates.request import CandidateRequest

Array = NDArray[np.float64]

KINDS: dict[str, str] = {
    "sofa": "sofa", "armchair": "sofa",
    "chair": "chair", "bar stool": "table", "stool": "table",
    "table": "table", "desk": "table", "coffee table": "table", "side table": "table", "bench": "table",
    "shelf": "shelf", "bookshelf": "shelf", "shoe rack": "shelf", "cabinet": "shelf", "tv stand": "shelf",
    "kitchen counter": "counter",
}  # fmt: skip
"""What templates a category of the generator has."""

LET_IN = ("sink", "stove", "oven", "basin", "hob", "cooktop")
"""What worktops are cut out for."""


def is_withheld(template: FurnitureTemplate) -> bool:
    """True for the half of the templates that look like furniture of wild rooms: U-shaped, right-handed, with uprights or a pedestal."""
    return template.name == "U" or any(word in template.name for word in ("right", "pedestal"))


def kind_of(request: CandidateRequest) -> str | None:
    """The category of the generator that an instance is of; None where it has no template."""
    from tasks.furniture import canonical_category

    word = request.category.lower()
    for name in (word, known_name(word), request.instance.nyu40_label):
        known = canonical_category(name) if name else None
        if known is not None:
            return known if known in KINDS else None
    return None


def forms_of(kind: str, request: CandidateRequest, points: Array) -> list[tuple[FurnitureTemplate, int]]:
    """Templates of a kind, each with a turn of its front; points [m], shape (n, 3), z from the bottom of the box."""
    x, y, z = request.extents
    forms = []
    for turn in range(4):
        extents: Extents = (x, y, z) if turn % 2 == 0 else (y, x, z)
        if KINDS[kind] == "sofa":
            made = sofas(extents)
        elif KINDS[kind] == "chair":
            made = chairs(extents)
        elif KINDS[kind] == "counter":
            made = counters(extents, [turned_rectangle(hole, -turn) for hole in cut_outs(request)])
        elif KINDS[kind] == "shelf":
            made = shelves(extents, board_levels(points, request.extents)) if extents[0] <= SQUARE * extents[1] else []
        else:
            made = tables(extents)
        offered = [template for template in made if not (request.is_withholding and is_withheld(template))]
        forms += [(template, turn) for template in offered if turn in template.turns]
    return forms


SQUARE = 1.15
"""A shelf is not deeper than wide, but by this."""


def turned_rectangle(rectangle: Rectangle, turn: int) -> Rectangle:
    """Spans of x and y, turned by quarters about +Z."""
    (x0, x1), (y0, y1) = rectangle
    for _ in range(turn % 4):
        x0, x1, y0, y1 = -y1, -y0, x0, x1
    return (x0, x1), (y0, y1)


BIN_M = 0.01
"""Heights are counted in steps of this."""

BOARD_SHARE = 0.3
"""A board shows points over this share of what the best level shows, at least."""

BETWEEN_M = 0.16
"""Boards are not nearer to each other: a row of small books is higher."""

EVEN_M = 0.035
"""Boards are even where those that were seen are this near to an even row's."""

MOST_BOARDS = 8
"""Boards between the lowest and the top."""


def board_levels(points: Array, extents: Extents) -> list[Level]:
    """Heights of the tops of boards below the top of the box, the lowest first: where many cells of the plan have points at one height,
    and where an even row of boards has others that the scan missed, as it does above eyes. Empty without any that was seen."""
    x, y, z = extents
    inner = points[(np.abs(points[:, 0]) < 0.5 * x - 0.04) & (np.abs(points[:, 1]) < 0.5 * y - 0.04)]
    if z < 2 * BETWEEN_M or len(inner) < 50:
        return []
    cells = np.unique(np.floor(inner / [0.04, 0.04, BIN_M]).astype(np.int64), axis=0)
    counts = np.bincount(np.clip(cells[:, 2], 0, None), minlength=int(z / BIN_M) + 3).astype(float)
    wide = np.convolve(counts, [1.0, 1.0, 1.0], "same")
    usual = np.median(wide[: max(int(z / BIN_M), 1)])
    seen: list[float] = []
    for k in np.argsort(-wide, kind="stable").tolist():
        if wide[k] < max(BOARD_SHARE * wide.max(), 2.0 * usual):
            break
        near = np.abs(inner[:, 2] - (k + 0.5) * BIN_M) <= 1.5 * BIN_M
        if not near.any():  # what lies below the box was counted into the lowest bin
            continue
        high = float(inner[near, 2].mean())
        if high <= z - BETWEEN_M and all(abs(high - other) >= BETWEEN_M for other in seen):
            seen.append(high)
    lowest = [high for high in seen if high < BETWEEN_M]
    between = sorted(high for high in seen if high >= BETWEEN_M)
    first = Level(lowest[0], True) if lowest else Level(0.02, False)
    if not between:
        return []
    return [first, *(_even(between, first.height, z) or [Level(high, True) for high in between[:MOST_BOARDS]])]


def _even(seen: list[float], low: float, high: float) -> list[Level] | None:
    """The fewest boards at even distances between two that hold all that were seen; None if there are no such."""
    for count in range(len(seen), MOST_BOARDS + 1):
        step = (high - low) / (count + 1)
        if step < BETWEEN_M:
            return None
        row = [low + step * (k + 1) for k in range(count)]
        near = [seen[int(np.argmin(np.abs(np.array(seen) - level)))] for level in row]
        held = [abs(other - level) <= EVEN_M for other, level in zip(near, row, strict=True)]
        if {other for other, ok in zip(near, held, strict=True) if ok} == set(seen):
            return [Level(other if ok else level, ok) for level, other, ok in zip(row, near, held, strict=True)]
    return None


def cut_outs(request: CandidateRequest) -> list[Rectangle]:
    """Where sinks and hobs are let into the top of the box: spans of x and y in its frame [m]."""
    pose, size = grown_box(request.instance.box_pose, request.instance.box_size, request.instance.hidden_m)
    low, high = pose[2, 3] - 0.5 * size[2], pose[2, 3] + 0.5 * size[2]
    holes: list[Rectangle] = []
    for other in request.neighbors:
        bottom = float(other.box_pose[11]) - 0.5 * other.box_size[2]
        top = bottom + other.box_size[2]
        name = (known_name(other.category) or other.category).split()[-1:]
        if not name or name[0] not in LET_IN or not (bottom < high - 0.015 and high - 0.1 < top < high + 0.2 and bottom > low - 0.4):
            continue
        corners = np.column_stack([box_footprint(other.box_pose, other.box_size), np.zeros(4)])
        plan = transform_points(corners, inverse(pose))[:, :2]
        (x0, y0), (x1, y1) = plan.min(axis=0), plan.max(axis=0)
        if (np.abs(plan.mean(axis=0)) <= 0.5 * size[:2]).all():
            holes.append(((float(x0), float(x1)), (float(y0), float(y1))))
    return holes
