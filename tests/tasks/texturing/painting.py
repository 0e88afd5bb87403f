"""A body whose color is a function of the place, and images of it as a camera takes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import trimesh

from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at
from tasks.texturing.views import ColorView

Array = np.ndarray


def paint(points: Array) -> Array:
    """Smooth colors 40..220 of places [m], shape (..., 3) to (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(points, dtype=np.float64), -1, 0)
    return 130 + 90 * np.stack([np.sin(5 * x + 1), np.cos(4 * y - z), np.sin(3 * z + 2 * x)], axis=-1)


def ring(count: int, radius: float = 2.0, rise: float = 0.8, size: tuple[int, int] = (200, 150)) -> list[Camera]:
    """Cameras around the origin that look at it."""
    turns = 2 * np.pi * (np.arange(count) + 0.3) / count
    eyes = np.stack([radius * np.cos(turns), radius * np.sin(turns), rise * (-1.0) ** np.arange(count)], axis=1)
    return [Camera.with_fov(look_at(eye, np.zeros(3)), *size, 0.9) for eye in eyes]


def taken(camera: Camera, parts: Sequence[trimesh.Trimesh], color: Callable[[Array], Array] = paint, gain: float = 1.0) -> ColorView:
    """What a camera sees of parts, whose places have colors; what is behind is white, and nothing is read there."""
    rays = camera.rays()
    depth = RayScene(parts).cast(rays)["t_hit"]
    hit = np.isfinite(depth)
    image = np.full((*depth.shape, 3), 255.0)
    image[hit] = color(rays[hit][:, :3] + depth[hit][:, None] * rays[hit][:, 3:].astype(np.float64))
    pixels, read = np.clip(np.round(image * gain), 0, 255).astype(np.uint8), np.where(hit, depth, np.float32(0.0))
    return ColorView(camera, lambda: pixels, camera, lambda: read)
