"""The outline of a floor along its walls: straight along the axes, slanted where a wall of the scan is, and ending where walls do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud
from tasks.capture.rooms.directions import MAX_PASSAGE_M, SlantedWall, slanted_walls_of, with_ends_on
from tasks.capture.rooms.plan import CELL_M, FloorCells, closed, enclosed, largest, walled

if TYPE_CHECKING:
    from shapely import Geometry, Polygon

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WALL_THICKNESS_M = 0.23
"""Thicker than the walls between rooms usually are."""

_MIN_OVERLAP = 0.85
"""Least overlap of the snapped and the seen outline: with less, walls are askew."""

_ON_LINE_M = 0.1
"""Floor that begins so near to the line of a wall lies behind it [m]."""

_MIN_CHORD_SHARE, _SPARSE_CHORD_SHARE = 0.5, 0.8
"""Least share of the cut through a corner along which the slanted wall was seen; the second one if little of its surface was."""

_MAX_SEEN_SHARE = 0.6
"""Most of the corner behind a slanted wall that was seen: behind a partition all of it, through an opening a part."""

_MAX_CUT_SHARE = 0.4
"""Most of a floor that one slanted wall or opening takes away."""

_MAX_CORNER_SHARE = 0.15
"""Most of a floor that a slanted wall cuts off although floor was seen behind it, through an opening. A partition has another face, and
cuts off nothing that was seen."""

_MIN_WALLED_SHARE = 0.3
"""Least share of the border of a room behind an opening along which its walls were seen: less is floor seen through that opening."""

_MAX_WALLED_SHARE, _MIN_LINTEL_SHARE, _LINTEL_M = 0.75, 0.5, 1.8
"""Most of that border along which walls were seen if wall was seen above at least this share of the opening, from this height [m] on:
a hall whose far wall shows. A bay has no wall above its opening, and a scanned room behind one has walls all around."""

_NECK_M = 0.03
"""Parts that hang together by less than twice this are apart, and corners nearer to an edge are none [m]."""

_MIN_NOTCH_WALL_SHARE, _NOTCH_REACH_M = 0.4, 0.08
"""Least share of a notch's own sides with wall points within this distance [m]: with less, the notch is floor that no camera saw."""

_MIN_STEP_M = 0.12
"""Ends of slanted walls nearer to another line are on it."""


def snapped_outline(plan: FloorCells, outline: Polygon, lines: Sequence[Array], cloud: Cloud, is_wall: Mask) -> tuple[Polygon, bool]:
    """The outline made of straight edges along walls, and true if it is; simplified only where walls are askew.

    The plane is cut at every wall along an axis and at every long straight stretch of the outline. Rectangles that are mostly inside make
    up the floor, with those that walls face on all sides though furniture hides their floor. Slanted walls cut corners off.

    Args:
        plan: cells of the floor.
        outline: outline of these cells.
        lines: positions of walls across x and across y [m].
        cloud: points of the scan.
        is_wall: which of these points are wall, shape (n,).
    """
    import shapely

    own_outline = without_passages(outline, lines, cloud.points[is_wall])
    plan, outline = plan.without(outline.difference(own_outline)), own_outline
    simple = outline.simplify(0.12)
    slanted = [with_ends_on(wall, lines) for wall in slanted_walls_of(cloud, is_wall)]
    xs, ys = (_with_ends(_with_outline(lines[axis], simple, axis), slanted, axis) for axis in (0, 1))
    share = plan.filled_share(xs, ys)
    # A strip no wider than a wall between two walls is that wall, though modelled floors run on below it. Inside the
    # room such strips are bridged again by the closing below.
    is_floor = ~_is_wall_strip(xs, lines[0])[:, None] & ~_is_wall_strip(ys, lines[1])
    chosen = (share > 0.5) & is_floor
    if min(map(len, lines)) >= 2:
        is_shown = (plan.filled_share(xs, ys, is_seen=True) > 0.0) | walled(cloud, is_wall, xs, ys)
        hidden = is_floor & ~chosen & is_shown & enclosed(cloud, is_wall, xs, ys, lines)
        outline = shapely.union_all([outline, *(shapely.box(xs[i], ys[j], xs[i + 1], ys[j + 1]) for i, j in np.argwhere(hidden))])
        chosen |= hidden
    boxes = [shapely.box(xs[i], ys[j], xs[i + 1], ys[j + 1]) for i, j in np.argwhere(chosen)]
    if boxes:
        # Strips narrower than a wall is thick are floor below a wall, or its recess at a window.
        shape = largest(closed(closed(shapely.union_all(boxes), 0.2), -0.13))
        if shape is not None:
            cut = along_slanted(shape.simplify(0.03), slanted, plan, cloud.points[is_wall, :2])
            own = without_neighbors(outline, cut, lines)
            if cut.intersection(own).area > _MIN_OVERLAP * cut.union(own).area:
                return cut, True
    return shapely.Polygon(simple.exterior), False


