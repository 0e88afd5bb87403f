"""A room's shell: floor, walls and, if wanted, ceiling as closed slabs in the world frame, with the openings of doors and windows."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.capture import Shell
from schemas.errors import InputError
from tasks.settings import LISTED, Config, Whole

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class ShellConfig(Config):
    """How a room's floor, walls and ceiling become slabs."""

    thickness_m: float = 0.1  # a partition wall; thick enough that nothing at walking pace passes it in one time step
    panel_m: float = 0.02  # what closes a door's or window's niche behind it; fixed, and nothing reaches it at speed
    floor_color: Annotated[tuple[Whole, Whole, Whole], LISTED] = (196, 186, 172)  # light wood, where the scan shows no floor
    wall_color: Annotated[tuple[Whole, Whole, Whole], LISTED] = (228, 226, 220)  # off-white paint, where the scan shows no wall
    ceiling: bool = False  # it would hide the room from who looks in from above, as viewers do
    miter_limit: float = 3.0  # sharper corners than about 40 degrees are cut instead of drawn out into spikes


def room_shell(room: Shell, config: ShellConfig | None = None) -> list[tuple[str, trimesh.Trimesh]]:
    """Floor and walls of a room as closed slabs in the world frame [m]: `floor`, `wall_00`, ..., `inner_00`, ..., and `ceiling`
    where it is wanted, a slab on the outer walls, colored as they are.

    The floor's top is z = 0. Floor and outer walls lie outside the floor polygon. Every outer wall is a convex prism on
    one edge of the polygon; they meet in miters and stand on the floor slab. Interior walls are boxes that stand on the
    floor inside the room, half-height ones as low as they are; lintels over the doorways between them are pieces of the wall that goes
    on there. A wall with doors or windows
    is cut into convex pieces, `wall_00`, `wall_00_1`, ..., of which the last are the wedges that slanted walls leave below the ceiling:
    openings of outer walls are niches as deep as what fills them, closed by a thin panel; those without a filling and those of interior
    walls go through. Nothing is left of a wall that is one opening from the floor to the ceiling. Colors are the scan's if it shows any.

    Raises:
        InputError: the floor polygon has no area or crosses itself, or an interior wall has no size.
    """
    shell = config or ShellConfig()
    ring = floor_ring(room)
    floor_color, wall_color = room.floor_color or shell.floor_color, room.wall_color or shell.wall_color
    named = [("floor", _prism_of_ring(_outer_ring(ring, shell), -shell.thickness_m, 0.0, floor_color))]
    for index, (corners, start, end) in enumerate(zip(_wall_footprints(ring, shell), ring, np.roll(ring, -1, axis=0), strict=True)):
        pieces = _cut(corners, start, end, room.height_m, room.openings or (), ring, shell)
        prisms = _named(f"wall_{index:02d}", pieces, wall_color)
        wedges = [_colored(mesh, wall_color) for mesh in _wedges(start, end, room)]
        named += [*prisms, *((f"wall_{index:02d}_{len(prisms) + i}", mesh) for i, mesh in enumerate(wedges))]
    lintels = _lintels(room)
    for index, (wall, corners) in enumerate(zip(room.interior_walls, interior_footprints(room), strict=True)):
        pieces = _cut(corners, np.array(wall[:2]), np.array(wall[2:4]), wall[5], room.openings or (), ring, None)
        over = [piece for owner, piece in lintels if owner == index]
        named += _named(f"inner_{index:02d}", [*pieces, *over], wall_color)
    if shell.ceiling:
        named.append(("ceiling", _prism_of_ring(_outer_ring(ring, shell), room.height_m, room.height_m + shell.thickness_m, wall_color)))
    return named


def wall_of(part: str) -> str:
    """The wall that a part of the shell belongs to: `wall_00` for `wall_00_1`."""
    return "_".join(part.split("_")[:2])


_Piece = tuple[NDArray[np.float64], float, float]
"""A convex footprint seen from above [m], shape (n, 2), counter-clockwise, with the heights of its bottom and top [m]."""

_Span = tuple[float, float, float, float, float]
"""An opening of a wall: from where to where along it, heights of bottom and top, how deep what fills it is [m]."""


def _named(name: str, pieces: list[_Piece], color: tuple[int, ...]) -> list[tuple[str, trimesh.Trimesh]]:
    return [(f"{name}_{i}" if i else name, _prism_of_ring(*piece, color)) for i, piece in enumerate(pieces)]


