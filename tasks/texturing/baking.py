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
from tasks.geometry.rendering import Camera, RayScene, reach
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

_TURN_M = 0.02
"""How far away a texel counts that is turned by 60 degrees [m]: light falls otherwise there. More, and legs borrow from seats."""

_NEAREST_M = 0.05
"""No camera sees what is nearer sharply."""

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
    rim_trust: Share = 0.05  # ... where colors of both sides mix: such looks are for what has no other
    mend_m: NonNegative = 0.05  # a texel that only such looks show takes the color of those so near that have better ones
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
    """A texture. image: shape (h, w, 3), full everywhere. covered, seen: texels of the charts, and those whose color is what an image
    shows there, shape (h, w). seen_share: of the covered ones. gains: exposure of each view over the usual one, shape (views,), 1 where
    nothing is known. looks: mean number of a seen texel.
    """

    image: Colors
    covered: Mask
    seen: Mask
    seen_share: float
    gains: Array
    looks: float


@dataclasses.dataclass(frozen=True)
class _Looks:
    """The best looks at each texel. color: shape (t, k, 3), 0..255. weight: shape (t, k), 0 for none. view: shape (t, k). at_rim: whether
    it was taken where an image mixes what lies before and behind, shape (t, k)."""

    color: NDArray[np.float32]
    weight: NDArray[np.float32]
    view: NDArray[np.int32]
    at_rim: Mask


@dataclasses.dataclass(frozen=True)
class _Sight:
    """Texels that a view shows: index, place in its image (column, row) [px], depth [m], and how well it sees them; (s,) or (s, 2)."""

    index: Integers
    pixel: Array
    depth: Array
    weight: NDArray[np.float32]

    def some(self, which: NDArray[np.bool_]) -> _Sight:
        return _Sight(self.index[which], self.pixel[which], self.depth[which], self.weight[which])


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
    color, quality = _mean(looks, gains, config.outlier_levels)
    sure, rim = quality == 2, quality == 1
    places = np.column_stack([atlas.points, _TURN_M * atlas.normals])
    lent, is_near = _lent(places, color, sure, rim, config.mend_m)
    mended = np.zeros(len(rim), dtype=bool)
    mended[np.flatnonzero(rim)[is_near]] = True
    color[mended] = lent[is_near]
    seen = (quality > 0) & ~mended
    hidden = quality == 0
    if own is None:
        color[hidden] = _lent(places, color, ~hidden, hidden, np.inf)[0]
    else:
        color[hidden] = np.asarray(own, dtype=np.float32)[hidden]
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
    looks = _Looks(np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.int32), np.zeros(shape, bool))
    for number, view in enumerate(views):
        sight = _facing(atlas, view.camera, config)
        sight = sight.some(sight.weight > looks.weight[sight.index].min(axis=1))
        points = atlas.points[sight.index]
        way = np.linalg.norm(points - view.camera.pose[:3, 3], axis=1)
        sight = sight.some(reach(view.camera, points, scene) >= way - config.touch_m)
        if not len(sight.index):
            continue
        at_rim, trust = _off_camera(sight, view, scene, atlas.points, config)
        weight = sight.weight * trust * np.where(at_rim, np.float32(config.rim_trust), np.float32(1.0))
        worst = looks.weight[sight.index].argmin(axis=1)
        better = weight > looks.weight[sight.index, worst]
        if not better.any():
            continue
        into = sight.index[better], worst[better]
        looks.color[into] = bilinear(view.color(), sight.pixel[better])
        looks.weight[into], looks.view[into], looks.at_rim[into] = weight[better], number, at_rim[better]
    return looks


def _facing(atlas: Atlas, camera: Camera, config: BakeConfig) -> _Sight:
    """Texels in a camera's picture that face it well enough, and how well it sees them: by angle, pixels per texel and the border."""
    pixel, depth = camera.project(atlas.points)
    inward = np.minimum(pixel, np.array([camera.width, camera.height]) - 1.0 - pixel).min(axis=1) + 0.5
    index = np.flatnonzero((depth > _NEAREST_M) & (inward >= 0.0))
    pixel, depth, inward = pixel[index], depth[index], inward[index]
    away = camera.pose[:3, 3] - atlas.points[index]
    distance = np.linalg.norm(away, axis=1)
    cosine = np.abs(np.einsum("tk,tk->t", away, atlas.normals[index])) / distance
    pixels = camera.fx * camera.fy * cosine * (atlas.side_m[index] / depth) ** 2
    ramp = np.clip(inward / max(config.border_px, 1e-9), 1e-3, 1.0)
    weight = (cosine * np.minimum(pixels, 1.0) * ramp).astype(np.float32)
    return _Sight(index, pixel, depth, weight).some((cosine >= config.least_cosine) & (distance <= config.max_m))


