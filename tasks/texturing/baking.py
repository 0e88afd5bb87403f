"""A texture from posed color images: every texel gets what the images show of its point of the surface.

An image counts where it sees the point: nothing stands between, and its depth reading, where it has one, agrees. The better it sees it,
the more it counts. Each image has an exposure of its own, which is solved for; what disagrees with most images is left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.capture.rooms.textures import filled
from tasks.fidelity.visibility import in_picture, reach
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.triangles import face_areas, face_normals
from tasks.settings import Config, Count, Natural, NonNegative, Positive, Share
from tasks.texturing.charts import signed_areas
from tasks.texturing.exposure import gains_of
from tasks.texturing.texels import Texels, texels_of
from tasks.texturing.views import ColorView

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Colors = NDArray[np.uint8]

_LEAST_PX = 64
"""Side of the smallest texture."""

_NEIGHBORS = 8
"""Texels around an unseen one, on the surface, that lend it their colors."""

_LENDERS = 200_000
"""More texels that were seen are thinned before they lend: their colors hardly differ over a millimeter."""

_BLANK = 180
"""Gray of what has no color: neither an image nor the asset knows one."""


@dataclasses.dataclass(frozen=True)
class BakeConfig(Config):
    """How the images of a scan become a texture."""

    texel_m: Positive = 0.004  # a pixel of a 640 x 480 camera at two metres
    max_px: Count = 1024  # of a side; sizes go up to the next power of two, as viewers want them
    looks: Count = 8  # the best ones of each texel: more only blur, as poses are never exact
    touch_m: NonNegative = 0.003  # what a ray meets so little before a point is the point's own surface: rays are single precision
    depth_m: NonNegative = 0.02  # a reading agrees with a point that near ...
    depth_per_m: NonNegative = 0.01  # ... and at that much more per metre of distance
    unread_trust: Share = 0.25  # of a pixel without a reading: what gives no depth may still be seen
    edge_jump: Share = 0.05  # readings around a pixel that differ by more of the depth than that are an edge ...
    edge_trust: Share = 0.05  # ... where colors of both sides mix
    least_cosine: Share = 0.17  # flatter looks than 10 degrees smear a pixel over six texels
    max_m: Positive = 8.0  # farther away a texel is a quarter of a pixel
    border_px: NonNegative = 16.0  # so near to the border lenses are at their worst, and looks count less and less
    outlier_levels: Positive = 24.0  # a look that differs more from the others' median, of 255, shows something else
    gutter_px: Natural = 8  # around charts, for bilinear filters and three levels of smaller textures
    solves_gains: bool = True  # cameras that set their exposure themselves; False takes the colors as they are


@dataclasses.dataclass(frozen=True)
class Atlas:
    """A texture's texels and where they lie. shape: height and width. points: world frame [m], shape (t, 3). normals: unit, shape (t, 3).
    side_m: of a texel on the surface [m], shape (t,)."""

    shape: tuple[int, int]
    texels: Texels
    points: Array
    normals: Array
    side_m: Array


@dataclasses.dataclass(frozen=True)
class Baked:
    """A texture. image: shape (h, w, 3), full everywhere. covered, seen: texels of the charts, and those that some image shows, shape
    (h, w). seen_share: of the covered ones. gains: exposure of each view over the usual one, shape (views,), 1 where nothing is known.
    looks: mean number of a seen texel.
    """

    image: Colors
    covered: Mask
    seen: Mask
    seen_share: float
    gains: Array
    looks: float


@dataclasses.dataclass(frozen=True)
class _Looks:
    """The best looks at each texel. color: shape (t, k, 3), 0..255. weight: shape (t, k), 0 for none. view: shape (t, k)."""

    color: NDArray[np.float32]
    weight: NDArray[np.float32]
    view: NDArray[np.int32]


def atlas_of(vertices: Array, faces: Integers, uv: Array, config: BakeConfig) -> Atlas:
    """The texels of a mesh's texture, so many that one takes about `texel_m`. vertices: world frame [m], shape (n, 3). uv: shape (n, 2)."""
    image = np.abs(signed_areas(uv, faces))
    area = face_areas(vertices, faces)
    wanted = np.sqrt(area.sum() / max(float(image.sum()), 1e-9)) / config.texel_m
    most = 1 << (max(config.max_px, _LEAST_PX).bit_length() - 1)
    side = int(np.clip(1 << max(int(np.ceil(min(wanted, most))) - 1, 1).bit_length(), _LEAST_PX, most))
    texels = texels_of(uv, faces, (side, side))
    points = np.einsum("tc,tck->tk", texels.weights, vertices[faces[texels.face]])
    size = np.sqrt(area / np.maximum(image * side * side, 1e-12))
    return Atlas((side, side), texels, points, face_normals(vertices, faces)[texels.face], size[texels.face])


