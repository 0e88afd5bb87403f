"""Bare floors with boxes on them, and a cart without errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from tasks.robot.configuration import DriveNoise
from tasks.robot.floor_map import Floor, outline

QUIET = DriveNoise(
    slip=0.0,
    slip_walk=0.0,
    skid_s=0.0,
    delay_s=0.0,
    lag_s=0.0,
    encoder=0.0,
    gyro_noise_rps=0.0,
    gyro_bias_rps=0.0,
    start_m=0.0,
    start_radians=0.0,
)
"""Nothing slips, errs, or is late."""


def bare_floor(boxes: Sequence[shapely.Geometry] = (), size: tuple[float, float] = (6.0, 6.0), unseen: Sequence[int] = ()) -> Floor:
    """A floor from the origin on with walls that the lidar sees, and boxes that it sees, too, but those of some numbers."""
    polygon = shapely.box(0.0, 0.0, *size)
    named = {f"{index:04d}": shape for index, shape in enumerate(boxes)}
    plane = {name: outline(shape) for name, shape in named.items() if int(name) not in unseen}
    return Floor(polygon, named, {"wall": outline(polygon), **plane}, {}, frozenset(named))


def random_boxes(
    rng: np.random.Generator, count: int = 8, size: float = 6.0, clear: Sequence[Sequence[float]] = (), keep: float = 0.6
) -> list:
    """Turned boxes of 0.2 to 1 m that keep away from some points."""
    boxes: list[shapely.Geometry] = []
    while len(boxes) < count:
        width, depth = rng.uniform(0.2, 1.0, 2)
        x, y = rng.uniform(0.4, size - 0.4, 2)
        box = shapely.affinity.rotate(shapely.box(x - width / 2, y - depth / 2, x + width / 2, y + depth / 2), rng.uniform(0, 180))
        if all(box.distance(shapely.Point(point)) > keep for point in clear):
            boxes.append(box)
    return boxes
