"""How far two pictures differ to the eye: CIEDE2000 of colors, and structural similarity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_WINDOW_SIGMA = 1.5
_WINDOW_RADIUS = 5
"""The window of Wang et al.: 11 pixels wide, sigma 1.5."""

_K1, _K2, _RANGE = 0.01, 0.03, 255.0


def ciede2000(first: ArrayLike, second: ArrayLike) -> Array:
    """Color difference of CIELAB colors, shape (..., 3) each, to shape (...): 1 is just seen, 2.3 by most people.

    Sharma, Wu, Dalal, "The CIEDE2000 color-difference formula: implementation notes, supplementary test data, and mathematical
    observations", 2005; all parametric factors are 1.
    """
    (l1, a1, b1), (l2, a2, b2) = (np.moveaxis(np.asarray(color, dtype=np.float64), -1, 0) for color in (first, second))
    mean_c = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    stretch = 1.5 - 0.5 * np.sqrt(mean_c**7 / (mean_c**7 + 25.0**7))
    a1, a2 = a1 * stretch, a2 * stretch
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = np.degrees(np.arctan2(b1, a1)) % 360, np.degrees(np.arctan2(b2, a2)) % 360
    is_gray = c1 * c2 == 0
    turn = h2 - h1
    turn = np.where(is_gray, 0.0, np.where(turn > 180, turn - 360, np.where(turn < -180, turn + 360, turn)))
    delta_h = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2)
    both = h1 + h2
    far = np.abs(h1 - h2) > 180
    mean_h = np.where(is_gray, both, np.where(far, np.where(both < 360, both + 360, both - 360), both) / 2)
    mean_l, mean_c = (l1 + l2) / 2, (c1 + c2) / 2
    t = (
        1
        - 0.17 * np.cos(np.radians(mean_h - 30))
        + 0.24 * np.cos(np.radians(2 * mean_h))
        + 0.32 * np.cos(np.radians(3 * mean_h + 6))
        - 0.20 * np.cos(np.radians(4 * mean_h - 63))
    )
    weight_l = 1 + 0.015 * (mean_l - 50) ** 2 / np.sqrt(20 + (mean_l - 50) ** 2)
    weight_c, weight_h = 1 + 0.045 * mean_c, 1 + 0.015 * mean_c * t
    rotation = -np.sin(np.radians(60 * np.exp(-(((mean_h - 275) / 25) ** 2)))) * 2 * np.sqrt(mean_c**7 / (mean_c**7 + 25.0**7))
    light, chroma, hue = (l2 - l1) / weight_l, (c2 - c1) / weight_c, delta_h / weight_h
    return np.asarray(np.sqrt(np.maximum(light**2 + chroma**2 + hue**2 + rotation * chroma * hue, 0.0)))


def gray(rgb: ArrayLike) -> Array:
    """Luma (BT.601) of sRGB colors 0..255, shape (..., 3) to (...), as structural similarity is published on."""
    return np.asarray(np.asarray(rgb, dtype=np.float64) @ [0.299, 0.587, 0.114])


def structural_similarity(first: ArrayLike, second: ArrayLike, seen: ArrayLike | None = None) -> Array:
    """Structural similarity (SSIM) of gray pictures 0..255 around each pixel, -1..1, shapes (h, w); 1 where they are equal.

    Wang et al., "Image quality assessment: from error visibility to structural similarity", 2004. Windows leave out pixels
    that are not `seen`, of all shapes (h, w); where none is, the value means nothing.
    """
    from scipy.ndimage import gaussian_filter

    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    mask = np.ones(a.shape) if seen is None else np.asarray(seen, dtype=np.float64)

    def blurred(values: Array) -> Array:
        return np.asarray(gaussian_filter(values, _WINDOW_SIGMA, radius=_WINDOW_RADIUS, mode="constant"))

    weight = np.maximum(blurred(mask), 1e-12)
    mean_a, mean_b = blurred(a * mask) / weight, blurred(b * mask) / weight
    var_a = blurred(a * a * mask) / weight - mean_a**2
    var_b = blurred(b * b * mask) / weight - mean_b**2
    cov = blurred(a * b * mask) / weight - mean_a * mean_b
    c1, c2 = (_K1 * _RANGE) ** 2, (_K2 * _RANGE) ** 2
    return np.asarray((2 * mean_a * mean_b + c1) * (2 * cov + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2)))
