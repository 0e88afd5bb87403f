"""Posed color images as baking takes them: cameras in the world frame, pixels read when they are asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.capture.reading import FrameSource
from tasks.geometry.rendering import Camera


@dataclasses.dataclass(frozen=True)
class ColorView:
    """A color image and, where there is one, the depth image that was taken with it.

    camera, depth_camera: In the world frame [m]; the pixels of each image. `color()` gives shape (h, w, 3) uint8, `depth()` metres,
    shape (h, w), 0 where there is no reading; both raise InputError.
    """

    camera: Camera
    color: Callable[[], NDArray[np.uint8]]
    depth_camera: Camera | None = None
    depth: Callable[[], NDArray[np.float32]] | None = None


def views_of(frames: Sequence[FrameSource], to_world: ArrayLike) -> list[ColorView]:
    """The frames that have a pose, in their order. to_world: Scan frame to world, 4x4 [m]."""
    turn, views = np.asarray(to_world, dtype=np.float64), []
    for frame in frames:
        if frame.pose is None:
            continue
        pose = turn @ frame.pose
        depth_camera = None
        if frame.depth is not None and frame.depth_size is not None:
            depth_camera = Camera(pose, *frame.depth_intrinsics, *frame.depth_size)
        camera = Camera(pose, *frame.intrinsics, frame.width, frame.height)
        views.append(ColorView(camera, frame.color, depth_camera, frame.depth if depth_camera else None))
    return views
