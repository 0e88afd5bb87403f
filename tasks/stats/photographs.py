"""Photographs of parts from a camera, softly lit: a ray for each pixel, and several where colors meet.

Light and the darkening of creases are found for pixels; the rays of a pixel share them.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.rendering import Camera, RayScene, Rendering

if TYPE_CHECKING:
    import trimesh

    from tasks.stats.scenes import PictureConfig

Floats = NDArray[np.float32]

Paint = Callable[[Floats, NDArray[np.int64]], Floats]
"""Colors from 0 to 255, shape (..., 3), and the part that is seen, -1 for none, shape (...), to other colors."""

_CONTRAST = 14
"""Neighbor pixels that differ more, of 255 in one channel, are seen with several rays: less is not seen as a stair."""


def photograph(parts: Sequence[trimesh.Trimesh], camera: Camera, config: PictureConfig, paint: Paint | None = None) -> Floats:
    """Colors of parts in the world frame from 0 to 255, shape (height, width, 3), softly lit from above and behind the camera.

    Edges are smooth: `config.oversampling` rays along each side of a pixel. `paint` changes the colors of single rays.
    """
    paint = paint or _as_they_are
    if not parts:
        image = np.empty((camera.height, camera.width, 3), dtype=np.float32)
        image[:] = config.background
        return paint(image, np.full(image.shape[:2], -1, dtype=np.int64))
    scene, factor = RayScene(parts), config.oversampling
    row, column = np.indices((camera.height, camera.width), dtype=np.float32)
    rays = _rays(camera, column, row)
    view = scene.render(camera, background=config.background, shade=False, rays=rays)
    light = _Light.of(view, camera, rays, factor)
    image = paint(light.on(view, rays, (slice(None), slice(None))), view.part)
    if factor == 1:
        return image
    at = np.nonzero(_edges(image))
    steps = (np.arange(factor, dtype=np.float32) + np.float32(0.5)) / np.float32(factor) - np.float32(0.5)
    across, down = (offset.reshape(-1) for offset in np.meshgrid(steps, steps))
    rays = _rays(camera, column[at][:, None] + across, row[at][:, None] + down)
    view = scene.render(camera, background=config.background, shade=False, rays=rays)
    image[at] = paint(light.on(view, rays, (at[0][:, None], at[1][:, None])), view.part).mean(axis=1)
    return image


def developed(image: Floats, config: PictureConfig) -> bytes:
    """JPEG of an image, colors from 0 to 255, shape (h, w, 3)."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.clip(np.round(image), 0, 255).astype(np.uint8)).save(file, "JPEG", quality=config.jpeg_quality, optimize=True)
    return file.getvalue()


def _as_they_are(colors: Floats, part: NDArray[np.int64]) -> Floats:
    return colors


def _rays(camera: Camera, column: Floats, row: Floats) -> Floats:
    """As `Camera.rays`, through any points of the picture [px], shape (..., 6)."""
    x, y = (column - np.float32(camera.cx)) / np.float32(camera.fx), (row - np.float32(camera.cy)) / np.float32(camera.fy)
    turn = camera.pose[:3, :3].astype(np.float32)
    rays = np.empty((*column.shape, 6), dtype=np.float32)
    rays[..., :3] = camera.pose[:3, 3]
    for axis in range(3):
        rays[..., 3 + axis] = turn[axis, 0] * x + turn[axis, 1] * y + turn[axis, 2]
    return rays


def _edges(image: Floats) -> NDArray[np.bool_]:
    """Pixels that differ from one of their neighbors, shape (height, width)."""
    shown = np.clip(image, 0, 255).astype(np.uint8)
    low, high = shown, shown
    for axis in (0, 1):
        low, high = _beside(low, axis, np.minimum), _beside(high, axis, np.maximum)
    return np.asarray((high - low > _CONTRAST).any(axis=2))


def _beside(values: NDArray[np.uint8], axis: int, choose: Any) -> NDArray[np.uint8]:
    """What `choose` takes of each pixel and of those before and after it."""
    chosen = values.copy()
    first, last = [slice(None)] * 3, [slice(None)] * 3
    first[axis], last[axis] = slice(None, -1), slice(1, None)
    before, after = tuple(first), tuple(last)
    choose(chosen[after], values[before], out=chosen[after])
    choose(chosen[before], values[after], out=chosen[before])
    return chosen


