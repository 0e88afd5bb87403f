"""Floor, walls and ceiling as images, baked from the scan's surface: what was hidden is filled in from around it."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.capture import RoomSurface, Shell
from tasks.geometry.meshes import vertex_colors
from tasks.geometry.rendering import RayScene
from tasks.geometry.triangles import face_normals, used_vertices
from tasks.settings import Config, Count, NonNegative, Positive, Share
from tasks.shell import floor_ring
from tasks.stage import Blobs
from tasks.surfaces import Chart

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Pixels = NDArray[np.float32]

STRUCTURE, LOOSE, OBJECT = 0, 1, 2
"""What a face of the scan is: of a floor, wall or ceiling; of nothing that was named; of an object, or at its border."""

_ALONG = 0.8
"""Cosine from which on a face of the scan is turned as the surface is: within 37 degrees, as noise and small bumps are."""

_LOOSE_M = 0.03
"""What nothing says is a floor or wall counts as such only so near to it."""

_MARGIN_PX = 1
"""Pixels around a wall: what is drawn between pixels never reaches over its end to the other one."""

_BORDER_M = 0.11
"""Of a floor and ceiling: as far as their slabs reach below the walls."""

_SWEEPS = 4
"""How often what is filled in is smoothed, at every size of the image."""


@dataclasses.dataclass(frozen=True)
class TextureConfig(Config):
    """How floor, walls and ceiling become images."""

    texel_m: Positive = 0.02  # as close as a fused scan has its vertices; sizes go up to the next power of two, as viewers want them
    max_px: Count = 1024  # of a side: 20 m
    reach_m: Positive = 0.1  # outlines of rooms are straight, walls are not
    rim_m: NonNegative = 0.04  # round what hides a surface: there scans mix the colors of both
    min_seen: Share = 0.05  # of a surface; what is filled in from less is a guess, and the room's one color no worse
    quality: Count = 90  # of a JPEG: differences that nobody sees, a fifth of a PNG


@dataclasses.dataclass(frozen=True)
class _Part:
    """Faces of a part of the scan that may be of floor, walls or ceiling: corners' indices, unit normals, middles [m], shape (m, 3) each,
    and which of them nothing says so of, shape (m,)."""

    mesh: trimesh.Trimesh
    faces: NDArray[np.int64]
    normals: Array
    middles: Array
    is_loose: Mask

    @staticmethod
    def of(part: trimesh.Trimesh, kind: NDArray[np.int8]) -> _Part:
        faces = np.asarray(part.faces, dtype=np.int64)[kind != OBJECT]
        vertices = np.asarray(part.vertices, dtype=np.float64)
        middles = (vertices[faces[:, 0]] + vertices[faces[:, 1]] + vertices[faces[:, 2]]) / 3
        return _Part(part, faces, face_normals(vertices, faces), middles, kind[kind != OBJECT] == LOOSE)

    def some(self, which: NDArray[np.int64]) -> trimesh.Trimesh:
        """A mesh of some of the faces, by index, and of their corners."""
        import trimesh

        count = len(self.mesh.vertices)
        used, faces = used_vertices(self.faces[which], count)
        mesh = trimesh.Trimesh(np.asarray(self.mesh.vertices)[used], faces, process=False)
        visual: Any = self.mesh.visual
        if visual.kind == "texture" and visual.uv is not None and len(visual.uv) == count:
            mesh.visual = trimesh.visual.TextureVisuals(uv=np.asarray(visual.uv)[used], material=visual.material)
        else:
            mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=_opaque(vertex_colors(self.mesh)[used]))
        return mesh


def _opaque(colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colors, shape (n, 3), as trimesh has them, shape (n, 4)."""
    return np.column_stack([colors, np.full(len(colors), 255, dtype=np.uint8)])


