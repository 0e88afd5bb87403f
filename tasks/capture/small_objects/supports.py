"""What carries small objects: the list of support categories, and where above an instance of one they can be.

The list is `supports.csv`, one row per category: how it carries (`top`: on its highest surface; `shelf`: on each of its boards), how
far above a board objects are looked for [m], and why. Source of the numbers: specs/models.md A.5.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import read_text
from tasks.furniture import canonical_category
from tasks.geometry.transforms import inverse, transform_points

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

KINDS = ("top", "shelf")
"""How supports carry."""

DILATION_M = 0.05
"""Objects reach so far over the edge of what carries them [m]."""

BELOW_M = 0.03
"""What a top's height may be wrong by [m]."""

_FLATNESS_M = 0.01
"""Height of the layers in which boards are looked for: a scan mesh is as rough."""

_CELL_M = 0.03
"""Edge of the cells of a footprint: wider than the distance of a scan mesh's vertices."""

_BOARD_SHARE = 0.3
"""Of the fullest layer's cells that a board has at least: what stands on it hides the rest from the scan."""

_BOARD_GAP_M = 0.12
"""Boards of a shelf are farther from each other than this."""

_OTHER_SIDE_SHARE = 0.6
"""Of a layer's cells that a layer right above it has at least, if both are sides of one board."""

_LEAST_TOP_M = 0.2
"""Lower surfaces are plinths and the bottoms of drawers."""

_BOARD_M = 0.025
"""Thickness of a board: what is so near below the next one is that one."""

_PANEL_M = 0.08
"""How far inside of its box a shelf's back or side is looked for."""

_PANEL_SHARE = 0.3
"""Of a side's cells, in a compartment, that a panel there has at least."""

_PANEL_SLACK_M = 0.005
"""What is so near to the layer in which a panel was seen is the panel: depth noise and drift of poses."""


@dataclasses.dataclass(frozen=True)
class SupportKind:
    """A row of `supports.csv`. slab_m: Height above the top, or the highest board, in which objects are looked for [m]."""

    category: str
    kind: str
    slab_m: float


@dataclasses.dataclass(frozen=True)
class SupportSlab:
    """Where small objects on one board can be: a box, turned about +Z only.

    pose: Its frame in the world, 4x4 [m]: origin on the board's surface, in the middle of the footprint. low, high: Least and largest
    coordinates in that frame of points of small objects [m], shape (3,): the footprint, dilated where nothing bounds it, from below
    the surface up to the next board. footprint: Half extents of the board itself along x and y [m], shape (2,).
    """

    pose: Array
    low: Array
    high: Array
    footprint: Array

    @property
    def height(self) -> float:
        """Of the board's surface over the floor [m]."""
        return float(self.pose[2, 3])

    def local(self, points: Array) -> Array:
        """World points [m], shape (..., 3), in the slab's frame."""
        return np.asarray((points - self.pose[:3, 3]) @ self.pose[:3, :3])

    def inset(self, local: Array) -> Array:
        """How far points in its frame [m], shape (..., 3), lie inside of the board's edges or panels [m], shape (...)."""
        low, high = np.maximum(self.low[:2], -self.footprint), np.minimum(self.high[:2], self.footprint)
        x, y = local[..., 0], local[..., 1]
        return np.asarray(np.minimum(np.minimum(x - low[0], high[0] - x), np.minimum(y - low[1], high[1] - y)))

    def holds(self, points: Array) -> Bools:
        """Which world points [m], shape (..., 3), lie in it."""
        local = self.local(points)
        held = np.ones(local.shape[:-1], dtype=bool)
        for axis in range(3):  # one after another: a reduction over an axis of three costs several times that
            held &= (local[..., axis] >= self.low[axis]) & (local[..., axis] <= self.high[axis])
        return held


@cache
def support_kinds() -> Mapping[str, SupportKind]:
    """Kinds of supports by category.

    Raises:
        InputError: `supports.csv` has a row that says nothing.
    """
    path = Path(__file__).with_name("supports.csv")
    return MappingProxyType(parsed_kinds(read_text(path, path.name), path.name))


def parsed_kinds(text: str, name: str) -> dict[str, SupportKind]:
    """Kinds of supports by category, from the text of a table; `name` is that of its file.

    Raises:
        InputError: a column is missing, or a row's kind or height is none.
    """
    rows = csv.DictReader(io.StringIO(text, newline=None))
    for field in ("category", "kind", "slab_m"):
        if field not in (rows.fieldnames or ()):
            raise InputError(name, field, "the column is missing", "write category, kind, slab_m, why into the first line")
    kinds = {}
    for line, row in enumerate(rows, start=2):
        if row["kind"] not in KINDS:
            raise InputError(name, f"line {line}, kind", f"must be top or shelf, is {str(row['kind'])[:20]!r}", "correct the line")
        try:
            height = float(row["slab_m"])
        except (TypeError, ValueError):
            height = math.nan
        if not 0.05 <= height <= 3:
            raise InputError(name, f"line {line}, slab_m", f"must be 0.05 to 3 m, is {str(row['slab_m'])[:20]!r}", "correct the line")
        category = " ".join((row["category"] or "").lower().split())
        if not category or category in kinds:
            raise InputError(name, f"line {line}, category", "is empty, or a line above has it already", "correct the line")
        kinds[category] = SupportKind(category, row["kind"], height)
    return kinds


