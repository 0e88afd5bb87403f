"""Floor plans of dwellings: rooms side by side, doorways between them, a way in, windows in outer walls.

World frame: +Z up, metres, floor at z = 0, axes along the walls.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.furnishing import Wall

if TYPE_CHECKING:
    from shapely.geometry import Polygon

Array = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]
"""x0, y0, x1, y1 [m]."""

PARTITION_M = 0.12
"""Thickness of a wall between two rooms."""

OUTER_M = 0.2
"""Thickness of a wall with nothing behind it."""

DOOR_M = (0.88, 2.03)
"""Width and height of a door's opening."""

PASSAGE_M = ((0.9, 1.8), (2.05, 2.25))
"""Widths and heights of openings without a door."""

SLOPE_M = 1.45
"""So far into a room a slanted wall may reach."""

AREA_PER_OBJECT_M2 = 0.85
"""Floor of a dwelling for each of its objects."""

KINDS: tuple[str, ...] = ("living room", "kitchen", "bedroom", "office", "dining room")
"""What rooms are, the largest first."""


@dataclasses.dataclass(frozen=True)
class Opening:
    """A hole in a wall. kind: `door`, `passage` (an opening without a door) or `window`. room, wall: whose, by number; the other
    side of a door or passage is an opening of its own, `to` the room there, -1 for outside. at: place of its middle along the
    wall, width, low, high [m]."""

    kind: str
    room: int
    wall: int
    at: float
    width: float
    low: float
    high: float
    to: int = -1

    @property
    def span(self) -> tuple[float, float]:
        """From where to where along the wall [m]."""
        return self.at - 0.5 * self.width, self.at + 0.5 * self.width


@dataclasses.dataclass(frozen=True)
class PlannedRoom:
    """A room of a plan. rectangles: it is made of these, whose union's inner corners are `polygon`, counter-clockwise, (n, 2) [m].
    walls: inner faces, one on each edge. shared: along each wall, from where to where another room lies behind it [m]."""

    kind: str
    rectangles: tuple[Rectangle, ...]
    polygon: Array
    walls: tuple[Wall, ...]
    shared: tuple[tuple[tuple[float, float, int], ...], ...]


@dataclasses.dataclass(frozen=True)
class FloorPlan:
    """Rooms, the height of all of them [m], and the openings in their walls."""

    rooms: tuple[PlannedRoom, ...]
    height: float
    openings: tuple[Opening, ...]

    def openings_of(self, room: int, wall: int | None = None) -> list[Opening]:
        """The openings of a room, or of one of its walls."""
        return [o for o in self.openings if o.room == room and wall in (None, o.wall)]


def floor_plan(objects: int, rng: np.random.Generator) -> FloorPlan:
    """A plan with floor for so many objects: two to four rooms, each reached from the others, some of them L-shaped."""
    count = int(np.clip(round(objects / 19 + rng.uniform(-0.5, 0.5)), 2, 4))
    area = AREA_PER_OBJECT_M2 * objects
    length = float(np.sqrt(area * rng.uniform(1.15, 1.6)))
    cells: list[Rectangle] = [(0.0, 0.0, length, area / length)]
    while len(cells) < count:
        cells.sort(key=_area, reverse=True)
        cells = [*_halves(cells[0], float(rng.uniform(0.44, 0.6))), *cells[1:]]
    cells.sort(key=_area, reverse=True)
    groups = _with_corner([[cell] for cell in cells], rng)
    kinds = [KINDS[0], *(KINDS[1 + int(i)] for i in rng.permutation(len(KINDS) - 1))]
    if "kitchen" not in kinds[: len(groups)]:
        kinds[1] = "kitchen"
    rooms = _rooms(groups, kinds)
    openings = _doorways(rooms, rng)
    openings += _entrance(rooms, openings, rng)
    openings += _windows(rooms, openings, rng)
    return FloorPlan(tuple(rooms), float(rng.uniform(2.4, 2.75)), tuple(openings))


def _area(cell: Rectangle) -> float:
    return (cell[2] - cell[0]) * (cell[3] - cell[1])


def _halves(cell: Rectangle, share: float) -> list[Rectangle]:
    x0, y0, x1, y1 = cell
    if x1 - x0 >= y1 - y0:
        x = x0 + share * (x1 - x0)
        return [(x0, y0, x, y1), (x, y0, x1, y1)]
    y = y0 + share * (y1 - y0)
    return [(x0, y0, x1, y), (x0, y, x1, y1)]


