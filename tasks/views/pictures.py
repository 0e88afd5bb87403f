"""Pictures as files, and pictures of assets from around."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at
from tasks.views.crops import filling

if TYPE_CHECKING:
    import trimesh

Image = NDArray[np.uint8]

FOV_RADIANS = 0.6
"""Of cameras around an asset: as a photo from some steps away, with little perspective."""

DRAWN = 1.5
"""Pictures are drawn this much larger than asked for, then cut out and shrunk."""

THUMBNAIL_PX = 96
"""Side of a thumbnail: ten of them fit beside each other, and one takes a few milliseconds."""

THUMBNAIL_TURN_RADIANS, THUMBNAIL_PITCH_RADIANS = 0.6, 0.4
"""Where thumbnails are seen from: beside the front (+X), towards +Y, and above, so that three sides show."""


def png_of(image: NDArray[np.uint8]) -> bytes:
    """A picture, shape (h, w, 3) or (h, w, 4), as PNG."""
    import PIL.Image

    file = io.BytesIO()
    PIL.Image.fromarray(np.ascontiguousarray(image)).save(file, "PNG")
    return file.getvalue()


def thumbnail(parts: Sequence[trimesh.Trimesh]) -> bytes:
    """A small picture of an asset's parts, +Z up and front +X, on white, as PNG: the same parts, the same bytes."""
    return png_of(seen_from([(THUMBNAIL_PITCH_RADIANS, THUMBNAIL_TURN_RADIANS)], parts, THUMBNAIL_PX)[0])


def around(parts: Sequence[trimesh.Trimesh], yaws: int, pitches_radians: tuple[float, ...], side: int) -> Image:
    """Pictures of parts from all around, on white, each as large as its square lets it be: shape (pitches * yaws, side, side, 3).

    pitches_radians: How far the camera looks down. The first picture of each pitch is from +x, the others follow counter-clockwise.
    """
    return seen_from([(pitch, yaw) for pitch in pitches_radians for yaw in 2 * np.pi * np.arange(yaws) / yaws], parts, side)


def seen_from(ways: Iterable[tuple[float, float]], parts: Sequence[trimesh.Trimesh], side: int) -> Image:
    """Pictures of parts on white, each as large as its square lets it be, shape (n, side, side, 3). ways: how far each camera looks down,
    and how far it stands about +Z from +X [rad]."""
    corners = np.array([bound for part in parts for bound in part.bounds])
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, radius = 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-3)
    far = radius / np.sin(0.5 * FOV_RADIANS)
    scene, points = RayScene(parts), np.concatenate([np.asarray(part.vertices) for part in parts])
    pictures, width = [], round(DRAWN * side)
    for pitch, yaw in ways:
        way = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
        camera = Camera.with_fov(look_at(middle + far * way, middle), width, width, FOV_RADIANS)
        drawn = scene.render(camera, window=camera.window(points))
        pictures.append(filling(drawn.color, drawn.part >= 0, side))
    return np.stack(pictures)
