"""Rooms of a dwelling: what its walls part of its floor plan once doorways are closed.

A doorway is an opening in an interior wall, or a gap: between a wall's end and what it would meet, were it longer. A wall that
furniture hides goes on where neither floor nor furniture is seen in its line, but on both of its sides. Gaps that part nothing are
floor again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.capture.rooms.slabs import NARROW_M, Slab

if TYPE_CHECKING:
    from shapely import Geometry, Polygon

Array = NDArray[np.float64]

GAP_M = 1.2
"""Widest gap between a wall's end and another wall or the outline that is a doorway: one leaf, with its frame and a stub of wall."""

WIDE_GAP_M = 2.0
"""Widest gap between the ends of two walls in one line: double doors, passages without a door."""

CORNER_GAP_M = 1.0
"""The same where the wall turns at that end: between a corner and a wall lies the neck of an L as often as a door, and it is wider."""

HIDDEN_M = 5.0
"""So far a hidden wall is followed; in its line no more than `WIDE_GAP_M` may be open."""

_LEAST_HIDDEN_M = 0.3
"""Less than this unseen is no hidden wall, but a leg or the shade of one."""

_BESIDE_M = 0.3
"""Beside a hidden wall something is seen this near to its center line."""

_STEP_M, _SMEAR_M = 0.025, 0.1
"""Step along a hidden wall, and how far what is seen counts along it: vertices of a coarse mesh are as far apart."""

PARTING_M = 1.6
"""Walls that are lower part no rooms: one looks over them."""

LEAST_ROOM_M2 = 1.0
"""Less floor than this is a shaft, or the space between two leaves of a wall."""

_GRID_M = 1e-6
"""Corners lie on a grid: beside askew walls there are slivers, which rounding lets cross themselves, or take the largest room away."""

_SLIT_M = 0.02
"""Slits between walls that are narrower than twice this are part of the wall: scanned faces do not quite meet."""

_IN_LINE_M = 0.15
"""Ends of two walls this near to one line are ends of one wall."""

_CORNER_M = 0.08
"""A wall turns where its end is this near to another's face; the stub of wall beside a doorway is longer."""

_STRAIGHT = 0.1
"""Walls that meet a line at an angle of less than this [rad] lie along it."""

_CUT_M = 0.001
"""Width of the cut that leads from a room around other rooms to its outside, so that its floor is one ring of corners."""


Seen = Callable[[Array], NDArray[np.bool_]]


@dataclasses.dataclass(frozen=True)
class Separation:
    """rooms: floors without holes, the largest first, disjoint. doorways: what of the outline was closed beside walls. What is neither
    room nor wall nor doorway is parts too small for a room."""

    rooms: tuple[Polygon, ...]
    doorways: Geometry


def separated(outline: Array, interior_walls: Sequence[Sequence[float]], is_seen: Seen | None = None) -> Separation:
    """The rooms of an outline, corners in the world frame [m], shape (n, 2), with interior walls x0, y0, x1, y1, thickness, height [m].

    is_seen: where anything but walls was seen, of places shape (m, 2) [m]; None where nobody knows, then no wall is taken for hidden.
    There is one room at least: where no part has `LEAST_ROOM_M2`, it is the outline.
    """
    import shapely

    whole = shapely.Polygon(outline)
    if not whole.is_valid or whole.area <= 0.0:
        return Separation((whole,), shapely.Polygon())
    walls = _walls_of(interior_walls)
    if not walls:
        return Separation((_turned(whole),), shapely.Polygon())
    gaps = [gap.polygon() for gap in _gaps(whole, walls, is_seen)]
    around = whole.buffer(0.5, join_style="mitre").difference(whole)
    solid = shapely.union_all([around, *(wall.polygon() for wall in walls), *gaps], grid_size=_GRID_M)
    solid = solid.buffer(_SLIT_M, join_style="mitre").buffer(-_SLIT_M, join_style="mitre")
    parts = [part for part in shapely.get_parts(whole.difference(solid, grid_size=_GRID_M)) if part.area > 1e-6]
    floors = [part for part in parts if part.area >= LEAST_ROOM_M2]
    if not floors:
        return Separation((_turned(whole),), shapely.Polygon())
    floors = _with_niches(
        floors, [part for part in parts if part.area < LEAST_ROOM_M2], _areas_of(whole.intersection(shapely.union_all(gaps)))
    )
    rooms = sorted((_without_holes(floor, floors) for floor in floors), key=_rank)
    closed = _areas_of(whole.intersection(shapely.union_all(gaps), grid_size=_GRID_M))
    return Separation(tuple(rooms), closed.difference(shapely.union_all(floors), grid_size=_GRID_M))