def without_passages(shape: Polygon, lines: Sequence[Array], walls: Array) -> Polygon:
    """A floor without parts behind the line of a wall that a narrow opening joins to it and that have no walls of their own.

    Args:
        shape: the floor that was seen.
        lines: positions of walls across x and across y [m].
        walls: points of walls [m], shape (n, 3).
    """
    import shapely
    from scipy.spatial import cKDTree

    if not len(walls):
        return shape
    tree = cKDTree(walls[:, :2])
    for axis, positions in enumerate(lines):
        for position, side in ((position, side) for position in positions.tolist() for side in (-1.0, 1.0)):
            low, high = np.full(2, -1e3), np.full(2, 1e3)
            (low if side > 0 else high)[axis] = position + side * _ON_LINE_M
            for part in _polygons(shape.intersection(shapely.box(*low, *high))):
                if part.area < CELL_M or part.area > _MAX_CUT_SHARE * shape.area:
                    continue
                ends = np.asarray(part.exterior.segmentize(0.1).coords)[:-1]
                is_contact = np.abs(ends[:, axis] - position) < 1.5 * _ON_LINE_M
                if is_contact.all() or not is_contact.any() or np.ptp(ends[is_contact, 1 - axis]) > MAX_PASSAGE_M:
                    continue
                has_wall = tree.query(ends[~is_contact], distance_upper_bound=_WALL_THICKNESS_M)[0] < np.inf
                ends_along = ends[is_contact, 1 - axis]
                is_hall = has_wall.mean() < _MAX_WALLED_SHARE and _has_lintel(walls, axis, position, ends_along)
                if has_wall.mean() < _MIN_WALLED_SHARE or is_hall:
                    edge_low, edge_high = np.full(2, -1e3), np.full(2, 1e3)
                    (edge_low if side > 0 else edge_high)[axis] = position
                    behind = shape.intersection(shapely.box(*edge_low, *edge_high))
                    own = [piece for piece in _polygons(behind) if piece.intersects(part)]
                    rest = largest(shape.difference(shapely.union_all(own)))
                    shape = rest if rest is not None else shape
    return shape


def _has_lintel(walls: Array, axis: int, position: float, ends_along: Array) -> bool:
    """True if wall was seen above most of an opening in the wall at a position along an axis [m].

    Args:
        walls: points of walls [m], shape (n, 3).
        axis: across which the wall stands, 0 or 1.
        position: of the wall along that axis [m].
        ends_along: places along the wall that the opening contains [m], shape (k,).
    """
    low, high = float(ends_along.min()), float(ends_along.max())
    count = int((high - low) / CELL_M)
    is_above = (np.abs(walls[:, axis] - position) < _ON_LINE_M) & (walls[:, 2] > _LINTEL_M)
    cell = np.floor((walls[is_above, 1 - axis] - low) / CELL_M).astype(np.int64)
    return count > 0 and len(np.unique(cell[(cell >= 0) & (cell < count)])) >= _MIN_LINTEL_SHARE * count


