"""Colors in the space that renderers compute in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def linear_colors(colors: NDArray[np.uint8]) -> NDArray[np.float64]:
    """sRGB bytes, shape (n, 3), as linear values in 0..1 (IEC 61966-2-1)."""
    values = np.arange(256) / 255.0
    table = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return np.asarray(table[colors])
