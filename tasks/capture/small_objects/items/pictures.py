"""What a model is shown of a support: the part of a frame around its mask (specs A.3)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tasks.views.crops import resized
from tasks.vision.pixels import Image

Bools = NDArray[np.bool_]

MaskStyle = Literal["hard", "dim", "box"]

_DIMMED = 0.35
"""Share of its brightness that is left to what is not the support."""


def grown(mask: Bools, share: float) -> Bools:
    """A mask that reaches farther by a share of the longer side of its box, shape (h, w)."""
    from scipy.ndimage import distance_transform_edt

    if not mask.any():
        return mask
    x0, y0, x1, y1 = box_of(mask)
    return np.asarray(distance_transform_edt(~mask) <= share * max(x1 - x0, y1 - y0))


def box_of(mask: Bools) -> tuple[int, int, int, int]:
    """The box x0, y0, x1, y1 of a mask that has a pixel [px], the ends exclusive."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def support_picture(picture: Image, mask: Bools, style: MaskStyle, dilation: float, margin: float, pixels: int) -> Image:
    """The part of a picture, shape (h, w, 3), around a support's mask, shape (h, w), at most so many pixels wide and high.

    style: What becomes of the rest of that part: `hard` blackens it, as the paper does, and with it whatever stands taller than the
    support's own mask; `dim` darkens it; `box` leaves it. dilation: How much farther the mask reaches, in longer sides of its box.
    margin: How much more is shown above it, in heights of its box: tall things stick out.
    """
    wide = grown(mask, dilation)
    x0, y0, x1, y1 = box_of(wide)
    y0 = max(0, y0 - round(margin * (y1 - y0)))
    part, inside = picture[y0:y1, x0:x1], wide[y0:y1, x0:x1, None]
    if style == "hard":
        part = np.where(inside, part, np.uint8(0))
    elif style == "dim":
        part = np.where(inside, part, (part * _DIMMED).astype(np.uint8))
    share = pixels / max(part.shape[:2])
    if share >= 1:
        return np.asarray(part, dtype=np.uint8)
    return resized(np.asarray(part, dtype=np.uint8), max(1, round(part.shape[1] * share)), max(1, round(part.shape[0] * share)))
