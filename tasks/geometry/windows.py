"""Parts of images: what the view of an object shows around its mask, and masks as rows hold them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

VIEW_MARGIN = 0.15
"""What the view of an object shows around its mask, in longer sides of the mask's box."""


def view_window(pixel_box: Sequence[int], width: int, height: int) -> tuple[int, int, int, int]:
    """The part of an image that shows what is in a box x0, y0, x1, y1, with a margin [px]: as the box, within the image."""
    x0, y0, x1, y1 = pixel_box
    margin = max(4, round(VIEW_MARGIN * max(x1 - x0, y1 - y0)))
    return max(0, x0 - margin), max(0, y0 - margin), min(width, x1 + margin), min(height, y1 + margin)


def mask_of(run_lengths: Sequence[int], pixel_box: Sequence[int]) -> NDArray[np.bool_]:
    """The mask in a box x0, y0, x1, y1 [px], shape (y1 - y0, x1 - x0), from its runs as `schemas.capture.Mask` has them.

    Raises:
        ValueError: the runs are not as long as the box is large.
    """
    x0, y0, x1, y1 = pixel_box
    inside = np.arange(len(run_lengths)) % 2 == 1
    return np.repeat(inside, np.asarray(run_lengths, dtype=np.int64)).reshape(y1 - y0, x1 - x0)
