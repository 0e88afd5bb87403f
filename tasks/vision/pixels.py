"""Pictures as networks take them, in NumPy: sizes, means and deviations as published with their weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Pixels = NDArray[np.float32]


def shrunk_to(image: Image, height: int, width: int) -> Image:
    """A picture of another size, shape (height, width, 3): bilinear, smoothed where it gets smaller, in whole grays."""
    import PIL.Image

    if image.shape[:2] == (height, width):
        return image
    return np.asarray(PIL.Image.fromarray(np.ascontiguousarray(image)).resize((width, height), PIL.Image.Resampling.BILINEAR))


def normalized(image: NDArray[np.uint8] | Pixels, mean: tuple[float, ...], deviation: tuple[float, ...]) -> Pixels:
    """A picture, shape (h, w, 3), as values about 0, shape (3, h, w). image: Grays, or shares of white."""
    shares = image.astype(np.float32) * np.float32(1 / 255) if image.dtype == np.uint8 else image
    values = (shares - np.array(mean, np.float32)) / np.array(deviation, np.float32)
    return np.ascontiguousarray(values.transpose(2, 0, 1), dtype=np.float32)


def sampled(shares: Pixels, height: int, width: int) -> Pixels:
    """A picture of another size, shape (height, width, 3): bilinear between the nearest four pixels, whatever it leaves out."""
    top, bottom, down = _between(shares.shape[0], height)
    left, right, across = _between(shares.shape[1], width)
    rows = shares[top] * (1 - down[:, None, None]) + shares[bottom] * down[:, None, None]
    made = rows[:, left] * (1 - across[None, :, None]) + rows[:, right] * across[None, :, None]
    return np.asarray(made, dtype=np.float32)


def _between(size: int, target: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Pixels]:
    """Of each pixel of a row of `target`, the two of `size` that it lies between, and how near it is to the second one."""
    place = np.maximum((np.arange(target) + 0.5) * (size / target) - 0.5, 0.0)
    first = np.minimum(place.astype(np.int64), size - 1)
    return first, np.minimum(first + 1, size - 1), (place - first).astype(np.float32)


def smoothed_to(shares: Pixels, side: int) -> Pixels:
    """A square picture of another size, shape (side, side, 3): a Gaussian of half of what it shrinks by, then bilinear.

    As OWLv2's authors shrink, who took scikit-image: mirrored borders, no value beyond those there were.
    """
    from scipy.ndimage import gaussian_filter, zoom

    factor = shares.shape[0] / side
    sigma = max(0.0, (factor - 1) / 2)
    filtered = gaussian_filter(shares, (sigma, sigma, 0), mode="mirror")
    made = zoom(filtered, (1 / factor, 1 / factor, 1), order=1, mode="mirror", grid_mode=True)
    return np.clip(made, shares.min(), shares.max()).astype(np.float32)


def fitted_size(height: int, width: int, shortest: int, longest: int) -> tuple[int, int]:
    """Height and width of a picture whose shorter side becomes `shortest`, or whose longer side becomes `longest` where that is less.

    As DETR and its kin round.
    """
    low, high = min(height, width), max(height, width)
    exact: float = shortest
    if high / low * shortest > longest:
        exact = longest * low / high
    size = round(exact)
    if size == low:
        return height, width
    other = int(exact * high / low)
    return (size, other) if height <= width else (other, size)
