"""The scanner's frames into one mesh, without specks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from schemas.errors import InputError
from tasks.geometry.fusion import Volume
from tasks.geometry.meshes import Surface
from tasks.scanner.sensor import Shot, depth_camera

if TYPE_CHECKING:
    from tasks.scanner import ScannerConfig

_FARTHER_M = 0.5
"""Readings up to so far beyond the sensor's range count: it is noise that carried them there."""


def fuse(shots: Iterable[Shot], config: ScannerConfig) -> Surface:
    """The fused surface in the scan frame [m] with vertex colors; components below `speck_faces` triangles are dropped.

    Raises:
        InputError: no frame saw anything.
    """
    volume = Volume(config.voxel_m, config.truncation_voxels)
    camera = depth_camera(np.eye(4), config)
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    step = config.color_width // config.depth_width
    for shot in shots:
        color = shot.color[step // 2 :: step, step // 2 :: step]
        volume.integrate((shot.depth / 1000).astype(np.float32), color, lens, lens, shot.pose, config.max_range_m + _FARTHER_M)
    surface = volume.surface(config.least_looks, config.speck_faces)
    if not len(surface.faces):
        raise InputError("scene", "surfaces", "no frame saw anything within the sensor's range", "is it in metres?")
    return surface
