"""Posed color images as baking takes them: cameras in the world frame, pixels read when they are asked for; and which of them show an
object best."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.errors import InputError
from tasks.capture.reading import FrameSource
from tasks.geometry.rendering import Camera, in_picture
from tasks.settings import Config, Count

Array = NDArray[np.float64]

PROBES = 200
"""Points of an object that are looked for in a frame: the share that it shows is then known to 3 percent."""

AGREES_M, AGREES_PER_M = 0.04, 0.01
"""How far a reading may be off a point that it is of [m], and that much more per metre: scanned points are noisy, too."""

NEAREST_M = 0.5
"""Nearer cameras see a part alone, however well."""

LEAST_NEW = 0.02
"""A view that is worth less than this share of the best one, once the others are taken, is left out."""


@dataclasses.dataclass(frozen=True)
class ViewsConfig(Config):
    """Which frames objects are painted with."""

    frames: Count = 120  # of a scan, evenly spread: a walk repeats itself, and each is looked at once for all objects
    views: Count = 16  # of an object, the best from as many sides as there are: a texel takes eight at most


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


def views_of(frames: Sequence[FrameSource], poses: Mapping[str, ArrayLike]) -> list[ColorView]:
    """The frames that have a pose, in their order. poses: Camera to world by frame, 4x4 each [m]."""
    views = []
    for frame in frames:
        if frame.frame_id not in poses:
            continue
        pose = np.asarray(poses[frame.frame_id], dtype=np.float64).reshape(4, 4)
        depth_camera = None
        if frame.depth is not None and frame.depth_size is not None:
            depth_camera = Camera(pose, *frame.depth_intrinsics, *frame.depth_size)
        camera = Camera(pose, *frame.intrinsics, frame.width, frame.height)
        views.append(ColorView(camera, frame.color, depth_camera, frame.depth if depth_camera else None))
    return views


def best_views(
    views: Sequence[ColorView], objects: Mapping[str, Array], config: ViewsConfig
) -> tuple[dict[str, tuple[ColorView, ...]], list[str]]:
    """The views that show each object best, best first, and what of the frames could not be read. objects: scanned points by name, world
    frame [m], shape (n, 3).

    A view is worth the share of points that its depth image agrees with, over the distance; less, the nearer it is in direction to one
    that was taken already. Views without a depth image are left out: what stands before an object would be painted on it.
    """
    usable = [view for view in views if view.depth is not None and view.depth_camera is not None]
    usable = usable[:: -(-len(usable) // config.frames)] if usable else []
    probes = {name: points[:: -(-len(points) // PROBES)] for name, points in objects.items() if len(points)}
    worth, toward = np.zeros((len(probes), len(usable))), np.zeros((len(probes), len(usable), 3))
    problems = []
    for number, view in enumerate(usable):
        assert view.depth is not None
        assert view.depth_camera is not None
        try:
            depth = view.depth()
        except InputError as error:
            problems.append(str(error))
            continue
        for row, points in enumerate(probes.values()):
            away = view.camera.pose[:3, 3] - points.mean(axis=0)
            distance = max(float(np.linalg.norm(away)), NEAREST_M)
            worth[row, number] = _shown(points, view.camera, view.depth_camera, depth).mean() / distance
            toward[row, number] = away / max(float(np.linalg.norm(away)), 1e-9)
    return {name: tuple(usable[k] for k in _chosen(worth[row], toward[row], config.views)) for row, name in enumerate(probes)}, problems


def _shown(points: Array, camera: Camera, depth_camera: Camera, depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which points lie in a camera's picture and where its depth image [m] says, shape (n,)."""
    shown = in_picture(camera, points) & in_picture(depth_camera, points)
    pixel, away = depth_camera.project(points)
    column, row = np.clip(np.round(pixel).astype(np.int64), 0, [depth.shape[1] - 1, depth.shape[0] - 1]).T
    return np.asarray(shown & (np.abs(depth[row, column] - away) <= AGREES_M + AGREES_PER_M * away))


def _chosen(worth: Array, toward: Array, most: int) -> list[int]:
    """Numbers of the views that are taken, one after another, shape (k,). worth: shape (n,). toward: unit directions, shape (n, 3)."""
    taken: list[int] = []
    new = np.ones(len(worth))
    while len(taken) < most:
        gain = worth * new
        best = int(gain.argmax()) if len(gain) else 0
        if not len(gain) or gain[best] <= LEAST_NEW * worth.max():
            break
        taken.append(best)
        new = np.minimum(new, 1.0 - np.clip(toward @ toward[best], 0.0, 1.0))
        new[best] = 0.0
    return taken
