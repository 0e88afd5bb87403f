"""What a selection model sees of an object and its candidates, as arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.selection.model.clouds import Array, ColoredCloud, filled, nearest_both
from tasks.selection.model.config import NoQuery, OwnImage, OwnText, SelectionModel
from tasks.selection.model.words import described, tokens_of

EVIDENCE = (
    "coverage", "box_iou", "color_similarity", "foreign_share", "looked", "closeness", "stretch_x", "stretch_y", "stretch_z",
    "oval", "unscaled", "category", "own", "closed",
)  # fmt: skip
"""Numbers of a candidate beside its shape, each about -1 to 1."""

RESIDUAL = 17
"""Numbers of a point with its distance: place 3, way to the nearest on the other side 3, distance, its logarithm, signed along the
surface's normal, difference of colors 3, normal 3, side 1, height above the object's bottom 1."""

SUMMED = 12
"""Means over the scan's points, then over the candidate's: distance, its logarithm, its size along the normal, of colors by channel."""

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

Features = Mapping[str, NDArray]


@dataclasses.dataclass(frozen=True)
class Contender:
    """A candidate as a model sees it.

    cloud: Of the asset's surface, in its own frame [m], with normals. extents: Of the asset's box [m]. pose: Asset to the instance's frame,
    (4, 4), rigid. scale: Along the asset's own axes, before the pose. evidence: Values by `EVIDENCE`, shape (14,).
    """

    cloud: ColoredCloud
    extents: Array
    pose: NDArray[np.float64]
    scale: NDArray[np.float64]
    evidence: Array

    def placed(self) -> ColoredCloud:
        """The cloud in the instance's frame [m]."""
        normals = self.cloud.normals
        turned: Array | None = None
        if normals is not None:
            leaning = (normals / self.scale) @ self.pose[:3, :3].T
            turned = (leaning / np.maximum(np.linalg.norm(leaning, axis=1, keepdims=True), 1e-9)).astype(np.float32)
        points = (self.cloud.points * self.scale) @ self.pose[:3, :3].T + self.pose[:3, 3]
        return ColoredCloud(points.astype(np.float32), self.cloud.colors, turned)


@dataclasses.dataclass(frozen=True)
class Scanned:
    """An instance as a model sees it.

    cloud: In the instance's frame: +Z up, its box turned straight, the middle of the box's bottom at the origin [m]. extents: Of its box
    [m]. image: Crop of its best view, (h, w, 3). image_vector, text_vector: What frozen encoders made of view and text.
    """

    cloud: ColoredCloud
    extents: Array
    category: str
    caption: str | None = None
    image: NDArray[np.uint8] | None = None
    image_vector: Array | None = None
    text_vector: Array | None = None


@dataclasses.dataclass(frozen=True)
class CloudView:
    """An object's clouds as one look at it has them.

    scan, clouds: For the encoder, of the instance and of the candidates in the model's frame. near, placed: For distances point by point,
    of the instance and of the candidates as aligned to it.
    """

    scan: ColoredCloud
    clouds: Sequence[ColoredCloud]
    near: ColoredCloud
    placed: Sequence[ColoredCloud]


def plain_view(scanned: Scanned, contenders: Sequence[Contender], config: SelectionModel) -> CloudView:
    """The clouds as they are."""
    placed = [each.placed() for each in contenders]
    return CloudView(scanned.cloud, placed if config.frame == "placed" else [each.cloud for each in contenders], scanned.cloud, placed)


def features_of(
    scanned: Scanned, contenders: Sequence[Contender], config: SelectionModel, view: CloudView | None = None
) -> dict[str, NDArray]:
    """What the network takes of an object, for a batch of one without its first axis (see `Selector`).

    view: the clouds where they were changed.
    """
    view = plain_view(scanned, contenders, config) if view is None else view
    count = config.architecture.points
    middle, radius = None, None
    if config.frame == "placed":
        middle, radius = np.array([0.0, 0.0, 0.5 * scanned.extents[2]], dtype=np.float32), radius_of(scanned.extents)
    made: dict[str, NDArray] = {"is_candidate": np.ones(len(contenders), dtype=bool)}
    made["clouds"] = np.stack([colored(cloud, count, middle, radius) for cloud in view.clouds])
    if config.query_points:
        made["scan"] = colored(view.scan, count, middle, radius)
    if config.extents:
        made["sizes"] = log_sizes(np.stack([each.extents for each in contenders]))
        made["scan_size"] = log_sizes(scanned.extents)
    if config.quality and config.query_evidence:
        made["evidence"] = np.stack([each.evidence for each in contenders])
    if config.quality and config.residuals:
        made["residuals"] = residuals_of(view.near, view.placed, scanned.extents, config.residual_points)
    return made | asked(scanned, config)


