"""Triangles that are all but segments, with points and how far these are from the segments."""

from __future__ import annotations

import numpy as np


def slivers(height: float, turn: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of 200 triangles of about such a height, shape (200, 3, 3), the first of each moved on by `turn`; a point for each,
    shape (200, 3); and its distance from the triangle's longest side, shape (200,)."""
    rng = np.random.default_rng(7)
    start, way, side = rng.normal(size=(3, 200, 3))
    side -= np.einsum("ni,ni->n", side, way)[:, None] / np.einsum("ni,ni->n", way, way)[:, None] * way
    tip = start + rng.uniform(0, 1, (200, 1)) * way + height * side
    corners = np.roll(np.stack([start, start + way, tip], axis=1), turn, axis=1)
    points = rng.normal(size=(200, 3))
    along = np.clip(np.einsum("ni,ni->n", points - start, way) / np.einsum("ni,ni->n", way, way), 0, 1)
    return corners, points, np.linalg.norm(start + along[:, None] * way - points, axis=1)