def _cut(
    corners: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64], height: float,
    openings: Sequence[Sequence[float]], room: NDArray[np.float64], shell: ShellConfig | None,
) -> list[_Piece]:  # fmt: skip
    """A wall without the openings on its line from start to end [m]. shell: of outer walls, whose openings are closed behind where
    the room, shape (n, 2), is not on the other side, too."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    spans = _spans(start, end, height, openings)
    if not spans:
        return [(corners, 0.0, height)]
    if shell is not None and _is_open(spans, length, height):
        return []  # its miters would stay as posts
    # an opening that reaches a corner leaves the wall's miter there
    cuts = sorted({0.0 if cut <= _LEAST_M else min(cut, length) for span in spans for cut in span[:2]})
    pieces: list[_Piece] = []
    for left, right in pairwise([-np.inf, *cuts, np.inf]):
        footprint = _between(corners, start, along, left, right)
        middle = np.clip(left, 0.0, length) / 2 + np.clip(right, 0.0, length) / 2
        top = 0.0
        for _, _, low, high, _ in [*sorted((s for s in spans if s[0] < middle < s[1]), key=lambda s: s[2]), (0, 0, height, height, 0)]:
            if low - top > _LEAST_M and _area(footprint) > _LEAST_M**2:
                pieces.append((footprint, top, low))
            top = max(top, high)
    if shell is not None:
        pieces += [panel for span in spans for panel in _panel(start, along, span, height, room, shell)]
    return pieces


def _wedges(start: NDArray[np.float64], end: NDArray[np.float64], room: Shell) -> list[trimesh.Trimesh]:
    """What lies between an outer wall, from start to end on its inner face [m], the ceiling, and the slanted walls before it: closed
    convex solids."""
    import trimesh

    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    inward, wedges = np.array([-along[1], along[0]]), []
    for slope in room.slopes or ():
        ends, (knee, reach) = np.asarray(slope[:4], dtype=np.float64).reshape(2, 2) - start, slope[4:6]
        low, high = sorted(float(point @ along) for point in ends)
        low, high = max(low, 0.0), min(high, length)
        if np.abs(ends @ inward).max() > _ON_LINE_M or min(high - low, room.height_m - knee, reach) < _LEAST_M:
            continue
        corners = [
            [*(start + s * along + d * inward), z]
            for s in (low, high)
            for d, z in ((0.0, knee), (reach, room.height_m), (0.0, room.height_m))
        ]
        faces = [[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]]
        wedges.append(trimesh.Trimesh(corners, faces, process=False))
    return wedges


def is_open_side(room: Shell, start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
    """True if a side of the floor, with ends of shape (2,) [m], is one opening from the floor to the ceiling: no wall stands there."""
    return _is_open(_spans(start, end, room.height_m, room.openings or ()), float(np.linalg.norm(end - start)), room.height_m)


def _is_open(spans: Sequence[_Span], length: float, height: float) -> bool:
    """True if one of the openings of a wall is all of it, and nothing fills it."""
    return any(s[0] <= _LEAST_M and s[1] >= length - _LEAST_M and s[2] <= _LEAST_M and s[3:] == (height, 0.0) for s in spans)


def _spans(start: NDArray[np.float64], end: NDArray[np.float64], height: float, openings: Sequence[Sequence[float]]) -> list[_Span]:
    """The openings on a wall's line from start to end [m]."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    spans: list[_Span] = []
    for opening in openings:
        ends = np.asarray(opening, dtype=np.float64)[:4].reshape(2, 2) - start
        low, high = sorted(float(point @ along) for point in ends)
        off = np.abs(ends @ [-along[1], along[0]]).max()
        if off < _ON_LINE_M and low > -_ON_LINE_M and high < length + _ON_LINE_M and high - low > _LEAST_M:
            span = (max(low, 0.0), min(high, length), max(float(opening[4]), 0.0), min(float(opening[5]), height), float(opening[6]))
            spans += [span] if span[3] - span[2] > _LEAST_M else []
    return spans


_ON_LINE_M = 0.002
"""Openings this near to a wall's line are in it."""

_LEAST_M = 0.001
"""No piece of a wall is narrower or lower."""


def _between(
    corners: NDArray[np.float64], start: NDArray[np.float64], along: NDArray[np.float64], left: float, right: float
) -> NDArray[np.float64]:
    """The part of a convex ring between two distances along a line; empty where there is none."""
    ring = corners
    for bound, sign in ((left, 1.0), (right, -1.0)):
        if not np.isfinite(bound) or not len(ring):
            continue
        inside = sign * ((ring - start) @ along - bound)
        kept: list[NDArray[np.float64]] = []
        for i in range(len(ring)):
            j = (i + 1) % len(ring)
            if inside[i] >= 0.0:
                kept.append(ring[i])
            if inside[i] * inside[j] < 0.0:
                kept.append(ring[i] + (ring[j] - ring[i]) * inside[i] / (inside[i] - inside[j]))
        ring = np.array(kept).reshape(-1, 2)
    return ring


