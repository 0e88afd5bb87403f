"""A scene before and after its optimization, from one camera, with what collides marked.

Objects that collide keep their place in the picture, whatever is cut away around them: they are tinted, and a ring lies
where they overlap, also when something stands before it. All else is paler than in the other pictures, so that the marks
stand out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.proximity import closest_points
from tasks.geometry.rendering import Camera
from tasks.stats.photographs import developed, photograph
from tasks.stats.scenes import PictureConfig, RoomOutline, opened, shown

if TYPE_CHECKING:
    import trimesh
    from PIL.ImageDraw import ImageDraw

    from schemas.optimization import Contact

Array = NDArray[np.float64]
Parts = Sequence["trimesh.Trimesh"]

DEEP_M = 0.002
"""Pairs that penetrate deeper count as collisions: resting contact of two meshes is a millimetre or so."""

_NEAR_M = 0.01  # surfaces cut each other where they come this near; finer than the samples on a sofa lie apart
_SAMPLES = 3000  # points per object: one every 3 cm on a sofa
_TINT = np.array([214.0, 36.0, 44.0])  # a red that no wood and no skin of a sofa has
_TINT_SHARE = 0.62  # the shading still shows which way a face is turned
_PALE = 0.8  # share of gray in what does not collide
_RING_PX = (11.0, 90.0)  # smallest and largest radius: to be seen, and not to be taken for the room
_LINE_PX, _HALO_PX = 2.2, 5.0  # the halo keeps the ring visible on red objects


@dataclasses.dataclass(frozen=True)
class OverlapPlace:
    """Where two objects overlap, world frame [m]: center, shape (3,), and radius of the ball around it."""

    center: Array
    radius: float


def colliding_pairs(contacts: Iterable[Contact], phase: str) -> list[tuple[str, str]]:
    """Names of the pairs that penetrate deeper than 2 mm in a phase and may not, in order."""
    return sorted((c.instance_a, c.body_b) for c in contacts if c.phase == phase and not c.is_allowed and c.penetration_m > DEEP_M)


def overlap_place(first: Parts, second: Parts) -> OverlapPlace:
    """Where two objects overlap: around all points at which the surface of one comes near that of the other.

    Where one is wholly inside the other no surfaces meet: then it is the overlap of their boxes.

    Parts are in the world frame [m].
    """
    (low_a, high_a), (low_b, high_b) = (_bounds(parts) for parts in (first, second))
    low, high = np.maximum(low_a, low_b), np.minimum(high_a, high_b)
    low, high = np.minimum(low, high), np.maximum(low, high)  # objects apart: the gap between them
    a, b = (_samples(parts, low - _NEAR_M, high + _NEAR_M) for parts in (first, second))
    near = [points[_distances(points, parts) < _NEAR_M] for points, parts in ((a, second), (b, first)) if len(points)]
    met = np.concatenate([np.zeros((0, 3)), *near])
    if len(met):
        low, high = met.min(axis=0), met.max(axis=0)
    return OverlapPlace((low + high) / 2, float(np.linalg.norm(high - low) / 2))


def marked_picture(
    objects: Mapping[str, Parts],
    shell: Mapping[str, Parts],
    pairs: Sequence[tuple[str, str]],
    outline: RoomOutline,
    camera: Camera,
    config: PictureConfig | None = None,
) -> bytes:
    """JPEG of a scene, the `pairs` that collide marked.

    objects: parts of every instance, shell: parts of the room, by name, in the world frame [m]. pairs: names of both.
    Names of objects that are not there are passed over. A colliding wall or floor is ringed, but not tinted: it is
    behind everything. So is an object whose pose is not finite left out.
    """
    config = config or PictureConfig()
    objects, shell = _finite(objects), _finite(shell)
    colliding = {name for pair in pairs for name in pair}
    parts: list[trimesh.Trimesh] = opened([part for of in shell.values() for part in of], outline, camera, config)
    tinted = np.zeros(len(parts), dtype=np.bool_)
    for name, of in objects.items():
        visible = list(of) if name in colliding else shown([of], outline, camera, config)
        parts.extend(visible)
        tinted = np.append(tinted, np.full(len(visible), name in colliding))
    image = photograph(parts, camera, config, lambda colors, part: _marked(colors, part, tinted))
    known = {**shell, **objects}
    places = [overlap_place(known[a], known[b]) for a, b in pairs if a in known and b in known]
    return developed(_ringed(image, places, camera, config), config)


def _marked(colors: NDArray[np.float32], part: NDArray[np.int64], tinted: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Colors, shape (..., 3), with parts that are `tinted` in red and all others paler; what shows no part stays."""
    gray = colors.mean(axis=-1, keepdims=True)
    marked = np.where((part >= 0)[..., None], colors + np.float32(_PALE) * (gray - colors), colors)
    red = tinted[part] & (part >= 0)
    light = np.clip(gray[red] / 190.0, 0.45, 1.15)
    marked[red] = colors[red] + _TINT_SHARE * (_TINT * light - colors[red])
    return marked


