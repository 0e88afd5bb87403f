"""What stands in an agent's way: footprints of placed geometry, and the floor that is left."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import shapely

    from tasks.geometry.meshes import Surface

Array = NDArray[np.float64]

JOIN_M = 1e-6
"""Grid on which shapes are joined [m]: without one, slivers of scanned geometry make the union fail."""

SEAM_M = 0.002
"""Footprints grow by this [m]: it closes the outline of faces that stand upright and meet at rounded coordinates."""

OUTLINE_M = 0.004
"""Detail of the free polygon [m]. It is simplified by at most this, after obstacles grew by as much: never in the agent's favor."""

QUARTER_SEGMENTS = 8
"""Segments per quarter turn around an obstacle's corner: chords of 11 degrees, 1 mm off the circle of a radius of 0.2 m."""

GRID_M = 0.01
"""Plan of a very dense mesh: corners move to this grid [m], and the outline grows by as much to cover what it covered."""

_MANY_TRIANGLES = 20_000
"""Triangles up to which their projections are united one by one: a quarter of a second."""

_WELD_M = 1e-6
"""Vertices nearer than this are one [m]: exporters split them at seams of color and texture."""

_THIN_M = 1e-4
"""Projections narrower than this [m] are lines: a twentieth of the width that lines get."""

_FLAT_M = 1e-4
"""Vertices may reach this far over a face of a convex solid [m]: rounding of exported coordinates, on thin faces too."""

_CONVEX_AREA = 1e-3
"""Relative difference of surface and hull area up to which a closed component counts as convex."""


def footprint(surface: Surface, low: float = -np.inf, high: float = np.inf) -> shapely.Geometry:
    """Projection to the floor of what a surface has between two heights [m]; holes are filled, nothing gives an empty polygon.

    Solids count as filled: a convex component is clipped as a solid, and what an upright wall of faces encloses is closed off.
    The result covers the true projection and, filled holes aside, exceeds it by at most `SEAM_M`; very dense meshes by two `GRID_M`.
    """
    return footprints(surface, [(low, high)])[0]


def footprints(surface: Surface, bands: Sequence[tuple[float, float]]) -> list[shapely.Geometry]:
    """As `footprint`, between several pairs of heights: what does not hang on them is computed once."""
    vertices, faces, label = _components(surface)
    order = np.argsort(label, kind="stable")
    members = np.split(faces[order], np.flatnonzero(np.diff(label[order])) + 1) if len(faces) else []
    convex: dict[int, bool] = {}
    return [_projected(vertices, members, convex, low, high) for low, high in bands]


def _projected(
    vertices: Array, members: Sequence[NDArray[np.int64]], convex: dict[int, bool], low: float, high: float
) -> shapely.Geometry:  # fmt: skip
    """The footprint of connected components, given as faces each. convex: Which of them are, as far as known, which grows."""
    import shapely

    pieces: list[shapely.Geometry] = []
    loose: list[NDArray[np.int64]] = []
    for index, member in enumerate(members):
        z = vertices[member, 2]
        if z.max() <= low or z.min() >= high:
            continue
        if index not in convex:
            convex[index] = _is_convex(vertices, member)
        if convex[index]:
            corners = _band_points(vertices[member], low, high).reshape(-1, 2)
            pieces.append(shapely.convex_hull(shapely.linestrings(corners)))  # as one line: points are made one by one
        else:
            loose.append(member)
    if loose:
        corners = vertices[np.concatenate(loose)]
        corners = corners[(corners[:, :, 2].max(axis=1) > low) & (corners[:, :, 2].min(axis=1) < high)]
        dense = len(corners) > _MANY_TRIANGLES
        points = _snapped(corners) if dense else _band_points(corners, low, high)
        drawn = shapely.union_all(_drawn(points), grid_size=JOIN_M)
        pieces.append(shapely.buffer(drawn, GRID_M, quad_segs=2) if dense else drawn)
    if not pieces:
        return shapely.Polygon()
    grown = shapely.buffer(shapely.union_all(pieces, grid_size=JOIN_M), SEAM_M / 2, quad_segs=2, join_style="mitre", mitre_limit=2.0)
    filled = [shapely.Polygon(part.exterior) for part in shapely.get_parts(grown) if not part.is_empty]
    return shapely.union_all(filled, grid_size=JOIN_M)


def free_space(floor: ArrayLike, footprints: Sequence[shapely.Geometry], radius: float, smallest_m2: float = 0.0) -> shapely.MultiPolygon:
    """Where the center of a disc can be: the floor less whatever is nearer to its edge or to a footprint than the radius.

    The boundary of the result keeps at least `radius` and at most some 12 mm more from every obstacle: circles are drawn
    around their chords, and the outline is simplified on the safe side.

    Args:
        floor: Corners of the floor polygon, world frame [m], shape (n, 2).
        footprints: Obstacles as polygons, world frame [m].
        radius: Radius of the disc [m].
        smallest_m2: Parts smaller than this are dropped [m2].
    """
    import shapely

    room = shapely.make_valid(shapely.Polygon(np.asarray(floor, dtype=np.float64)))
    # A chord of GEOS's circle spans at most one and a half steps: grown by this, its middle still touches the circle.
    around = 1.0 / np.cos(0.75 * np.pi / 2 / QUARTER_SEGMENTS)
    reach = radius * around + OUTLINE_M
    solid = [f for f in footprints if not f.is_empty]
    free = shapely.buffer(room, -reach, quad_segs=QUARTER_SEGMENTS)
    if solid:
        free = shapely.difference(free, shapely.buffer(shapely.union_all(solid), reach, quad_segs=QUARTER_SEGMENTS))
    free = shapely.simplify(free, OUTLINE_M, preserve_topology=True)
    parts = [p for p in shapely.get_parts(free) if p.geom_type == "Polygon" and p.area > max(smallest_m2, 1e-9)]
    return shapely.MultiPolygon(sorted(parts, key=lambda p: (-p.area, p.bounds)))


