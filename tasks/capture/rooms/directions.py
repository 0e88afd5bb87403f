"""Directions of walls other than a room's own two."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_OBLIQUE_M2 = 1.0
"""A direction other than the room's own needs this much wall: it could be noise otherwise."""


def oblique_direction(cloud: Cloud, free: Mask, tried: list[float]) -> float | None:
    """The angle of normals [rad], off the axes and off those tried, that most of the points in `free`, shape (n,), have; None if few do."""
    if cloud.areas[free].sum() < _OBLIQUE_M2:
        return None
    normals, areas = cloud.normals[free, :2], cloud.areas[free]
    angles = np.arctan2(normals[:, 1], normals[:, 0]) % np.pi
    weights = np.bincount((angles / np.deg2rad(5)).astype(np.int64) % 36, weights=areas, minlength=36)
    near = weights + np.roll(weights, 1) + np.roll(weights, -1)
    for known in (0.0, np.pi / 2, *tried):  # nothing is left there but noise
        near[(np.arange(-1, 2) + round(known / np.deg2rad(5) - 0.5)) % 36] = 0
        near[round(known / np.deg2rad(5)) % 36] = 0
    if near.max() < _OBLIQUE_M2:
        return None
    middle = np.deg2rad(5 * (int(np.argmax(near)) + 0.5))
    close = np.abs((angles - middle + np.pi / 2) % np.pi - np.pi / 2) < np.deg2rad(10)
    return _sharpest(cloud.points[free][close, :2], areas[close], middle)


def _sharpest(points: Array, areas: Array, middle: float) -> float:
    """The angle within 8 degrees of `middle` [rad] along which points lie in the thinnest planes."""
    angles = middle + np.deg2rad(np.arange(-8, 8.1, 0.25))
    center = points.mean(axis=0)

    def sharpness(angle: float) -> float:
        offset = (points - center) @ [np.cos(angle), np.sin(angle)]
        histogram = np.bincount(((offset - offset.min()) / 0.02).astype(np.int64), weights=areas)
        return float((histogram**2).sum())

    return float(angles[int(np.argmax([sharpness(float(angle)) for angle in angles]))])