def asked(scanned: Scanned, config: SelectionModel) -> dict[str, NDArray]:
    """The queries of image and text."""
    made: dict[str, NDArray] = {}
    if isinstance(config.image, OwnImage):
        side = config.image.side
        image = np.zeros((3, side, side), dtype=np.float32)
        if scanned.image is not None:
            image = square_crop(scanned.image, side).transpose(2, 0, 1).astype(np.float32) / 255.0
            if config.image_normalization == "imagenet":
                image = (image - np.reshape(IMAGENET_MEAN, (3, 1, 1))) / np.reshape(IMAGENET_STD, (3, 1, 1))
        made["image"], made["has_image"] = image.astype(np.float32), np.array(scanned.image is not None, dtype=np.float32)
    elif not isinstance(config.image, NoQuery) and scanned.image_vector is not None:
        made["image"], made["has_image"] = scanned.image_vector, np.array(np.any(scanned.image_vector), dtype=np.float32)
    if isinstance(config.text, OwnText):
        made["text"] = tokens_of(described(scanned.category, scanned.caption), config.text.buckets, config.text.tokens)
    elif not isinstance(config.text, NoQuery) and scanned.text_vector is not None:
        made["text"] = scanned.text_vector
    return made


def radius_of(extents: NDArray) -> float:
    """Half the diagonal of a box, at least a millimetre [m]."""
    return max(0.5 * float(np.linalg.norm(extents)), 1e-3)


def log_sizes(extents: NDArray) -> Array:
    """Logarithms of extents [m], of less than a millimetre as of one."""
    return np.log(np.maximum(extents, 1e-3)).astype(np.float32)


def colored(cloud: ColoredCloud, count: int, middle: NDArray | None = None, radius: float | None = None) -> Array:
    """Places and colors, shape (count, 6): about `middle`, in units of `radius`; without these about its mean, in a ball of radius 1."""
    points = filled(cloud.points, count)
    middle = points.mean(axis=0) if middle is None else middle
    points = points - middle
    if radius is None:
        radius = max(float(np.sqrt(np.square(points).sum(axis=1).max())), 1e-6)
    # what lies far out of its object's box is held near it: one stray point must not drown the rest
    return np.concatenate([np.clip(points / radius, -2.0, 2.0), filled(cloud.colors, count) / np.float32(255.0)], axis=1).astype(np.float32)


def residuals_of(scan: ColoredCloud, placed: Sequence[ColoredCloud], extents: NDArray, count: int) -> Array:
    """Points of the scan and of every candidate with their distances to the other, shape (k, 2 count, 17): first those of the scan.

    Lengths are in units of half the box's diagonal. scan, placed: in the instance's frame [m], placed ones with normals.
    """
    radius = np.float32(radius_of(extents))
    middle = np.array([0.0, 0.0, 0.5 * extents[2]], dtype=np.float32)
    least = max(min(len(cloud.points) for cloud in placed), count)
    points = (filled(scan.points, max(count, len(scan.points))) - middle) / radius
    surfaces = (np.stack([filled(cloud.points, least) for cloud in placed]) - middle) / radius
    normals = np.stack([filled(_normals(cloud), least) for cloud in placed])
    colors = np.stack([filled(cloud.colors, least) for cloud in placed]).astype(np.float32) / 255.0
    own = filled(scan.colors, len(points)).astype(np.float32) / 255.0
    forth, back = nearest_both(points, surfaces)
    rows = np.arange(len(placed))[:, None]
    forth, back = forth[:, :count], back[:, :count]
    here = np.broadcast_to(points[:count], (len(placed), count, 3))
    from_scan = _residual(here, surfaces[rows, forth], normals[rows, forth], colors[rows, forth] - own[:count], 0.0)
    from_asset = _residual(surfaces[:, :count], points[back], normals[:, :count], colors[:, :count] - own[back], 1.0)
    return np.concatenate([from_scan, from_asset], axis=1)


def _residual(at: NDArray, to: NDArray, normal: NDArray, color: NDArray, side: float) -> Array:
    """One point's numbers, shape (k, m, 17); see `RESIDUAL`."""
    way = np.clip(to - at, -0.5, 0.5)
    length = np.linalg.norm(way, axis=2, keepdims=True)
    along = (way * normal).sum(axis=2, keepdims=True)
    sides = np.full_like(length, side)
    parts = [at, 5.0 * way, 5.0 * length, np.log1p(50.0 * length), 5.0 * along, color, normal, sides, at[..., 2:]]
    return np.concatenate(parts, axis=2, dtype=np.float32)


def _normals(cloud: ColoredCloud) -> Array:
    """Normals, zeros where the cloud has none."""
    return np.zeros_like(cloud.points) if cloud.normals is None else cloud.normals


def square_crop(image: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """The whole picture in a square of `side` pixels, means of the pixels below each; what it lacks to a square is white."""
    from PIL import Image

    height, width = image.shape[:2]
    longer = max(height, width)
    square = np.full((longer, longer, 3), 255, dtype=np.uint8)
    top, left = (longer - height) // 2, (longer - width) // 2
    square[top : top + height, left : left + width] = image
    return np.asarray(Image.fromarray(square).resize((side, side), Image.Resampling.BOX))
