"""Lines of sight inside a polygon with holes: which straight moves stay in the closed polygon."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import shapely

Array = NDArray[np.float64]

ON_BOUNDARY = 1e-9
"""Points nearer to an edge than this lie on it [m]: a million times the rounding error of a coordinate of a room."""

_ENDPOINT = 1e-7
"""Crossings nearer to an end of a segment than this are the end itself [m]; there the corner's opening decides."""

_ANGLE = 1e-7
"""A direction that leaves the free side by less than this runs along the edge [rad]: 1 micrometre on an edge of 10 m."""

TANGENT = 1e-9
"""How far a neighbor corner may reach over a tangent, as a sine: the same tolerance as for lying on an edge."""

_SHORTEST_EDGE = 1e-8
"""Edges shorter than this are dropped [m]: they have no direction."""


@dataclasses.dataclass(frozen=True)
class Boundary:
    """Edges of a polygon with holes, free side on their left, world frame [m]. Every array has shape (n, 2).

    starts, ends: Ends of every edge. arriving, leaving: Unit direction of the edge that ends at `starts`, and of the edge itself.
    island: Part of the polygon that the edge belongs to, shape (n,).
    """

    starts: Array
    ends: Array
    arriving: Array
    leaving: Array
    island: NDArray[np.int64]

    @property
    def reflex(self) -> NDArray[np.bool_]:
        """Corners that paths bend around: where the free side opens more than half a turn, shape (n,)."""
        turn = self.arriving[:, 0] * self.leaving[:, 1] - self.arriving[:, 1] * self.leaving[:, 0]
        return np.asarray(turn < -_ANGLE)

    @property
    def rings(self) -> tuple[Array, Array, Array, Array]:
        """The arrays as the compiled loop takes them."""
        return self.starts, self.ends, self.arriving, self.leaving


def boundary_of(parts: list[shapely.Polygon]) -> Boundary:
    """Boundary of polygons that share at most corners."""
    import shapely

    starts, ends, arriving, leaving, island = [], [], [], [], []
    for number, part in enumerate(parts):
        turned = shapely.orient_polygons(part)
        for ring in (turned.exterior, *turned.interiors):
            corners = shapely.get_coordinates(ring)[:-1]
            corners = corners[np.hypot(*(np.roll(corners, -1, axis=0) - corners).T) > _SHORTEST_EDGE]
            if len(corners) < 3:
                continue
            after = np.roll(corners, -1, axis=0)
            direction = after - corners
            direction /= np.hypot(direction[:, 0], direction[:, 1])[:, None]
            starts.append(corners)
            ends.append(after)
            leaving.append(direction)
            arriving.append(np.roll(direction, 1, axis=0))
            island.append(np.full(len(corners), number, dtype=np.int64))
    if not starts:
        empty = np.zeros((0, 2))
        return Boundary(empty, empty, empty, empty, np.zeros(0, dtype=np.int64))
    return Boundary(
        starts=np.concatenate(starts),
        ends=np.concatenate(ends),
        arriving=np.concatenate(arriving),
        leaving=np.concatenate(leaving),
        island=np.concatenate(island),
    )


def joined(boundaries: Sequence[Boundary]) -> Boundary:
    """Boundaries one after another, each an island of its own."""
    if not boundaries:
        return boundary_of([])
    island = np.repeat(np.arange(len(boundaries)), [len(b.starts) for b in boundaries])
    starts, ends, arriving, leaving = (np.concatenate(arrays) for arrays in zip(*(b.rings for b in boundaries), strict=True))
    return Boundary(starts, ends, arriving, leaving, island)


def clear(boundary: Boundary, starts: Array, ends: Array) -> NDArray[np.bool_]:
    """Whether each segment stays in the closed polygon, (n, 2) and (n, 2) to (n,). Its ends must lie in the polygon."""
    return np.asarray(_compiled()(np.ascontiguousarray(starts), np.ascontiguousarray(ends), *boundary.rings, False))


