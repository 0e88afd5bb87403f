"""Triangulation of polygons with any number of corners. Outlines that a fan of triangles would leave are filled by ear clipping."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

MIN_TURN = 1e-9
"""Smallest turn against the normal, as a share of the polygon's area, that makes a corner of a fan reach out of its outline."""

MAX_AREA_ERROR = 1e-6
"""Largest relative difference between the areas of a polygon and its triangles; outlines that cross themselves have others."""


@dataclasses.dataclass(frozen=True)
class Triangulation:
    """Triangulation of polygons.

    corners: positions among the corners of all polygons, shape (m, 3). owner: polygon of each triangle, shape (m,).
    """

    corners: Integers
    owner: Integers


def triangulate(points: NDArray[np.float64], counts: Integers) -> Triangulation:
    """Triangulation of polygons, those of each polygon together; polygons of fewer than three corners have none.

    Args:
        points: position of each corner, polygon by polygon, shape (c, 3).
        counts: corners of each polygon, shape (p,).
    """
    fans = np.maximum(counts - 2, 0)
    owner = np.repeat(np.arange(len(counts)), fans)
    starts = np.cumsum(counts) - counts
    step = np.arange(len(owner)) - np.repeat(np.cumsum(fans) - fans, fans)
    first = starts[owner]
    corners = np.column_stack([first, first + step + 1, first + step + 2])
    if counts.max(initial=0) <= 3:
        return Triangulation(corners, owner)
    pieces = {number: _clipped(points, int(starts[number]), int(counts[number])) for number in _concave(points, corners, owner, counts)}
    known = {number: piece for number, piece in pieces.items() if piece is not None}
    if not known:
        return Triangulation(corners, owner)
    is_fan = ~np.isin(owner, list(known))
    owners = np.concatenate([owner[is_fan], *(np.full(len(piece), number) for number, piece in known.items())])
    order = np.argsort(owners, kind="stable")
    return Triangulation(np.concatenate([corners[is_fan], *known.values()])[order], owners[order])


def _concave(points: NDArray[np.float64], corners: Integers, owner: Integers, counts: Integers) -> list[int]:
    """Polygons whose fans have a triangle that turns against the others."""
    with np.errstate(invalid="ignore", over="ignore"):
        crosses = _crosses(points[corners])
        normals = np.zeros((len(counts), 3))
        np.add.at(normals, owner, crosses)
        along = np.einsum("md,md->m", crosses, normals[owner])
        is_turned = along < -MIN_TURN * np.einsum("md,md->m", normals[owner], normals[owner])
    return [int(number) for number in np.unique(owner[is_turned])]


def _crosses(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Twice the area of triangles along their normals, shape (m, 3)."""
    crosses: NDArray[np.float64] = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return crosses


def _clipped(points: NDArray[np.float64], start: int, count: int) -> Integers | None:
    """Triangulation of one polygon by ear clipping, shape (m, 3); None for an outline that crosses itself or is not finite."""
    import mapbox_earcut

    outline = points[start : start + count]
    if not np.isfinite(outline).all():
        return None
    moved = outline - outline[0]
    normal = np.cross(moved, np.roll(moved, -1, axis=0)).sum(axis=0)
    dropped = int(np.abs(normal).argmax())
    plane = np.ascontiguousarray(np.delete(moved, dropped, axis=1))
    faces = mapbox_earcut.triangulate_float64(plane, np.array([count], dtype=np.uint32)).astype(np.int64).reshape(-1, 3)
    crosses = _crosses(moved[faces])
    along = crosses @ normal
    # Triangulation keep the winding of their outline.
    faces = np.where((along < 0)[:, None], faces[:, ::-1], faces)
    area = float(np.linalg.norm(normal))
    if abs(float(np.abs(along).sum()) / max(area, 1e-300) - area) > MAX_AREA_ERROR * area:
        return None
    return faces + start
