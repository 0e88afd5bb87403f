"""Scanned solids completed by what furniture must have: bodies back to the wall behind and down to what they stand on, legs below
corners, tops without holes where something stood."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.mounting import Base, Mounting

Array = NDArray[np.float64]
Field = NDArray[np.float32]
Mask = NDArray[np.bool_]

HOLE_M = 0.3
"""What stands on a table hides no wider part of its top."""

TOP_SHARE = 0.5
"""Of the columns of a solid, from which on the height that they share is its top."""

SAFE_SHARE = 0.12
"""Of the smaller side: so far within its feet lies the center of mass of what stands safely."""

FOOT_M = 0.025
"""Thickness of the foot of a pole."""

LEG_SHARE = 12
"""A leg is this part of the smaller side wide."""


@dataclasses.dataclass(frozen=True)
class Unseen:
    """What a scan lacks of an object. sides: how far it reaches beyond the crop at -x, +x, -y, +y, -z [m]. base: what it reaches down
    with. stands: it stands by itself. is_flat_topped: others are put on it. held: rectangles x0, y0, x1, y1 of its top that others were
    seen on [m]."""

    sides: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    base: Base | None = None
    stands: bool = False
    is_flat_topped: bool = False
    held: tuple[tuple[float, float, float, float], ...] = ()

    @staticmethod
    def of(sides: Sequence[float] | None, kind: Mounting, held: Sequence[tuple[float, float, float, float]] = ()) -> Unseen:
        """What is unseen of an object of a kind, by its row, and of its top below others."""
        known = (0.0,) * 5 if sides is None else tuple(float(v) for v in sides[:5])
        return Unseen(known, kind.base or "body", kind.base is not None, kind.is_flat_topped, tuple(held))


NOTHING_UNSEEN = Unseen()


def completed(field: Field, axes: Sequence[Array], low: Array, high: Array, unseen: Unseen, empty: Mask | None = None) -> Field:
    """The field of a solid, negative inside, with what is unseen of it.

    Args:
        field: signed distance at the nodes [m].
        axes: coordinates of the nodes along each axis [m].
        low: lowest corner of the box with what is unseen [m], shape (3,).
        high: highest corner, as low.
        unseen: what a scan lacks of the object.
        empty: nodes that the scan saw empty; bodies are not drawn down into them, legs and poles are, since scans lose these.
    """
    drawn = field.copy()
    for side in range(4):
        if unseen.sides[side] > 0.0 and unseen.base != "pole":
            _draw_out(drawn, axes, low, high, side)
    if unseen.is_flat_topped:
        _fill_top(drawn, axes, unseen.held)
    plan = np.asarray((drawn < 0).any(axis=2))
    if unseen.sides[4] > 0.0 and unseen.base == "pole":
        _draw_pole(drawn, axes, low, high)
    elif unseen.sides[4] > 0.0 and unseen.base == "legs":
        _draw_down(drawn, axes[2], low[2], plan & _corners(plan))
    elif unseen.sides[4] > 0.0:
        above = drawn.copy()
        _draw_down(drawn, axes[2], low[2], plan)
        carved = drawn if empty is None else np.where(empty & (above >= 0), above, drawn)
        # A solid that does not reach its carrier would be stretched down to it: furniture gets legs, the rest keeps its body.
        if unseen.stands and not _reaches(carved, axes[2], low[2]):
            _draw_down(carved, axes[2], low[2], plan & _corners(plan))
        if _reaches(carved, axes[2], low[2]):
            drawn = carved
    if unseen.stands and plan.any() and not _stands(drawn, axes, low[2]):
        _draw_down(drawn, axes[2], low[2], plan & _corners(plan))
    return drawn


def _draw_out(field: Field, axes: Sequence[Array], low: Array, high: Array, side: int) -> None:
    """Fill what lies between the outermost solid nodes and a side of the box."""
    axis, end = side // 2, side % 2
    rows, at, bound = np.moveaxis(field, axis, 0), axes[axis], low[axis]
    if end:
        rows, at, bound = rows[::-1], -at[::-1], -high[axis]
    solid = rows < 0
    first = np.where(solid.any(axis=0), solid.argmax(axis=0), 0)
    value = np.take_along_axis(rows, first[None], axis=0)[0]
    behind = (np.arange(len(at))[:, None, None] < first) & (at >= bound - 1e-9)[:, None, None] & (value < 0)
    rows[behind] = np.broadcast_to(value, rows.shape)[behind]


def _draw_pole(field: Field, axes: Sequence[Array], low: Array, high: Array) -> None:
    """Fill a pole below the middle of what was seen, and a round foot of the width of the box."""
    nodes = np.argwhere((field < 0).any(axis=2))
    if not len(nodes):
        return
    middle = nodes.mean(axis=0).round().astype(int)
    plan = np.zeros(field.shape[:2], dtype=np.bool_)
    seen = nodes[np.argsort(((nodes - middle) ** 2).sum(axis=1), kind="stable")[:4]]
    plan[seen[:, 0], seen[:, 1]] = True
    _draw_down(field, axes[2], low[2], plan)
    x, y = (axis - axis[k] for axis, k in zip(axes[:2], middle, strict=True))
    wide = 0.5 * float(min(high[:2] - low[:2]))
    step = float(axes[2][1] - axes[2][0])
    levels = (axes[2] >= low[2] - 1e-9) & (axes[2] <= low[2] + max(FOOT_M, 2.0 * step))
    foot = (x[:, None] ** 2 + y**2 <= wide**2)[:, :, None] & levels
    field[foot] = np.minimum(field[foot], -0.5 * step)


def _draw_down(field: Field, heights: Array, bottom: float, plan: Mask) -> None:
    """Fill what lies between the lowest solid nodes of some columns, shape (nx, ny), and the bottom [m]."""
    solid = field < 0
    lowest = np.where(plan & solid.any(axis=2), solid.argmax(axis=2), 0)
    value = np.take_along_axis(field, lowest[:, :, None], axis=2)
    below = (np.arange(len(heights)) < lowest[:, :, None]) & (heights >= bottom - 1e-9) & plan[:, :, None]
    field[below] = np.broadcast_to(value, field.shape)[below]


def _reaches(field: Field, heights: Array, bottom: float) -> bool:
    """True if a solid has nodes within a step of the bottom [m]."""
    step = float(heights[1] - heights[0])
    return bool((field[:, :, (heights >= bottom - 1e-9) & (heights <= bottom + step)] < 0).any())


def _fill_top(field: Field, axes: Sequence[Array], held: Sequence[tuple[float, float, float, float]]) -> None:
    """Close the holes of the level at which most columns end: there something stood that has an asset of its own, as on `held`."""
    from scipy.ndimage import binary_closing, binary_fill_holes

    solid = field < 0
    columns = solid.any(axis=2)
    if not columns.any():
        return
    highest = field.shape[2] - 1 - solid[:, :, ::-1].argmax(axis=2)
    top = int(np.bincount(highest[columns]).argmax())
    level = columns & (np.abs(highest - top) <= 1)
    if level.sum() < TOP_SHARE * columns.sum():
        return
    step = float(axes[0][1] - axes[0][0])
    for x0, y0, x1, y1 in held:
        level |= ((axes[0] >= x0) & (axes[0] <= x1))[:, None] & (axes[1] >= y0) & (axes[1] <= y1)
    reach = max(int(0.5 * HOLE_M / step), 1)
    closed = binary_closing(np.pad(level, reach), iterations=reach)[reach:-reach, reach:-reach]
    missing = binary_fill_holes(closed) & ~solid[:, :, top]
    field[missing, max(top - 1, 0)] = np.minimum(field[missing, max(top - 1, 0)], -0.5 * step)
    field[missing, top] = np.minimum(field[missing, top], -0.5 * step)


def _stands(field: Field, axes: Sequence[Array], bottom: float) -> bool:
    """Whether a solid has its center of mass well within what it stands on."""
    import shapely

    solid = field < 0
    levels = np.flatnonzero(solid.any(axis=(0, 1)) & (axes[2] >= bottom))
    if not len(levels):
        return False
    foot = np.argwhere(solid[:, :, levels[0] : levels[0] + 2].any(axis=2))
    nodes = np.argwhere(solid)
    if len(foot) < 3:
        return False
    safe = SAFE_SHARE * float(np.ptp(nodes[:, :2], axis=0).min() + 1)
    return bool(shapely.MultiPoint(foot).convex_hull.buffer(0.5 - safe).covers(shapely.Point(nodes[:, :2].mean(axis=0))))


def _corners(plan: Mask) -> Mask:
    """Nodes of a plan, shape (nx, ny), that legs stand below: squares at its four corners, two nodes wide at least."""
    nodes = np.argwhere(plan)
    legs = np.zeros_like(plan)
    wide = max(round(float(np.ptp(nodes, axis=0).min()) / LEG_SHARE), 2) if len(nodes) else 0
    for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)) if len(nodes) else ():
        i, j = nodes[np.argmax(x * nodes[:, 0] + y * nodes[:, 1])]
        first_x, first_y = (max(k - (wide - 1), 0) if s > 0 else k for k, s in ((i, x), (j, y)))  # inward from the corner
        legs[first_x : first_x + wide, first_y : first_y + wide] = True
    return legs