def _off_camera(sight: _Sight, view: ColorView, scene: RayScene, points: Array, config: BakeConfig) -> tuple[Mask, NDArray[np.float32]]:
    """Which looks lie at a rim, of the surface itself or of what stands before it, and how far the depth image bears the others out."""
    camera = view.camera
    column, row = _pixels(sight.pixel, camera)
    left, top = max(int(column.min()) - 1, 0), max(int(row.min()) - 1, 0)
    width, height = min(int(column.max()) + 2, camera.width) - left, min(int(row.max()) + 2, camera.height) - top
    part = dataclasses.replace(camera, cx=camera.cx - left, cy=camera.cy - top, width=width, height=height)
    cast = scene.cast(part.rays())["t_hit"]
    at_rim = depth_edges(np.where(np.isfinite(cast), cast, np.float32(0.0)), config.edge_jump)[row - top, column - left]
    if view.depth is None or view.depth_camera is None:
        return at_rim, np.ones(len(row), dtype=np.float32)
    read, expected = view.depth(), sight.depth
    pixel = sight.pixel
    if view.depth_camera is not camera:
        pixel, expected = view.depth_camera.project(points[sight.index])
    column, row = _pixels(pixel, view.depth_camera)
    reading = np.where(np.abs(pixel - np.column_stack([column, row])).max(axis=1) <= 0.5, read[row, column], np.float32(0.0))
    agrees = np.abs(reading - expected) <= config.depth_m + config.depth_per_m * expected
    trust = np.where(reading > 0, np.where(agrees, 1.0, 0.0), config.unread_trust).astype(np.float32)
    return at_rim | depth_edges(read, config.edge_jump)[row, column], trust


def _pixels(pixel: Array, camera: Camera) -> tuple[Integers, Integers]:
    """The column and line of the nearest pixel, shape (s,) each."""
    column, row = np.clip(np.round(pixel).astype(np.int64), 0, [camera.width - 1, camera.height - 1]).T
    return column, row


def depth_edges(depth: NDArray[np.float32], jump: float) -> Mask:
    """Pixels of a depth image [m] around which, in a square of 3, readings differ by more than a share of the largest, or some are
    missing (0) but not all, shape (h, w)."""
    from scipy.ndimage import maximum_filter, minimum_filter

    far, near = maximum_filter(depth, 3, mode="nearest"), minimum_filter(depth, 3, mode="nearest")
    return np.asarray(far - near > jump * far, dtype=np.bool_)


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


def _mean(looks: _Looks, gains: Array, outlier_levels: float) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
    """The weighted mean of the looks that lie near their weighted median, shape (t, 3), and what it is, shape (t,): 2 of looks within
    the surface, which then count alone, 1 of looks at rims, 0 of none."""
    color = looks.color / gains.astype(np.float32)[looks.view][..., None] if len(gains) else looks.color
    inside = np.where(looks.at_rim, np.float32(0.0), looks.weight)
    is_sure: Mask = np.asarray(inside.max(axis=1) > 0)
    weight = np.where(is_sure[:, None], inside, looks.weight)
    middle = weighted_median(color, weight)
    apart = np.abs(color - middle[:, None]).max(axis=2)
    kept = np.where(apart <= outlier_levels, weight, np.float32(0.0))
    lonely = kept.sum(axis=1) <= 0  # a median channel by channel may be near no look at all
    kept[lonely] = weight[lonely]
    total = kept.sum(axis=1)
    mean = (color * kept[..., None]).sum(axis=1) / np.maximum(total, np.float32(1e-12))[:, None]
    return np.clip(mean, 0, 255).astype(np.float32), np.where(is_sure, 2, total > 0).astype(np.int8)


def weighted_median(values: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """The weighted median of each row, channel by channel: values, shape (t, k, c), and weights, shape (t, k), to shape (t, c)."""
    order = np.argsort(values, axis=1, kind="stable")
    ascending = np.take_along_axis(values, order, axis=1)
    passed = np.cumsum(np.take_along_axis(np.repeat(weight[..., None], values.shape[2], axis=2), order, axis=1), axis=1)
    at = (passed >= 0.5 * passed[:, -1:]).argmax(axis=1)
    return np.take_along_axis(ascending, at[:, None], axis=1)[:, 0]


def _lent(places: Array, color: NDArray[np.float32], lends: Mask, needs: Mask, reach_m: float) -> tuple[NDArray[np.float32], Mask]:
    """Colors of the texels that need one, of the nearest within reach that lend theirs, nearer ones more, shape (needy, 3); and which of
    them have any, shape (needy,). places: of texels, with normals that count as far as `_TURN_M`, shape (t, 6)."""
    from scipy.spatial import cKDTree

    lenders = np.flatnonzero(lends)
    if not len(lenders):
        return np.full((int(needs.sum()), 3), _BLANK, dtype=np.float32), np.zeros(int(needs.sum()), dtype=bool)
    lenders = lenders[:: -(-len(lenders) // _LENDERS)]
    k = min(_NEIGHBORS, len(lenders))
    lent_by = cKDTree(places[lenders]).query(places[needs], k=k, distance_upper_bound=reach_m)
    distance, nearest = (of.reshape(-1, k) for of in lent_by)  # infinite, and one past the last, where fewer are within reach
    closeness = 1.0 / (distance + 1e-6) ** 2
    weighted = color[lenders[np.minimum(nearest, len(lenders) - 1)]] * closeness[..., None]
    lent = weighted.sum(axis=1) / np.maximum(closeness.sum(axis=1), 1e-300)[:, None]
    return lent.astype(np.float32), distance[:, 0] <= reach_m


def _with_gutters(image: NDArray[np.float32], covered: Mask, gutter_px: int) -> Colors:
    """The image with the colors of charts carried past their borders, and all between filled in smoothly."""
    from scipy.ndimage import distance_transform_edt

    if not covered.any():
        return np.full(image.shape, _BLANK, dtype=np.uint8)
    distance, (row, column) = distance_transform_edt(~covered, return_indices=True)
    return filled(image[row, column], distance <= gutter_px)