def baked(atlas: Atlas, views: Sequence[ColorView], scene: RayScene, config: BakeConfig, own: ArrayLike | None = None) -> Baked:
    """The texture of a surface. scene: all that stands there, the surface itself too, world frame [m].

    own: What the surface shows where no image does, RGB by texel, shape (t, 3); without it, that is taken from around it on the surface.

    Raises:
        InputError: an image cannot be read.
    """
    looks = _gathered(atlas, views, scene, config)
    gains = gains_of(looks.color, looks.weight, looks.view, len(views)) if config.solves_gains else np.ones(len(views))
    color, seen = _mean(looks, gains, config.outlier_levels)
    color[~seen] = _hidden(atlas.points, color, seen) if own is None else np.asarray(own, dtype=np.float32)[~seen]
    rows, columns = atlas.texels.row, atlas.texels.column
    image, covered, shown = np.zeros((*atlas.shape, 3), np.float32), np.zeros(atlas.shape, bool), np.zeros(atlas.shape, bool)
    image[rows, columns], covered[rows, columns], shown[rows, columns] = color, True, seen
    counts = (looks.weight > 0).sum(axis=1)[seen]
    return Baked(
        image=_with_gutters(image, covered, config.gutter_px),
        covered=covered,
        seen=shown,
        seen_share=float(seen.mean()) if len(seen) else 0.0,
        gains=gains,
        looks=float(counts.mean()) if len(counts) else 0.0,
    )


def _gathered(atlas: Atlas, views: Sequence[ColorView], scene: RayScene, config: BakeConfig) -> _Looks:
    """The best looks of all views, one view after another."""
    shape = (len(atlas.points), config.looks)
    looks = _Looks(np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.int32))
    for number, view in enumerate(views):
        index, weight = _facing(atlas, view.camera, config)
        better = weight > looks.weight[index].min(axis=1)
        index, weight = index[better], weight[better]
        if not len(index):
            continue
        way = np.linalg.norm(atlas.points[index] - view.camera.pose[:3, 3], axis=1)
        clear = reach(view.camera, atlas.points[index], scene) >= way - config.touch_m
        index, weight = index[clear], weight[clear]
        if view.depth is not None and view.depth_camera is not None and len(index):
            weight = weight * _agreement(atlas.points[index], view.depth_camera, view.depth(), config)
        worst = looks.weight[index].argmin(axis=1)
        better = weight > looks.weight[index, worst]
        index, worst = index[better], worst[better]
        if not len(index):
            continue
        pixel, _ = view.camera.project(atlas.points[index])
        looks.color[index, worst] = bilinear(view.color(), pixel)
        looks.weight[index, worst] = weight[better]
        looks.view[index, worst] = number
    return looks


def _facing(atlas: Atlas, camera: Camera, config: BakeConfig) -> tuple[Integers, NDArray[np.float32]]:
    """Texels in a camera's picture that face it well enough, and how well it sees them: by angle, pixels per texel and the border."""
    index = np.flatnonzero(in_picture(camera, atlas.points))
    pixel, depth = camera.project(atlas.points[index])
    away = camera.pose[:3, 3] - atlas.points[index]
    distance = np.linalg.norm(away, axis=1)
    cosine = np.abs(np.einsum("tk,tk->t", away, atlas.normals[index])) / np.maximum(distance, 1e-9)
    pixels = camera.fx * camera.fy * cosine * (atlas.side_m[index] / np.maximum(depth, 1e-9)) ** 2
    inward = np.minimum(pixel, np.array([camera.width, camera.height]) - 1.0 - pixel).min(axis=1) + 0.5
    ramp = np.clip(inward / max(config.border_px, 1e-9), 1e-3, 1.0)
    weight = cosine * np.minimum(pixels, 1.0) * ramp
    fit = (cosine >= config.least_cosine) & (distance <= config.max_m)
    return index[fit], weight[fit].astype(np.float32)


def _agreement(points: Array, camera: Camera, depth: NDArray[np.float32], config: BakeConfig) -> NDArray[np.float32]:
    """How far a depth image bears out that it shows points: 1 where a reading agrees, 0 where it does not, shape (t,)."""
    pixel, expected = camera.project(points)
    column, row = np.round(pixel).astype(np.int64).T
    inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    column, row = np.clip(column, 0, camera.width - 1), np.clip(row, 0, camera.height - 1)
    reading = np.where(inside, depth[row, column], 0.0)
    agrees = np.abs(reading - expected) <= config.depth_m + config.depth_per_m * expected
    trust = np.where(reading > 0, np.where(agrees, 1.0, 0.0), config.unread_trust)
    return np.where(depth_edges(depth, config.edge_jump)[row, column], trust * config.edge_trust, trust).astype(np.float32)