def _with_corner(groups: list[list[Rectangle]], rng: np.random.Generator) -> list[list[Rectangle]]:
    """The largest room reaches round a corner into a neighbor, now and then: both are L-shaped then."""
    if rng.random() < 0.4:
        return groups
    x0, y0, x1, y1 = groups[0][0]
    for index in (int(k) + 1 for k in rng.permutation(len(groups) - 1)):
        a0, b0, a1, b1 = groups[index][0]
        along, up = 0.42 * (a1 - a0), 0.4 * (b1 - b0)
        if min(along, up) < 1.2 or min(a1 - a0 - along, b1 - b0 - up) < 1.7:
            continue
        if abs(a0 - x1) < 1e-9 and b0 > y0 - 1e-9 and b0 + up < y1 + 1e-9:  # it lies to the right
            part, rest = (a0, b0, a0 + along, b0 + up), [(a0 + along, b0, a1, b0 + up), (a0, b0 + up, a1, b1)]
        elif abs(b0 - y1) < 1e-9 and a0 > x0 - 1e-9 and a0 + along < x1 + 1e-9:  # or above
            part, rest = (a0, b0, a0 + along, b0 + up), [(a0, b0 + up, a0 + along, b1), (a0 + along, b0, a1, b1)]
        else:
            continue
        return [[groups[0][0], part], *groups[1:index], rest, *groups[index + 1 :]]
    return groups


def _rooms(groups: list[list[Rectangle]], kinds: list[str]) -> list[PlannedRoom]:
    from shapely.geometry import box
    from shapely.ops import unary_union

    inner = [unary_union([box(*c) for c in g]).buffer(-0.5 * PARTITION_M, join_style="mitre") for g in groups]
    rooms = []
    for index, shape in enumerate(inner):
        polygon = _ring(shape)
        walls = _walls(polygon)
        shared = tuple(_behind(wall, index, inner) for wall in walls)
        rooms.append(PlannedRoom(kinds[index], tuple(_rectangles(polygon)), polygon, walls, shared))
    return rooms


def _ring(shape: Polygon) -> Array:
    from shapely.geometry.polygon import orient

    return np.asarray(orient(shape.simplify(1e-6)).exterior.coords)[:-1].astype(np.float64)


def _walls(polygon: Array) -> tuple[Wall, ...]:
    after = np.roll(polygon, -1, axis=0)
    lengths = np.linalg.norm(after - polygon, axis=1)
    ways = (after - polygon) / lengths[:, None]
    return tuple(Wall(p, d, np.array([-d[1], d[0]]), float(n)) for p, d, n in zip(polygon, ways, lengths, strict=True))


def _rectangles(polygon: Array) -> list[Rectangle]:
    """A rectilinear polygon cut along its corners into rectangles that do not overlap."""
    from shapely.geometry import Point, Polygon

    shape = Polygon(polygon)
    xs = sorted({round(float(x), 9) for x in polygon[:, 0]})
    ys = sorted({round(float(y), 9) for y in polygon[:, 1]})
    rectangles = []
    for x0, x1 in pairwise(xs):
        for y0, y1 in pairwise(ys):
            if shape.contains(Point(0.5 * (x0 + x1), 0.5 * (y0 + y1))):
                rectangles.append((x0, y0, x1, y1))
    return rectangles


def _behind(wall: Wall, own: int, inner: list[Polygon]) -> tuple[tuple[float, float, int], ...]:
    """Along a wall, where which other room lies behind it."""
    from shapely.geometry import LineString

    back = -1.5 * PARTITION_M * wall.inward
    line = LineString([wall.start + back, wall.start + wall.length * wall.along + back])
    spans = []
    for index, shape in enumerate(inner):
        met = line.intersection(shape) if index != own else None
        if met is not None and met.length > 1e-6:
            ends = [float((np.asarray(p) - wall.start - back) @ wall.along) for p in met.coords]
            spans.append((max(0.0, min(ends)), min(wall.length, max(ends)), index))
    return tuple(sorted(spans))


def _doorways(rooms: list[PlannedRoom], rng: np.random.Generator) -> list[Opening]:
    """Openings between rooms until each can be reached, each of them once from either side."""
    ways = [
        (i, w, span) for i, room in enumerate(rooms) for w in range(len(room.walls)) for span in room.shared[w]
        if span[2] > i and span[1] - span[0] > DOOR_M[0] + 0.5
    ]  # fmt: skip
    reached, openings = {0}, []
    order = [ways[int(k)] for k in rng.permutation(len(ways))]
    while len(reached) < len(rooms):
        nearest = [way for way in order if (way[0] in reached) != (way[2][2] in reached)]
        if not nearest:
            break
        room, wall, (low, high, other) = nearest[0]
        reached |= {room, other}
        kind = "door" if rng.random() < 0.55 else "passage"
        width, tall = DOOR_M
        if kind == "passage":
            width = min(float(rng.uniform(*PASSAGE_M[0])), high - low - 0.4)
            tall = float(rng.uniform(*PASSAGE_M[1]))
        at = float(rng.uniform(low + 0.5 * width + 0.12, high - 0.5 * width - 0.12))
        openings.append(Opening(kind, room, wall, at, width, 0.0, tall, other))
        openings.append(_other_side(rooms, openings[-1]))
    return openings


