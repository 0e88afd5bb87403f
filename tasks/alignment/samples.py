"""Samples of assets, and the poses that put them onto instances."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tasks.geometry.meshes import Surface

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Fit:
    """A pose of an asset in the instance's frame: turn about +Z [rad], shift [m], shape (3,), scale, shape (3,)."""

    yaw: float
    offset: Array
    scale: Array


@dataclasses.dataclass(frozen=True)
class Sample:
    """Evenly spread samples of a canonical asset's surface, in random order. `points`, `normals`, `colors`: shape
    (m, 3); `extents`: of the asset's box [m]; `area`: of its surface [m2]; `surface`: its triangles, for methods that take them."""

    points: Array
    normals: Array
    colors: NDArray[np.uint8]
    extents: Array
    area: float
    surface: Surface | None = None

    def placed(self, fit: Fit) -> tuple[Array, Array, float]:
        """Points, unit normals and disc radius of the samples in the instance's frame [m]."""
        points, normals, radii = self.placed_all([fit])
        return points[0], normals[0], float(radii[0])

    def placed_all(self, fits: Sequence[Fit]) -> tuple[Array, Array, Array]:
        """The same for several fits at a time, shapes (p, m, 3), (p, m, 3) and (p,)."""
        turns = np.stack([turned(fit.yaw).T for fit in fits])
        scales = np.stack([fit.scale for fit in fits])
        points = (self.points * scales[:, None]) @ turns + np.stack([fit.offset for fit in fits])[:, None]
        normals = (self.normals / scales[:, None]) @ turns
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
        stretch = [float(np.prod(scale)) ** (2 / 3) for scale in scales]  # area grows with the square of the mean scale
        return points, normals, np.sqrt(self.area * np.array(stretch) / (np.pi * len(self.points)))


def turned(yaw: float) -> Array:
    """Turn about +Z by a yaw [rad], shape (3, 3)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
