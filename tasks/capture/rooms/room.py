"""The shell of a scene: outline of its rooms, walls and height, estimated from its points."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Shell
from tasks.capture.cloud import Cloud
from tasks.capture.instances.boxes import oriented_box
from tasks.capture.labels import CEILING, FLOOR, WALL, Label
from tasks.capture.rooms.outline import snapped_outline
from tasks.capture.rooms.partitions import interior_walls
from tasks.capture.rooms.plan import CELL_M, FloorCells, closed, largest
from tasks.capture.rooms.separation import Seen
from tasks.capture.rooms.slopes import Slope, slanted_walls
from tasks.geometry.boxes import box_footprint
from tasks.geometry.transforms import flat

if TYPE_CHECKING:
    from shapely import Geometry, Polygon

Array = NDArray[np.float64]

_MIN_WALL_M2 = 0.4
"""Wall surface on one plane below which it is rather the side of a cupboard."""

_LINE_GAP_M = 0.08
"""Lines nearer than this are one wall: thinner walls than that do not exist."""

_MIN_HEIGHT_M, _TOP_PERCENT = 1.8, 99.5
"""Nothing lower is a ceiling [m]; and what counts as the top of a scan: above lies stray depth."""

_MISSED_SHARE = 0.03
"""Furniture outside of the outline, as a share of it, from which on the outline is too small: bleeding through walls is a percent."""

_BRIDGED_M = 1.5
"""Farther from the seen floor than this, furniture may stand in another room."""

_SIGHT_M = 4.0
"""Nor do people stand farther from the floor that they see, whose cameras look to the horizon [m]."""

_EYES_M = 2.5
"""Cameras are held lower than this above the floor [m]; others were on another storey."""

_BODY_M = 0.3
"""Half the width of a person with a camera [m]."""

_STANDING_M = 0.5
"""What begins lower than this stands on the floor; the lowest part of furniture is often hidden."""

_FEW_POINTS = 50
"""Fewer points than this are no furniture."""

_PATCHES_M, _ROOM_M = 0.15, 0.4
"""Half the width of gaps between furniture and patches of floor that are closed: where walls were named, and where nobody knows of any."""

_AROUND_M = 0.15
"""Left around the box of furniture where nobody knows of walls: no simplified outline cuts it [m]."""

_MIN_SLANT_DEGREES, _MIN_SLANTED_M = 8.0, 0.2
"""Angle to the axes and length [m] from which on a stated edge is a wall of its own, not noise of walls along the axes."""

_MIN_SAME_SHARE = 0.85
"""Share of the ground of a stated floor and an estimated one that both cover, from which on the stated one is the whole floor."""

NO_ROOM = "not a room"
"""Begins the note on scans of things: a figure on a plate, a table."""

_UPRIGHT, _UPRIGHT_M2 = 0.3, 1.2
"""Most vertical part of the normal of upright surface; and such surface from which on a scan has sides as large as a wall [m2]."""

_TALL_M = 1.2
"""Upright surface that nobody named is a wall where it is as high in one place: furniture behind it stands in another room."""


@dataclasses.dataclass(frozen=True)
class RoomShape:
    """Shape of a room in the world frame.

    polygon: Corners of the floor, counter-clockwise, open ring [m], shape (n, 2). walls: Segments x0, y0, x1, y1 with the
    room to their left [m], shape (m, 4): edges of the polygon, then faces of interior walls. interior_walls: Center lines
    x0, y0, x1, y1, thickness, height [m], shape (k, 6). height [m]. is_seen: where anything but walls was seen, of places shape
    (m, 2) [m]; None where nobody looked. slopes: slanted walls. top: how high anything was scanned [m].
    is_room: false for a scan of things, which has no walls.
    """

    polygon: Array
    area: float
    floor_source: str
    walls: Array
    interior_walls: Array
    height: float
    height_source: str
    notes: tuple[str, ...]
    is_seen: Seen | None = None
    slopes: tuple[Slope, ...] = ()
    top: float = 0.0
    is_room: bool = True

    def row(
        self, scene_id: str, parts: Sequence[tuple[NDArray[np.uint8], Label]],
        openings: tuple[tuple[float, ...], ...] | None = None, lintels: tuple[tuple[float, ...], ...] | None = None,
    ) -> Shell:  # fmt: skip
        """The row of `shells` for this shape, of unknown kind. parts: Colors, shape (n, 3), and label of what tells the colors of floor
        and walls."""
        return Shell(
            scene_id=scene_id,
            room_type="unknown",
            floor_polygon=tuple((float(x), float(y)) for x, y in self.polygon),
            floor_area_m2=self.area,
            floor_source=self.floor_source,
            walls=tuple(tuple(float(v) for v in wall) for wall in self.walls),
            interior_walls=tuple(tuple(float(v) for v in wall) for wall in self.interior_walls),
            openings=openings,
            lintels=lintels,
            slopes=tuple(slope.row for slope in self.slopes),
            height_m=self.height,
            height_source=self.height_source,
            floor_color=_median_color(parts, FLOOR),
            wall_color=_median_color(parts, WALL),
        )


def _median_color(parts: Iterable[tuple[NDArray[np.uint8], Label]], nyu40: int) -> tuple[int, ...] | None:
    """Median color of the parts of an NYU40 class, shape (3,); None where they have none."""
    colors = [values for values, label in parts if label.nyu40_id == nyu40 and len(values)]
    return tuple(int(value) for value in np.median(np.concatenate(colors), axis=0)) if colors else None


def estimate_room(cloud: Cloud, nyu40: NDArray[np.int64], stated: Array | None = None, eyes: Array | None = None) -> RoomShape:
    """The room around a scan.

    Args:
        cloud: points of the scan in the world frame.
        nyu40: NYU40 class of each point of the cloud, 0 for none, shape (n,).
        stated: corners of the floor as a file states them in the world frame [m], shape (n, 3); used if an edge is slanted.
        eyes: where the cameras were in the world frame [m], shape (n, 3).
    """
    import shapely

    kinds = _kinds(cloud, nyu40)
    height, height_source = _height(cloud, kinds)
    top = float(np.percentile(cloud.points[:, 2], _TOP_PERCENT))
    plan = FloorCells.of(cloud, kinds, height)
    notes: list[str] = []
    outline, lines = plan.outline(), [_wall_lines(cloud, kinds == WALL, axis) for axis in (0, 1)]
    is_room = bool((nyu40 == WALL).any()) or (any(map(len, lines)) and _looks_inward(cloud, kinds == WALL))
    if not is_room:
        notes.append(_not_a_room(cloud))
    if outline is None:
        low, high = (np.percentile(cloud.points[:, :2], q, axis=0) for q in (0.5, 99.5))
        high = np.maximum(high, low + 0.2)
        polygon = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        notes.append("no floor to be seen: its polygon is the extent of the scan")
        area, walls, inner = float(np.prod(high - low)), _edges(polygon) if is_room else np.zeros((0, 4)), np.zeros((0, 6))
        return RoomShape(polygon, area, "extent", walls, inner, height, height_source, tuple(notes), top=top, is_room=is_room)
    has_walls = bool((nyu40 == WALL).any()) or min(map(len, lines)) >= 2
    outline, missed = _with_furniture(outline, cloud, kinds, has_walls, eyes if eyes is not None and is_room else np.zeros((0, 3)))
    if has_walls:
        shape, is_snapped = snapped_outline(plan, outline, lines, cloud, kinds == WALL)
    else:
        shape, is_snapped = outline.simplify(0.5 * _AROUND_M), False
    if stated is not None and _is_followed(stated, shape):
        # Rectangles between walls along the axes would fill a chamfered corner.
        shape, is_snapped, missed = shapely.Polygon(stated[:, :2]), True, 0.0
    if missed > 0.0:
        notes.append(f"the floor was seen in patches: {missed:.1f} m2 under and around furniture are added to its polygon")
    if plan.left_out_m2 > 1.0:
        notes.append(f"{plan.left_out_m2:.1f} m2 of floor not connected to the rest: left out of the polygon")
    polygon = _ring(shape)
    seen = plan.share_of_floor(shape)
    source = "surface" if seen >= 0.25 else ("walls" if is_snapped and any(len(side_lines) for side_lines in lines) else "extent")
    area = float(shape.area)
    if not is_room:
        walls, inner = np.zeros((0, 4)), np.zeros((0, 6))
        return RoomShape(polygon, area, source, walls, inner, height, height_source, tuple(notes), plan.is_seen, top=top, is_room=False)
    slabs, more = interior_walls(cloud, kinds == WALL, shape, height, plan.is_floor)
    walls = np.array([*_edges(polygon), *(face for slab in slabs for face in slab.faces)])
    inner = np.array([slab.row for slab in slabs]).reshape(-1, 6)
    slopes = tuple(slanted_walls(cloud, np.isin(kinds, (WALL, CEILING)), polygon, inner, height))
    return RoomShape(polygon, area, source, walls, inner, height, height_source, (*notes, *more), plan.is_seen, slopes, top)


def _not_a_room(cloud: Cloud) -> str:
    """The note on a scan without walls, with the reason."""
    upright_m2 = float(cloud.areas[np.abs(cloud.normals[:, 2]) < _UPRIGHT].sum())
    sides = f"its {upright_m2:.1f} m2 of upright surface are sides of what stands there, not walls around it"
    reason = sides if upright_m2 >= _UPRIGHT_M2 else "nothing upright in it is as large as a wall"
    return f"{NO_ROOM}: {reason}: handled as a scan of objects on a floor without walls"


def _looks_inward(cloud: Cloud, is_wall: NDArray[np.bool_]) -> bool:
    """True if most upright surface that nobody named looks to the middle of the scan, as walls do and the sides of a thing do not."""
    middle = np.average(cloud.points[:, :2], axis=0, weights=cloud.areas + 1e-12)
    inward = ((middle - cloud.points[is_wall, :2]) * cloud.normals[is_wall, :2]).sum(axis=1) > 0.0
    return bool(cloud.areas[is_wall] @ inward >= 0.5 * cloud.areas[is_wall].sum())


def _is_followed(ring: Array, estimated: Geometry) -> bool:
    """True if a stated floor, corners of shape (n, 3), has an edge as long as a wall that runs along no axis, and is the whole floor."""
    import shapely

    edges, stated = (np.roll(ring, -1, axis=0) - ring)[:, :2], shapely.Polygon(ring[:, :2])
    lengths = np.hypot(*edges.T)
    off_axis = np.abs(edges).min(axis=1) > np.sin(np.deg2rad(_MIN_SLANT_DEGREES)) * lengths
    is_candidate = bool(stated.is_valid and (off_axis & (lengths >= _MIN_SLANTED_M)).any())
    return is_candidate and stated.intersection(estimated).area >= _MIN_SAME_SHARE * stated.union(estimated).area


def floor_points(cloud: Cloud, nyu40: NDArray[np.int64]) -> NDArray[np.float64]:
    """Points of the floor that was seen, labelled or not [m], shape (m, 3). `nyu40`: as for `estimate_room`."""
    return cloud.points[_kinds(cloud, nyu40) == FLOOR]


def wall_points(cloud: Cloud, nyu40: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which points are of walls, labelled or not, shape (n,). `nyu40`: as for `estimate_room`."""
    return np.asarray(_kinds(cloud, nyu40) == WALL)