Planes = Sequence[Floats]
"""x, y and z of vectors, arrays of one shape: ten times as fast as vectors side by side."""


@dataclasses.dataclass(frozen=True)
class _Light:
    """Light over a picture, arrays of shape (height, width): normals evened out over neighbors, mean depths around [m]."""

    normals: Planes
    around: Planes
    key: Floats

    @staticmethod
    def of(view: Rendering, camera: Camera, rays: Floats, factor: int) -> _Light:
        """The light over a view. `factor`: rays along the side of a pixel, for which its widths are stated."""
        from scipy.ndimage import gaussian_filter, uniform_filter

        normal = _towards(view.normal, _to_eye(rays))
        blurred = _unit([np.asarray(gaussian_filter(plane, 3.0 / factor, truncate=2.5), dtype=np.float32) for plane in normal])
        seen = view.part >= 0
        around = []
        if seen.any():
            filled = np.where(seen, view.depth, view.depth[seen].max()).astype(np.float32)
            for size in (13, 41):  # rays: the foot of a leg, the foot of a wall
                odd = max(3, 2 * round(size / factor / 2 - 0.5) + 1)
                around.append(uniform_filter(uniform_filter(filled, odd), odd))
        key = camera.pose[:3, :3] @ np.array([-0.45, -0.75, -0.5])  # over the camera's left shoulder
        return _Light(blurred, around, (key / np.linalg.norm(key)).astype(np.float32))

    def on(self, view: Rendering, rays: Floats, at: Any) -> Floats:
        """Colors of a view, 0 to 255, with darkened creases, shape (..., 3); `at` says which pixels it looks through."""
        to_eye = _to_eye(rays)
        sharp = _towards(view.normal, to_eye)
        soft = [np.broadcast_to(plane[at], view.part.shape) for plane in self.normals]
        # an edge between two faces turns by more than noise does, and stays sharp
        noise = _dot(soft, sharp) > 0.82
        normal = [np.where(noise, a, b) for a, b in zip(soft, sharp, strict=True)]
        facing = np.clip(_dot(normal, to_eye), 0, 1)
        direct = np.clip(normal[0] * self.key[0] + normal[1] * self.key[1] + normal[2] * self.key[2], 0, 1)
        light = np.float32(0.67) + np.float32(0.14) * facing + np.float32(0.22) * direct + np.float32(0.07) * normal[2]
        seen = view.part >= 0
        light *= self._openness(np.where(seen, view.depth, np.float32(0)), at)
        light[~seen] = 1.0
        lit: Floats = view.color * light[..., None]
        return lit

    def _openness(self, depth: Floats, at: Any) -> Floats:
        """How little the surroundings stand before a point, 0.65 to 1, from depth alone; creases and contacts are darker."""
        shade = np.zeros_like(depth)
        for around in self.around:
            before = np.clip(depth - around[at], 0.0, None)
            # a few centimetres behind its surroundings: a crease; metres behind them: a background, which stays light
            shade += before * np.exp(before * np.float32(-5.0))
        return np.clip(np.float32(1.0) - np.float32(1.6) * shade, 0.65, 1.0).astype(np.float32)


def _to_eye(rays: Floats) -> list[Floats]:
    return _unit([-rays[..., 3 + axis] for axis in range(3)])


def _dot(a: Planes, b: Planes) -> Floats:
    total: Floats = a[0] * b[0]
    total += a[1] * b[1]
    total += a[2] * b[2]
    return total


def _unit(vectors: Planes) -> list[Floats]:
    length: Floats = np.maximum(np.sqrt(_dot(vectors, vectors)), np.float32(1e-6))
    return [np.divide(plane, length, dtype=np.float32) for plane in vectors]


def _towards(normals: Floats, to_eye: Planes) -> list[Floats]:
    """Unit normals, shape (..., 3), on the side of the camera."""
    normal: list[Floats] = [np.nan_to_num(normals[..., axis].astype(np.float32)) for axis in range(3)]
    side = np.sign(_dot(normal, to_eye))
    return [np.multiply(plane, side, dtype=np.float32) for plane in normal]
