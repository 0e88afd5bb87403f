"""How frames see a support: which of them best, within which box, and which of their pixels lie where small objects can be."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.views import border_contact, depth_tolerance
from tasks.capture.reading import FrameSource
from tasks.capture.small_objects.lifting import DepthView, at_color, depths, visible_points
from tasks.capture.small_objects.supports import SupportSlab

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_LEAST_POINTS = 20
"""Of a support that a frame has to see before it shows it."""

_SPACING_M = 0.03
"""Distance over which a support's points are one surface [m]: a scan mesh's vertices lie as far from each other."""

_BOARD_M = 0.015
"""What is so near to a board's height is the board [m]: its unevenness, and drift of poses."""


@dataclasses.dataclass(frozen=True)
class CarryingInstance:
    """An instance that may carry small objects. slabs: Where they can be. points: Its own, world frame [m], shape (n, 3)."""

    instance_id: str
    category: str
    slabs: tuple[SupportSlab, ...]
    points: Array


@dataclasses.dataclass(frozen=True)
class SupportView:
    """A frame that shows a support. frame: As the scan has it. allowed: Pixels of its depth whose points lie where small objects can
    be, shape (h, w). board: Those of them that are the boards themselves. score: How well it shows the support's own points."""

    frame: FrameSource
    view: DepthView
    allowed: Bools
    board: Bools
    score: float


def support_view(frame: FrameSource, view: DepthView, support: CarryingInstance) -> SupportView:
    """How a frame sees a support. Its score is the share of the support's points that it sees, times the square root of the area of their
    box, times one minus its contact with the image's border: as `schemas.capture.Mask` has it (specs A.5)."""
    world = view.points()
    measured = view.depth > 0
    allowed, board = np.zeros(view.depth.shape, dtype=bool), np.zeros(view.depth.shape, dtype=bool)
    for slab in support.slabs:
        local = slab.local(world)
        inside = measured & ((local >= slab.low) & (local <= slab.high)).all(axis=-1)
        allowed |= inside
        board |= inside & (np.abs(local[..., 2]) <= _BOARD_M) & (slab.inset(local) >= 0)
    seen, row, column = _seen(view, support)
    score = 0.0
    if seen.sum() >= _LEAST_POINTS:
        area = np.zeros(view.depth.shape, dtype=bool)
        area[row[seen].min() : row[seen].max() + 1, column[seen].min() : column[seen].max() + 1] = True
        score = float(seen.mean() * np.sqrt(area.sum()) * (1 - border_contact(area)))
    return SupportView(frame, view, allowed, board, score)


def best_views(views: Sequence[SupportView], most: int) -> list[int]:
    """The frames that show a support best, at most so many, best first."""
    shown = [i for i, view in enumerate(views) if view.score > 0]
    return sorted(shown, key=lambda i: (-views[i].score, i))[:most]


def support_box(view: SupportView, support: CarryingInstance) -> Array:
    """The box x0, y0, x1, y1 of a support's seen points in a frame's color image [px], shape (1, 4); none, (0, 4), where it sees none."""
    seen, _, _ = _seen(view.view, support)
    if seen.sum() < _LEAST_POINTS:
        return np.zeros((0, 4))
    local = (support.points[seen] - view.view.pose[:3, 3]) @ view.view.pose[:3, :3]
    fx, fy, cx, cy = view.frame.intrinsics
    x, y = fx * local[:, 0] / local[:, 2] + cx, fy * local[:, 1] / local[:, 2] + cy
    low, high = np.percentile([x, y], [1, 99], axis=1)  # a few points lie beyond its edges
    return np.clip([[low[0], low[1], high[0], high[1]]], 0, [view.frame.width, view.frame.height] * 2)


def support_pixels(view: SupportView, support: CarryingInstance) -> Bools:
    """The support in a frame's color image by its own seen points, shape (height, width): pixels that lie between them."""
    from scipy.ndimage import binary_closing, distance_transform_edt

    seen, row, column = _seen(view.view, support)
    drawn = np.zeros(view.view.depth.shape, dtype=bool)
    if not seen.any():
        return at_color(drawn, view.frame)
    drawn[row[seen], column[seen]] = True
    reach = view.view.intrinsics[0] * _SPACING_M / float(np.median(view.view.depth[row[seen], column[seen]]))
    near = distance_transform_edt(~drawn) <= reach
    return at_color(np.asarray(binary_closing(near, iterations=max(1, round(reach)))) | near, view.frame)


def slab_window(view: SupportView) -> tuple[int, int, int, int]:
    """The box x0, y0, x1, y1 of what may be small objects in a frame's color image [px], the ends exclusive."""
    rows, columns = np.nonzero(view.allowed)
    dfx, dfy, dcx, dcy = view.view.intrinsics
    fx, fy, cx, cy = view.frame.intrinsics
    x = (np.array([columns.min(), columns.max() + 1]) - dcx) / dfx * fx + cx
    y = (np.array([rows.min(), rows.max() + 1]) - dcy) / dfy * fy + cy
    x0, x1 = np.clip(np.rint(x), 0, view.frame.width).astype(int)
    y0, y1 = np.clip(np.rint(y), 0, view.frame.height).astype(int)
    return int(x0), int(y0), int(x1), int(y1)


def _seen(view: DepthView, support: CarryingInstance) -> tuple[Bools, NDArray[np.int64], NDArray[np.int64]]:
    """Which of a support's points a frame sees, and their rows and columns."""
    if not len(support.points):
        return np.zeros(0, dtype=bool), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    return visible_points(view, support.points, depth_tolerance(depths(view, support.points)))