def first_clear(boundary: Boundary, start: Array, ends: Array) -> int:
    """Index of the first of `ends`, shape (n, 2), that is seen from `start`, shape (2,); -1 when none is."""
    if not len(ends):
        return -1
    seen = _compiled()(np.broadcast_to(start, ends.shape).copy(), np.ascontiguousarray(ends), *boundary.rings, True)
    index = int(np.argmax(seen))
    return index if seen[index] else -1


def tangent_corners(point: Array, corners: Corners, beyond: Array, limit: float) -> tuple[NDArray[np.int64], Array]:
    """Corners that a shortest path from a point, shape (2,), could bend around first, best first, and its length over each [m].

    Args:
        point: World frame [m], shape (2,).
        corners: Corners of the point's island.
        beyond: Distance from every corner to the goal [m], shape (n,).
        limit: Only lengths below this are wanted [m].
    """
    found: tuple[NDArray[np.int64], Array] = _compiled_corners()(point[0], point[1], corners.at, corners.back, corners.ahead, beyond, limit)
    return found


@dataclasses.dataclass(frozen=True)
class Corners:
    """Corners that paths bend around, each with unit vectors along its two edges, away from it. Every array has shape (n, 2)."""

    at: Array
    back: Array
    ahead: Array


def contains(boundary: Boundary, points: Array) -> NDArray[np.bool_]:
    """Whether points, shape (n, 2), lie in the closed polygon, shape (n,)."""
    return np.asarray(_compiled_contains()(np.ascontiguousarray(points), boundary.starts, boundary.ends))


@cache
def _compiled() -> Callable[..., Any]:
    import numba

    compiled: Callable[..., Any] = numba.njit(cache=True, nogil=True)(_sights)
    return compiled


@cache
def _compiled_corners() -> Callable[..., Any]:
    import numba

    compiled: Callable[..., Any] = numba.njit(cache=True, nogil=True, error_model="numpy")(_tangent_corners)
    return compiled


@cache
def _compiled_contains() -> Callable[..., Any]:
    import numba

    compiled: Callable[..., Any] = numba.njit(cache=True, nogil=True, error_model="numpy")(_contains)
    return compiled


def _tangent_corners(
    x: float, y: float, at: Array, back: Array, ahead: Array, beyond: Array, limit: float
) -> tuple[NDArray[np.int64], Array]:
    """Corners whose two edges lie on one side of the line from the point: any other cannot be on a shortest path."""
    chosen = np.empty(len(at), dtype=np.int64)
    total = np.empty(len(at))
    count = 0
    for i in range(len(at)):
        dx, dy = x - at[i, 0], y - at[i, 1]
        away = np.hypot(dx, dy)
        length = away + beyond[i]
        if not length < limit:
            continue
        ux, uy = dx / max(away, 1e-300), dy / max(away, 1e-300)
        left = ux * back[i, 1] - uy * back[i, 0]
        right = ux * ahead[i, 1] - uy * ahead[i, 0]
        if min(left, right) >= -TANGENT or max(left, right) <= TANGENT:
            chosen[count], total[count] = i, length
            count += 1
    order = np.argsort(total[:count], kind="mergesort")
    return chosen[:count][order], total[:count][order]


def _contains(points: Array, starts: Array, ends: Array) -> NDArray[np.bool_]:
    """By crossings of a ray to the right; points as near to an edge as rounding brings them count as inside."""
    result = np.zeros(len(points), dtype=np.bool_)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        inside = False
        for e in range(len(starts)):
            ax, ay, bx, by = starts[e, 0], starts[e, 1], ends[e, 0], ends[e, 1]
            if (ay > y) != (by > y) and x < ax + (bx - ax) * (y - ay) / (by - ay):
                inside = not inside
            if min(ay, by) - ON_BOUNDARY <= y <= max(ay, by) + ON_BOUNDARY and min(ax, bx) - ON_BOUNDARY <= x <= max(ax, bx) + ON_BOUNDARY:
                length = np.hypot(bx - ax, by - ay)
                share = min(1.0, max(0.0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / (length * length)))
                if np.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay)) <= ON_BOUNDARY:
                    inside = True
                    break
        result[i] = inside
    return result


