"""Samples of assets, and the poses that put them onto instances."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

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
    (m, 3); `extents`: of the asset's box [m]; `area`: of its surface [m2]; `surface`: its triangles, for methods that take them;
    `has_own_size`: whether its size is its own, and was not made to the measure of the instance."""

    points: Array
    normals: Array
    colors: NDArray[np.uint8]
    extents: Array
    area: float
    surface: Surface | None = None
    has_own_size: bool = False

    def placed(self, fit: Fit) -> tuple[Array, Array, float]:
        """Points, unit normals and disc radius of the samples in the instance's frame [m]."""
        turn = turned(fit.yaw).T
        normals = (self.normals / fit.scale) @ turn
        _compiled()["_lengthened"](normals)
        return (self.points * fit.scale) @ turn + fit.offset, normals, self._radius(fit)

    def placed_all(self, fits: Sequence[Fit]) -> tuple[Array, Array, Array]:
        """The same for several fits at a time, shapes (p, m, 3), (p, m, 3) and (p,)."""
        turns = np.stack([turned(fit.yaw).T for fit in fits])
        scales = np.stack([fit.scale for fit in fits])
        points = (self.points * scales[:, None]) @ turns + np.stack([fit.offset for fit in fits])[:, None]
        normals = (self.normals / scales[:, None]) @ turns
        _compiled()["_lengthened"](normals.reshape(-1, 3))
        return points, normals, np.array([self._radius(fit) for fit in fits])

    def _radius(self, fit: Fit) -> float:
        """Of the discs of a fit [m]: area grows with the square of the mean scale."""
        x, y, z = fit.scale.tolist()
        return math.sqrt(self.area * (x * y * z) ** (2 / 3) / (math.pi * len(self.points)))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_lengthened)


def _lengthened(normals: Array) -> None:
    """Make vectors, shape (n, 3), as long as one."""
    for i in range(len(normals)):
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        length = max(np.sqrt(x * x + y * y + z * z), 1e-12)
        normals[i, 0], normals[i, 1], normals[i, 2] = x / length, y / length, z / length


def turned(yaw: float) -> Array:
    """Turn about +Z by a yaw [rad], shape (3, 3)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
