"""Scanned instances that assets are aligned to."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.alignment.distances import spacing
from tasks.geometry.triangles import distinct_rows

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig

Array = NDArray[np.float64]

HIDDEN_M = 0.05
"""Farther than this beyond what a scan could see, nobody expects points [m]."""


AWAY = -0.1
"""Cosine between a normal and the camera below which a surface cannot be seen: a little noise of normals is let pass."""


@dataclasses.dataclass(frozen=True)
class Viewpoint:
    """From where the crop of an instance was taken, in the instance's frame. azimuth: About +Z, from +X [rad]; elevation: above the
    horizon [rad]. picture: What the crop shows of it, on white and cut out, shape (h, w, 3) uint8; None where nobody has it."""

    azimuth: float
    elevation: float
    picture: NDArray[np.uint8] | None = None

    @property
    def toward(self) -> Array:
        """Direction to the camera, shape (3,), of unit length."""
        flat = np.cos(self.elevation)
        return np.array([flat * np.cos(self.azimuth), flat * np.sin(self.azimuth), np.sin(self.elevation)])


def sight_of(camera: Array, frame: Array, height: float, picture: NDArray[np.uint8] | None = None) -> Viewpoint:
    """How a camera sees an instance. camera, frame: Camera (OpenCV axes) and instance to world, 4x4 [m]; height: of the instance [m]."""
    way = frame[:3, :3].T @ (camera[:3, 3] - frame[:3, 3]) - np.array([0.0, 0.0, 0.5 * height])
    return Viewpoint(float(np.arctan2(way[1], way[0])), float(np.arctan2(way[2], np.hypot(way[0], way[1]))), picture)


@dataclasses.dataclass(frozen=True)
class ScannedInstance:
    """A scanned instance in its own frame. `points`: shape (k, 3) [m]; `colors`: shape (n, 3); `size`: box extents [m];
    `spacing`: distance between neighboring points [m]; `resolution`: the same of all points that the scan has of it; `seen`: lowest
    and highest corner of the part of the box that the scan could see, shape (2, 3) [m]; `sight`: how its crop was taken, where that is
    known, for methods that look at it; `toward`: direction of the camera that alone counts as having seen it, shape (3,), if any;
    `is_square`: whether the box says how it is turned and where it is, as a wall does of what is let into it; `is_grounded`: whether it
    stands on the floor, so that its height is known. Known once they were asked
    for: `spans`, its size and middle along the axes of an asset, by the asset's yaw; `parts`, the instance with fewer points, by how
    many."""

    points: Array
    colors: NDArray[np.uint8]
    size: Array
    spacing: float
    resolution: float
    seen: Array = dataclasses.field(default_factory=lambda: np.array([[-np.inf] * 3, [np.inf] * 3]))
    sight: Viewpoint | None = None
    toward: Array | None = None
    is_square: bool = False
    is_grounded: bool = False
    spans: dict[float, tuple[Array, Array]] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)
    parts: dict[int, ScannedInstance] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def is_cut_off(self) -> bool:
        """Whether a part beside what was seen is hidden, so that only the box tells how wide it is."""
        low, high = self.seen[:, :2]
        return bool((low > HIDDEN_M - 0.5 * self.size[:2]).any() or (high < 0.5 * self.size[:2] - HIDDEN_M).any())

    def thinned(self, count: int) -> ScannedInstance:
        """The instance with its first points alone."""
        if count not in self.parts:
            points = self.points[:count]
            self.parts[count] = dataclasses.replace(self, points=points, spacing=spacing(points))
        return self.parts[count]

    def weights(self, placed: Array, normals: Array, config: AlignmentConfig) -> Array:
        """What samples of a surface, with unit normals, shapes (..., m, 3), count where no point is near: little where none could be."""
        low, high = self.seen
        hidden = normals[..., 2] < config.hidden_normal
        if np.isfinite(self.seen).any():
            hidden |= (placed < low - HIDDEN_M).any(axis=-1) | (placed > high + HIDDEN_M).any(axis=-1)
        if self.toward is not None:
            hidden |= normals @ self.toward < AWAY
        return np.where(hidden, config.hidden_weight, 1.0)

    @property
    def diagonal(self) -> float:
        """Diagonal of the box [m]."""
        return float(np.linalg.norm(self.size))


def make_target(
    points: Array, colors: NDArray[np.uint8], size: Array, config: AlignmentConfig, rng: np.random.Generator,
    hidden: Sequence[float] | None = None, is_let_in: bool = False,
) -> ScannedInstance:  # fmt: skip
    """An instance from its points in its own frame, shape (n, 3) [m]: thinned evenly, in random order.

    hidden: how much of the box the scan could not see on its sides -x, +x, -y, +y, -z, +z [m]. is_let_in: into a wall; where a part of
    it is hidden, its box was turned as the wall runs, and a strip of it fits other turns as well.
    """
    order = rng.permutation(len(points))
    cell = max(float(np.linalg.norm(size)) / 40, 1e-3)
    cells = np.floor(points[order] / cell).astype(np.int64)
    first = np.sort(distinct_rows(cells)[0])
    thinned = points[order[first]][: config.points]
    size, lost = np.maximum(size, 5e-3), np.zeros(6) if hidden is None else np.asarray(hidden, dtype=np.float64)
    low, high = np.array([-0.5 * size[0], -0.5 * size[1], 0.0]), np.array([0.5 * size[0], 0.5 * size[1], size[2]])
    seen = np.array([np.where(lost[0::2] > 0, low + lost[0::2], -np.inf), np.where(lost[1::2] > 0, high - lost[1::2], np.inf)])
    is_square = is_let_in and bool(lost[:4].any())
    return ScannedInstance(thinned, colors, size, spacing(thinned), spacing(points), seen, is_square=is_square)