def _area(ring: NDArray[np.float64]) -> float:
    """Area of a counter-clockwise ring [m2], 0 for no ring."""
    x, y = ring.reshape(-1, 2).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _panel(
    start: NDArray[np.float64], along: NDArray[np.float64], span: tuple[float, ...], height: float,
    room: NDArray[np.float64], shell: ShellConfig,
) -> list[_Piece]:  # fmt: skip
    """What closes an opening: a panel in the wall, or, where what fills the opening reaches farther, a panel and a frame behind the wall.

    Nothing where nothing fills the opening (depth 0), or the room is on the other side, too: there the opening goes through.
    """
    from shapely.geometry import Polygon

    low, high, bottom, top, depth = span
    if depth == 0.0:
        return []
    panel, thickness, free = shell.panel_m, shell.thickness_m, Polygon(room)
    front = max(depth, thickness - panel)
    back, out = front + panel, np.array([along[1], -along[0]])

    def block(left: float, right: float, near: float, far: float, under: float, over: float) -> list[_Piece]:
        """A block between distances along the wall, behind its face and over the floor; none without size or inside the room."""
        if min(right - left, far - near, over - under) < _LEAST_M:
            return []
        ring = np.array([start + s * along + d * out for s, d in ((right, near), (left, near), (left, far), (right, far))])
        return [(ring, under, over)] if Polygon(ring).intersection(free).area < 1e-9 else []

    if back <= thickness:
        return block(low, high, front, back, bottom, top)
    if not block(low, high, front, back, bottom, top):
        return []
    under, over = max(bottom - panel, 0.0), min(top + panel, height)
    left, right = block(low - panel, low, thickness, back, under, over), block(high, high + panel, thickness, back, under, over)
    over_and_under = block(low, high, thickness, back, bottom - panel, bottom) + block(low, high, thickness, back, top, over)
    return [*block(low, high, front, back, bottom, top), *left, *right, *over_and_under]


def interior_footprints(room: Shell) -> list[NDArray[np.float64]]:
    """Corners of every interior wall seen from above [m], shape (4, 2) each, counter-clockwise.

    Raises:
        InputError: an interior wall has no length, thickness or height.
    """
    footprints = []
    for number, wall in enumerate(room.interior_walls):
        values = np.asarray(wall, dtype=np.float64)
        along = values[2:4] - values[:2] if len(values) == 6 else np.zeros(2)
        length = float(np.linalg.norm(along))
        if length < 1e-3 or values[4] < 1e-3 or values[5] < 1e-3:
            raise InputError("shells", f"{room.scene_id} interior_walls {number}", "has no size", "capture the scan again")
        footprints.append(_band(values[:2], values[2:4], values[4]))
    return footprints


def _lintels(room: Shell) -> list[tuple[int, _Piece]]:
    """Lintels, each with the number of the interior wall that it goes on from; none without size, or where there is no such wall."""
    made = []
    for x0, y0, x1, y1, thickness, bottom, top in room.lintels or () if room.interior_walls else ():
        start, end = np.array([x0, y0]), np.array([x1, y1])
        length = float(np.linalg.norm(end - start))
        if min(length, thickness, top - bottom) < _LEAST_M:
            continue
        away = [min(float(np.hypot(wall[i] - x0, wall[i + 1] - y0)) for i in (0, 2)) for wall in room.interior_walls]
        made.append((int(np.argmin(away)), (_band(start, end, thickness), max(bottom, 0.0), top)))
    return made


def lintel_footprints(room: Shell, below_m: float) -> list[NDArray[np.float64]]:
    """Corners of every lintel that ends below a height [m], seen from above [m], shape (4, 2) each, counter-clockwise."""
    return [footprint for _, (footprint, bottom, _) in _lintels(room) if bottom < below_m]


def _band(start: NDArray[np.float64], end: NDArray[np.float64], thickness: float) -> NDArray[np.float64]:
    """Corners of a box along a center line, seen from above [m], shape (4, 2), counter-clockwise."""
    along = (end - start) / np.linalg.norm(end - start)
    side = np.array([-along[1], along[0]]) * thickness / 2
    return np.array([start - side, end - side, end + side, start + side])


def floor_ring(room: Shell) -> NDArray[np.float64]:
    """Corners of the room's floor [m], shape (n, 2), counter-clockwise, without repeated and straight corners.

    Raises:
        InputError: the floor polygon has no area or crosses itself.
    """
    from shapely.geometry import Polygon

    points = np.asarray(room.floor_polygon, dtype=np.float64).reshape(-1, 2) if room.floor_polygon else np.zeros((0, 2))
    if len(points) >= 3:
        polygon = Polygon(points)
        if polygon.is_valid and polygon.area > 1e-4:
            simple = polygon.simplify(1e-4, preserve_topology=True)
            ring = np.asarray(simple.exterior.coords)[:-1]
            area = np.sum(ring[:, 0] * np.roll(ring[:, 1], -1) - ring[:, 1] * np.roll(ring[:, 0], -1))
            return ring if area > 0 else ring[::-1].copy()
    raise InputError("shells", f"{room.scene_id} floor_polygon", "has no area or crosses itself", "capture the scan again")


