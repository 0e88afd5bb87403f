"""Floors of a captured room: the stated ones, and those that walls enclose where a storey has none."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.roomplan.curves import WallSheet
from tasks.capture.roomplan.elements import RoomElement
from tasks.capture.roomplan.surfaces import FLOOR_GRAY, corners_of, flat_part, floor_part, outline_of
from tasks.capture.storeys.levels import Levels
from tasks.geometry.transforms import transform_points

if TYPE_CHECKING:
    import shapely
    import trimesh

Array = NDArray[np.float64]

MAX_GAP_M = 0.3
"""Distance between ends of walls that meet: RoomPlan leaves gaps of a wall's thickness between rooms."""

MAX_OPENING_M = 2.0
"""Distance between walls of one room that do not meet: a wide door, or a piece of wall that was not scanned."""

MIN_LEVEL = 0.94
"""Vertical part of a floor's normal, 20 degrees: steeper surfaces are no floors."""

MIN_COVER = 0.5
"""Share of the ground within walls that stated floors cover: parts of rooms are left unscanned, but not most."""

MAX_LIFT_M = 0.3
"""Height between a floor and the lower edges of its walls: a step is less."""

MIN_RISE_M = 1.5
"""Rise between storeys of walls whose numbers are not stated: sunken floors rise less."""

_ABOVE_CUT_M = 0.01
"""Depth of the cut below an upper floor whose walls reach down to the ceiling."""

_SLAB_M = 0.3
"""Thickness of a slab: walls that reach higher are not of the storey below."""


@dataclasses.dataclass(frozen=True)
class FloorPart:
    """A floor's surface. field: the element that it comes from."""

    part: trimesh.Trimesh
    field: str


@dataclasses.dataclass(frozen=True)
class Storeys:
    """Floors of a captured room. levels: of storeys in the +Z-up frame, None if there is one."""

    floors: tuple[FloorPart, ...]
    levels: Levels | None
    notes: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class StoreyGround:
    """Ground within walls, from above [m]. is_closed: true if walls enclose all of the shape. hull_m2: Area of the walls' convex hull."""

    shape: shapely.Geometry
    is_closed: bool
    hull_m2: float

    @property
    def area(self) -> float:
        """Area of the ground [m2]."""
        return float(self.shape.area)


def storeys_of(walls: Sequence[RoomElement], sheets: Sequence[WallSheet], floors: Sequence[RoomElement], name: str) -> Storeys:
    """Floors of all storeys: the stated ones that lie level, otherwise the ground within the walls.

    sheets: Of the walls. name: The file, for notes.
    """
    notes: list[str] = []
    stated = [floor for floor in floors if _is_floor(floor, name, notes)]
    numbers, more = _numbers(walls, name)
    notes += more
    own = _own_floors(walls, numbers, stated)
    parts: list[FloorPart] = []
    heights = {}
    for number in sorted({*numbers, *own}):
        members = [k for k, wall_number in enumerate(numbers) if wall_number == number]
        lines = [_plan_line(walls[k], sheets[k]) for k in members]
        bottoms = [float(line[:, 2].min()) for line in lines]
        storey = f"{name}: storey {number}" if len({*numbers, *own}) > 1 else name
        if number in own:
            parts += [FloorPart(floor_part(floor), floor.field) for floor in own[number]]
            heights[number] = min(_height(floor) for floor in own[number])
            notes += _contradictions(storey, own[number], lines, bottoms)
            continue
        heights[number] = float(np.median(bottoms))
        ground = ground_within(lines)
        how = "the ground within its walls" if ground.is_closed else "the convex hull of its walls, which leave gaps"
        notes.append(f"{storey}: floors: none is usable: {how} is taken")
        if ground.area < MIN_COVER * ground.hull_m2:
            notes.append(f"{storey}: floors: {ground.area:.1f} m2 are taken, the convex hull of all walls has {ground.hull_m2:.1f} m2")
        parts.append(FloorPart(flat_part(ground.shape, _at_height(heights[number]), FLOOR_GRAY), walls[members[0]].field))
    levels, more = _levels(heights, walls, numbers, name)
    return Storeys(tuple(parts), levels, (*notes, *more))


def floor_within(walls: Sequence[RoomElement], sheets: Sequence[WallSheet]) -> trimesh.Trimesh:
    """A floor within the lower edges of walls, at the height of the lowest."""
    lines = [_plan_line(wall, sheet) for wall, sheet in zip(walls, sheets, strict=True)]
    return flat_part(ground_within(lines).shape, _at_height(min(float(line[:, 2].min()) for line in lines)), FLOOR_GRAY)


