"""Space that a scan's frames saw empty: depth maps of all scanned points from the frames' cameras, and the cells in front of them."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Frame, Instance
from schemas.errors import InputError
from tasks.geometry.meshes import read_points
from tasks.geometry.transforms import inverse, matrix
from tasks.geometry.triangles import distinct_rows
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

CUBE_M = 0.04
"""Points are drawn as cubes of this edge, so that depth maps have few holes and scenes few points."""

MAX_CAMERAS = 24
"""Frames of a walk around a room look alike; two dozen of them see what all of them saw."""

MAP_WIDTH_PX = 96
"""Width of depth maps. A pixel is as wide as a cube of points at 3 m, so that maps have few holes."""

FREE_MARGIN_M = 0.08
"""A cell is empty only if a surface was seen this far behind it: twice the edge of the cubes that stand for points."""

FREE_DISTANCE_M = 0.05
"""Cells this near to the instance's points are not empty: sightlines that graze a surface pass close above it."""

MAX_FREE_CELLS = 100_000
"""Cells of an instance's box that are tested: 6 m3 of those of 4 cm, a corner sofa. Larger boxes get a coarser grid."""


@dataclasses.dataclass(frozen=True)
class DepthMap:
    """A camera with the depth that it saw.

    pose: world to camera, 4x4 [m]. intrinsics: fx, fy, cx, cy of the map [px]. depth: nearest scanned surface, shape (h, w) [m],
    infinite where nothing was scanned.
    """

    to_camera: Array
    intrinsics: tuple[float, float, float, float]
    depth: Array


def scene_depth_maps(frames: Sequence[Frame], instances: Sequence[Instance], blobs: Mapping[str, bytes]) -> list[DepthMap]:
    """Depth maps of a scene's frames from the points of all its instances that can be read, as `depth_views` makes them."""
    if not any(frame.pose is not None for frame in frames):
        return []
    clouds = []
    for row in instances:
        with contextlib.suppress(InputError, KeyError):  # said where the instance itself is worked on
            clouds.append(read_points(blobs[row.points_blob], row.points_blob)[0])
    return depth_views(frames, np.concatenate([np.zeros((0, 3)), *(cube_middles(points) for points in clouds)]), CUBE_M)


def cube_middles(points: Array) -> Array:
    """Middles of the cubes of edge `CUBE_M` that points are in [m], shape (n, 3) to (m, 3)."""
    cells = np.floor(points / CUBE_M).astype(np.int64)
    return np.asarray((cells[distinct_rows(cells)[0]] + 0.5) * CUBE_M)


def depth_views(frames: Sequence[Frame], cubes: Array, edge_m: float) -> list[DepthMap]:
    """Depth maps of at most `MAX_CAMERAS` frames with a pose, evenly chosen in their order.

    Args:
        frames: frames of the scan.
        cubes: middles of the cubes in which anything was scanned, in the world frame [m], shape (n, 3).
        edge_m: edge of the cubes [m].
    """
    posed = [frame for frame in sorted(frames, key=lambda row: row.frame_id) if frame.pose is not None and frame.intrinsics[0] > 0]
    if not posed or not len(cubes):
        return []
    chosen = sorted({int(i) for i in np.linspace(0, len(posed) - 1, min(MAX_CAMERAS, len(posed))).round()})
    views = []
    for frame in (posed[i] for i in chosen):
        scale = min(MAP_WIDTH_PX / frame.width, 1.0)
        shape = (max(round(frame.height * scale), 1), max(round(frame.width * scale), 1))
        fx, fy, cx, cy = (value * scale for value in frame.intrinsics)
        to_camera = inverse(matrix(frame.pose or ()))
        local = np.ascontiguousarray(cubes @ to_camera[:3, :3].T + to_camera[:3, 3])
        depth = np.asarray(_compiled()["_splatted"](local, fx, fy, cx, cy, edge_m, *shape))
        views.append(DepthMap(to_camera, (fx, fy, cx, cy), depth))
    return views


def is_seen_empty(points: Array, views: Sequence[DepthMap]) -> NDArray[np.bool_]:
    """Points that some frame saw past, shape (n,): it has a scanned surface at least `FREE_MARGIN_M` behind the point.

    Args:
        points: points in the world frame [m], shape (n, 3).
        views: depth maps of the scan.
    """
    is_empty = np.zeros(len(points), dtype=np.bool_)
    for view in views:
        local = points @ view.to_camera[:3, :3].T + view.to_camera[:3, 3]
        is_empty |= np.asarray(_compiled()["_before"](np.ascontiguousarray(local), *view.intrinsics, view.depth, FREE_MARGIN_M))
    return is_empty


def box_cells(low: Array, high: Array, edge_m: float) -> Array:
    """Middles of the cells of a box [m], shape (n, 3): at most about `MAX_FREE_CELLS`, of an edge of at least `edge_m`."""
    edge = max(edge_m, float(np.prod(np.maximum(high - low, edge_m)) / MAX_FREE_CELLS) ** (1 / 3))
    axes = [np.arange(a + 0.5 * edge, max(b, a + edge), edge) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


@cache
def _compiled() -> Kernels:
    return compile_kernels(_splatted, _before)


def _splatted(local: Array, fx: float, fy: float, cx: float, cy: float, edge: float, height: int, width: int) -> Array:
    """Nearest depth per pixel of cubes in the camera's frame, each drawn as a square of its size."""
    depth = np.full((height, width), np.inf)
    for i in range(len(local)):
        z = local[i, 2]
        if z <= edge:
            continue
        u, v = fx * local[i, 0] / z + cx, fy * local[i, 1] / z + cy
        across, down = 0.5 * fx * edge / z, 0.5 * fy * edge / z
        left, right = max(int(np.floor(u - across + 0.5)), 0), min(int(np.floor(u + across + 0.5)), width - 1)
        top, bottom = max(int(np.floor(v - down + 0.5)), 0), min(int(np.floor(v + down + 0.5)), height - 1)
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                depth[row, column] = min(depth[row, column], z)
    return depth


def _before(local: Array, fx: float, fy: float, cx: float, cy: float, depth: Array, margin: float) -> NDArray[np.bool_]:
    """Points in the camera's frame that lie at least a margin in front of the surface of their pixel."""
    is_before = np.zeros(len(local), dtype=np.bool_)
    for i in range(len(local)):
        z = local[i, 2]
        if z <= 0.0:
            continue
        column, row = int(np.floor(fx * local[i, 0] / z + cx + 0.5)), int(np.floor(fy * local[i, 1] / z + cy + 0.5))
        if 0 <= row < depth.shape[0] and 0 <= column < depth.shape[1] and np.isfinite(depth[row, column]):
            is_before[i] = z + margin <= depth[row, column]
    return is_before