def inferred_room_type(categories: Iterable[str]) -> str:
    """Kind of room by what stands in it, 'unknown' when nothing tells. Ties go to the first of the list below."""
    present = list(categories)
    best, most = "unknown", 0.0
    for room_type, words in _TELLING.items():
        score = sum(weight for word, weight in words.items() if word in present)
        if score > most:
            best, most = room_type, score
    return best if most >= 1 else "unknown"


_TELLING: dict[str, dict[str, float]] = {
    "bathroom": {"toilet": 3, "bathtub": 3, "shower": 2, "shower curtain": 2, "sink": 0.8},
    "bedroom": {"bed": 3, "nightstand": 1, "wardrobe": 1, "dresser": 0.8},
    "kitchen": {"stove": 2, "refrigerator": 2, "oven": 2, "dishwasher": 2, "range hood": 2, "kitchen cabinet": 1.5, "kitchen counter": 1.5,
                "microwave": 0.8, "sink": 0.6},
    "living room": {"sofa": 2, "coffee table": 1, "tv": 0.8, "tv stand": 1, "armchair": 0.6, "fireplace": 1},
    "dining room": {"dining table": 2.5},
    "office": {"desk": 1.5, "monitor": 1, "office chair": 1.5, "whiteboard": 1, "printer": 0.8, "keyboard": 0.6, "file cabinet": 0.8},
}  # fmt: skip
"""How much a category speaks for a kind of room; one clear object, or two weak ones, decide."""


