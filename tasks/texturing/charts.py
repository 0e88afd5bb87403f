"""What a UV layout is worth, from vertices, faces and places in the texture alone.

Stretch is that of Sander, Snyder, Gortler, Hoppe, "Texture mapping progressive meshes", SIGGRAPH 2001, section 3: the singular values of
the map from the texture to the surface, so scaled that a layout without distortion has 1. A place in a texture is (u, v), origin at the
lower left.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.triangles import crosses, distinct_rows, face_crosses, welded
from tasks.texturing.texels import coverage_of

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

RASTER_PX = 1024
"""Side of the raster for coverage and overlap: the size of most assets' textures."""

_UV_DECIMALS = 6
"""Places that agree to a millionth of the texture are one: half of a hundredth of a texel of the largest textures."""

_OUTSIDE = 1e-5
"""So far beyond the unit square is still within it: single precision."""

FLAT = 1e-6
"""Height over longest edge below which a triangle has no area: single precision leaves that of what is meant to be flat."""


@dataclasses.dataclass(frozen=True)
class ChartFigures:
    """Figures of a layout.

    charts: Pieces that are connected in the texture, by edges. stretch_l2: Root mean square of the stretch, weighted by area; 1 is best.
    stretch_linf: The largest stretch of any triangle, on the same scale. angle_distortion: Mean difference between an angle on the
    surface and in the texture, weighted by area [rad]. coverage: Share of the unit square that triangles cover. overlap: Share of that
    which more than one triangle covers. flipped: Triangles that lie mirrored in the texture against most of their chart. mirrored: Charts
    that lie so as a whole, which no baked texture minds. outside: Triangles with a corner outside of
    the unit square. degenerate: Triangles without area. collapsed: Triangles with an area, but none in the texture. seam_ratio: Length of
    all cuts over the diagonal of the mesh's box.
    """

    faces: int
    charts: int
    stretch_l2: float
    stretch_linf: float
    angle_distortion: float
    coverage: float
    overlap: float
    flipped: int
    mirrored: int
    outside: int
    degenerate: int
    collapsed: int
    seam_ratio: float


def chart_figures(vertices: ArrayLike, faces: ArrayLike, uv: ArrayLike, raster_px: int = RASTER_PX) -> ChartFigures:
    """Figures of a layout. vertices: [m], shape (n, 3). faces: shape (m, 3). uv: a place per vertex, shape (n, 2).

    Raises:
        ValueError: shapes do not fit, a number is not finite, or no triangle has an area both on the surface and in the texture.
    """
    points, corners, places = _checked(vertices, faces, uv)
    area = 0.5 * np.linalg.norm(face_crosses(points, corners), axis=1)
    image = signed_areas(places, corners)
    degenerate = flat_faces(points, corners)
    collapsed = ~degenerate & flat_faces(np.column_stack([places, np.zeros(len(places))]), corners)
    usable = ~degenerate & ~collapsed
    if not usable.any():
        raise ValueError("uv: no triangle has an area both on the surface and in the texture")
    largest, mean_square = _stretch(points, corners[usable], places)
    weight = area[usable] / area[usable].sum()
    scale = float(np.sqrt(np.abs(image[usable]).sum() / area[usable].sum()))
    turned = np.abs(_angles(points, corners[usable]) - _angles(places, corners[usable])).mean(axis=1)
    chart, count, seams = _cut(points, corners, places, usable)
    mirrored = np.bincount(chart, image) < 0
    raster = coverage_of(places, corners, (raster_px, raster_px))
    covered = raster.owner >= 0
    beyond: Mask = np.asarray(np.abs(places - 0.5).max(axis=1) > 0.5 + _OUTSIDE)
    return ChartFigures(
        faces=len(corners),
        charts=count,
        stretch_l2=float(np.sqrt((weight * mean_square).sum()) * scale),
        stretch_linf=float(largest.max() * scale),
        angle_distortion=float((weight * turned).sum()),
        coverage=float(covered.mean()),
        overlap=float((raster.depth > 1).sum() / max(int(covered.sum()), 1)),
        flipped=int((usable & ((image < 0) != mirrored[chart])).sum()),
        mirrored=int(mirrored[np.unique(chart[usable])].sum()),
        outside=int(beyond[corners].any(axis=1).sum()),
        degenerate=int(degenerate.sum()),
        collapsed=int(collapsed.sum()),
        seam_ratio=float(seams / np.linalg.norm(np.ptp(points[corners.ravel()], axis=0))),
    )


def charts_of(vertices: ArrayLike, faces: ArrayLike, uv: ArrayLike) -> Integers:
    """The chart of each triangle, shape (m,), numbered from 0 in the order of their first triangles. Arguments and errors as for
    `chart_figures`."""
    points, corners, places = _checked(vertices, faces, uv)
    return _cut(points, corners, places, np.ones(len(corners), dtype=bool))[0]


