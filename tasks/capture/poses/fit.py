"""How well poses fit the depth of their frames: where two frames see one surface, both must have it in one place."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.reading import FrameSource
from tasks.geometry.transforms import inverse, transform_points

Array = NDArray[np.float64]

_FRAMES = 24
"""Frames that are compared, evenly over all: 276 pairs, of which a walk around a room has some dozens that see the same surface."""

_POINTS = 600
"""Of a frame: a quartile of them is good to a tenth."""

_SHARED = 0.2
"""Of a frame's points: pairs that share less say little."""

_OTHER_SURFACE_M = 0.3
"""Depths that differ by more are of two surfaces, one of which hides the other [m]."""

_LEAST_ALIKE = 0.3
"""Of what two frames share: where less is nearer than that, one does not see what the other does."""


_QUANTILE = 0.75
"""Of points, and of pairs: what slides along most of the surfaces that two frames share shows in a part of them only."""


@dataclasses.dataclass(frozen=True)
class PoseFit:
    """pairs: Of frames that see the same surface. misfit_m: How far apart they have it, the upper quartile over points, and over
    pairs [m]; 0 for no pair."""

    pairs: int
    misfit_m: float


def pose_fit(frames: Sequence[FrameSource]) -> PoseFit:
    """How well the poses of frames with depth fit one another.

    Raises:
        InputError: a depth image cannot be read.
    """
    usable = [frame for frame in frames if frame.pose is not None and frame.depth is not None and frame.depth_size is not None]
    chosen = [usable[i] for i in np.unique(np.linspace(0, len(usable) - 1, min(_FRAMES, len(usable))).round().astype(int))]
    clouds, images = [], []
    for frame in chosen:
        assert frame.depth is not None
        assert frame.pose is not None
        image = frame.depth()
        images.append(image)
        clouds.append(transform_points(_points(image, frame.depth_intrinsics), frame.pose))
    misfits = [
        misfit
        for i in range(len(chosen))
        for j in range(len(chosen))
        if i != j and (misfit := _misfit(clouds[i], images[j], chosen[j])) is not None
    ]
    if not misfits:
        return PoseFit(0, 0.0)
    return PoseFit(len(misfits), float(np.quantile(misfits, _QUANTILE)))


def _points(depth: NDArray[np.float32], intrinsics: Sequence[float]) -> Array:
    """Some of an image's points in its camera's frame [m], shape (n, 3)."""
    rows, columns = np.nonzero(depth > 0)
    step = max(1, len(rows) // _POINTS)
    rows, columns = rows[::step], columns[::step]
    fx, fy, cx, cy = intrinsics
    z = depth[rows, columns].astype(np.float64)
    return np.stack([(columns - cx) / fx * z, (rows - cy) / fy * z, z], axis=1)


def _misfit(points: Array, depth: NDArray[np.float32], frame: FrameSource) -> float | None:
    """How far points [m], shape (n, 3), are from the surface that a frame sees in their place, the upper quartile [m]; None where it sees
    others."""
    assert frame.pose is not None
    local = transform_points(points, inverse(frame.pose))
    z = np.maximum(local[:, 2], 1e-6)
    fx, fy, cx, cy = frame.depth_intrinsics
    u, v = local[:, 0] / z * fx + cx, local[:, 1] / z * fy + cy
    height, width = depth.shape
    inside = (local[:, 2] > 0.05) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    seen = depth[np.rint(v[inside]).astype(np.int64), np.rint(u[inside]).astype(np.int64)].astype(np.float64)
    off = np.abs(seen - local[inside, 2])[seen > 0]
    alike = off < _OTHER_SURFACE_M
    if len(off) < _SHARED * max(len(points), 1) or alike.sum() < _LEAST_ALIKE * len(off):
        return None
    return float(np.quantile(off[alike], _QUANTILE))