def _kinds(cloud: Cloud, nyu40: NDArray[np.int64]) -> NDArray[np.int64]:
    """WALL, FLOOR or CEILING per point, 0 for anything else: as labelled, else by where unlabelled points lie."""
    kinds = np.where(np.isin(nyu40, (WALL, FLOOR, CEILING)), nyu40, 0)
    loose = (cloud.instance < 0) & (kinds == 0)
    level = np.abs(cloud.normals[:, 2]) > 0.9
    kinds[loose & level & (np.abs(cloud.points[:, 2]) < 0.06)] = FLOOR
    if not (kinds == WALL).any():
        kinds[loose & (np.abs(cloud.normals[:, 2]) < 0.2)] = WALL
    if not (kinds == CEILING).any():
        kinds[loose & level & (cloud.points[:, 2] > _MIN_HEIGHT_M + 0.2)] = CEILING
    return kinds


def _height(cloud: Cloud, kinds: NDArray[np.int64]) -> tuple[float, str]:
    """Height of the room [m] and what it was taken from."""
    z, areas = cloud.points[:, 2], cloud.areas
    ceiling = (kinds == CEILING) & (z > _MIN_HEIGHT_M)
    if areas[ceiling].sum() > 0.5:
        heights, weights = z[ceiling], areas[ceiling]
        bins = np.floor(heights / 0.05).astype(np.int64)
        filled = np.convolve(np.bincount(bins, weights=weights), np.ones(3), mode="same")
        near = np.abs(heights - (int(np.argmax(filled)) + 0.5) * 0.05) < 0.1
        return float(np.median(heights[near])), "ceiling"
    walls = z[kinds == WALL]
    if areas[kinds == WALL].sum() > 1.0 and (top := float(np.percentile(walls, 99.7))) > 1.0:
        return top, "walls"
    return max(float(np.percentile(z, _TOP_PERCENT)), 0.1), "extent"


