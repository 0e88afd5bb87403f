"""Lines on the upright sides of a scanned box: the gaps of drawers and doors, and their handles.

The sides of a box are resampled on a grid, from the picture of its best view and from its scanned points. A line is a row or a column that
is darker, lighter or otherwise set off from its surroundings over most of its length.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.captions.colors import lab
from tasks.views.crops import Crop

Array = NDArray[np.float64]

PICTURE_CELL_M, POINT_CELL_M = 0.006, 0.02
"""Cells of the grids: a pixel of a camera at 2 to 3 m, and the distance of scanned points."""

BAND_M = 0.05
"""Points this near to a side of the box are of it: handles stick out of fronts, and drawers stand back."""

SURROUNDINGS_CELLS = 15
"""Lines are compared with so many cells around them: 9 cm of a picture, a half of the lowest drawer."""

MIN_CONTRAST = 3.0
"""Difference of lightness (CIELAB) of a line and its surroundings: gaps of 4 mm have 4 and more in pictures, noise of fronts 1."""

MIN_RELIEF_M = 0.008
"""Depth of a line that points tell from a sensor's noise of 2 to 4 mm, averaged over a stretch."""

STRETCHES, MIN_SHARE = 5, 0.6
"""A side is divided into so many stretches along a line, and a line is seen in at least this share of them: boxes are a degree askew."""

SLACK_CELLS = 2
"""A line may be so many cells higher or lower in the next stretch."""

RIM_SHARE = 0.1
"""Edges of a side are no lines on it: shares of its height and width that do not count."""

MIN_CELLS = 8
"""Sides that fewer cells show along an axis tell nothing of lines."""


def has_lines(points: Array, colors: NDArray[np.uint8], size: Array, pose: Array, view: Crop | None) -> bool:
    """True if an upright side of a box shows lines in its picture or in its points.

    Args:
        points: scanned points in the frame of the box, whose origin is its middle [m], shape (n, 3).
        colors: their colors, shape (n, 3).
        size: extents of the box [m], shape (3,).
        pose: box to world, 4x4 [m].
        view: picture of the object; None without one.
    """
    lightness = lab(colors)[:, 0]
    for axis in (0, 1):
        for sign in (-1.0, 1.0):
            depth = sign * points[:, axis] - 0.5 * size[axis]
            of_side = np.abs(depth) <= BAND_M
            places = points[of_side][:, [1 - axis, 2]]
            extent = np.array([size[1 - axis], size[2]])
            if _shows_line(_gridded(places, lightness[of_side], extent), MIN_CONTRAST):
                return True
            if _shows_line(_gridded(places, depth[of_side], extent), MIN_RELIEF_M):
                return True
            if view is not None and _shows_line(_pictured(axis, sign, size, pose, view), MIN_CONTRAST):
                return True
    return False


def _gridded(places: Array, values: Array, extent: Array) -> Array:
    """Means of values on the grid of a side, shape (rows upward, columns), NaN where no point is.

    Args:
        places: along the side and upward from its middle [m], shape (n, 2).
        values: of the points, shape (n,).
        extent: width and height of the side [m], shape (2,).
    """
    shape = np.maximum(np.ceil(extent / POINT_CELL_M).astype(np.int64), 1)
    cell = np.clip(((places + 0.5 * extent) / POINT_CELL_M).astype(np.int64), 0, shape - 1)
    flat = cell[:, 1] * shape[0] + cell[:, 0]
    count = np.bincount(flat, minlength=int(shape.prod()))
    total = np.bincount(flat, weights=values, minlength=int(shape.prod()))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(int(shape[1]), int(shape[0]))


def _pictured(axis: int, sign: float, size: Array, pose: Array, view: Crop) -> Array:
    """Lightness of a side as its picture shows it, shape (rows upward, columns), NaN where it does not."""
    camera = view.camera
    if camera is None or view.silhouette is None:
        return np.full((1, 1), np.nan)
    steps = [max(int(extent / PICTURE_CELL_M), 1) for extent in (size[1 - axis], size[2])]
    along = ((np.arange(steps[0]) + 0.5) / steps[0] - 0.5) * size[1 - axis]
    upward = ((np.arange(steps[1]) + 0.5) / steps[1] - 0.5) * size[2]
    local = np.zeros((steps[1], steps[0], 3))
    local[..., axis], local[..., 1 - axis], local[..., 2] = sign * 0.5 * size[axis], along, upward[:, None]
    normal = sign * pose[:3, axis]
    middle = pose[:3, 3] + 0.5 * size[axis] * normal
    away = camera.pose[:3, 3] - middle
    values = np.full(local.shape[:2], np.nan)
    # Flat looks smear lines over each other.
    if away @ normal < 0.4 * np.linalg.norm(away):
        return values
    pixel, depth = camera.project(local.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3])
    column, row = np.round(pixel).astype(np.int64).T
    height, width = view.silhouette.shape
    is_shown = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    is_shown[is_shown] = view.silhouette[row[is_shown], column[is_shown]]
    values.reshape(-1)[is_shown] = lab(view.image[row[is_shown], column[is_shown]])[:, 0]
    return values


def _shows_line(values: Array, contrast: float) -> bool:
    """True if a grid, NaN where nothing is known, has a row or a column that is set off from those around it by a contrast."""
    return _has_row(values, contrast) or _has_row(values.T, contrast)


def _has_row(values: Array, contrast: float) -> bool:
    from scipy.ndimage import maximum_filter1d, median_filter

    if values.shape[0] < MIN_CELLS or values.shape[1] < MIN_CELLS:
        return False
    votes, valid = np.zeros(values.shape[0]), np.zeros(values.shape[0])
    for stretch in np.array_split(values, STRETCHES, axis=1):
        known = np.isfinite(stretch)
        is_known = known.mean(axis=1) >= 0.5
        if is_known.sum() < MIN_CELLS:
            continue
        profile = np.full(len(stretch), np.nan)
        profile[is_known] = np.nanmedian(stretch[is_known], axis=1)
        dense = profile[is_known]
        apart = np.zeros(len(stretch))
        apart[is_known] = np.abs(dense - median_filter(dense, size=min(SURROUNDINGS_CELLS, len(dense)), mode="nearest"))
        votes += maximum_filter1d((apart >= contrast).astype(np.float64), 2 * SLACK_CELLS + 1)
        valid += maximum_filter1d(is_known.astype(np.float64), 2 * SLACK_CELLS + 1)
    rim = max(int(RIM_SHARE * len(votes)), 1)
    inner = slice(rim, len(votes) - rim)
    return bool(((valid[inner] >= 3) & (votes[inner] >= MIN_SHARE * valid[inner])).any())