def flat_faces(vertices: Array, faces: Integers) -> Mask:
    """Which triangles have no area to speak of, shape (m,)."""
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.einsum("mek,mek->me", edges, edges).max(axis=1)
    return np.asarray(np.linalg.norm(crosses(edges[:, 0], edges[:, 1]), axis=1) <= FLAT * longest)


def signed_areas(uv: Array, faces: Integers) -> Array:
    """Areas of triangles in the texture, shape (m,), negative where they are mirrored."""
    a, b, c = uv[faces].transpose(1, 0, 2)
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def _checked(vertices: ArrayLike, faces: ArrayLike, uv: ArrayLike) -> tuple[Array, Integers, Array]:
    points, places = np.asarray(vertices, dtype=np.float64), np.asarray(uv, dtype=np.float64)
    corners = np.asarray(faces, dtype=np.int64)
    if points.ndim != 2 or points.shape[1:] != (3,) or places.shape != (len(points), 2) or corners.ndim != 2 or corners.shape[1:] != (3,):
        raise ValueError(f"uv: shapes {points.shape}, {corners.shape}, {places.shape} do not fit together")
    if not len(corners) or corners.min() < 0 or corners.max() >= len(points):
        raise ValueError("faces: there are none, or one names a vertex that does not exist")
    if not (np.isfinite(points).all() and np.isfinite(places).all()):
        raise ValueError("uv: a number is not finite")
    return points, corners, places


def _stretch(points: Array, corners: Integers, places: Array) -> tuple[Array, Array]:
    """Largest singular value of the map from the texture to each triangle, and mean square of both, shape (m,) each."""
    twice = 2.0 * signed_areas(places, corners)[:, None]
    s, t = places[corners].transpose(2, 0, 1)
    ahead, behind = [1, 2, 0], [2, 0, 1]
    along_s = np.einsum("mck,mc->mk", points[corners], t[:, ahead] - t[:, behind]) / twice
    along_t = np.einsum("mck,mc->mk", points[corners], s[:, behind] - s[:, ahead]) / twice
    a, b, c = ((first * other).sum(axis=1) for first, other in ((along_s, along_s), (along_s, along_t), (along_t, along_t)))
    return np.sqrt(0.5 * (a + c + np.hypot(a - c, 2.0 * b))), 0.5 * (a + c)


def _angles(points: Array, corners: Integers) -> Array:
    """Angles at the corners of triangles of points of any dimension [rad], shape (m, 3)."""
    at = points[corners]
    onward, back = np.roll(at, -1, axis=1) - at, np.roll(at, 1, axis=1) - at
    sizes = np.linalg.norm(onward, axis=2, keepdims=True), np.linalg.norm(back, axis=2, keepdims=True)
    first, other = onward / sizes[0], back / sizes[1]
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(first - other, axis=2), np.linalg.norm(first + other, axis=2)))  # Kahan's


def _cut(points: Array, corners: Integers, places: Array, usable: Mask) -> tuple[Integers, int, float]:
    """The chart of each triangle, how many charts have a usable one, and the length of all cuts [m].

    An edge of the mesh lies in the texture once for every chart, or part of one, that has it; each time but the first is a cut.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    place = welded(points)[1]
    knot = distinct_rows(np.column_stack([place, np.round(places, _UV_DECIMALS)]))[1]
    ends = [column[corners][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2) for column in (place, knot)]
    swapped = ends[0][:, 0] > ends[0][:, 1]
    edges = np.concatenate([np.where(swapped[:, None], pair[:, ::-1], pair) for pair in ends], axis=1)
    owner, proper = np.repeat(np.arange(len(corners)), 3), edges[:, 0] != edges[:, 1]
    owner, edges = owner[proper], edges[proper]
    first, which = distinct_rows(edges) if len(edges) else (np.zeros(0, np.int64), np.zeros(0, np.int64))
    order = np.argsort(which, kind="stable")
    same = which[order][1:] == which[order][:-1]
    joined = owner[order][:-1][same], owner[order][1:][same]
    graph = coo_matrix((np.ones(len(joined[0]), dtype=bool), joined), shape=(len(corners), len(corners)))
    label = connected_components(graph, directed=False)[1].astype(np.int64)
    begins, label = distinct_rows(label[:, None])
    rank = np.argsort(np.argsort(begins))
    start = np.zeros((welded(points)[0].size, 3))
    start[place] = points
    lengths = np.linalg.norm(start[edges[:, 0]] - start[edges[:, 1]], axis=1)
    own = distinct_rows(edges[:, :2])[0] if len(edges) else first
    chart = rank[label]
    return chart, len(np.unique(chart[usable])), float(lengths[first].sum() - lengths[own].sum())
