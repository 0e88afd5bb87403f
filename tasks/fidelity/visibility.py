"""What of a replica the cameras could see, and where they saw past it: rays from each camera to each point.

A ray that meets no scanned surface is no reading: what lies along it is not known, neither seen nor empty.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.rendering import TOUCH_M, Camera, RayScene, in_picture, reach

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Rays(Protocol):
    """What rays from a camera meet."""

    def reach(self, camera: Camera, points: Array, /) -> Array:
        """How far rays through points get before they meet something [m], infinite where they do not. Shape (n, 3) to (n,)."""


def visible(points: Array, replica: Rays, scan: RayScene, cameras: Sequence[Camera], behind_m: float) -> Mask:
    """Which points of the replica's surface some camera could see, shape (n,).

    It could when the ray meets the replica there first, and the scan's surface does not hide it: along the ray the scan
    was read, no farther than `behind_m` before the point [m]. Deeper behind the scan's surface nobody knows what there is.
    """
    seen = np.zeros(len(points), dtype=bool)
    for camera in cameras:
        index = np.flatnonzero(~seen)
        index = index[in_picture(camera, points[index])]
        length = np.linalg.norm(points[index] - camera.pose[:3, 3], axis=1)
        clear = np.abs(replica.reach(camera, points[index]) - length) <= TOUCH_M
        index, length = index[clear], length[clear]
        read = reach(camera, points[index], scan)
        seen[index[np.isfinite(read) & (read >= length - behind_m)]] = True
    return seen


def seen_past(points: Array, scan: RayScene, cameras: Sequence[Camera], margin_m: float) -> Mask:
    """Which points some camera saw past: it read scanned surface at least `margin_m` behind the point [m]. Shape (n,)."""
    past = np.zeros(len(points), dtype=bool)
    for camera in cameras:
        index = np.flatnonzero(~past)
        index = index[in_picture(camera, points[index])]
        read = reach(camera, points[index], scan)
        length = np.linalg.norm(points[index] - camera.pose[:3, 3], axis=1)
        past[index[np.isfinite(read) & (read >= length + margin_m)]] = True
    return past