def depth_edges(depth: NDArray[np.float32], jump: float) -> Mask:
    """Pixels of a depth image [m] around which, in a square of 3, readings differ by more than a share of the largest, shape (h, w)."""
    from scipy.ndimage import maximum_filter, minimum_filter

    far = maximum_filter(depth, 3)
    near = minimum_filter(np.where(depth > 0, depth, np.float32(np.inf)), 3)
    return np.asarray((far - near > jump * far) & (far > 0))


def bilinear(image: Colors, pixel: Array) -> NDArray[np.float32]:
    """Colors between pixels, whose centers are whole numbers (column, row), shape (n, 2) to (n, 3); at the border the nearest."""
    height, width = image.shape[:2]
    x, y = np.clip(pixel[:, 0], 0.0, width - 1.0), np.clip(pixel[:, 1], 0.0, height - 1.0)
    left, top = np.minimum(x.astype(np.int64), max(width - 2, 0)), np.minimum(y.astype(np.int64), max(height - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = (x - left).astype(np.float32)[:, None], (y - top).astype(np.float32)[:, None]
    upper = image[top, left] * (1 - u) + image[top, right] * u
    lower = image[below, left] * (1 - u) + image[below, right] * u
    return np.asarray(upper * (1 - v) + lower * v, dtype=np.float32)


def _mean(looks: _Looks, gains: Array, outlier_levels: float) -> tuple[NDArray[np.float32], Mask]:
    """The weighted mean of the looks that lie near their weighted median, shape (t, 3), and which texels have any look, shape (t,)."""
    color = looks.color / gains.astype(np.float32)[looks.view][..., None] if len(gains) else looks.color
    weight = looks.weight
    middle = weighted_median(color, weight)
    apart = np.abs(color - middle[:, None]).max(axis=2)
    kept = np.where(apart <= outlier_levels, weight, np.float32(0.0))
    lonely = kept.sum(axis=1) <= 0  # a median channel by channel may be near no look at all
    kept[lonely] = weight[lonely]
    total = kept.sum(axis=1)
    mean = (color * kept[..., None]).sum(axis=1) / np.maximum(total, np.float32(1e-12))[:, None]
    return np.clip(mean, 0, 255).astype(np.float32), total > 0


def weighted_median(values: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """The weighted median of each row, channel by channel: values, shape (t, k, c), and weights, shape (t, k), to shape (t, c)."""
    order = np.argsort(values, axis=1, kind="stable")
    ascending = np.take_along_axis(values, order, axis=1)
    passed = np.cumsum(np.take_along_axis(np.repeat(weight[..., None], values.shape[2], axis=2), order, axis=1), axis=1)
    at = (passed >= 0.5 * passed[:, -1:]).argmax(axis=1)
    return np.take_along_axis(ascending, at[:, None], axis=1)[:, 0]


def _hidden(points: Array, color: NDArray[np.float32], seen: Mask) -> NDArray[np.float32]:
    """Colors of texels that were not seen: of those that were, the nearest on the surface, nearer ones more, shape (hidden, 3)."""
    from scipy.spatial import cKDTree

    lenders = np.flatnonzero(seen)
    if not len(lenders):
        return np.full((len(seen), 3), _BLANK, dtype=np.float32)
    lenders = lenders[:: -(-len(lenders) // _LENDERS)]
    k = min(_NEIGHBORS, len(lenders))
    distance, nearest = cKDTree(points[lenders]).query(points[~seen], k=k)
    closeness = 1.0 / (distance.reshape(-1, k) + 1e-6) ** 2
    lent = color[lenders[nearest.reshape(-1, k)]]
    return np.asarray((lent * closeness[..., None]).sum(axis=1) / closeness.sum(axis=1)[:, None], dtype=np.float32)


def _with_gutters(image: NDArray[np.float32], covered: Mask, gutter_px: int) -> Colors:
    """The image with the colors of charts carried past their borders, and all between filled in smoothly."""
    from scipy.ndimage import distance_transform_edt

    if not covered.any():
        return np.full(image.shape, _BLANK, dtype=np.uint8)
    distance, (row, column) = distance_transform_edt(~covered, return_indices=True)
    return filled(image[row, column], distance <= gutter_px)