def _with_furniture(outline: Polygon, cloud: Cloud, kinds: NDArray[np.int64], has_walls: bool, eyes: Array) -> tuple[Polygon, float]:
    """The outline with what stands outside of it, and how much was added [m2]; as it was where little stands outside. Whoever carried the
    cameras stood in the room, too.

    A few frames see furniture well and the floor in patches: then furniture lies across the patches' outline. has_walls: Walls are named,
    or seen along both axes. Where they are not, what hangs in the air is furniture, too, whose lower part was hidden, and nothing within
    reach may stand outside.
    """
    import shapely

    hulls = []
    order = np.argsort(cloud.instance, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(cloud.instance[order])) + 1):
        points = cloud.points[members]
        if cloud.instance[members[0]] < 0 or len(points) < _FEW_POINTS or kinds[members].any():
            continue
        low, high = np.percentile(points, [1, 99], axis=0)
        if low[2] < (_STANDING_M if has_walls else _MIN_HEIGHT_M):
            within = ((points[:, :2] >= low[:2]) & (points[:, :2] <= high[:2])).all(axis=1)
            hulls.append(shapely.MultiPoint(points[within, :2]).convex_hull.buffer(CELL_M) if has_walls else _around(points))
    walls = cloud.points[kinds == WALL]
    walls = walls[:, :2] if has_walls else walls[_is_tall(walls), :2]
    stood = _standpoints(eyes, outline)
    hulls = [hull for hull in (*hulls, *stood) if not _is_behind_wall(hull, outline, walls)]
    furniture = shapely.union_all(hulls) if hulls else shapely.Polygon()
    if furniture.difference(outline).area <= (_MISSED_SHARE if has_walls else 0.0) * outline.area:
        return outline, 0.0
    parts = shapely.get_parts(shapely.union_all([outline, furniture])).tolist()
    room = max(parts, key=lambda part: float(part.intersection(outline).area))
    parts.remove(room)
    while parts:
        part = min(parts, key=lambda part: float(part.distance(room)))
        away = float(part.distance(room))
        if away > (_SIGHT_M if any(part.intersects(body) for body in stood) else _BRIDGED_M):
            break
        near = shapely.intersection(room, part.buffer(away + 0.3))  # the floor between was not seen
        room = shapely.union_all([room, shapely.union_all([part, near]).convex_hull])
        parts.remove(part)
    whole = shapely.union_all([room, closed(room, _PATCHES_M if has_walls else _ROOM_M)])  # closing cuts necks between acute corners
    grown = _around_floor(whole, outline)
    return (grown, float(grown.area - outline.area)) if grown is not None else (outline, 0.0)


