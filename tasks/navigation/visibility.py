"""Lines of sight inside a polygon with holes: which straight moves stay in the closed polygon."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

if TYPE_CHECKING:
    import shapely

Array = NDArray[np.float64]

ON_BOUNDARY = 1e-9
"""Points nearer to an edge than this lie on it [m]: a million times the rounding error of a coordinate of a room."""

_ANGLE = 1e-7
"""An edge between two corners on a segment lies along it unless it is turned by more than this [rad]: rounding turns the shortest so."""

_BEND = 1e-10
"""A corner that turns less than this is none to bend around [rad]: on a room's edges, the chord past it is nearer than `ON_BOUNDARY`."""

TANGENT = 1e-9
"""How far a neighbor corner may reach over a tangent, as a sine: the same tolerance as for lying on an edge."""

_SHORTEST_EDGE = 1e-8
"""Edges shorter than this are dropped [m]: they have no direction."""

_REACH = 4 * ON_BOUNDARY
"""How far beyond itself an edge or a segment counts into the cells of the grid [m]: more than any tolerance of the tests."""

_FEW = 64
"""So many edges are looked at one by one faster than by a grid."""


@dataclasses.dataclass(frozen=True)
class Boundary:
    """Edges of a polygon with holes, free side on their left, world frame [m]. Every array has shape (n, 2).

    before, starts, ends: Ends of every edge, and the corner before them. arriving, leaving: Unit direction of the edge that
    ends at `starts`, and of the edge itself. island: Part of the polygon that the edge belongs to, shape (n,).
    """

    before: Array
    starts: Array
    ends: Array
    arriving: Array
    leaving: Array
    island: NDArray[np.int64]

    @property
    def reflex(self) -> NDArray[np.bool_]:
        """Corners that paths bend around: where the free side opens more than half a turn, shape (n,)."""
        turn = self.arriving[:, 0] * self.leaving[:, 1] - self.arriving[:, 1] * self.leaving[:, 0]
        return np.asarray(turn < -_BEND)

    @cached_property
    def corners(self) -> tuple[Any, ...]:
        """The corners and the grid of the edges as the compiled loop takes them."""
        return self.before, self.starts, self.ends, *_grid_of(self.starts, self.ends)


def boundary_of(parts: list[shapely.Polygon]) -> Boundary:
    """Boundary of polygons that share at most corners."""
    import shapely

    before, starts, ends, arriving, leaving, island = [], [], [], [], [], []
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
            before.append(np.roll(corners, 1, axis=0))
            starts.append(corners)
            ends.append(after)
            leaving.append(direction)
            arriving.append(np.roll(direction, 1, axis=0))
            island.append(np.full(len(corners), number, dtype=np.int64))
    if not starts:
        empty = np.zeros((0, 2))
        return Boundary(empty, empty, empty, empty, empty, np.zeros(0, dtype=np.int64))
    return Boundary(
        before=np.concatenate(before),
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
    whole = {
        name: np.concatenate([getattr(boundary, name) for boundary in boundaries])
        for name in ("before", "starts", "ends", "arriving", "leaving")
    }
    return Boundary(**whole, island=island)


def clear(boundary: Boundary, starts: Array, ends: Array) -> NDArray[np.bool_]:
    """Whether each segment stays in the closed polygon, (n, 2) and (n, 2) to (n,). Its ends must lie in the polygon."""
    blocks = _compiled()["_sights"](np.ascontiguousarray(starts), np.ascontiguousarray(ends), *boundary.corners, False, False)
    return np.asarray(np.isinf(blocks))


def clear_lengths(boundary: Boundary, starts: Array, ends: Array) -> Array:
    """How far straight moves from points of the polygon stay in it [m], (n, 2) twice to (n,); infinite for those that do to their ends."""
    lengths = _compiled()["_sights"](np.ascontiguousarray(starts), np.ascontiguousarray(ends), *boundary.corners, False, True)
    return np.asarray(lengths)


def first_clear(boundary: Boundary, start: Array, ends: Array) -> int:
    """Index of the first of `ends`, shape (n, 2), that is seen from `start`, shape (2,); -1 when none is."""
    if not len(ends):
        return -1
    blocks = _compiled()["_sights"](np.broadcast_to(start, ends.shape).copy(), np.ascontiguousarray(ends), *boundary.corners, True, False)
    index = int(np.argmax(blocks))
    return index if np.isinf(blocks[index]) else -1


def tangent_corners(point: Array, corners: Corners, beyond: Array, limit: float) -> tuple[NDArray[np.int64], Array]:
    """Corners that a shortest path from a point, shape (2,), could bend around first, best first, and its length over each [m].

    Args:
        point: World frame [m], shape (2,).
        corners: Corners of the point's island.
        beyond: Distance from every corner to the goal [m], shape (n,).
        limit: Only lengths below this are wanted [m].
    """
    tangents: tuple[NDArray[np.int64], Array] = _compiled()["_tangent_corners"](
        point[0], point[1], corners.at, corners.back, corners.ahead, beyond, limit
    )
    return tangents


@dataclasses.dataclass(frozen=True)
class Corners:
    """Corners that paths bend around, each with unit vectors along its two edges, away from it. Every array has shape (n, 2)."""

    at: Array
    back: Array
    ahead: Array


def contains(boundary: Boundary, points: Array) -> NDArray[np.bool_]:
    """Whether points, shape (n, 2), lie in the closed polygon, shape (n,)."""
    return np.asarray(_compiled()["_contains"](np.ascontiguousarray(points), boundary.starts, boundary.ends))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_sights, _cells, _tangent_corners, _contains)


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