def _areas_of(shape: Geometry) -> Geometry:
    """The polygons of a shape without the lines and points along which others only touched."""
    import shapely

    return shapely.union_all([part for part in shapely.get_parts(shape) if part.area > 0.0])


def corners_of(room: Polygon) -> Array:
    """Corners of a room's floor [m], counter-clockwise from the lowest (x, y) on, without the repeated last one, shape (n, 2)."""
    ring = np.asarray(_turned(room).exterior.coords)[:-1]
    first = int(np.lexsort((ring[:, 1], ring[:, 0]))[0])
    return np.roll(ring, -first, axis=0) + 0.0


def _slab(row: Sequence[float]) -> Slab:
    x0, y0, x1, y1, thickness, height = (float(value) for value in row)
    return Slab(np.array([x0, y0]), np.array([x1, y1]), thickness, height)


def _turned(room: Polygon) -> Polygon:
    """Counter-clockwise, without corners in a straight line."""
    import shapely

    return shapely.geometry.polygon.orient(room.simplify(1e-4))


def _rank(room: Polygon) -> tuple[float, float, float]:
    """The largest first; of rooms that are equal to the tenth of a square decimetre the one farther left, then the lower one."""
    return (-round(float(room.area), 3), float(room.centroid.x), float(room.centroid.y))


def doorways(outline: Array, interior_walls: Sequence[Sequence[float]] | Array) -> list[Slab]:
    """Gaps between walls that part rooms, each once, up to `WIDE_GAP_M`: from the end of a wall to what it would meet, as thick and high
    as that wall. outline, interior_walls: as for `separated`."""
    import shapely

    whole = shapely.Polygon(outline)
    if not whole.is_valid or whole.area <= 0.0:
        return []
    kept: list[Slab] = []
    for gap in _gaps(whole, _walls_of(interior_walls), None, WIDE_GAP_M):
        way = (gap.end - gap.start) / gap.length
        inner = dataclasses.replace(gap, start=gap.start + _SLIT_M * way, end=gap.end - _SLIT_M * way)
        if inner.length > NARROW_M and not any(inner.polygon().intersection(other.polygon()).area > 1e-3 for other in kept):
            kept.append(inner)
    return kept


def _walls_of(rows: Sequence[Sequence[float]] | Array) -> list[Slab]:
    """Walls that part rooms."""
    return [_slab(row) for row in rows if row[5] >= PARTING_M and np.hypot(row[2] - row[0], row[3] - row[1]) > 1e-3]


def _gaps(outline: Polygon, walls: Sequence[Slab], is_seen: Seen | None, least: float = 0.0) -> list[Slab]:
    """What closes the gaps at the ends of walls, as thick as the wall: as wide as doorways are, or `least` [m]."""
    gaps = []
    turns = [(_turns(index, wall.start, walls), _turns(index, wall.end, walls)) for index, wall in enumerate(walls)]
    for index, wall in enumerate(walls):
        along = (wall.end - wall.start) / wall.length
        for end, way, is_corner in ((wall.start, -along, turns[index][0]), (wall.end, along, turns[index][1])):
            limit = max(CORNER_GAP_M if is_corner else GAP_M, least)
            borders: list[tuple[Geometry, float]] = [(outline.exterior, limit)]
            for k, other in enumerate(walls):
                if k != index:
                    goes_on = _goes_on(end, way, other, is_corner, turns[k])
                    borders.append((other.polygon(), WIDE_GAP_M if goes_on else limit))
            reach = _reach(end, way, wall.thickness, borders)
            if reach is None and is_seen is not None:
                far = _reach(end, way, wall.thickness, [(border, HIDDEN_M) for border, _ in borders])
                reach = far if far is not None and _is_hidden(end, way, far, is_seen) else None
            if reach is not None:
                gaps.append(Slab(end - _SLIT_M * way, end + (reach + _SLIT_M) * way, wall.thickness, wall.height))
    return gaps


def _is_hidden(end: Array, way: Array, length: float, is_seen: Seen) -> bool:
    """Whether a wall goes on over a length beyond its end [m], hidden, with a doorway at most."""
    from scipy.ndimage import binary_dilation

    side = np.array([-way[1], way[0]])
    at = np.arange(0.5 * _STEP_M, length, _STEP_M)
    line = end + at[:, None] * way
    shifts = np.arange(_STEP_M, _BESIDE_M, 2 * _STEP_M)
    beside = [np.any([is_seen(line + sign * shift * side) for shift in shifts], axis=0) for sign in (-1.0, 1.0)]
    smear = np.ones(2 * round(_SMEAR_M / _STEP_M) + 1, dtype=np.bool_)
    hidden = ~binary_dilation(is_seen(line), smear) & beside[0] & beside[1]
    return bool(hidden.sum() * _STEP_M >= _LEAST_HIDDEN_M and (~hidden).sum() * _STEP_M <= WIDE_GAP_M)


