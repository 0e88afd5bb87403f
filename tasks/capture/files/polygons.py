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
    crossed: number of polygons whose outlines cross themselves; they stay fans.
    """

    corners: Integers
    owner: Integers
    crossed: int = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """A line about the outlines that cross themselves, if there are any."""
        return (f"outlines that cross themselves ({self.crossed}): their area is not exact",) if self.crossed else ()


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
    concave = _concave(points, corners, owner, counts)
    is_quad = counts[concave] == 4
    quads, is_split = _split_quads(points, starts[concave[is_quad]])
    quad_owners = np.repeat(concave[is_quad][is_split], 2)
    pieces = {int(number): _clipped(points, int(starts[number]), int(counts[number])) for number in concave[~is_quad]}
    clipped = {number: piece for number, piece in pieces.items() if piece is not None}
    crossed = len(pieces) - len(clipped) + int((~is_split).sum())
    is_fan = ~np.isin(owner, np.concatenate([quad_owners, np.array(list(clipped), dtype=np.int64)]))
    owners = np.concatenate([owner[is_fan], quad_owners, *(np.full(len(piece), number) for number, piece in clipped.items())])
    order = np.argsort(owners, kind="stable")
    triangles = np.concatenate([corners[is_fan], quads, *clipped.values()])[order]
    return Triangulation(triangles, owners[order], crossed)


def _concave(points: NDArray[np.float64], corners: Integers, owner: Integers, counts: Integers) -> Integers:
    """Polygons whose fans have a triangle that turns against the others."""
    with np.errstate(invalid="ignore", over="ignore"):
        crosses = _crosses(points[corners])
        normals = np.zeros((len(counts), 3))
        np.add.at(normals, owner, crosses)
        along = np.einsum("md,md->m", crosses, normals[owner])
        is_turned = along < -MIN_TURN * np.einsum("md,md->m", normals[owner], normals[owner])
        # Halves of an outline that crosses itself in its middle cancel out.
        sizes = np.bincount(owner, np.linalg.norm(crosses, axis=1), minlength=len(counts))
        is_turned |= (np.linalg.norm(normals, axis=1) < MIN_TURN * sizes)[owner]
        # Turns of outlines without an area come from rounding.
        lengths = np.zeros(len(counts))
        np.maximum.at(lengths, owner, np.square(points[corners] - points[corners[:, :1]]).sum(axis=2).max(axis=1))
        is_turned &= (sizes > MIN_TURN * lengths)[owner]
    return np.unique(owner[is_turned])


def _split_quads(points: NDArray[np.float64], starts: Integers) -> tuple[Integers, NDArray[np.bool_]]:
    """Split concave quads along the diagonal from their second corner to their fourth.

    Args:
        points: position of each corner, shape (c, 3).
        starts: first corner of each quad, shape (q,). The fans from these corners leave their outlines.

    Returns:
        Triangles of the quads that this diagonal splits, two for each, shape (2 k, 3), and which quads these are, shape (q,).
    """
    triangles = starts[:, None, None] + np.array([[0, 1, 3], [1, 2, 3]])
    with np.errstate(invalid="ignore", over="ignore"):
        crosses = _crosses(points[triangles.reshape(-1, 3)]).reshape(-1, 2, 3)
        normals = crosses.sum(axis=1)
        along = np.einsum("qtd,qd->qt", crosses, normals)
        # A comparison with a value that is not finite is false: such quads are not split.
        is_split = (along >= -MIN_TURN * np.einsum("qd,qd->q", normals, normals)[:, None]).all(axis=1)
        is_split &= np.linalg.norm(normals, axis=1) >= MIN_TURN * np.linalg.norm(crosses, axis=2).sum(axis=1)
    return triangles[is_split].reshape(-1, 3), is_split


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
    # The triangles keep the winding of the outline.
    faces = np.where((along < 0)[:, None], faces[:, ::-1], faces)
    area = float(np.linalg.norm(normal))
    size = float(np.linalg.norm(crosses, axis=1).sum())
    if area <= MIN_TURN * size or abs(float(np.abs(along).sum()) / area - area) > MAX_AREA_ERROR * area:
        return None
    return faces + start