def support_kind(category: str) -> SupportKind | None:
    """What the list says of a category, or of the one that it is another word for; None for what carries nothing."""
    kinds = support_kinds()
    return kinds.get(category) or kinds.get(canonical_category(category) or "")


def support_slabs(category: str, box_pose: Array, box_size: Array, points: Array) -> tuple[SupportSlab, ...]:
    """Where small objects on an instance can be, the lowest board first; none for a category that carries nothing.

    box_pose: Box to world frame, 4x4 [m], origin at its center. box_size: Its extents [m], shape (3,). points: The instance's, world
    frame [m], shape (n, 3), which find the boards; where they find none, the box's top is taken.
    """
    kind = support_kind(category)
    if kind is None:
        return ()
    bottom = float(box_pose[2, 3] - 0.5 * box_size[2])
    local = transform_points(points, inverse(box_pose)) if len(points) else np.zeros((0, 3))
    levels = _levels(local, 0.5 * np.asarray(box_size), kind.kind == "shelf", _LEAST_TOP_M - bottom - 0.5 * float(box_size[2]))
    slabs = []
    for index, level in enumerate(levels):
        is_last = index == len(levels) - 1
        clear = kind.slab_m if is_last else levels[index + 1] - level - _BOARD_M
        half = 0.5 * np.asarray(box_size[:2], dtype=np.float64)
        low, high = np.array([*(-half - DILATION_M), -BELOW_M]), np.array([*(half + DILATION_M), clear])
        if kind.kind == "shelf":
            _keep_off_panels(low, high, local, half, level, clear)
        pose = box_pose.copy()
        pose[:3, 3] += box_pose[:3, 2] * level
        slabs.append(SupportSlab(pose, low, high, half))
    return tuple(slabs)


def _levels(local: Array, half: Array, is_shelf: bool, least: float) -> list[float]:
    """Heights of boards in a box's frame [m], the lowest first: layers that fill much of the footprint.

    local: Points in that frame [m], shape (n, 3). least: Lower ones do not count [m]."""
    inside = local[(np.abs(local[:, :2]) <= half[:2] + _CELL_M).all(axis=1) & (local[:, 2] >= least)]
    if not len(inside):
        return [float(half[2])]
    start = float(inside[:, 2].min())
    layer = np.floor((inside[:, 2] - start) / _FLATNESS_M).astype(np.int64)
    cells = np.floor((inside[:, :2] + half[:2] + _CELL_M) / _CELL_M).astype(np.int64)
    wide = int(cells[:, 1].max()) + 1
    count = int(layer.max()) + 1
    # a board fills its own layer and, by noise, the next one
    filled = np.zeros(count)
    plan = cells[:, 0] * wide + cells[:, 1]
    for low in range(count):
        filled[low] = len(np.unique(plan[(layer == low) | (layer == low + 1)]))
    boards: list[float] = []
    for fullest in np.argsort(-filled, kind="stable"):
        low = fullest
        if filled[low] < _BOARD_SHARE * filled.max():
            break
        while True:  # up from its lower side, where a scan has that too
            above = np.arange(low + 1, min(low + 5, count))
            above = above[filled[above] >= _OTHER_SIDE_SHARE * filled[low]]
            if not len(above):
                break
            low = above.max()
        height = float(np.median(inside[(layer == low) | (layer == low + 1), 2]))
        if all(abs(height - other) > _BOARD_GAP_M for other in boards):
            boards.append(_surface_of(inside, height))
    return sorted(boards) if is_shelf else [max(boards)]


def _surface_of(inside: Array, height: float) -> float:
    """Height of the upper side of a board near a height: of the cells' highest points within a board's thickness the median [m]."""
    near = inside[np.abs(inside[:, 2] - height) <= _BOARD_M]
    cells = np.floor(near[:, :2] / _CELL_M).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    highest = np.full(int(cell.max()) + 1, -np.inf)
    np.maximum.at(highest, cell, near[:, 2])
    return float(np.median(highest))


def _keep_off_panels(low: Array, high: Array, local: Array, half: Array, level: float, clear: float) -> None:
    """Draw the sides of a compartment in to what is seen of the shelf's own back and sides, in place."""
    between = local[(local[:, 2] > level + 0.25 * clear) & (local[:, 2] < level + 0.75 * clear)]
    for axis in (0, 1):
        other = 1 - axis
        middle = between[np.abs(between[:, other]) < half[other] - _PANEL_M]
        wanted = _PANEL_SHARE * (2 * (half[other] - _PANEL_M) / _CELL_M) * (0.5 * clear / _CELL_M)
        for sign, limit in ((-1.0, low), (1.0, high)):
            inset = half[axis] - sign * middle[:, axis]
            is_near = np.abs(inset) <= _PANEL_M
            layer = np.floor((inset[is_near] + _PANEL_M) / _FLATNESS_M).astype(np.int64)
            cells = np.floor(middle[is_near][:, [other, 2]] / _CELL_M).astype(np.int64)
            full = [i for i in np.unique(layer) if len(np.unique(cells[(layer == i) | (layer == i + 1)], axis=0)) >= wanted]
            if full:  # a panel has two faces, and objects stand at the inner one
                limit[axis] = sign * (half[axis] - (max(full) + 2) * _FLATNESS_M + _PANEL_M - _PANEL_SLACK_M)
