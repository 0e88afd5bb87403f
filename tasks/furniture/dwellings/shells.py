"""Shells of dwellings: floors, walls with their openings, ceilings, half-height and slanted walls, as closed solids."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.dwellings.plans import OUTER_M, PARTITION_M, FloorPlan, Opening, PlannedRoom
from tasks.furniture.furnishing import Wall
from tasks.furniture.palette import PAINTS, WOODS, Color, pick, shade
from tasks.furniture.solids import Solid, box, hull
from tasks.geometry.transforms import yaw_pose

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Zone = tuple[Array, tuple[float, float, float]]
"""A box that stays empty: pose of its center, 4x4, and its sides [m]."""

TILES: tuple[Color, ...] = ((176, 172, 166), (140, 130, 120), (206, 200, 190), (110, 112, 116))
"""Floors of kitchens."""

HALF_WALL_M = (0.9, 1.25)
"""Heights of walls that one looks over."""

KNEE_M = (1.0, 1.4)
"""Heights at which a slanted wall begins."""

SLANT_STEPS = 8
"""A slanted wall keeps objects off by so many boxes below it."""


@dataclasses.dataclass(frozen=True)
class RoomFeature:
    """What makes a room's walls other than upright and full: `half wall` or `slanted wall`, at which wall of the room, its
    corners in the world [m], shape (n, 3), as a convex solid, and the boxes that stay empty because of it."""

    kind: str
    wall: int
    solid: Solid
    zones: tuple[Zone, ...]


def half_wall(room: PlannedRoom, wall: int, at: float, rng: np.random.Generator) -> RoomFeature:
    """A wall of a part of a room's height, from `at` along a wall [m] into the room."""
    face = room.walls[wall]
    reach, tall = float(rng.uniform(0.9, 1.5)), float(rng.uniform(*HALF_WALL_M))
    solid = box((-0.03, reach), (-0.5 * PARTITION_M, 0.5 * PARTITION_M), (0.0, tall)).moved(_frame(face, at))
    zone = _frame(face, at) @ yaw_pose(0.0, [0.5 * reach, 0.0, 0.5 * tall])
    return RoomFeature("half wall", wall, solid, ((zone, (reach + 0.02, PARTITION_M + 0.02, tall)),))


def slanted_wall(room: PlannedRoom, wall: int, height: float, rng: np.random.Generator) -> RoomFeature:
    """The slope of a roof over the whole length of a wall: from a knee's height at the wall up to the ceiling."""
    face = room.walls[wall]
    knee, run = float(rng.uniform(*KNEE_M)), float(rng.uniform(0.9, 1.4))
    frame = _frame(face, 0.5 * face.length)
    half = 0.5 * face.length
    points = [(x, y, z) for y in (-half, half) for x, z in ((-0.02, knee), (run, height), (-0.02, height))]
    solid = hull(np.array(points))
    zones = []
    for k in range(SLANT_STEPS):
        low = knee + (height - knee) * k / SLANT_STEPS
        reach = run * (k + 1) / SLANT_STEPS
        middle = yaw_pose(0.0, [0.5 * reach, 0.0, 0.5 * (low + height)])
        zones.append((frame @ middle, (reach, face.length, height - low)))
    return RoomFeature("slanted wall", wall, Solid(solid.vertices, solid.faces, (solid,)).moved(frame), tuple(zones))


def _frame(wall: Wall, at: float) -> Array:
    """x into the room, y along the wall's face, origin at `at` along it [m], on the floor."""
    point = wall.start + at * wall.along
    return yaw_pose(wall.yaw, [point[0], point[1], 0.0])


def shell(plan: FloorPlan, features: list[tuple[int, RoomFeature]], rng: np.random.Generator) -> list[tuple[str, trimesh.Trimesh]]:
    """Floors, walls and ceilings of a plan as (node name, mesh) in the world frame, names as `model|category|part`."""
    nodes = []
    wood, paint = pick(WOODS[2:5], rng), pick((*PAINTS[:2], (206, 214, 208), (226, 214, 198)), rng)
    for index, room in enumerate(plan.rooms):
        tone = wood if room.kind != "kitchen" else pick(TILES, rng)
        nodes.append((f"floor_{index:03d}|floor|floor", _mesh(_boards(plan, index, tone, rng))))
        wall_paint = shade(paint, float(rng.uniform(0.9, 1.04)))
        for number, wall in enumerate(room.walls):
            solids = [(wall_paint, solid) for solid in _wall(plan, index, number)]
            name = f"wall_{index:03d}_{number:02d}"
            extra = [(wall_paint, f.solid) for at, f in features if at == index and f.wall == number and f.kind == "slanted wall"]
            nodes.append((f"{name}|wall|wall", _mesh([*solids, *extra, *_skirting(plan, index, number, wall)])))
        for number, (at, feature) in enumerate(features):
            if at == index and feature.kind == "half wall":
                nodes.append((f"half_wall_{index:03d}_{number:02d}|wall|wall", _mesh([(wall_paint, feature.solid)])))
        white = (236, 234, 228)
        plates = [(white, box((x0 - 0.06, x1 + 0.06), (y0 - 0.06, y1 + 0.06), (plan.height, plan.height + 0.1)))
                  for x0, y0, x1, y1 in room.rectangles]  # fmt: skip
        nodes.append((f"ceiling_{index:03d}|ceiling|ceiling", _mesh(plates)))
    return nodes