def without_neighbors(outline: Geometry, shape: Polygon, lines: Sequence[Array]) -> Geometry:
    """The outline without parts outside of a shape that are seen through an opening in the line of a wall: floor of a neighboring room.

    Args:
        outline: what was seen.
        shape: the floor along walls.
        lines: positions of walls across x and across y [m].
    """
    import shapely

    beyond = []
    for part in _polygons(outline.difference(shape.buffer(0.5 * CELL_M))):
        contact = part.buffer(CELL_M).intersection(shape.exterior)
        if contact.is_empty:
            continue
        low, high = np.array(contact.bounds).reshape(2, 2)
        axis = int(np.argmin(high - low))
        middle = 0.5 * (low + high)[axis]
        is_on_line = bool((np.abs(lines[axis] - middle) < _ON_LINE_M).any()) and (high - low)[axis] < 2 * _ON_LINE_M
        if is_on_line and (high - low)[1 - axis] <= MAX_PASSAGE_M:
            beyond.append(part)
    return outline.difference(shapely.union_all(beyond)) if beyond else outline


def along_slanted(shape: Polygon, walls: Sequence[SlantedWall], plan: FloorCells, wall_points: Array) -> Polygon:
    """A floor made of rectangles that ends at slanted walls: corners behind them are cut off.

    Args:
        shape: floor with edges along the axes.
        walls: slanted walls, the largest first.
        plan: where floor and objects were seen.
        wall_points: points of walls seen from above [m], shape (n, 2).
    """
    import shapely

    for wall in walls:
        # Rectangles that are mostly behind a wall are left out whole: fill the front half of its box again.
        corners = np.asarray(shape.exterior.coords)
        start, end = (_at_edges(place, corners) for place in (wall.start, wall.end))
        box = shapely.box(*np.minimum(start, end), *np.maximum(start, end))
        front = box.intersection(_half_plane(wall, wall.normal))
        missing = front.difference(shape)
        is_floor = missing.area > CELL_M**2 and (_seen_share(missing, plan) > 0.5 or _has_no_sides(missing, shape, wall, wall_points))
        if is_floor:
            filled = largest(closed(shape.union(front), 0.02))
            shape = filled if filled is not None else shape
        behind = shape.intersection(_half_plane(wall, -wall.normal))
        for core in _polygons(behind.buffer(-_NECK_M, join_style="mitre")):  # parts that touch in a point are several
            part = core.buffer(_NECK_M, join_style="mitre").intersection(behind)
            if part.geom_type != "Polygon":
                continue
            chord = _chord(part, wall)
            if chord <= 0.0 or part.area > _MAX_CUT_SHARE * shape.area:
                continue
            is_corner = not wall.has_back and part.area <= _MAX_CORNER_SHARE * shape.area
            if wall.is_sparse and wall.seen_m < _SPARSE_CHORD_SHARE * chord:
                continue
            if wall.seen_m >= _MIN_CHORD_SHARE * chord and (is_corner or _seen_share(part, plan) <= _MAX_SEEN_SHARE):
                rest = largest(closed(shape.difference(part), -_NECK_M))
                shape = rest if rest is not None else shape
    return _simplified(shape)


def _has_no_sides(notch: Geometry, shape: Polygon, wall: SlantedWall, wall_points: Array) -> bool:
    """True if no walls were seen along the border between a notch before a slanted wall and the floor around that notch."""
    import shapely
    from scipy.spatial import cKDTree

    # Where both only touch in a corner, the border has points next to its lines, or nothing else.
    parts = shapely.get_parts(notch.boundary.intersection(shape.exterior.buffer(1e-3))).tolist()
    border = shapely.MultiLineString([part for part in parts if part.geom_type == "LineString"])
    if border.is_empty or not len(wall_points):
        return False
    places = np.array([border.interpolate(at).coords[0] for at in np.arange(0.0, border.length, 0.5 * CELL_M)])
    # Near the slanted wall, its own points would count as the notch's sides.
    places = places[(places - wall.start) @ wall.normal > 2 * _NOTCH_REACH_M]
    if not len(places):
        return False
    distance, _ = cKDTree(wall_points).query(places, distance_upper_bound=_NOTCH_REACH_M)
    return bool(np.isfinite(distance).mean() < _MIN_NOTCH_WALL_SHARE)


def _at_edges(place: Array, corners: Array) -> Array:
    """A place, shape (2,) [m], moved along each axis to the nearest corner of a ring that is near: walls along the axes stay straight."""
    away = corners - place
    nearest = np.abs(away).argmin(axis=0)
    step = away[nearest, [0, 1]]
    return place + np.where(np.abs(step) < _MIN_STEP_M, step, 0.0)