def _other_side(rooms: list[PlannedRoom], opening: Opening) -> Opening:
    """The same hole in the wall of the room behind."""
    wall = rooms[opening.room].walls[opening.wall]
    point = wall.start + opening.at * wall.along - PARTITION_M * wall.inward
    for index, behind in enumerate(rooms[opening.to].walls):
        if behind.inward @ wall.inward < -0.99 and abs((point - behind.start) @ behind.inward) < 1e-6:
            at = float((point - behind.start) @ behind.along)
            if 0 < at < behind.length:
                return dataclasses.replace(opening, kind="passage", room=opening.to, wall=index, at=at, to=opening.room)
    raise ValueError(f"opening: nothing lies behind wall {opening.wall} of room {opening.room}")


def _free_spans(room: PlannedRoom, wall: int, openings: list[Opening], index: int, margin: float) -> list[tuple[float, float]]:
    """Parts of a wall with neither an opening nor a room behind it [m]."""
    taken = [(low, high) for low, high, _ in room.shared[wall]]
    taken += [(o.span[0] - margin, o.span[1] + margin) for o in openings if o.room == index and o.wall == wall]
    spans, at = [], 0.12
    for low, high in sorted(taken):
        if low - at > 0.3:
            spans.append((at, low))
        at = max(at, high)
    if room.walls[wall].length - 0.12 - at > 0.3:
        spans.append((at, room.walls[wall].length - 0.12))
    return spans


def _entrance(rooms: list[PlannedRoom], openings: list[Opening], rng: np.random.Generator) -> list[Opening]:
    """The door of the dwelling, in an outer wall."""
    width, tall = DOOR_M
    for index in [int(k) for k in rng.permutation(len(rooms))]:
        for wall in [int(k) for k in rng.permutation(len(rooms[index].walls))]:
            for low, high in _free_spans(rooms[index], wall, openings, index, 0.2):
                if high - low > width + 0.1:
                    at = low + 0.5 * width + 0.05 if rng.random() < 0.5 else high - 0.5 * width - 0.05
                    return [Opening("door", index, wall, at, width, 0.0, tall)]
    return []


def _windows(rooms: list[PlannedRoom], openings: list[Opening], rng: np.random.Generator) -> list[Opening]:
    """One or two windows for each room that has an outer wall, some of them down to the floor's height."""
    windows: list[Opening] = []
    taken = {(o.room, o.wall) for o in openings}
    outer = [
        (i, w)
        for i, room in enumerate(rooms)
        for w in range(len(room.walls))
        if not room.shared[w] and (i, w) not in taken and room.kind != "kitchen" and room.walls[w].length > 2.0
    ]
    plain = outer[int(rng.integers(len(outer)))] if outer else None
    for index, room in enumerate(rooms):
        wanted = 1 + int(rng.random() < 0.4)
        for wall in [int(k) for k in rng.permutation(len(room.walls))]:
            spans = _free_spans(room, wall, [*openings, *windows], index, 0.25)
            if plain is not None and plain[0] == index:
                spans = [_clear_of(plain[1], wall, len(room.walls), room.walls[wall].length, span) for span in spans]
            spans = [span for span in spans if span[1] - span[0] > 1.2]
            if not spans or wanted == 0 or (index, wall) == plain:
                continue
            low, high = spans[int(rng.integers(len(spans)))]
            width = min(float(rng.uniform(0.9, 1.7)), high - low - 0.2)
            at = float(rng.uniform(low + 0.5 * width, high - 0.5 * width))
            sill = float(rng.choice([0.12, 0.98, 1.02, 1.1]))
            windows.append(Opening("window", index, wall, at, width, sill, float(rng.uniform(2.05, 2.2))))
            wanted -= 1
    return windows


def _clear_of(plain: int, wall: int, count: int, length: float, span: tuple[float, float]) -> tuple[float, float]:
    """A part of a wall without its end beside the wall that has no window: a slope may begin there."""
    low, high = span
    if (wall + 1) % count == plain:
        high = min(high, length - SLOPE_M)
    if (wall - 1) % count == plain:
        low = max(low, SLOPE_M)
    return low, high
