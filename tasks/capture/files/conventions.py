"""Which convention the poses of a plain RGB-D folder follow, told from the depth images themselves.

Exporters differ in the direction of a pose, the axes of a camera and the order of a quaternion, and seldom say which.
Only with the right reading do the depth images of neighboring frames show the same surfaces in the same places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tasks.capture.reading import FrameSource
from tasks.geometry.rendering import Camera
from tasks.geometry.transforms import transform_points

CONVENTIONS = ("", "world-to-camera", "OpenGL", "OpenGL world-to-camera")
"""What a scan may mean by a pose, in the words of `trajectory`; the usual meaning first."""

QUATERNIONS = ("", "qw qx qy qz")
"""Order of a quaternion; real part last first."""

_PAIRS = 8
_PIXELS = 1500
_SEEN_SHARE = 0.1
"""Neighbors that share less than a tenth of their view say nothing."""

MIN_AGREEMENT = 0.5
CLEARLY_BETTER = 1.5
"""Another convention than the usual one is believed when half of the shared view agrees under it, and half as much again as usual."""


def agreement(frames: Sequence[FrameSource]) -> float:
    """Share of the depth readings that the next frame confirms where it looks at the same place, 0 to 1; 0 when none can be compared.

    The tolerance, 5 cm and 2 % of the depth, is that of hand-held tracking from one frame to the next.
    """
    usable = [frame for frame in frames if frame.pose is not None and frame.depth is not None and frame.depth_size is not None]
    if len(usable) < 2:
        return 0.0
    starts = np.unique(np.linspace(0, len(usable) - 2, _PAIRS).round().astype(int))
    shares = [share for i in starts if (share := _confirmed(usable[i], usable[i + 1])) is not None]
    return float(np.mean(shares)) if shares else 0.0


def _confirmed(first: FrameSource, second: FrameSource) -> float | None:
    """Share of a frame's readings that another confirms, of those that it could; None when there are too few."""
    assert first.depth is not None
    assert second.depth is not None
    a, b = first.depth(), second.depth()
    rows, columns = np.nonzero(a > 0.1)
    if len(rows) < _PIXELS // 4:
        return None
    step = max(1, len(rows) // _PIXELS)
    rows, columns = rows[::step], columns[::step]
    camera, other = _camera(first), _camera(second)
    z = a[rows, columns].astype(np.float64)
    local = np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z], axis=1)
    pixel, depth = other.project(transform_points(local, camera.pose))
    u, v = (np.round(np.clip(pixel[:, i], -1e6, 1e6)).astype(np.int64) for i in (0, 1))
    inside = (depth > 0.1) & (u >= 0) & (u < other.width) & (v >= 0) & (v < other.height)
    seen = b[v[inside], u[inside]].astype(np.float64)
    readable = seen > 0.1
    if readable.sum() < _SEEN_SHARE * len(rows):
        # A wrong convention also looks away: what is not confirmed at all speaks against it, but not as loudly as a contradiction.
        return 0.0
    return float((np.abs(seen - depth[inside])[readable] < 0.05 + 0.02 * seen[readable]).mean())


def _camera(frame: FrameSource) -> Camera:
    assert frame.pose is not None
    assert frame.depth_size is not None
    fx, fy, cx, cy = frame.depth_intrinsics
    return Camera(frame.pose, fx, fy, cx, cy, *frame.depth_size)