def ground_within(lines: Sequence[Array]) -> StoreyGround:
    """The ground that walls enclose. Walls that enclose nothing have the convex hull of those near to each other.

    lines: each wall from above [m], shapes (n, 2) or (n, 3).
    """
    import shapely

    plan = np.array([shapely.LineString(line[:, :2]) for line in lines if len(line) > 1], dtype=object)
    half = 0.5 * MAX_GAP_M
    thick = shapely.union_all(shapely.buffer(plan, half, join_style="mitre", cap_style="square"))
    rings = [ring for piece in shapely.get_parts(thick) for ring in getattr(piece, "interiors", ())]
    inner = shapely.union_all([shapely.Polygon(ring) for ring in rings])
    closed = shapely.buffer(inner, half + 1e-6, join_style="mitre").simplify(1e-4)
    hull = shapely.union_all(plan).convex_hull
    # A wall that runs outside of all rings is of a room that leaves gaps: a ring may be a column.
    within = shapely.length(shapely.intersection(plan, shapely.buffer(closed, MAX_GAP_M)))
    open_walls = plan[within < 0.5 * shapely.length(plan)]
    pieces = shapely.get_parts(shapely.union_all(shapely.buffer(plan, 0.5 * MAX_OPENING_M)))
    wall_rows, piece_rows = shapely.STRtree(pieces).query(open_walls, predicate="intersects")
    groups = [open_walls[wall_rows[piece_rows == row]] for row in np.unique(piece_rows)]
    hulls = [shapely.union_all(group).convex_hull for group in groups]
    ground = shapely.union_all([closed, *(piece for piece in hulls if piece.geom_type == "Polygon")])
    # Walls that stand alone have a hull together; next to a larger ground they are no room.
    alone = [wall for group, piece in zip(groups, hulls, strict=True) if piece.geom_type != "Polygon" for wall in group]
    common = shapely.union_all(alone).convex_hull
    if ground.area < MIN_COVER * common.area:
        ground = shapely.union_all([ground, common])
    if ground.area <= closed.area * (1.0 + 1e-3) + 1e-6:
        return StoreyGround(hull, False, hull.area) if closed.is_empty else StoreyGround(closed, True, hull.area)
    return StoreyGround(ground, False, hull.area)


def _is_floor(floor: RoomElement, name: str, notes: list[str]) -> bool:
    """True if a floor has an area and lies level; a note says why not."""
    if not len(floor_part(floor).faces):
        notes.append(f"{name}: {floor.field}: has no area, left out")
        return False
    if abs(float(floor.pose[2, 2])) < MIN_LEVEL:
        tilt = np.degrees(np.arccos(min(abs(float(floor.pose[2, 2])), 1.0)))
        notes.append(f"{name}: {floor.field}: is tilted by {tilt:.0f} degrees, left out")
        return False
    return True


def _numbers(walls: Sequence[RoomElement], name: str) -> tuple[list[int], list[str]]:
    """Number of the storey of each wall, and notes on numbers that are not stated: lower edges decide."""
    bottoms = np.array([float(_points(wall)[:, 2].min()) for wall in walls])
    stated = np.array([wall.story is not None for wall in walls])
    numbers = np.array([wall.story or 0 for wall in walls], dtype=np.int64)
    if stated.all():
        return numbers.tolist(), []
    rest = np.flatnonzero(~stated)
    rest = rest[np.argsort(bottoms[rest], kind="stable")]
    rises = np.diff(bottoms[rest], prepend=bottoms[rest[0]])
    if not stated.any():
        numbers[rest] = np.cumsum(rises > MIN_RISE_M)
        steps = rises[(rises > MAX_LIFT_M) & (rises <= MIN_RISE_M)]
        note = f"{name}: walls: lower edges rise by {steps.max(initial=0.0):.2f} m without a story: read as one storey"
        return numbers.tolist(), [note] if len(steps) else []
    own, levels = numbers[stated], bottoms[stated]
    order = np.argsort(levels, kind="stable")
    sorted_levels, sorted_numbers = levels[order], own[order]
    after = np.clip(np.searchsorted(sorted_levels, bottoms[rest]), 1, max(len(order) - 1, 1))
    before, after = after - 1, np.minimum(after, len(order) - 1)
    is_after = np.abs(sorted_levels[after] - bottoms[rest]) < np.abs(sorted_levels[before] - bottoms[rest])
    numbers[rest] = sorted_numbers[np.where(is_after, after, before)]
    # Walls far above or below all stated ones are of further storeys.
    above = rest[bottoms[rest] > sorted_levels[-1] + MIN_RISE_M]
    below = rest[bottoms[rest] < sorted_levels[0] - MIN_RISE_M][::-1]
    for rows, limit, step in ((above, int(own.max()), 1), (below, int(own.min()), -1)):
        gaps = np.abs(np.diff(bottoms[rows], prepend=bottoms[rows[:1]]))
        numbers[rows] = limit + step * (1 + np.cumsum(gaps > MIN_RISE_M))
    return numbers.tolist(), [f"{name}: walls: {len(rest)} of {len(walls)} state no story: their lower edges decide"]