def _components(surface: Surface) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Welded vertices, faces without the degenerate, and the connected component of each face."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    first, welded = _distinct(np.round(surface.vertices / _WELD_M).astype(np.int64))
    vertices, faces = surface.vertices[first], welded[surface.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    links = coo_matrix(
        (np.ones(2 * len(faces), dtype=np.int8), (np.r_[faces[:, 0], faces[:, 1]], np.r_[faces[:, 1], faces[:, 2]])),
        shape=(len(vertices), len(vertices)),
    )
    _, component = connected_components(links, directed=False)
    return vertices, faces, component[faces[:, 0]] if len(faces) else np.zeros(0, dtype=np.int64)


def _distinct(rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Index of the first of each kind of row, shape (m,), and the kind of every row, shape (n,). Faster than sorting rows."""
    kind = np.zeros(len(rows), dtype=np.int64)
    first = np.zeros(min(1, len(rows)), dtype=np.int64)
    for column in rows.T:
        values, level = np.unique(column, return_inverse=True)
        _, first, kind = np.unique(kind * len(values) + level, return_index=True, return_inverse=True)
    return first, kind


def _is_convex(vertices: Array, faces: NDArray[np.int64]) -> bool:
    """Whether a connected component is the closed surface of a convex solid: its area is that of its hull."""
    from scipy.spatial import ConvexHull, QhullError

    if len(faces) < 4:
        return False
    # Every edge of a closed surface has two faces.
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges[:, 0] * len(vertices) + edges[:, 1], return_counts=True)
    if (count != 2).any():
        return False
    corners, used = vertices[faces], vertices[np.unique(faces)]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # A few faces tell most solids apart before the hull, which is slow for many vertices: nothing reaches over a convex one's face.
    for index in range(0, len(faces), max(1, len(faces) // 16)):
        over = (used - corners[index, 0]) @ cross[index] / max(float(np.linalg.norm(cross[index])), 1e-300)
        if over.max() > _FLAT_M and over.min() < -_FLAT_M:
            return False
    area = 0.5 * np.linalg.norm(cross, axis=1).sum()
    try:
        hull = ConvexHull(used)
    except QhullError:  # flat
        return False
    return bool(abs(area - hull.area) <= _CONVEX_AREA * hull.area)


def _drawn(points: Array) -> NDArray[np.object_]:
    """Hulls of groups of points, shape (n, k, 2), as polygons. Upright faces, which have no width from above, get half a `SEAM_M`.

    Left as slivers, with the width of a rounding error, they would vanish when the hulls are united.
    """
    import shapely

    hulls = shapely.convex_hull(shapely.linestrings(points))
    away = points - points[:, :1]
    far = np.take_along_axis(away, np.hypot(away[:, :, 0], away[:, :, 1]).argmax(axis=1)[:, None, None], axis=1)
    length = np.hypot(far[:, 0, 0], far[:, 0, 1])
    thin = shapely.area(hulls) <= _THIN_M * length
    along = (away[thin] * far[thin]).sum(axis=2)
    ends = np.stack([along.argmin(axis=1), along.argmax(axis=1)], axis=1)
    lines = np.unique(np.take_along_axis(points[thin], ends[:, :, None], axis=1).reshape(-1, 4), axis=0).reshape(-1, 2, 2)
    walls = shapely.buffer(shapely.linestrings(lines), SEAM_M / 2, cap_style="square", quad_segs=1)
    return np.concatenate([hulls[~thin], walls])


def _snapped(corners: Array) -> Array:
    """Projections of triangles, shape (n, 3, 3), with corners on a grid of `GRID_M`, each once, shape (m, 3, 2)."""
    cells = np.round(corners[:, :, :2] / GRID_M).astype(np.int64)
    order = np.lexsort((cells[:, :, 1], cells[:, :, 0]), axis=1)
    cells = np.take_along_axis(cells, order[:, :, None], axis=1)
    first, _ = _distinct(cells.reshape(-1, 6))
    return cells[first].astype(np.float64) * GRID_M


def _band_points(corners: Array, low: float, high: float) -> Array:
    """For each triangle, shape (n, 3, 3), nine points (n, 9, 2) whose hull is the projection of its part between two heights.

    Its corners in the band and its edges' crossings with both limits; a point that does not exist repeats one that does.
    """
    following = np.roll(corners, -1, axis=1)
    z, dz = corners[:, :, 2], following[:, :, 2] - corners[:, :, 2]
    points, there = [corners[:, :, :2]], [(z >= low) & (z <= high)]
    for limit in (low, high):
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(dz != 0, (limit - z) / dz, np.nan)
        crosses = np.isfinite(t) & (t >= 0) & (t <= 1)
        t = np.where(crosses, t, 0.0)[:, :, None]
        points.append(corners[:, :, :2] + t * (following[:, :, :2] - corners[:, :, :2]))
        there.append(crosses)
    every, exists = np.concatenate(points, axis=1), np.concatenate(there, axis=1)
    every, exists = every[exists.any(axis=1)], exists[exists.any(axis=1)]
    stand_in = np.take_along_axis(every, exists.argmax(axis=1)[:, None, None], axis=1)
    return np.where(exists[:, :, None], every, stand_in)
