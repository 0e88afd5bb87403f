"""What a model sees of rows and samples: an instance in its frame, and candidates as they are aligned to it."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.capture import Instance
from schemas.errors import InputError
from tasks.geometry.boxes import grown_box
from tasks.geometry.meshes import read_points
from tasks.geometry.transforms import inverse, transform_points, yaw_of, yaw_pose
from tasks.selection.model.clouds import Array, Cloud, spread_cloud
from tasks.selection.model.config import NoQuery, OwnImage, SelectionModel
from tasks.selection.model.features import Scanned, square_crop

LEAST_CLOUD = 512
"""Points that an asset's cloud has at least, for distances point by point."""

BESIDE_M, FLOOR_M, LEAST_WITHIN = 0.05, 0.05, 0.3
"""As the stage has them: points farther out of the box are another object's; what ends this near the floor stands on it; a box that holds
less than this share of its points is none to go by."""


@dataclasses.dataclass(frozen=True)
class Standing:
    """An instance in its own frame. frame: in the world, 4x4 [m]. points: (n, 3) [m], colors: (n, 3). extents: of its box, (3,) [m]."""

    frame: NDArray[np.float64]
    points: NDArray[np.float64]
    colors: NDArray[np.uint8]
    extents: NDArray[np.float64]


def standing(instance: Instance, blobs: Mapping[str, bytes]) -> Standing:
    """An instance's points in its frame: its box turned straight, z zero at the height on which an asset is to stand.

    Raises:
        InputError: its points cannot be read.
    """
    box, size = grown_box(instance.box_pose, instance.box_size, instance.hidden_m)
    bottom, top = box[2, 3] - 0.5 * size[2], box[2, 3] + 0.5 * size[2]
    bottom = 0.0 if abs(bottom) <= FLOOR_M < top else bottom
    frame = yaw_pose(yaw_of(box), [box[0, 3], box[1, 3], bottom])
    points, colors = read_points(blobs[instance.points_blob], instance.points_blob)
    local, extents = transform_points(points, inverse(frame)), np.maximum([size[0], size[1], top - bottom], 5e-3)
    within = (np.abs(local - [0.0, 0.0, 0.5 * extents[2]]) <= 0.5 * extents + BESIDE_M).all(axis=1)
    if within.mean() >= LEAST_WITHIN:
        local, colors = local[within], colors[within]
    return Standing(frame, local, colors, extents)


def scan_points(config: SelectionModel) -> int:
    """How many of an instance's points are kept: twice what the encoder takes, so that leaving some out leaves enough."""
    return max(2 * config.architecture.points, 2 * config.residual_points)


def asset_points(config: SelectionModel) -> int:
    """How many points of an asset's surface are kept."""
    return max(2 * config.architecture.points, LEAST_CLOUD)


def scan_cloud(points: NDArray[np.floating], colors: NDArray[np.uint8], config: SelectionModel) -> Cloud:
    """An instance's cloud, of its points in its frame, shape (n, 3) [m]; of many, evenly drawn ones."""
    count = scan_points(config)
    if len(points) > 4 * count:
        index = np.sort(np.random.default_rng(0).permutation(len(points))[: 4 * count])
        points, colors = points[index], colors[index]
    return spread_cloud(points, colors, count)


def asset_cloud(points: NDArray[np.floating], normals: NDArray[np.floating], colors: NDArray[np.uint8], config: SelectionModel) -> Cloud:
    """An asset's cloud, of samples of its surface with unit normals in its own frame, shape (m, 3) [m]."""
    return spread_cloud(points, colors, asset_points(config), normals)


def scanned(
    points: NDArray[np.floating], colors: NDArray[np.uint8], extents: NDArray[np.floating], category: str, caption: str | None,
    image: NDArray[np.uint8] | None, config: SelectionModel,
) -> Scanned:  # fmt: skip
    """An instance as a model sees it. points, colors: in its frame (see `standing`). image: the crop of its best view."""
    return Scanned(scan_cloud(points, colors, config), np.asarray(extents, dtype=np.float32), category, caption, image)


def evidence(
    *, coverage: float, box_iou: float, color: float, foreign: float | None, chamfer_m: float, diagonal_m: float,
    scale: Sequence[float] | NDArray, category: str, asset: Asset, is_own: bool,
) -> Array:  # fmt: skip
    """Values by `features.EVIDENCE`: what the rows of a candidate, its asset and its alignment say.

    foreign: None where nobody looked. diagonal_m: of the instance's box. scale: of the alignment, shape (3,). category: of the instance.
    is_own: the asset is made of the instance's own points.
    """
    stretch = np.log(np.maximum(np.asarray(scale, dtype=np.float64), 1e-3))
    values = [
        coverage, box_iou, color, foreign or 0.0, float(foreign is not None), float(np.exp(-chamfer_m / (0.04 * max(diagonal_m, 1e-3)))),
        *np.clip(stretch, -1.0, 1.0), float(min(np.ptp(stretch), 1.0)), float(category == asset.category), float(is_own),
        float(asset.is_watertight),
    ]  # fmt: skip
    return np.array(values, dtype=np.float32)


def view_of(instance: Instance, blobs: Mapping[str, bytes], config: SelectionModel) -> NDArray[np.uint8] | None:
    """The crop of an instance's best view, shape (h, w, 3), as small as an own encoder wants it; None where it has none.

    Raises:
        InputError: it cannot be read as a picture.
    """
    from PIL import Image

    if instance.view_blob is None or isinstance(config.image, NoQuery):
        return None
    try:
        with Image.open(io.BytesIO(blobs[instance.view_blob])) as picture:
            pixels = np.asarray(picture.convert("RGB"))
    except Exception as error:  # decoders raise what they like
        raise InputError(instance.view_blob, "view_blob", "cannot be read as a picture", "run the capture stage again") from error
    return square_crop(pixels, config.image.side) if isinstance(config.image, OwnImage) else pixels