def prism(corners: ArrayLike, low: float, high: float) -> trimesh.Trimesh:
    """Closed prism over a convex counter-clockwise ring, shape (n, 2), from height `low` to `high` [m]."""
    import trimesh

    ring = np.asarray(corners, dtype=np.float64)
    n = len(ring)
    vertices = np.concatenate([np.column_stack([ring, np.full(n, low)]), np.column_stack([ring, np.full(n, high)])])
    fan = np.column_stack([np.zeros(n - 2, dtype=np.int64), np.arange(1, n - 1), np.arange(2, n)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    sides = np.concatenate([np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n])])
    return trimesh.Trimesh(vertices, np.concatenate([fan[:, ::-1], fan + n, sides]), process=False)


def _prism_of_ring(ring: NDArray[np.float64], low: float, high: float, color: tuple[int, ...]) -> trimesh.Trimesh:
    """Closed, colored, flat-shaded prism over any simple counter-clockwise ring."""
    import trimesh
    from shapely.geometry import Polygon

    if len(ring) <= 4 and Polygon(ring).convex_hull.area - Polygon(ring).area < 1e-9:
        mesh = prism(ring, low, high)
    else:
        mesh = trimesh.creation.extrude_polygon(Polygon(ring), high - low)
        mesh.apply_translation([0, 0, low])
    return _colored(mesh, color)


def _colored(mesh: trimesh.Trimesh, color: tuple[int, ...]) -> trimesh.Trimesh:
    """A mesh in one color."""
    import trimesh

    colors = np.tile(np.array([*color, 255], dtype=np.uint8), (len(mesh.vertices), 1))
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors)
    return mesh


def _outer_ring(ring: NDArray[np.float64], shell: ShellConfig) -> NDArray[np.float64]:
    """The ring grown by the wall thickness, so that walls stand on the floor slab."""
    from shapely.geometry import Polygon
    from shapely.geometry.polygon import orient

    grown = Polygon(ring).buffer(shell.thickness_m, join_style="mitre", mitre_limit=shell.miter_limit)
    return np.asarray(orient(Polygon(grown.exterior)).exterior.coords)[:-1]


def _wall_footprints(ring: NDArray[np.float64], shell: ShellConfig) -> list[NDArray[np.float64]]:
    """Convex footprint of every wall, counter-clockwise, shape (4, 2) each, outside the ring."""
    from shapely.geometry import Polygon

    room = Polygon(ring)
    footprints = []
    for index in range(len(ring)):
        a, b = ring[index], ring[(index + 1) % len(ring)]
        before, after = ring[index - 1], ring[(index + 2) % len(ring)]
        thickness = shell.thickness_m
        corners = np.array([b, a, _miter(before, a, b, thickness, shell), _miter(a, b, after, thickness, shell)])
        # between two inward corners a short wall's miters may cross, and near a narrow notch a wall may reach back
        # into the room: there the wall is a plain rectangle, as thick as there is place for
        while thickness > 1e-4 and not _fits(corners, room):
            along = (b - a) / np.linalg.norm(b - a)
            out = np.array([along[1], -along[0]]) * thickness
            corners = np.array([b, a, a + out, b + out])
            thickness *= 0.5
        footprints.append(corners)
    return footprints


def _fits(corners: NDArray[np.float64], room: object) -> bool:
    """Whether four corners are a simple convex counter-clockwise ring outside the room."""
    from shapely.geometry import Polygon

    edges = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    return bool((turns > 0).all()) and Polygon(corners).intersection(room).area < 1e-9


def _miter(
    before: NDArray[np.float64], at: NDArray[np.float64], after: NDArray[np.float64], thickness: float, shell: ShellConfig
) -> NDArray[np.float64]:
    """Outer corner [m], shape (2,), where the outsides of the walls before and after a corner of the room meet."""
    first, second = at - before, after - at
    normals = [np.array([d[1], -d[0]]) / np.linalg.norm(d) for d in (first, second)]
    middle = normals[0] + normals[1]
    length = float(np.linalg.norm(middle))
    if length < 1e-9:
        return at + normals[0] * thickness
    reach = min(2.0 / length, shell.miter_limit)
    return np.asarray(at + middle / length * reach * thickness)