def _standpoints(eyes: Array, outline: Polygon) -> list[Polygon]:
    """Floor below cameras at shape (n, 3) [m], outside of an outline and within reach of it; none in one place, or on another storey."""
    import shapely

    eyes = eyes[(eyes[:, 2] > 0.0) & (eyes[:, 2] < _EYES_M)]
    _, first = np.unique(np.floor(eyes[:, :2] / _BODY_M).astype(np.int64), axis=0, return_index=True)
    bodies = [shapely.Point(place).buffer(_BODY_M) for place in eyes[np.sort(first), :2]]
    return [body for body in bodies if not outline.covers(body) and body.distance(outline) <= _SIGHT_M]


def _around_floor(shape: Polygon, outline: Polygon) -> Polygon | None:
    """The polygon of a shape that holds most of the seen floor, without holes."""
    import shapely

    return largest(max(shapely.get_parts(shape).tolist(), key=lambda part: float(part.intersection(outline).area)))


def _around(points: Array) -> Polygon:
    """What furniture, of points of shape (n, 3), takes of the floor, with a margin."""
    import shapely

    pose, size = oriented_box(points)
    return shapely.Polygon(box_footprint(flat(pose), size)[:, :2]).buffer(_AROUND_M, join_style="mitre")


def _is_tall(points: Array) -> NDArray[np.bool_]:
    """Which points, shape (n, 3), are of cells in plan in which they reach as high as a wall, shape (n,)."""
    if not len(points):
        return np.zeros(0, dtype=np.bool_)
    _, cell = np.unique(np.floor(points[:, :2] / (2 * CELL_M)).astype(np.int64), axis=0, return_inverse=True)
    low, high = np.full(int(cell.max()) + 1, np.inf), np.full(int(cell.max()) + 1, -np.inf)
    np.minimum.at(low, cell.ravel(), points[:, 2])
    np.maximum.at(high, cell.ravel(), points[:, 2])
    return np.asarray((high - low)[cell.ravel()] >= _TALL_M)


def _is_behind_wall(hull: Polygon, outline: Polygon, walls: Array) -> bool:
    """Whether wall points, shape (n, 2), lie where furniture leaves the outline, or between the two."""
    import shapely

    outside = hull.difference(outline)
    if outside.is_empty:
        return False
    away = float(hull.distance(outline))
    near = shapely.intersection(outline, hull.buffer(away + 0.1))
    between = shapely.union_all([outside, near]).convex_hull.difference(outline.buffer(-0.05)).difference(hull.buffer(-0.1))
    return bool(shapely.contains_xy(between, walls[:, 0], walls[:, 1]).sum() >= _FEW_POINTS)


def _wall_lines(cloud: Cloud, is_wall: NDArray[np.bool_], axis: int) -> Array:
    """Positions along `axis` [m], sorted, of walls that stand across it."""
    across = is_wall & (np.abs(cloud.normals[:, axis]) > 0.9)
    values, areas = cloud.points[across, axis], cloud.areas[across]
    if not len(values):
        return np.zeros(0)
    start = values.min() - 0.2
    bins = np.floor((values - start) / 0.01).astype(np.int64)
    histogram = np.bincount(bins, weights=areas, minlength=bins.max() + 20)
    smooth = np.convolve(histogram, np.ones(7), mode="same")
    lines: list[float] = []
    for peak in np.argsort(-smooth, kind="stable"):
        if smooth[peak] < _MIN_WALL_M2:
            break
        position = start + (peak + 0.5) * 0.01
        if all(abs(position - other) > _LINE_GAP_M for other in lines):
            near = np.abs(values - position) < 0.04
            lines.append(float(np.average(values[near], weights=areas[near])))
    return np.sort(np.array(lines))


def _ring(shape: Polygon) -> Array:
    """Corners, counter-clockwise, starting with the lowest (x, y), without the repeated last one, shape (n, 2)."""
    import shapely

    ring = np.asarray(shapely.geometry.polygon.orient(shape).exterior.coords)[:-1]
    first = int(np.lexsort((ring[:, 1], ring[:, 0]))[0])
    return np.roll(ring, -first, axis=0) + 0.0


def _edges(ring: Array) -> Array:
    return np.column_stack([ring, np.roll(ring, -1, axis=0)])
