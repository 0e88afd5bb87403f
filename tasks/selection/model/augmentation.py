"""Changes of clouds in training (specs C.4), as functions of a generator: points left out, then scale, shift, tilt and turn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.selection.model.clouds import ColoredCloud
from tasks.selection.model.config import AugmentationConfig, SelectionModel
from tasks.selection.model.features import CloudView, Contender, Scanned, plain_view

Motion = tuple[NDArray[np.float64], NDArray[np.float64]]
"""A matrix (3, 3), of which every column has one length, and a shift (3,) [m]."""


def thinned(cloud: ColoredCloud, most: float, rng: np.random.Generator) -> ColoredCloud:
    """A cloud without a share U(0, most) of its points, in the order that they had; whoever needs more takes its first ones again."""
    keep = max(round(len(cloud.points) * (1.0 - rng.uniform(0.0, most))), 1)
    return taken(cloud, np.sort(rng.permutation(len(cloud.points))[:keep]))


def shuffled(cloud: ColoredCloud, rng: np.random.Generator) -> ColoredCloud:
    """A cloud in another order."""
    return taken(cloud, rng.permutation(len(cloud.points)))


def taken(cloud: ColoredCloud, index: NDArray[np.int64]) -> ColoredCloud:
    """The points of these indices."""
    return ColoredCloud(cloud.points[index], cloud.colors[index], None if cloud.normals is None else cloud.normals[index])


def drawn_motion(config: AugmentationConfig, radius: float, rng: np.random.Generator) -> Motion:
    """Scale, tilt and turn, and a shift, of a cloud of this radius [m]."""
    scale = rng.uniform(config.scale_least, config.scale_most)
    shift = radius * rng.uniform(-config.shift, config.shift, 3)
    tilts = np.clip(rng.normal(0.0, config.tilt_radians, 3), -config.tilt_limit_radians, config.tilt_limit_radians)
    turn = rng.uniform(0.0, 2.0 * np.pi) if config.turn else 0.0
    matrix = about("xyz".index(config.axis), turn)
    for axis in range(3):
        matrix = matrix @ about(axis, float(tilts[axis]))
    return scale * matrix, shift


def about(axis: int, angle: float) -> NDArray[np.float64]:
    """The turn about a coordinate axis [rad], shape (3, 3)."""
    matrix = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix[[first, second], [first, second]] = np.cos(angle)
    matrix[second, first], matrix[first, second] = np.sin(angle), -np.sin(angle)
    return matrix


def moved(cloud: ColoredCloud, motion: Motion, middle: NDArray) -> ColoredCloud:
    """A cloud scaled and turned about a point [m], then shifted."""
    matrix, shift = motion
    points = (cloud.points - middle) @ matrix.T + middle + shift
    normals = None if cloud.normals is None else (cloud.normals @ (matrix / np.linalg.norm(matrix[:, 0])).T).astype(np.float32)
    return ColoredCloud(points.astype(np.float32), cloud.colors, normals)


def augmented(
    scanned: Scanned, contenders: Sequence[Contender], model: SelectionModel, config: AugmentationConfig, rng: np.random.Generator
) -> CloudView:
    """The clouds of an object changed at random.

    What stands in one frame moves as one, since its differences are what is to be learned; in frames of their own each moves by itself.
    """
    plain = plain_view(scanned, contenders, model)
    middle, radius = np.array([0.0, 0.0, 0.5 * scanned.extents[2]]), 0.5 * float(np.linalg.norm(scanned.extents))
    motion = drawn_motion(config, radius, rng)
    near = shuffled(moved(plain.near, motion, middle), rng)
    placed = [moved(cloud, motion, middle) for cloud in plain.placed]
    scan = thinned(moved(plain.scan, motion, middle), config.dropout, rng)
    if model.frame == "placed":
        clouds = [thinned(cloud, config.dropout, rng) for cloud in placed]
    else:
        clouds = []
        for cloud in plain.clouds:
            center = cloud.points.mean(axis=0)
            far = float(np.linalg.norm(cloud.points - center, axis=1).max())
            clouds.append(thinned(moved(cloud, drawn_motion(config, far, rng), center), config.dropout, rng))
    return CloudView(scan, clouds, near, [shuffled(cloud, rng) for cloud in placed])


def cropped(image: NDArray[np.uint8], least: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """A window of a picture, shape (h, w, 3), with its share U(least, 1) of the area and its proportions, as it lies."""
    side = np.sqrt(rng.uniform(least, 1.0))
    height, width = (max(round(side * length), 1) for length in image.shape[:2])
    top, left = int(rng.integers(image.shape[0] - height + 1)), int(rng.integers(image.shape[1] - width + 1))
    return image[top : top + height, left : left + width]