def _wall(plan: FloorPlan, index: int, number: int) -> list[Solid]:
    """A wall's solids: half a partition where a room lies behind it, else an outer wall, with its openings left out."""
    room = plan.rooms[index]
    wall, shared = room.walls[number], room.shared[number]
    openings = plan.openings_of(index, number)
    before, after = room.walls[number - 1], room.walls[(number + 1) % len(room.walls)]
    # past an outward corner the wall goes on, so that no gap is left; past an inward corner lies the room
    first = 0.0 if _turns_inward(before, wall) else -0.5 * PARTITION_M
    last = wall.length + (0.0 if _turns_inward(wall, after) else 0.5 * PARTITION_M)
    cuts = {first, last, *(v for low, high, _ in shared for v in (low, high)), *(v for o in openings for v in o.span)}
    edges = sorted(v for v in cuts if first <= v <= last)
    solids = []
    for low, high in pairwise(edges):
        if high - low < 1e-6:
            continue
        middle = 0.5 * (low + high)
        # the end of a partition between two rooms behind it is as thin as beside it
        thick = 0.5 * PARTITION_M if any(a - PARTITION_M <= middle <= b + PARTITION_M for a, b, _ in shared) else OUTER_M
        holes = [o for o in openings if o.span[0] <= middle <= o.span[1]]
        levels = [(0.0, plan.height)] if not holes else [(0.0, holes[0].low), (holes[0].high, plan.height)]
        for bottom, top in levels:
            if top - bottom > 1e-3:
                solids.append(_slab(wall, low, high, thick, bottom, top))
        for o in holes:
            if o.low == 0.0:
                solids.append(_slab(wall, low, high, thick, -0.1, 0.0))
    return solids


def _turns_inward(wall: Wall, following: Wall) -> bool:
    return bool(wall.along[0] * following.along[1] - wall.along[1] * following.along[0] < 0)


def _slab(wall: Wall, low: float, high: float, thick: float, bottom: float, top: float) -> Solid:
    """A part of a wall, behind its face. With x into the room and z up, y runs against the wall's `along`."""
    return box((-thick, 0.0), (-high, -low), (bottom, top)).moved(_frame(wall, 0.0))


def _skirting(plan: FloorPlan, index: int, number: int, wall: Wall) -> list[tuple[Color, Solid]]:
    """Baseboards beside the doors."""
    at, solids = 0.0, []
    for o in sorted((o for o in plan.openings_of(index, number) if o.low == 0.0), key=lambda o: o.at):
        if o.span[0] - at > 0.02:
            solids.append(_board(wall, at, o.span[0]))
        at = o.span[1]
    if wall.length - at > 0.02:
        solids.append(_board(wall, at, wall.length))
    return [((236, 234, 228), solid) for solid in solids]


def _board(wall: Wall, low: float, high: float) -> Solid:
    return box((-0.01, 0.01), (-high, -low), (0.0, 0.07)).moved(_frame(wall, 0.0))


def _boards(plan: FloorPlan, index: int, tone: Color, rng: np.random.Generator) -> list[tuple[Color, Solid]]:
    """Boards of a room's floor, top at z = 0."""
    solids: list[tuple[Color, Solid]] = []
    for x0, y0, x1, y1 in plan.rooms[index].rectangles:
        edges = np.linspace(y0, y1, max(2, round((y1 - y0) / 0.16)) + 1)
        for low, high in pairwise(edges):
            cut = float(rng.uniform(x0 + 0.15, x1 - 0.15))
            for a, b in ((x0, cut), (cut, x1)):
                solids.append((shade(tone, float(rng.uniform(0.92, 1.08))), box((a, b), (float(low), float(high)), (-0.1, 0.0))))
    return solids


def rectangle(plan: FloorPlan, opening: Opening) -> Array:
    """Corners of an opening on the inner face of its wall [m], shape (4, 3): low start, low end, high end, high start."""
    wall = plan.rooms[opening.room].walls[opening.wall]
    corners = []
    (first, last), low, high = opening.span, opening.low, opening.high
    for at, z in ((first, low), (last, low), (last, high), (first, high)):
        point = wall.start + at * wall.along
        corners.append([point[0], point[1], z])
    return np.array(corners)


def _mesh(solids: list[tuple[Color, Solid]]) -> trimesh.Trimesh:
    """One mesh of colored solids."""
    import trimesh

    offsets = np.cumsum([0] + [len(solid.vertices) for _, solid in solids])
    vertices = np.concatenate([solid.vertices for _, solid in solids])
    faces = np.concatenate([solid.faces + offset for (_, solid), offset in zip(solids, offsets[:-1], strict=True)])
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    colors = np.concatenate([np.tile(np.array([*color, 255], dtype=np.uint8), (len(s.vertices), 1)) for color, s in solids])
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors)
    return mesh
