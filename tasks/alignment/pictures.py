"""Pictures compared by the patches of DINOv2 (Oquab et al., 2023), whose weights lie in a folder that somebody names."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.alignment.snapshots import surface_snapshot
from tasks.geometry.meshes import Surface
from tasks.selection.methods.encoders import dino_in

if TYPE_CHECKING:
    from tasks.alignment.acdc import Acdc


def picture_distances(picture: NDArray[np.uint8], surface: Surface, elevation: float, config: Acdc) -> NDArray[np.float64]:
    """How far the snapshots of a surface are from a square picture on white, shape (h, h, 3), by the cosines of their patches in
    the same place: shape (snapshots,).

    Raises:
        InputError: the folder holds no weights of DINOv2, or lacks some, or packages are not installed.
    """
    encoder = dino_in(config.dinov2)
    side = max(config.picture_pixels // encoder.patch, 1) * encoder.patch
    wanted = encoder.patches(resized(picture, side)[None])[0]
    azimuths = [2 * np.pi * i / config.snapshots for i in range(config.snapshots)]
    drawn = [surface_snapshot(surface, azimuth, elevation, side).color for azimuth in azimuths]
    shown = encoder.patches(np.stack(drawn))
    return np.asarray(1.0 - np.einsum("npd,pd->np", shown, wanted).mean(axis=1), dtype=np.float64)


def resized(picture: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """A picture as a square of so many pixels, shape (side, side, 3), its longer side filling it, white beside it."""
    import PIL.Image

    height, width = picture.shape[:2]
    wide, high = (max(1, round(side * length / max(height, width))) for length in (width, height))
    part = np.asarray(PIL.Image.fromarray(np.ascontiguousarray(picture)).resize((wide, high), PIL.Image.Resampling.BICUBIC))
    square = np.full((side, side, 3), 255, dtype=np.uint8)
    top, left = (side - high) // 2, (side - wide) // 2
    square[top : top + high, left : left + wide] = part
    return square