def _sights(
    starts: Array, ends: Array, edge_starts: Array, edge_ends: Array, arriving: Array, leaving: Array, only_first: bool
) -> NDArray[np.bool_]:
    """Segments against all edges; stops at the first clear one when `only_first`.

    A segment is blocked by an edge that it crosses properly, and at a corner that it passes or ends at
    when it leaves the corner towards the wrong side.
    """
    result = np.zeros(len(starts), dtype=np.bool_)
    for i in range(len(starts)):
        px, py, qx, qy = starts[i, 0], starts[i, 1], ends[i, 0], ends[i, 1]
        length = np.hypot(qx - px, qy - py)
        if length <= ON_BOUNDARY:
            result[i] = True
            if only_first:
                break
            continue
        ux, uy = (qx - px) / length, (qy - py) / length
        x0, x1 = min(px, qx) - ON_BOUNDARY, max(px, qx) + ON_BOUNDARY
        y0, y1 = min(py, qy) - ON_BOUNDARY, max(py, qy) + ON_BOUNDARY
        free = True
        for e in range(len(edge_starts)):
            ax, ay, bx, by = edge_starts[e, 0], edge_starts[e, 1], edge_ends[e, 0], edge_ends[e, 1]
            if (ax < x0 and bx < x0) or (ax > x1 and bx > x1) or (ay < y0 and by < y0) or (ay > y1 and by > y1):
                continue
            side_a = ux * (ay - py) - uy * (ax - px)
            side_b = ux * (by - py) - uy * (bx - px)
            if (side_a > ON_BOUNDARY and side_b > ON_BOUNDARY) or (side_a < -ON_BOUNDARY and side_b < -ON_BOUNDARY):
                continue
            lx, ly, kx, ky = leaving[e, 0], leaving[e, 1], arriving[e, 0], arriving[e, 1]
            along_a = ux * (ax - px) + uy * (ay - py)
            along_b = ux * (bx - px) + uy * (by - py)
            if abs(side_a) <= ON_BOUNDARY and -_ENDPOINT <= along_a <= length + _ENDPOINT:
                # The corner at the edge's start lies on the segment: onward and backward must both be on the free side.
                convex = kx * ly - ky * lx >= 0
                for sign in (1.0, -1.0):
                    if (sign > 0 and along_a >= length - _ENDPOINT) or (sign < 0 and along_a <= _ENDPOINT):
                        continue
                    first = sign * (kx * uy - ky * ux) >= -_ANGLE
                    second = sign * (lx * uy - ly * ux) >= -_ANGLE
                    if (convex and not (first and second)) or not (first or second):
                        free = False
            elif abs(side_b) > ON_BOUNDARY and (side_a > 0) != (side_b > 0):
                cross = along_a + (along_b - along_a) * side_a / (side_a - side_b)
                if _ENDPOINT < cross < length - _ENDPOINT:
                    free = False
            if free:
                # An end that lies on the edge between its corners: the segment must stay on the edge's left.
                edge_length = lx * (bx - ax) + ly * (by - ay)
                for sign, ex, ey in ((1.0, px, py), (-1.0, qx, qy)):
                    along = lx * (ex - ax) + ly * (ey - ay)
                    across = lx * (ey - ay) - ly * (ex - ax)
                    on_edge = abs(across) <= ON_BOUNDARY and ON_BOUNDARY < along < edge_length - ON_BOUNDARY
                    if on_edge and sign * (lx * uy - ly * ux) < -_ANGLE:
                        free = False
            if not free:
                break
        result[i] = free
        if free and only_first:
            break
    return result
