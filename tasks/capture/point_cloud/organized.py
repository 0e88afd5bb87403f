"""Grids of points as depth cameras leave them: a frame with color and depth."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.point_cloud.pcd import Pcd
from tasks.capture.reading import FrameSource
from tasks.geometry.transforms import inverse

Array = NDArray[np.float64]

MIN_GRID_POINTS = 5_000
"""Fewer are not an image."""

MAX_RESIDUAL_PX = 1.0
"""Median distance between a pixel and the projection of its point, above which the grid is not that of a pinhole camera."""

_FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])
"""Cameras of OpenNI look along -z with +y up."""

MAX_UNIT_DEPTH = 100.0
"""Median depth above which the unit is the millimeter: depth cameras see 20 m."""


def grid_frame(pcd: Pcd, path: Path, name: str) -> FrameSource | None:
    """The frame of a depth camera, without a pose; None for rows of points and for grids of other scanners.

    The camera is where the viewpoint of the file says, or at the origin, and looks along +z or -z.
    """
    header, points = pcd.header, pcd.points
    if header.height < 2 or header.points < MIN_GRID_POINTS:
        return None
    is_finite = np.isfinite(points.positions).all(axis=1) & (np.abs(points.positions) < 1e9).all(axis=1) & points.positions.any(axis=1)
    v, u = np.divmod(np.flatnonzero(is_finite), header.width)
    if len(u) < MIN_GRID_POINTS:
        return None
    for to_camera in (np.eye(4), _FLIPPED, inverse(header.viewpoint), _FLIPPED @ inverse(header.viewpoint)):
        seen = points.positions[is_finite] @ to_camera[:3, :3].T + to_camera[:3, 3]
        lens = _lens(seen, u.astype(np.float64), v.astype(np.float64))
        if lens is not None:
            break
    else:
        return None
    depth = np.zeros(header.height * header.width, np.float32)
    scale = 0.001 if float(np.median(seen[:, 2])) > MAX_UNIT_DEPTH else 1.0
    depth[is_finite] = seen[:, 2] * scale
    colors = points.colors if points.colors is not None else np.full((header.points, 3), 180, np.uint8)
    image = np.ascontiguousarray(colors.reshape(header.height, header.width, 3))
    size = (header.width, header.height)
    depth_image = depth.reshape(header.height, header.width)
    return FrameSource(
        frame_id="0", color_file=path.name, depth_file=path.name, width=size[0], height=size[1], intrinsics=lens, depth_size=size,
        depth_intrinsics=lens, depth_scale=1.0, pose=None, color=partial(_held, image), depth=partial(_held, depth_image),
    )  # fmt: skip


def _held(pixels: NDArray[Any]) -> NDArray[Any]:
    """Pixels that are in memory already, where those of files are read when they are asked for."""
    return pixels


def _lens(seen: Array, u: Array, v: Array) -> tuple[float, float, float, float] | None:
    """fx, fy, cx and cy [px] of a pinhole camera that sees points, shape (n, 3), at pixels; None if none does."""
    if not (seen[:, 2] > 0).all():
        return None
    numbers = []
    for axis, pixels in enumerate((u, v)):
        slope = seen[:, axis] / seen[:, 2]
        if float(np.ptp(slope)) < 1e-3:
            return None
        (focal, center), *_ = np.linalg.lstsq(np.stack([slope, np.ones_like(slope)], axis=1), pixels, rcond=None)
        if focal <= 1.0 or float(np.median(np.abs(focal * slope + center - pixels))) > MAX_RESIDUAL_PX:
            return None
        numbers.append((float(focal), float(center)))
    (fx, cx), (fy, cy) = numbers
    return fx, fy, cx, cy
