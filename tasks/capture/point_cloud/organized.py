"""Grids of points as depth cameras leave them: a frame with color and depth."""

from __future__ import annotations

import dataclasses
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.files.ply_elements import GRAY
from tasks.capture.point_cloud.pcd import Pcd
from tasks.capture.point_cloud.points import INSTANCE_NAMES, LABEL_NAMES, NORMAL_NAMES, Points
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


@dataclasses.dataclass(frozen=True)
class GridFrame:
    """The frame of a depth camera. from_file: the file's coordinates to those of the frame's pose [m], 4x4. notes: a line each."""

    frame: FrameSource
    from_file: Array
    notes: tuple[str, ...]


def grid_frame(pcd: Pcd, path: Path, name: str) -> GridFrame | None:
    """The frame of a depth camera; None for rows of points and for grids of other scanners.

    The camera is where the viewpoint of the file says, or at the origin, and looks along +z or -z. The frame has the pose of the
    viewpoint if the file states one. Otherwise it has none, and coordinates are those of the camera.
    """
    header, points = pcd.header, pcd.points
    if header.height < 2 or header.points < MIN_GRID_POINTS:
        return None
    is_finite = np.isfinite(points.positions).all(axis=1) & (np.abs(points.positions) < 1e9).all(axis=1) & points.positions.any(axis=1)
    v, u = np.divmod(np.flatnonzero(is_finite), header.width)
    if len(u) < MIN_GRID_POINTS:
        return None
    viewpoint, is_placed = header.viewpoint, header.states_viewpoint
    # Points are in the frame that the viewpoint is in, or still in that of the camera.
    placements = ([inverse(viewpoint)] if is_placed else []) + [np.eye(4)]
    for turn, place in product((np.eye(4), _FLIPPED), placements):
        to_camera = turn @ place
        seen = points.positions[is_finite] @ to_camera[:3, :3].T + to_camera[:3, 3]
        lens = _lens(seen, u.astype(np.float64), v.astype(np.float64))
        if lens is not None:
            break
    else:
        return None
    depth = np.zeros(header.height * header.width, np.float32)
    scale = 0.001 if float(np.median(seen[:, 2])) > MAX_UNIT_DEPTH else 1.0
    depth[is_finite] = seen[:, 2] * scale
    notes = [f"{name}: a grid of {header.width} x {header.height} points is read as the frame of a depth camera"]
    if scale != 1.0:
        notes.append(f"{name}: is read as millimeters: in meters the camera would see {np.median(seen[:, 2]):.0f} m far")
    pose, from_file = None, _scaled(to_camera, scale)
    if is_placed:
        is_in_camera = place is placements[-1]
        to_world = viewpoint if is_in_camera else np.eye(4)
        from_file = _scaled(to_world, scale)
        pose = to_world @ inverse(to_camera)
        pose[:3, 3] *= scale
        where = "; points are in the frame of the camera" if is_in_camera else ""
        notes.append(f"{name}: the camera's pose is the VIEWPOINT of the file{where}")
    dropped = [field for field, _, count in header.fields if count == 1 and _is_dropped(field, points)]
    if dropped:
        notes.append(f"{name}: {', '.join(dropped)}: not used, a frame has color and depth alone")
    if points.colors is None:
        notes.append(f"{name}: has no colors: drawn in gray")
    colors = points.colors if points.colors is not None else np.full((header.points, 3), GRAY, np.uint8)
    image = np.ascontiguousarray(colors.reshape(header.height, header.width, 3))
    size = (header.width, header.height)
    depth_image = depth.reshape(header.height, header.width)
    frame = FrameSource(
        frame_id="000000", color_file=path.name, depth_file=path.name, width=size[0], height=size[1], intrinsics=lens, depth_size=size,
        depth_intrinsics=lens, depth_scale=1.0, pose=pose, color=partial(_held, image), depth=partial(_held, depth_image),
    )  # fmt: skip
    return GridFrame(frame, from_file, tuple(notes))


def _scaled(pose: Array, scale: float) -> Array:
    """A change of coordinates, 4x4, and of their unit after it."""
    return np.diag([scale, scale, scale, 1.0]) @ pose


def _is_dropped(field: str, points: Points) -> bool:
    """True for columns that points have a use for, and frames do not."""
    is_of_objects = points.objects is not None and field in (*INSTANCE_NAMES, *LABEL_NAMES)
    return is_of_objects or (points.normals is not None and any(field in axes for axes in NORMAL_NAMES))


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
