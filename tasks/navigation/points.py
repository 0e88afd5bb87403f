"""Points on the floor: as arrays, and drawn at random from triangles."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def rows(points: ArrayLike) -> Array:
    """Points as float64, shape (n, 2)."""
    return np.asarray(points, dtype=np.float64).reshape(-1, 2)


@dataclasses.dataclass(frozen=True)
class FloorTriangles:
    """Triangles that tile a navigable region, world frame, in the order of their islands.

    corners: Shape (n, 3, 2) [m]. cumulative: Area of the triangles up to and with each [m2], shape (n,). islands: Shape (n,).
    """

    corners: Array
    cumulative: Array
    islands: NDArray[np.int64]

    def random_point(self, rng: np.random.Generator, island: int | None = None) -> Array:
        """A point, uniform over the area of one island or of all, shape (2,)."""
        first, last = (0, len(self.corners)) if island is None else map(int, np.searchsorted(self.islands, [island, island + 1]))
        low, high = (float(self.cumulative[first - 1]) if first else 0.0), float(self.cumulative[last - 1])
        pick, u, v = rng.random(3)
        drawn = int(np.searchsorted(self.cumulative, low + pick * (high - low), side="right"))
        triangle = self.corners[min(max(drawn, first), last - 1)]
        if u + v > 1:
            u, v = 1 - u, 1 - v
        return np.asarray(triangle[0] + u * (triangle[1] - triangle[0]) + v * (triangle[2] - triangle[0]))