def _own_floors(walls: Sequence[RoomElement], numbers: Sequence[int], floors: Sequence[RoomElement]) -> dict[int, list[RoomElement]]:
    """Floors by storey: as stated, otherwise of the walls that begin nearest to their height."""
    is_stated = any(wall.story is not None for wall in walls)
    bottoms = np.array([float(_points(wall)[:, 2].min()) for wall in walls])
    own: dict[int, list[RoomElement]] = {}
    for floor in floors:
        nearest = numbers[int(np.abs(bottoms - _height(floor)).argmin())]
        own.setdefault(floor.story if is_stated and floor.story is not None else nearest, []).append(floor)
    return own


def _contradictions(storey: str, floors: Sequence[RoomElement], lines: Sequence[Array], bottoms: Sequence[float]) -> list[str]:
    """Notes on floors that lie elsewhere than the walls of their storey."""
    import shapely

    if not lines:
        return [f"{storey}: has a floor and no walls"]
    notes = []
    lift = min(_height(floor) for floor in floors) - float(np.median(bottoms))
    if abs(lift) > MAX_LIFT_M:
        side = "above" if lift > 0 else "below"
        notes.append(f"{storey}: {floors[0].field}: lies {abs(lift):.2f} m {side} the lower edges of its walls")
    ground = ground_within(lines)
    covered = shapely.union_all([_plan(floor) for floor in floors])
    area = float(covered.intersection(ground.shape).area)
    if ground.is_closed and area < MIN_COVER * ground.area:
        notes.append(f"{storey}: {floors[0].field}: floors cover {area:.1f} of {ground.area:.1f} m2 within the walls")
    return notes


def _levels(heights: dict[int, float], walls: Sequence[RoomElement], numbers: Sequence[int], name: str) -> tuple[Levels | None, list[str]]:
    """Floors of storeys and the cuts between them, None for one storey; and notes on numbers that contradict the heights."""
    if len(heights) < 2:
        return None, []
    ordered = sorted(heights, key=lambda number: (heights[number], number))
    floors = [heights[number] for number in ordered]
    if ordered != sorted(heights) or min(np.diff(floors)) < MIN_RISE_M:
        listed = ", ".join(f"storey {number} at {heights[number]:.2f} m" for number in sorted(heights))
        return None, [f"{name}: story: {listed}: numbers and heights disagree: the geometry decides"]
    tops = [float(_points(wall)[:, 2].max()) for wall in walls]
    cuts = []
    for lower, floor in zip(ordered[:-1], floors[1:], strict=True):
        below = [top for top, number in zip(tops, numbers, strict=True) if number == lower and top <= floor]
        top = max(below, default=floor)
        cuts.append(max(0.5 * (top + floor), floor - _SLAB_M) if top < floor - 2.0 * _ABOVE_CUT_M else floor - _ABOVE_CUT_M)
    return Levels(tuple(floors), tuple(cuts)), []


def _plan_line(wall: RoomElement, sheet: WallSheet) -> Array:
    """The lower edge of a wall in the +Z-up frame [m], shape (n, 3)."""
    low = float(corners_of(wall)[:, 1].min())
    seams = sheet.seams
    return transform_points(sheet.roll(np.column_stack([seams, np.full(len(seams), low), np.zeros(len(seams))])), wall.pose)


def _plan(floor: RoomElement) -> Any:
    """The outline of a floor from above."""
    import shapely

    def place(points: Array) -> Array:
        return transform_points(np.column_stack([points, np.zeros(len(points))]), floor.pose)[:, :2]

    return shapely.make_valid(shapely.transform(outline_of(floor), place))


def _points(element: RoomElement) -> Array:
    """Corners of an element in the +Z-up frame [m], shape (n, 3)."""
    return transform_points(corners_of(element), element.pose)


def _height(floor: RoomElement) -> float:
    return float(_points(floor)[:, 2].mean())


def _at_height(height: float) -> Array:
    pose = np.eye(4)
    pose[2, 3] = height
    return pose