def baked_surfaces(
    room: Shell, parts: Sequence[trimesh.Trimesh], kinds: Sequence[NDArray[np.int8]], config: TextureConfig, blobs: Blobs
) -> list[RoomSurface]:
    """Rows of the surfaces of a room of which the scan shows enough; their images are put into `blobs`.

    parts: The scan's surface, world frame [m]. kinds: What each face of each part is, shape (m,).
    """
    usable = [_Part.of(part, kind) for part, kind in zip(parts, kinds, strict=True)]
    rows = []
    for name, bare in room_charts(room):
        chart, (columns, lines) = _grid(bare, config)
        across, up = np.meshgrid(
            (np.arange(columns) + 0.5) * chart.width / columns, (lines - np.arange(lines) - 0.5) * chart.height / lines
        )
        points, facing = chart.points(across, up)
        own = _own(name, chart, points, room)
        colors, seen = _looked_at(chart, points, facing, usable, config)
        seen = _without_rim(seen, (chart.height / lines, chart.width / columns), config.rim_m)
        share = float((seen & own).sum() / max(own.sum(), 1))
        if share < config.min_seen or not share:
            continue
        image = filled(_steadied(colors, seen), seen)
        rows.append(
            RoomSurface(
                scene_id=room.scene_id,
                surface=name,
                texture_blob=blobs.add(_jpeg(image, config.quality), "jpg"),
                origin=tuple(float(value) for value in chart.origin),
                u_axis=tuple(float(value) + 0.0 for value in chart.u_axis),
                v_axis=tuple(float(value) + 0.0 for value in chart.v_axis),
                width_m=chart.width,
                height_m=chart.height,
                texel_m=(chart.width / columns, chart.height / lines),
                seen_share=share,
                color=tuple(int(value) for value in np.median(image[seen & own], axis=0)),
            )
        )
    return rows


def room_charts(room: Shell) -> Iterator[tuple[str, Chart]]:
    """Floor, ceiling and walls of a room by the names of `tasks.shell.room_shell`, without margins.

    Raises:
        InputError: the floor polygon has no area or crosses itself.
    """
    ring = floor_ring(room)
    (low_x, low_y), (wide, deep) = ring.min(axis=0) - _BORDER_M, np.ptp(ring, axis=0) + 2 * _BORDER_M
    x, y, z = np.eye(3)
    yield "floor", Chart(np.array([low_x, low_y, 0.0]), x, y, float(wide), float(deep))
    yield "ceiling", Chart(np.array([low_x, low_y + deep, room.height_m]), x, -y, float(wide), float(deep))
    for index, (start, end) in enumerate(zip(ring, np.roll(ring, -1, axis=0), strict=True)):
        length = float(np.linalg.norm(end - start))
        yield f"wall_{index:02d}", Chart(np.array([*end, 0.0]), np.array([*(start - end) / length, 0.0]), z, length, room.height_m)
    for index, wall in enumerate(room.interior_walls):
        start, end = np.array(wall[:2]), np.array(wall[2:4])
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        corner = np.array([*(end + 0.5 * wall[4] * np.array([-along[1], along[0]])), 0.0])
        yield f"inner_{index:02d}", Chart(corner, np.array([*-along, 0.0]), z, length, 2 * wall[5], (wall[5], wall[4]))


def _grid(chart: Chart, config: TextureConfig) -> tuple[Chart, tuple[int, int]]:
    """A chart with margins, and the columns and lines of its image, both powers of two."""
    is_upright = bool(chart.v_axis[2])
    margin = _MARGIN_PX if is_upright else 0
    sizes, steps = [], []
    for extent in (chart.width, chart.height):
        least = int(np.ceil(extent / config.texel_m)) + 2 * margin
        size = min(1 << max(least - 1, 3).bit_length(), 1 << (max(config.max_px, 8).bit_length() - 1))
        sizes.append(size)
        steps.append(extent / (size - 2 * margin))
    around = margin * np.array(steps)
    origin = chart.origin - around[0] * chart.u_axis - around[1] * chart.v_axis
    fold = None if chart.fold is None else (chart.fold[0] + float(around[1]), chart.fold[1])
    width, height = chart.width + 2 * around[0], chart.height + 2 * around[1]
    return Chart(origin, chart.u_axis, chart.v_axis, float(width), float(height), fold), (sizes[0], sizes[1])


def _own(name: str, chart: Chart, points: Array, room: Shell) -> Mask:
    """Which points of a surface are its own: the floor inside of its outline, a wall without its openings."""
    import shapely

    if name in ("floor", "ceiling"):
        inside: Mask = shapely.contains_xy(shapely.Polygon(floor_ring(room)), points[..., 0], points[..., 1])
        return inside
    top = 0.5 * chart.height if chart.fold else chart.height
    own: Mask = (points[..., 2] > 0.0) & (points[..., 2] < top + chart.origin[2])
    place = (points - chart.origin) @ chart.u_axis
    middle = chart.origin - (0.0 if chart.fold is None else 0.5 * chart.fold[1]) * chart.normal
    for opening in room.openings or ():
        ends = np.asarray(opening, dtype=np.float64)[:4].reshape(2, 2) - middle[:2]
        if np.abs(ends @ chart.normal[:2]).max() < 0.01:
            low, high = sorted(ends @ chart.u_axis[:2])
            own &= ~((place > low) & (place < high) & (points[..., 2] > opening[4]) & (points[..., 2] < opening[5]))
    return own


