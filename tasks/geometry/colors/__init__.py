"""Every color space, converted here and nowhere else.

Inside the project a color is a display value: sRGB bytes, or sRGB from 0 to 1. That holds for vertices, images and materials.
These borders are linear: `COLOR_0` and the factors of glTF, display colors and inputs of preview surfaces in USD.
These borders are display values: images, PLY, `Kd` of MTL, `rgba` of MJCF and URDF, materials of SDF, Rerun, CSS.
A product of colors is a product of linear values.

Source: IEC 61966-2-1; glTF 2.0, sections 3.7.2.1 and 3.9.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Shorts = NDArray[np.uint16]

COLOR_MAX = 65535
"""Full intensity in 16 bits, which keep all 256 display values apart. 8 linear bits lose 73 of them, all dark."""


def linear_of(display: ArrayLike) -> Array:
    """Linear values of display values, both 0 to 1, any shape. Values outside are clipped; NaN is 0."""
    value = _unit(display)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def display_of(linear: ArrayLike) -> Array:
    """Display values of linear values, both 0 to 1, any shape; inverse of `linear_of`."""
    value = _unit(linear)
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


def linear_of_bytes(display: NDArray[np.uint8]) -> Array:
    """Linear values, 0 to 1, of display bytes, any shape."""
    return np.asarray(_LINEAR[display])


def bytes_of_linear(linear: ArrayLike) -> Bytes:
    """Display bytes of linear values, 0 to 1, any shape; inverse of `linear_of_bytes`."""
    return bytes_of(display_of(linear))


def bytes_of(display: ArrayLike) -> Bytes:
    """Display bytes of display values, 0 to 1, any shape."""
    return np.round(255.0 * _unit(display)).astype(np.uint8)


def shorts_of_bytes(display: NDArray[np.uint8]) -> Shorts:
    """Linear 16-bit values of display bytes, RGB or RGBA, shape (..., 3 or 4). Alpha is linear in both."""
    shorts = _LINEAR_SHORTS[display]
    shorts[..., 3:] = display[..., 3:].astype(np.uint16) * 257
    return shorts


def bytes_of_shorts(linear: NDArray[np.uint16]) -> Bytes:
    """Display bytes of linear 16-bit values, shape (..., 3 or 4); inverse of `shorts_of_bytes`."""
    display = _BYTES_OF_SHORTS[linear]
    display[..., 3:] = np.round(linear[..., 3:] / 257).astype(np.uint8)
    return display


def tinted(image: NDArray[np.uint8], factor: ArrayLike) -> Bytes:
    """An image times a linear factor.

    Args:
        image: display bytes, shape (..., 3), or (..., 4) with an alpha that stays.
        factor: linear, shape (3,).
    """
    factors = np.asarray(factor, dtype=np.float64)
    if (factors[:3] == 1.0).all():
        return image
    product = image.copy()
    for channel in range(3):
        product[..., channel] = bytes_of_linear(_LINEAR * factors[channel])[image[..., channel]]
    return product


def _unit(values: ArrayLike) -> Array:
    """Values clipped to 0..1; NaN is 0."""
    return np.clip(np.nan_to_num(np.asarray(values, dtype=np.float64), nan=0.0), 0.0, 1.0)


_LINEAR = linear_of(np.arange(256) / 255.0)
_LINEAR_SHORTS = np.round(COLOR_MAX * _LINEAR).astype(np.uint16)
_BYTES_OF_SHORTS = bytes_of_linear(np.arange(COLOR_MAX + 1) / COLOR_MAX)
