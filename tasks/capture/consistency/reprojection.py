"""Agreement of depth images under a reading of their poses, unit and lens: each frame's points, projected into the other frames.

Only under the right reading do frames that see one surface have it in one place.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.reading import FrameSource
from tasks.geometry.transforms import inverse, transform_points

Array = NDArray[np.float64]

_VIEWS = 16
"""Frames that are compared, each with each: a walk around a room has some dozens of pairs that see the same surface."""

_POINTS = 400
"""Points of a frame: a share of them is good to 2 %."""

_LONGEST_STEP = 15
"""Frames between two of a pair of neighbors: half a second of video, after which a hand-held camera still sees the same."""

_TOLERANCE = 0.045
"""Difference of two depths of one surface, relative: noise and drift of hand-held tracking over a room."""

_MIN_SHIFT = 0.02
"""Mean shift, in image sizes, from which on two readings of a pair of frames predict different things."""


@dataclasses.dataclass(frozen=True)
class DepthSample:
    """A frame in memory. lens: fx, fy, cx, cy [px]; points: in its camera's frame [m], shape (n, 3); depth: image [m]."""

    pose: Array | None
    lens: tuple[float, float, float, float]
    points: Array
    depth: NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """A reading of a recording: change of each pose (4x4), factor on depth, factor on focal lengths; and its words for messages."""

    words: str
    pose: Callable[[Array], Array] = lambda pose: pose
    depth_factor: float = 1.0
    focal_factor: float = 1.0


STATED = Hypothesis("stated")


@dataclasses.dataclass(frozen=True)
class PairAgreement:
    """Agreement of all ordered pairs of views under a hypothesis.

    confirmed, compared: shares of the points of view j that view i confirms and could confirm, shape (n, n).
    pixels: positions of all points in each view, in image sizes, shape (n, points, 2).
    """

    confirmed: Array
    compared: Array
    pixels: NDArray[np.float32]

    def share(self, pairs: NDArray[np.bool_]) -> float:
        """Confirmed share of the points that can be compared in some pairs, 0 to 1; 0 without any."""
        compared = float(self.compared[pairs].sum())
        return float(self.confirmed[pairs].sum()) / compared if compared else 0.0


def views_of(frames: Sequence[FrameSource]) -> list[DepthSample]:
    """Some frames with depth, evenly over all and each with a neighbor; images that cannot be read are left out."""
    views = []
    for index in _chosen(len(frames)):
        frame = frames[index]
        assert frame.depth is not None
        # The stages that need an image report that it cannot be read.
        with contextlib.suppress(InputError):
            depth = frame.depth()
            points = _points(depth, frame.depth_intrinsics)
            if len(points):
                views.append(DepthSample(frame.pose, frame.depth_intrinsics, points, depth))
    return views


def _chosen(count: int) -> list[int]:
    if count <= _VIEWS:
        return list(range(count))
    step = int(np.clip(count // (3 * _VIEWS), 1, _LONGEST_STEP))
    first = np.unique(np.linspace(0, count - 1 - step, _VIEWS // 2).round().astype(int)).tolist()
    return sorted({*first, *(index + step for index in first)})


def _points(depth: NDArray[np.float32], lens: Sequence[float]) -> Array:
    """Points of an image at an even grid of pixels in its camera's frame [m], shape (n, 3)."""
    step = max(1, int(np.sqrt(depth.size / _POINTS)))
    sparse = depth[step // 2 :: step, step // 2 :: step]
    rows, columns = np.nonzero(sparse > 0)
    z = sparse[rows, columns].astype(np.float64)
    fx, fy, cx, cy = lens
    return np.stack([(columns * step + step // 2 - cx) / fx * z, (rows * step + step // 2 - cy) / fy * z, z], axis=1)


def agreement(views: Sequence[DepthSample], hypothesis: Hypothesis = STATED) -> PairAgreement:
    """Agreement of views that have poses under a hypothesis."""
    zoom = np.array([1 / hypothesis.focal_factor, 1 / hypothesis.focal_factor, 1.0]) * hypothesis.depth_factor
    poses = [hypothesis.pose(view.pose) for view in views if view.pose is not None]
    world = np.concatenate([transform_points(view.points * zoom, pose) for view, pose in zip(views, poses, strict=True)])
    counts = np.array([len(view.points) for view in views])
    owner = np.repeat(np.arange(len(views)), counts)
    confirmed, compared = np.zeros((2, len(views), len(views)))
    pixels = np.zeros((len(views), len(owner), 2), dtype=np.float32)
    for index, (view, pose) in enumerate(zip(views, poses, strict=True)):
        local = transform_points(world, inverse(pose))
        height, width = view.depth.shape
        fx, fy, cx, cy = view.lens
        z = np.maximum(local[:, 2], 1e-3)
        u = np.clip(local[:, 0] / z * fx * hypothesis.focal_factor + cx, -10 * width, 10 * width)
        v = np.clip(local[:, 1] / z * fy * hypothesis.focal_factor + cy, -10 * height, 10 * height)
        pixels[index, :, 0], pixels[index, :, 1] = u / width, v / height
        inside = (local[:, 2] > 1e-3) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5) & (owner != index)
        seen = view.depth[np.rint(v[inside]).astype(np.int64), np.rint(u[inside]).astype(np.int64)] * hypothesis.depth_factor
        is_readable = seen > 0
        off = np.abs(local[inside, 2][is_readable] - seen[is_readable]) / seen[is_readable]
        source = owner[inside][is_readable]
        compared[index] = np.bincount(source, minlength=len(views)) / counts
        confirmed[index] = np.bincount(source[off < _TOLERANCE], minlength=len(views)) / counts
    return PairAgreement(confirmed, compared, pixels)


def telling_pairs(views: Sequence[DepthSample], stated: PairAgreement, other: PairAgreement) -> NDArray[np.bool_]:
    """Pairs of views for which two readings predict different pixels, shape (n, n): others tell nothing of which is right."""
    shift = np.minimum(np.linalg.norm(stated.pixels - other.pixels, axis=2), 1.0)
    counts = [len(view.points) for view in views]
    sums = np.add.reduceat(shift, np.cumsum([0, *counts[:-1]]), axis=1)
    return np.asarray(sums / counts > _MIN_SHIFT)