def _finite(objects: Mapping[str, Parts]) -> dict[str, Parts]:
    """Objects without those that are nowhere."""
    return {name: of for name, of in objects.items() if of and all(np.isfinite(part.vertices).all() for part in of)}


def _bounds(parts: Parts) -> Array:
    """Lowest and highest corner [m], shape (2, 3)."""
    return np.array([np.min([p.bounds[0] for p in parts], axis=0), np.max([p.bounds[1] for p in parts], axis=0)])


def _samples(parts: Parts, low: Array, high: Array) -> Array:
    """Points on the faces of parts that reach into a box, those inside it [m], shape (n, 3)."""
    corners = np.concatenate([np.asarray(p.vertices, dtype=np.float64)[np.asarray(p.faces)] for p in parts])
    inside = (corners.max(axis=1) >= low).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1)
    a, b, c = corners[inside].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not area.sum() > 0:
        return np.zeros((0, 3))
    rng = np.random.default_rng(0)
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * area.sum()
    face = np.minimum(np.searchsorted(np.cumsum(area), steps), len(area) - 1)
    u, v = rng.random((2, _SAMPLES, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points = np.concatenate([a[face] + u * (b - a)[face] + v * (c - a)[face], a, b, c])
    return points[((points >= low) & (points <= high)).all(axis=1)]


def _distances(points: Array, parts: Parts) -> Array:
    """Distance of points (n, 3) to the surface of parts [m], shape (n,)."""
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([np.asarray(part.vertices, dtype=np.float64) for part in parts])
    faces = np.concatenate([np.asarray(part.faces, dtype=np.int64) + at for part, at in zip(parts, offsets[:-1], strict=True)])
    return closest_points(vertices, faces, points).distance


def _ringed(image: NDArray[np.float32], places: Sequence[OverlapPlace], camera: Camera, config: PictureConfig) -> NDArray[np.float32]:
    """The image with a ring around each place, its edges as smooth as those of the objects."""
    from PIL import Image, ImageDraw

    if not places:
        return image
    factor = config.oversampling
    drawn = Image.fromarray(np.clip(np.round(image), 0, 255).astype(np.uint8))
    drawn = drawn.resize((factor * drawn.width, factor * drawn.height), Image.Resampling.NEAREST)
    brush = ImageDraw.Draw(drawn)
    centers, depths = camera.project(np.array([place.center for place in places]))
    smallest, largest = (limit * camera.width / PictureConfig.width for limit in _RING_PX)
    rings = [
        (center * factor, float(np.clip(1.15 * camera.fx * place.radius / depth, smallest, largest)) * factor)
        for place, center, depth in zip(places, centers, depths, strict=True)
        if depth > 0
    ]
    for color, width in (((255, 255, 255), _HALO_PX), ((150, 0, 20), _LINE_PX)):  # all halos lie under all rings
        for center, radius in rings:
            _ring(brush, center, radius, color, max(1.0, width * factor * camera.width / PictureConfig.width))
    return np.asarray(drawn.reduce(factor), dtype=np.float32)


def _ring(brush: ImageDraw, center: Array, radius: float, color: tuple[int, int, int], width: float) -> None:
    reach = radius + width / 2
    brush.ellipse((*(center - reach), *(center + reach)), outline=color, width=round(width))