def _turns(index: int, end: Array, walls: Sequence[Slab]) -> bool:
    """Whether another wall than `index` begins, ends or passes at a wall's end."""
    import shapely

    return any(bool(shapely.intersects_xy(other.polygon(_CORNER_M), *end)) for k, other in enumerate(walls) if k != index)


def _goes_on(end: Array, way: Array, other: Slab, is_corner: bool, turns: tuple[bool, bool]) -> bool:
    """Whether another wall goes on in a wall's line after a passage. Between two corners it does not: there is the neck of an L."""
    along = (other.end - other.start) / other.length
    ends = np.array([other.start - end, other.end - end])
    off = np.abs(ends @ np.array([-way[1], way[0]]))
    near = int(np.argmin(np.linalg.norm(ends, axis=1)))
    return bool(abs(float(along @ way)) > np.cos(_STRAIGHT) and off[near] < _IN_LINE_M and not (is_corner and turns[near]))


def _reach(end: Array, way: Array, thickness: float, borders: Sequence[tuple[Geometry, float]]) -> float | None:
    """How far a wall's end is from what it would meet of the borders, each no farther than its limit [m]; None where it meets nothing.

    With its whole thickness: the farther of what its two faces meet, so that a slanted wall leaves no wedge open.
    """
    import shapely

    side = 0.45 * thickness * np.array([-way[1], way[0]])
    reaches = []
    for start in (end - side, end, end + side):
        nearest = np.inf
        for border, limit in borders:
            hits = shapely.get_coordinates(shapely.LineString([start - 0.01 * way, start + limit * way]).intersection(border))
            if len(hits):
                nearest = min(nearest, max(0.0, float(((hits - start) @ way).min())))
        reaches.append(nearest)
    # walls that are a little out of line meet with one face alone, right at the corner
    first = reaches[1] if np.isfinite(reaches[1]) else min(reaches)
    if not np.isfinite(first) or (first > thickness and first != reaches[1]):
        return None
    # beside a corner a face may pass what the middle meets
    return max(reach for reach in reaches if reach <= first + thickness)


def _with_niches(floors: Sequence[Polygon], small: Sequence[Polygon], gaps: Geometry) -> list[Polygon]:
    """Floors with what is no doorway between two of them: gaps that touch one floor alone, and what is too small for a room behind."""
    import shapely

    grown = list(floors)
    for gap in shapely.get_parts(gaps):
        piece = shapely.union_all([gap, *(part for part in small if part.distance(gap) < 1e-3)])
        near = [k for k, floor in enumerate(floors) if _touches(floor, piece)]
        if len(near) == 1:
            taken = shapely.union_all([floor for k, floor in enumerate(grown) if k != near[0]])
            joined = shapely.union_all([grown[near[0]], piece.difference(taken)])
            joined = joined.buffer(1e-4, join_style="mitre").buffer(-1e-4, join_style="mitre")
            if joined.geom_type == "Polygon":
                grown[near[0]] = joined
    return grown


def _touches(floor: Polygon, piece: Geometry) -> bool:
    """Whether a floor has an edge in common with a piece, not a corner alone."""
    return float(floor.buffer(0.01).intersection(piece).area) > 0.01 * 0.1


def _without_holes(floor: Polygon, floors: Sequence[Polygon]) -> Polygon:
    """A floor as one ring: pillars and walls that stand free are part of it, around other rooms a cut leads to its outside."""
    import shapely

    room = shapely.Polygon(floor.exterior)
    for hole in floor.interiors:
        if any(shapely.Polygon(hole).contains(other.representative_point()) for other in floors if other is not floor):
            near, far = shapely.get_coordinates(shapely.shortest_line(hole, floor.exterior))
            way = (far - near) / max(float(np.linalg.norm(far - near)), 1e-9)
            cut = shapely.LineString([near - 0.01 * way, far + 0.01 * way]).buffer(_CUT_M / 2, cap_style="flat")
            rest = room.difference(shapely.union_all([shapely.Polygon(hole), cut]))
            room = max(shapely.get_parts(rest), key=lambda part: part.area)
    return _turned(room)
