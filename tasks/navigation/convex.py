"""A free polygon as convex polygons that share whole edges: what a navmesh is made of."""

from __future__ import annotations

import dataclasses
import heapq
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import shapely

Array = NDArray[np.float64]

_BEND_M = 1e-6
"""A corner may lie this far inside the line of its neighbors and still count as convex [m]: navmeshes hold 32-bit floats."""

_SLIVER_M = 1e-5
"""Triangles lower than this [m] join a neighbor first: as polygons of their own they would have no area in 32-bit floats."""


@dataclasses.dataclass(frozen=True)
class ConvexCover:
    """Convex polygons that tile a region, world frame, counter-clockwise.

    vertices: Corners [m], shape (n, 2). polygons: Indices of each polygon's corners.
    neighbors: For every edge (corner k to k + 1) the polygon on its other side, -1 for none; same shapes as `polygons`.
    """

    vertices: Array
    polygons: tuple[tuple[int, ...], ...]
    neighbors: tuple[tuple[int, ...], ...]


def convex_cover(free: shapely.Geometry, most_corners: int = 6) -> ConvexCover:
    """Tile polygons with holes by convex polygons of at most `most_corners` corners.

    A constrained Delaunay triangulation, merged across the longest edge first while the union stays convex.
    Every shared edge is shared whole, so neighbors are exact.
    """
    import shapely

    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(free))
    if not len(triangles):
        return ConvexCover(np.zeros((0, 2)), (), ())
    corners = shapely.get_coordinates(shapely.orient_polygons(triangles)).reshape(-1, 4, 2)[:, :3]
    vertices, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    rings = [tuple(int(i) for i in ring) for ring in index.reshape(-1, 3)]
    rings = _merged(vertices, rings, most_corners)
    owner = _owners(rings)
    neighbors = tuple(tuple(owner.get((b, a), -1) for a, b in _edges(ring)) for ring in rings)
    return ConvexCover(vertices, tuple(rings), neighbors)


def _edges(ring: tuple[int, ...]) -> list[tuple[int, int]]:
    return list(zip(ring, (*ring[1:], ring[0]), strict=True))


def _owners(rings: list[tuple[int, ...]]) -> dict[tuple[int, int], int]:
    return {edge: number for number, ring in enumerate(rings) for edge in _edges(ring)}


def _merged(vertices: Array, rings: list[tuple[int, ...]], most_corners: int) -> list[tuple[int, ...]]:
    """Greedy merging: slivers first, then across the longest edges."""
    at = [(float(x), float(y)) for x, y in vertices]
    polygon: dict[int, tuple[int, ...]] = dict(enumerate(rings))
    owner = _owners(rings)

    def length(edge: tuple[int, int]) -> float:
        (ax, ay), (bx, by) = at[edge[0]], at[edge[1]]
        return float(np.hypot(bx - ax, by - ay))

    queue: list[tuple[int, float, tuple[int, int]]] = []
    for edge, number in owner.items():
        if (edge[1], edge[0]) in owner and edge[0] < edge[1]:
            thin = any(_height(at, polygon[n]) < _SLIVER_M for n in (number, owner[edge[1], edge[0]]))
            heapq.heappush(queue, (0 if thin else 1, -length(edge), edge))
    while queue:
        _, _, (a, b) = heapq.heappop(queue)
        first, other = owner.get((a, b)), owner.get((b, a))
        if first is None or other is None or first == other:
            continue
        ring = _joined(polygon[first], polygon[other], a, b)
        if len(ring) > most_corners or len(set(ring)) < len(ring) or not _is_convex(at, ring):
            continue
        del owner[a, b], owner[b, a]
        for edge in _edges(polygon.pop(other)):
            if edge in owner:
                owner[edge] = first
        polygon[first] = ring
    return [polygon[number] for number in sorted(polygon)]


def _joined(first: tuple[int, ...], other: tuple[int, ...], a: int, b: int) -> tuple[int, ...]:
    """The ring around two polygons that share the edge from a to b of the first."""
    i, j = first.index(b), other.index(a)
    return (*first[i:], *first[:i], *((*other[j:], *other[:j])[1:-1]))


def _is_convex(at: list[tuple[float, float]], ring: tuple[int, ...]) -> bool:
    """Whether no corner bends inward by more than `_BEND_M`."""
    count = len(ring)
    for k in range(count):
        (ax, ay), (bx, by), (cx, cy) = at[ring[k - 1]], at[ring[k]], at[ring[(k + 1) % count]]
        base = max(float(np.hypot(cx - ax, cy - ay)), 1e-12)
        if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) < -_BEND_M * base:
            return False
    return True


def _height(at: list[tuple[float, float]], ring: tuple[int, ...]) -> float:
    """Height of a triangle above its longest edge [m]."""
    (ax, ay), (bx, by), (cx, cy) = (at[i] for i in ring[:3])
    longest = max(float(np.hypot(bx - ax, by - ay)), float(np.hypot(cx - bx, cy - by)), float(np.hypot(ax - cx, ay - cy)))
    return abs((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)) / max(longest, 1e-12)
