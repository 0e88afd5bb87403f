"""Convex pieces cut back from one another: what one keeps, and the rest of the other as convex parts beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.hulls import Hull, hull_of, reduced
from tasks.geometry.triangles import face_planes

Array = NDArray[np.float64]

LEAST_M = 0.002
"""Parts thinner than this [m] are nothing: engines inflate them, or refuse them."""

MOST_PARTS = 3
"""Parts that stand for what is left of a piece: each is another piece for engines to test."""

ENOUGH = 0.9
"""Of what is left of a piece: one part with so much of it is the only one."""

GRID = 9
"""Points along each axis of a piece's box at which it is asked what of it lies where."""

FEW = 24
"""A piece with fewer such points inside, a slanting plate, is judged by points between its corners."""


def beyond(hull: Hull, normal: Array, offset: float) -> Hull | None:
    """The part of a hull with normal . x >= offset [m]; None where it is thinner than `LEAST_M`. normal: unit vector, shape (3,)."""
    heights = hull.vertices @ normal - offset
    if heights.max() < LEAST_M:
        return None
    if heights.min() >= 0.0:
        return hull
    edges = np.concatenate([hull.faces[:, [0, 1]], hull.faces[:, [1, 2]], hull.faces[:, [2, 0]]])
    crossing = edges[(heights[edges[:, 0]] > 0.0) & (heights[edges[:, 1]] < 0.0)]  # closed: each edge comes once in either direction
    share = heights[crossing[:, 0]] / (heights[crossing[:, 0]] - heights[crossing[:, 1]])
    start, end = hull.vertices[crossing[:, 0]], hull.vertices[crossing[:, 1]]
    return solid_hull(np.concatenate([hull.vertices[heights >= 0.0], start + share[:, None] * (end - start)]))


def solid_hull(points: Array) -> Hull | None:
    """The hull of points, shape (n, 3) [m], that engines take as it is; None where it is thinner than `LEAST_M`."""
    from scipy.spatial import QhullError

    if len(points) < 4:
        return None
    try:
        hull = hull_of(points)
    except QhullError:
        return None
    normals, offsets = face_planes(hull.vertices, hull.faces, 1e-14)
    if not len(normals) or float((offsets - (hull.vertices @ normals.T).min(axis=0)).min()) < LEAST_M:
        return None
    return reduced(hull)


def without(hull: Hull, other: Hull, margin: float = 0.0) -> list[Hull]:
    """Parts of a hull outside of another one, at least `margin` [m] off its faces: up to `MOST_PARTS` convex parts that share faces and
    together lose as little as planes through the faces of the other allow. The hull itself where the other is not in it."""
    normals, offsets = face_planes(other.vertices, other.faces, 1e-14)
    _, first = np.unique(np.round(np.column_stack([normals, offsets]), 6), axis=0, return_index=True)
    normals, offsets = normals[np.sort(first)], offsets[np.sort(first)] + margin
    if bool(((hull.vertices @ normals.T) >= offsets).all(axis=0).any()):
        return [hull]
    points = inner_points(hull)
    inside = np.asarray(points @ normals.T < offsets)
    is_left = np.asarray(~inside.all(axis=1))
    parts: list[Hull] = []
    rest: Hull | None = hull
    for _ in range(MOST_PARTS):
        if rest is None or not is_left.any():
            break
        kept = (is_left[:, None] & ~inside).sum(axis=0)
        best = int(kept.argmax())
        part = beyond(rest, normals[best], float(offsets[best]))
        if part is not None:
            parts.append(part)
        enough = kept[best] >= ENOUGH * is_left.sum()
        is_left &= inside[:, best]
        if enough:
            break
        rest = beyond(rest, -normals[best], -float(offsets[best]))
    return parts


def shared_by(hull: Hull, other: Hull) -> tuple[Array, Array]:
    """Planes of the space that two hulls share: outward unit normals, shape (n, 3), and offsets [m], shape (n,)."""
    planes = [face_planes(each.vertices, each.faces, 1e-14) for each in (hull, other)]
    return np.concatenate([normals for normals, _ in planes]), np.concatenate([offsets for _, offsets in planes])


def inner_points(hull: Hull) -> Array:
    """Points inside a hull, evenly spread over its box where it fills enough of that, shape (n, 3) [m]."""
    low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    steps = (np.arange(GRID) + 0.5) / GRID
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3) * (high - low) + low
    normals, offsets = face_planes(hull.vertices, hull.faces, 1e-14)
    grid = grid[((grid @ normals.T) < offsets).all(axis=1)]
    if len(grid) >= FEW:
        return grid
    middle = hull.vertices.mean(axis=0)
    between = 0.5 * (hull.vertices[hull.faces].mean(axis=1)[:, None] + hull.vertices[None])
    return np.concatenate([grid, between.reshape(-1, 3), 0.9 * hull.vertices + 0.1 * middle])


def prism(ring: Array, low: float, high: float) -> Hull | None:
    """An upright prism over the convex hull of corners in plan, shape (n, 2) [m]; None where it is thinner than `LEAST_M`."""
    return solid_hull(np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for z in (low, high)]))