def _looked_at(chart: Chart, points: Array, facing: Array, parts: Sequence[_Part], config: TextureConfig) -> tuple[NDArray[np.uint8], Mask]:
    """Color of the scan's surface before or behind points, seen from the room, shape (..., 3), and where there is any, shape (...)."""
    thickness = 0.0 if chart.fold is None else chart.fold[1]
    back = config.reach_m if chart.fold is None else min(config.reach_m, 0.45 * thickness)
    chosen = []
    for part in parts:
        which = np.flatnonzero(np.abs(part.normals @ chart.normal) > _ALONG)
        depth = (part.middles[which] - chart.origin) @ chart.normal
        if chart.fold is not None:  # from the face that is nearer
            depth = np.abs(depth + 0.5 * thickness) - 0.5 * thickness
        which = which[np.abs(depth) < np.where(part.is_loose[which], _LOOSE_M, 2 * config.reach_m)]
        if len(which):
            chosen.append(part.some(which))
    scene = RayScene(chosen)
    rays = np.concatenate([points + config.reach_m * facing, -(config.reach_m + back) * facing], axis=-1).astype(np.float32)
    hits = scene.cast(rays)
    hits["t_hit"] = np.where(hits["t_hit"] <= 1.0, hits["t_hit"], np.inf)
    return scene.colors(hits), np.isfinite(hits["t_hit"])


def _without_rim(seen: Mask, texel: tuple[float, float], rim_m: float) -> Mask:
    """Pixels that were seen and lie farther from those that were not, or all of them where that would leave less than half.

    texel: Height and width of a pixel [m].
    """
    from scipy.ndimage import distance_transform_edt

    kept: Mask = np.asarray(distance_transform_edt(seen, sampling=texel)) > rim_m
    return kept if 2 * kept.sum() >= seen.sum() else seen


def _steadied(colors: NDArray[np.uint8], seen: Mask) -> Pixels:
    """The median of each pixel and its four neighbors, of those that were seen, channel by channel: single pixels tell of noise."""
    padded = np.pad(np.where(seen[..., None], colors, np.int16(999)).astype(np.int16), ((1, 1), (1, 1), (0, 0)), constant_values=999)
    h, w = seen.shape
    stack = np.stack([padded[1 + y : 1 + y + h, 1 + x : 1 + x + w] for y, x in ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0))], axis=-1)
    stack.sort(axis=-1)
    middle = np.maximum((stack < 999).sum(axis=-1, keepdims=True) - 1, 0) // 2
    return np.take_along_axis(stack, middle, axis=-1)[..., 0].astype(np.float32)


def filled(colors: Pixels, seen: Mask) -> NDArray[np.uint8]:
    """Pixels that were not seen as means of those around them, smoothly, from coarse to fine; the others as they are.

    colors: shape (h, w, 3), 0..255, h and w powers of two. seen: shape (h, w), somewhere true. Returns shape (h, w, 3).
    """
    levels = [(np.where(seen[..., None], colors, np.float32(0.0)).astype(np.float32), seen)]
    while max(levels[-1][1].shape) > 1:
        levels.append(_halved(*levels[-1]))
    image = levels[-1][0]
    for known, mask in reversed(levels[:-1]):
        h, w = mask.shape
        image = np.repeat(np.repeat(image, h // image.shape[0], axis=0), w // image.shape[1], axis=1)
        image = np.where(mask[..., None], known, image)
        if not mask.all():
            for _ in range(_SWEEPS):
                around = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
                mean = 0.25 * (around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:])
                image = np.where(mask[..., None], known, mean)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def _halved(colors: Pixels, seen: Mask) -> tuple[Pixels, Mask]:
    """An image of half the size, where it has more than one pixel: means of what was seen."""
    total, count = colors, seen.astype(np.float32)
    if seen.shape[0] > 1:
        total, count = total[::2] + total[1::2], count[::2] + count[1::2]
    if seen.shape[1] > 1:
        total, count = total[:, ::2] + total[:, 1::2], count[:, ::2] + count[:, 1::2]
    means: Pixels = (total / np.maximum(count, 1.0)[..., None]).astype(np.float32)
    return means, count > 0


def _jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    """An image, shape (h, w, 3), as JPEG with colors as fine as brightness."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(image).save(out, format="JPEG", quality=quality, subsampling=0)
    return out.getvalue()