def _grid_of(starts: Array, ends: Array) -> tuple[float, float, float, int, int, NDArray[np.int64], NDArray[np.int64]]:
    """Cells that hold the edges near them, about as many cells as edges: a sight is held against the edges along it alone.

    Returns:
        Least x and y and the size of a cell [m], columns and rows, where each cell's edges begin, shape (columns * rows + 1,), and the
        edges of all cells one after another. Few edges are all in one cell.
    """
    if len(starts) <= _FEW:
        return 0.0, 0.0, 1.0, 1, 1, np.array([0, len(starts)]), np.arange(len(starts))
    low, high = starts.min(axis=0), starts.max(axis=0)
    width, depth = np.maximum(high - low, 1e-6)
    cell = float(max(np.sqrt(width * depth / len(starts)), max(width, depth) / len(starts)))
    columns, rows = int(width / cell) + 1, int(depth / cell) + 1
    offsets, members = _compiled()["_cells"](starts, ends, low[0], low[1], cell, columns, rows)
    return float(low[0]), float(low[1]), cell, columns, rows, offsets, members


def _cells(
    starts: Array, ends: Array, low_x: float, low_y: float, cell: float, columns: int, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where each cell's edges begin, and the edges: counted first, then put in."""
    offsets = np.zeros(columns * rows + 1, dtype=np.int64)
    members = np.zeros(0, dtype=np.int64)
    place = np.zeros(columns * rows, dtype=np.int64)
    for fills in (False, True):
        for e in range(len(starts)):
            ax, ay, bx, by = starts[e, 0], starts[e, 1], ends[e, 0], ends[e, 1]
            first = min(max(int((min(ax, bx) - _REACH - low_x) / cell), 0), columns - 1)
            last = min(max(int((max(ax, bx) + _REACH - low_x) / cell), 0), columns - 1)
            for c in range(first, last + 1):
                ya, yb = ay, by
                if last > first and abs(bx - ax) > _REACH:  # the stretch of the edge that lies over the column
                    left, right = low_x + c * cell - _REACH - ax, low_x + (c + 1) * cell + _REACH - ax
                    ya = ay + (by - ay) * min(max(left / (bx - ax), 0.0), 1.0)
                    yb = ay + (by - ay) * min(max(right / (bx - ax), 0.0), 1.0)
                lowest = min(max(int((min(ya, yb) - _REACH - low_y) / cell), 0), rows - 1)
                highest = min(max(int((max(ya, yb) + _REACH - low_y) / cell), 0), rows - 1)
                for r in range(lowest, highest + 1):
                    at = c * rows + r
                    if fills:
                        members[place[at]] = e
                        place[at] += 1
                    else:
                        offsets[at + 1] += 1
        if not fills:
            offsets = np.cumsum(offsets)
            place = offsets[:-1].copy()
            members = np.empty(offsets[-1], dtype=np.int64)
    return offsets, members


def _sights(
    starts: Array, ends: Array, before: Array, edge_starts: Array, edge_ends: Array, low_x: float, low_y: float, cell: float,
    columns: int, rows: int, offsets: NDArray[np.int64], members: NDArray[np.int64], only_first: bool, nearest: bool,
) -> Array:  # fmt: skip
    """How far along each segment something blocks it [m], infinite where nothing does: the nearest block, or any.

    A segment is blocked by an edge that has one of its ends on either side, farther than `ON_BOUNDARY` from the edge's
    line however near along the segment, and at a corner or edge that it touches when it goes on to the wrong side.

    Args:
        starts: Shape (n, 2) [m].
        ends: Shape (n, 2) [m].
        before: Corners before the edges' starts, shape (m, 2) [m].
        edge_starts: Shape (m, 2) [m].
        edge_ends: Shape (m, 2) [m].
        low_x, low_y, cell, columns, rows, offsets, members: As `_grid_of` gives them.
        only_first: Stop at the first clear segment; those behind it count as blocked at once.
        nearest: Look for the nearest block.
    """
    result = np.zeros(len(starts))
    for i in range(len(starts)):
        px, py, qx, qy = starts[i, 0], starts[i, 1], ends[i, 0], ends[i, 1]
        length = np.hypot(qx - px, qy - py)
        block = np.inf
        ux, uy = (qx - px) / max(length, 1e-300), (qy - py) / max(length, 1e-300)
        x0, x1 = min(px, qx) - ON_BOUNDARY, max(px, qx) + ON_BOUNDARY
        y0, y1 = min(py, qy) - ON_BOUNDARY, max(py, qy) + ON_BOUNDARY
        west = min(max(int((x0 - _REACH - low_x) / cell), 0), columns - 1)
        east = min(max(int((x1 + _REACH - low_x) / cell), 0), columns - 1)
        for k in range(east - west + 1 if length > ON_BOUNDARY else 0):
            c = west + k if qx >= px else east - k  # from the start on: what blocks is mostly near
            ya, yb = py, qy
            if east > west and abs(qx - px) > _REACH:  # the stretch of the segment that lies over the column
                left, right = low_x + c * cell - _REACH - px, low_x + (c + 1) * cell + _REACH - px
                ya = py + (qy - py) * min(max(left / (qx - px), 0.0), 1.0)
                yb = py + (qy - py) * min(max(right / (qx - px), 0.0), 1.0)
            lowest = min(max(int((min(ya, yb) - _REACH - low_y) / cell), 0), rows - 1)
            highest = min(max(int((max(ya, yb) + _REACH - low_y) / cell), 0), rows - 1)
            for m in range(offsets[c * rows + lowest], offsets[c * rows + highest + 1]):
                e = members[m]
                ax, ay, bx, by = edge_starts[e, 0], edge_starts[e, 1], edge_ends[e, 0], edge_ends[e, 1]
                if (ax < x0 and bx < x0) or (ax > x1 and bx > x1) or (ay < y0 and by < y0) or (ay > y1 and by > y1):
                    continue
                side_a = ux * (ay - py) - uy * (ax - px)
                side_b = ux * (by - py) - uy * (bx - px)
                if (side_a > ON_BOUNDARY and side_b > ON_BOUNDARY) or (side_a < -ON_BOUNDARY and side_b < -ON_BOUNDARY):
                    continue
                lx, ly = bx - ax, by - ay
                edge = np.hypot(lx, ly)
                lx, ly = lx / edge, ly / edge
                along_a = ux * (ax - px) + uy * (ay - py)
                # Distances of the segment's ends from the edge's line, positive on the free side.
                over_p = lx * (py - ay) - ly * (px - ax)
                over_q = lx * (qy - ay) - ly * (qx - ax)
                if abs(side_a) <= ON_BOUNDARY and -ON_BOUNDARY <= along_a <= length + ON_BOUNDARY:
                    # The corner at the edge's start lies on the segment: both of its ends must be on the corner's free side.
                    # An edge that lies along the segment leaves that to the corner at its other end.
                    zx, zy = before[e, 0], before[e, 1]
                    kx, ky = ax - zx, ay - zy
                    last = np.hypot(kx, ky)
                    kx, ky = kx / last, ky / last
                    first = abs(ux * (zy - py) - uy * (zx - px)) <= ON_BOUNDARY and abs(kx * uy - ky * ux) <= _ANGLE
                    second = abs(side_b) <= ON_BOUNDARY and abs(lx * uy - ly * ux) <= _ANGLE
                    convex = kx * ly - ky * lx >= 0
                    for x, y, over, away in ((px, py, over_p, along_a), (qx, qy, over_q, length - along_a)):
                        left_of_first = first or kx * (y - ay) - ky * (x - ax) >= -ON_BOUNDARY
                        left_of_second = second or over >= -ON_BOUNDARY
                        is_free = (left_of_first and left_of_second) if convex else (left_of_first or left_of_second)
                        if away > ON_BOUNDARY and not is_free:
                            block = min(block, max(0.0, along_a))
                elif (
                    (abs(side_b) > ON_BOUNDARY and (side_a > 0) != (side_b > 0))
                    and (min(over_p, over_q) < -ON_BOUNDARY and max(over_p, over_q) > ON_BOUNDARY)
                ):  # fmt: skip
                    block = min(block, length * over_p / (over_p - over_q))
                # An end on the edge between its corners: the other end must be on the edge's left, or the corner between them decides.
                ahead, behind = (side_b, side_a) if lx * ux + ly * uy > 0 else (side_a, side_b)
                on_p = abs(over_p) <= ON_BOUNDARY and ON_BOUNDARY < lx * (px - ax) + ly * (py - ay) < edge - ON_BOUNDARY
                on_q = abs(over_q) <= ON_BOUNDARY and ON_BOUNDARY < lx * (qx - ax) + ly * (qy - ay) < edge - ON_BOUNDARY
                if on_p and over_q < -ON_BOUNDARY and abs(ahead) > ON_BOUNDARY:
                    block = 0.0
                elif on_q and over_p < -ON_BOUNDARY and abs(behind) > ON_BOUNDARY:
                    block = min(block, length)
                if block < np.inf and not nearest:
                    break
            if block < np.inf and not nearest:
                break
        result[i] = block
        if only_first and block == np.inf:
            break
    return result
