"""Which way is up in a scan that has frames alone: away from what carries things, however cameras were held."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.views import camera_up, chosen_frames
from tasks.capture.reading import FrameSource
from tasks.capture.rooms.floor_levels import BAND_M, SeenLevel
from tasks.capture.segmentation.frame import FrameConfig
from tasks.capture.segmentation.organized import organized_frame
from tasks.capture.segmentation.planes import MIN_ANGLE_COS, FramePlane, FramePlanes, frame_planes
from tasks.capture.small_objects.lifting import DepthView, depth_view

Array = NDArray[np.float64]

_MOST_FRAMES = 12
"""Frames that are asked: of a walk through a room most show some floor or table."""

_AGREE_DEGREES = 6.0
"""Between two frames' supports: their noise, and a tracker's drift."""

_SAME_LEVEL_M, _LEAST_M2 = 0.025, 0.15
"""Between frames' views of one level and its middle [m], drift of poses; and least of it that is seen, over all frames [m2]: less is the
lid of a box."""

_HIGHEST_M = 3.0
"""Nobody holds a camera higher over what carries things [m]: a plane farther off is a wall that it looks at."""

_LEVEL_POINTS = 4000
"""Of a level, points by which its height is told: its median is then known to a fiftieth of the depth noise."""

_LEVEL_ROUNDS = 8
"""Times that the middle of a level moves to the mean of those around it: each halves the way that is left."""

_BAND_SPACINGS, _LEAST_BAND_M = 3.0, 0.01
"""Depth noise of a fused floor in distances of its vertices; and least [m]."""

_LEAST_SHARE = 0.25
"""Of the pixels that a direction needs behind it, before cameras are believed instead."""

_UPRIGHT, _SOME_SHARE = 0.8, 0.05
"""Length of the mean of the cameras' own up from which they were held upright; and of all supports' pixels that look up then, to be
believed: who films a room may look at its floor now and then."""


def scan_level(frames: Sequence[FrameSource], spacing: float, config: FrameConfig) -> SeenLevel | None:
    """Up by the normal of the supports of most pixels of some frames, within reach of a person; else that of the cameras on average, None
    where they disagree.

    spacing: Of the vertices of the surface that was fused from them [m], which follows depth noise.

    Raises:
        InputError: images of a frame cannot be read.
    """
    band = float(np.clip(_BAND_SPACINGS * spacing, _LEAST_BAND_M, BAND_M))
    views = [depth_view(frames[index], np.eye(4)) for index in chosen_frames(frames, _MOST_FRAMES)]
    seen = [(view, _planes(view, config)) for view in views if view is not None]
    supports = _upward([(view, own) for view, planes in seen if (own := planes.support) is not None and own.plane.offset <= _HIGHEST_M])
    if supports:
        directions = np.array([view.pose[:3, :3] @ support.plane.normal for view, support in supports])
        counts = np.array([float(support.pixels.sum()) for _, support in supports])
        agrees = directions @ directions.T > np.cos(np.deg2rad(_AGREE_DEGREES))
        best = int((agrees @ counts).argmax())
        if (agrees[best] * counts).sum() >= _LEAST_SHARE * counts.sum():
            mean = (directions * (agrees[best] * counts)[:, None]).sum(axis=0)
            up = mean / np.linalg.norm(mean)
            return SeenLevel(up, _lowest(seen, up, config.planes.storey_m), band)
    up = camera_up(frames)
    return None if up is None else SeenLevel(up, np.zeros((0, 3)), band)


def _upward(supports: list[tuple[DepthView, FramePlane]]) -> list[tuple[DepthView, FramePlane]]:
    """Supports that look up in their images, where cameras were held upright and some see one: walls before level cameras are none."""
    upward = [(view, support) for view, support in supports if -support.plane.normal[1] > MIN_ANGLE_COS]
    pixels, all_pixels = (sum(int(support.pixels.sum()) for _, support in each) for each in (upward, supports))
    held = np.mean([-view.pose[:3, 1] for view, _ in supports], axis=0) if supports else np.zeros(3)
    return upward if np.linalg.norm(held) >= _UPRIGHT and pixels >= _SOME_SHARE * all_pixels else supports


def _planes(view: DepthView, config: FrameConfig) -> FramePlanes:
    frame = organized_frame(view, config.farthest_m, config.window_m, config.window_sigmas, config.gate_sigmas)
    return frame_planes(frame, config.planes)


def _lowest(seen: Sequence[tuple[DepthView, FramePlanes]], up: Array, storey_m: float) -> Array:
    """Points of the lowest level along `up` of which enough is seen, in the scan frame [m], shape (n, 3).

    storey_m: distance of levels that are a table and the floor, not one floor by poses that drift [m].
    """
    levels = [
        (view.points()[each.pixels], each.area_m2, is_carrier)
        for view, planes in seen
        for each, is_carrier in (*((own, True) for own in (planes.support, *planes.lower)), *((top, False) for top in planes.tops))
        if each is not None and view.pose[:3, :3] @ each.plane.normal @ up > np.cos(np.deg2rad(_AGREE_DEGREES))
    ]
    if not levels:
        return np.zeros((0, 3))
    height = np.array([float(np.median(points @ up)) for points, _, _ in levels])
    area, carries = np.array([area for _, area, _ in levels]), np.array([carries for _, _, carries in levels])
    total = (np.abs(height[:, None] - height[None, :]) < _SAME_LEVEL_M) @ area
    lowest = float(height[total >= min(_LEAST_M2, total.max())].min())
    # Less than a storey above it what carries things is the same floor, by the poses of other frames: most of it is right.
    is_near = (height >= lowest) & (height < lowest + storey_m)
    is_near &= carries if (is_near & carries).any() else True
    middle = float(height[is_near][np.argmax(total[is_near])])
    for _ in range(_LEVEL_ROUNDS):
        near = np.abs(height - middle) < _SAME_LEVEL_M
        # What carries things comes before tops that are as high within a tracker's drift.
        chosen = near & carries if (near & carries).any() else near
        middle = float(np.average(height[chosen], weights=area[chosen]))
    counts = np.maximum(_LEVEL_POINTS * area / area[chosen].sum(), 1.0).astype(np.int64)
    # Every plane gives points by its area, however many pixels it has.
    rows = {k: np.linspace(0, len(levels[k][0]) - 1, counts[k]).round().astype(np.int64) for k in np.flatnonzero(chosen)}
    return np.concatenate([levels[k][0][row] for k, row in rows.items()])