def _simplified(shape: Polygon) -> Polygon:
    """A polygon without corners that lie within 3 cm of the line between others."""
    import shapely

    # The first corner always stays: begin at another one the second time.
    once = shape.simplify(_NECK_M)
    ring = np.asarray(once.exterior.coords)[:-1]
    return shapely.Polygon(np.roll(ring, len(ring) // 2, axis=0)).simplify(_NECK_M)


def _polygons(shape: Geometry) -> list[Polygon]:
    """Polygons of a shape, without lines and points."""
    import shapely

    return [part for part in shapely.get_parts(shape).tolist() if part.geom_type == "Polygon" and part.area > 0.0]


def _half_plane(wall: SlantedWall, normal: Array) -> Polygon:
    """What lies on the side of a wall's line that a normal looks to, within 100 m."""
    import shapely

    along = np.array([-normal[1], normal[0]])
    middle = 0.5 * (wall.start + wall.end)
    return shapely.Polygon([middle - 100 * along, middle + 100 * along, middle + 100 * (along + normal), middle + 100 * (normal - along)])


def _chord(part: Polygon, wall: SlantedWall) -> float:
    """Length of the border of a part along a wall's line [m]; 0 if the wall does not lie on it."""
    along = (wall.end - wall.start) / wall.length
    corners = np.asarray(part.exterior.coords)
    on_line = corners[np.abs((corners - wall.start) @ wall.normal) < 1e-3]
    if len(on_line) < 2:
        return 0.0
    places = (on_line - wall.start) @ along
    low, high = float(places.min()), float(places.max())
    overlap = min(high, wall.length) - max(low, 0.0)
    return high - low if overlap >= _MIN_CHORD_SHARE * min(wall.length, high - low) else 0.0


def _seen_share(shape: Geometry, plan: FloorCells) -> float:
    """Share of a shape, sampled in the plan's cells, in which floor or objects were seen."""
    import shapely

    low_x, low_y, high_x, high_y = shape.bounds
    xs, ys = (np.arange(low + 0.5 * CELL_M, high, CELL_M) for low, high in ((low_x, high_x), (low_y, high_y)))
    places = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    places = places[shapely.contains_xy(shape, places[:, 0], places[:, 1])] if len(places) else places
    return float(plan.is_seen(places).mean()) if len(places) else 0.0


def _with_ends(positions: Array, slanted: Sequence[SlantedWall], axis: int) -> Array:
    """Positions along an axis with those at which slanted walls end, where none is near; sorted."""
    ends = sorted(float(place[axis]) for wall in slanted for place in (wall.start, wall.end))
    for end in ends:
        if (np.abs(positions - end) > _MIN_STEP_M).all() and positions[0] < end < positions[-1]:
            positions = np.sort(np.append(positions, end))
    return positions


def _is_wall_strip(positions: Array, walls: Array) -> NDArray[np.bool_]:
    """Which gaps between consecutive lines lie between two walls and are as narrow as a wall, shape (len(positions) - 1,)."""
    is_wall = np.isin(positions, walls)
    return is_wall[:-1] & is_wall[1:] & (np.diff(positions) < _WALL_THICKNESS_M)


def _with_outline(lines: Array, outline: Polygon, axis: int) -> Array:
    """Wall lines, and where no wall is near (0.3 m), the outline's own long edges and extremes; sorted."""
    corners = np.asarray(outline.exterior.coords)
    a, b = corners[:-1], corners[1:]
    other = 1 - axis
    along = np.abs(b[:, other] - a[:, other])
    straight = (along > 0.5) & (np.abs(b[:, axis] - a[:, axis]) < 0.15 * along + 0.05)
    edges = sorted(zip((-along[straight]).tolist(), ((a + b) / 2)[straight, axis].tolist(), strict=True))
    extremes = [(0.0, float(corners[:, axis].min())), (0.0, float(corners[:, axis].max()))]
    positions = lines.tolist()
    for _, position in [*edges, *extremes]:
        if all(abs(position - other_line) > 0.3 for other_line in positions):
            positions.append(position)
    return np.sort(np.array(positions))
