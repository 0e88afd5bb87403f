"""Pictures as files."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray


def png_of(image: NDArray[np.uint8]) -> bytes:
    """A picture, shape (h, w, 3) or (h, w, 4), as PNG."""
    import PIL.Image

    file = io.BytesIO()
    PIL.Image.fromarray(np.ascontiguousarray(image)).save(file, "PNG")
    return file.getvalue()
