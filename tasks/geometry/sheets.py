"""Sheets of triangles, for engines that drape them: the layer of convex pieces that lies on what is below them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.pieces import Hull
from tasks.geometry.tetrahedra import cell_counts
from tasks.geometry.triangles import face_planes, surface_area

Array = NDArray[np.float64]

CELLS = 256
"""Most cells of the grid over a sheet's outline: 512 triangles, which engines step in milliseconds on a CPU."""

THINNEST, THICKEST = 0.001, 0.02
"""Of a sheet where it touches [m]: a shirt, and a quilt; what is thicker is folded, and would not bend like cloth."""


@dataclasses.dataclass(frozen=True)
class Sheet:
    """One connected manifold sheet. vertices: [m], shape (n, 3). triangles: shape (m, 3). thickness: where it touches [m]."""

    vertices: Array
    triangles: NDArray[np.int64]
    thickness: float

    @property
    def area(self) -> float:
        """Area of the triangles [m2]."""
        return surface_area(self.vertices, self.triangles)


def sheet_of(hulls: Sequence[Hull], volume: float, cells: int = CELLS) -> Sheet:
    """A sheet across the shortest side of the box of convex pieces, in the pieces' frame [m], +Z up.

    It is as thick as their volume over its area, within limits. Where the shortest side is upright it lies half its
    thickness above their lower side, and rests where they rest: a rug, a blanket on a bed. Else it lies in the middle
    between where a line along that side enters them and leaves them: a towel on a rack, with its folds.

    Args:
        hulls: The pieces.
        volume: Of their union [m3].
        cells: Most cells of the grid; two triangles each.
    """
    points = np.concatenate([hull.vertices for hull in hulls])
    low, high = points.min(axis=0), points.max(axis=0)
    up = int(np.argmin(high - low))
    u, v = (i for i in range(3) if i != up)
    counts = cell_counts(high[[u, v]] - low[[u, v]], cells)
    lines = [low[axis] + (high[axis] - low[axis]) * np.arange(n + 1) / n for axis, n in zip((u, v), counts, strict=True)]
    middles = [(line[:-1] + line[1:]) / 2 for line in lines]
    center, _ = _ends(hulls, up, (u, v), np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2))
    filled = _outline(np.isfinite(center).reshape(counts))
    inward = [line + (line.mean() - line) * 1e-6 for line in lines]  # a line through the very border of a box may miss it
    ends = _ends(hulls, up, (u, v), np.stack(np.meshgrid(*inward, indexing="ij"), axis=-1).reshape(-1, 2))
    bottom, top = (_completed(end.reshape(counts + 1), center) for end in ends)
    triangles = _cut(filled)
    grid = np.zeros((counts[0] + 1, counts[1] + 1, 3))
    grid[..., u], grid[..., v], grid[..., up] = lines[0][:, None], lines[1][None], (bottom + top) / 2.0
    if up == 1:  # then u and v are x and z, whose cross product points down the axis
        triangles = triangles[:, ::-1]
    used, inverse = np.unique(triangles, return_inverse=True)
    vertices, faces = grid.reshape(-1, 3)[used], inverse.reshape(-1, 3).astype(np.int64)
    thickness = float(np.clip(volume / surface_area(vertices, faces), THINNEST, THICKEST))
    if up == 2:
        vertices[:, 2] = bottom.reshape(-1)[used] + thickness / 2.0
    return Sheet(vertices, faces, thickness)


def _ends(hulls: Sequence[Hull], up: int, across: tuple[int, int], points: Array) -> tuple[Array, Array]:
    """Where the pieces begin and end along axis `up` over points across it, shape (n, 2); NaN beside the pieces."""
    lowest, highest = np.full(len(points), np.inf), np.full(len(points), -np.inf)
    for hull in hulls:
        normals, offsets = face_planes(hull.vertices, hull.faces)
        room = offsets - points @ normals[:, across].T  # normal * height <= room
        slope = normals[:, up]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = room / slope
        bottom = np.where(slope < -1e-9, at, -np.inf).max(axis=1)
        top = np.where(slope > 1e-9, at, np.inf).min(axis=1)
        hit = (bottom <= top) & (np.where(np.abs(slope) <= 1e-9, room, 0.0) >= -1e-9).all(axis=1)
        lowest[hit], highest[hit] = np.minimum(lowest, bottom)[hit], np.maximum(highest, top)[hit]
    over = highest >= lowest
    return np.where(over, lowest, np.nan), np.where(over, highest, np.nan)


def _outline(filled: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest connected part of the cells, filled where parts of it touch in a corner only."""
    from scipy import ndimage

    parts, _ = ndimage.label(filled)
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    largest = np.asarray(parts == sizes.argmax()) if filled.any() else np.ones_like(filled)
    while True:
        a, b, c, d = largest[:-1, :-1], largest[1:, :-1], largest[:-1, 1:], largest[1:, 1:]
        touching = np.argwhere((a & d & ~b & ~c) | (b & c & ~a & ~d))
        if not len(touching):
            return largest
        for i, j in touching:
            largest[i : i + 2, j : j + 2] = True


def _completed(corner: Array, center: Array) -> Array:
    """Heights at the grid's corners; where a line misses the pieces, the nearest height that is known."""
    from scipy import ndimage

    known = np.isfinite(corner)
    if not known.any():
        return np.full(corner.shape, float(np.nanmean(center)) if np.isfinite(center).any() else 0.0)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(corner[tuple(nearest)])


def _cut(filled: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Two triangles per filled cell over the grid's corners, with diagonals in turn so that no direction is stiffer."""
    width = filled.shape[1] + 1
    i, j = np.nonzero(filled)
    a, b, c, d = i * width + j, (i + 1) * width + j, (i + 1) * width + j + 1, i * width + j + 1
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(even, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    return np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int64)
