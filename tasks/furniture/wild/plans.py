"""Plans of wild rooms: a room with corners cut off, a door, a window, and openings without a door into a hall.

World frame: +Z up, metres, floor at z = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.dwellings.plans import DOOR_M, OUTER_M, FloorPlan, Opening, PlannedRoom
from tasks.furniture.furnishing import Wall
from tasks.furniture.solids import box
from tasks.geometry.transforms import yaw_pose

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

CUT_M = (0.45, 0.85)
"""So much of either wall a corner that is cut off takes."""

WAY_M = ((1.0, 1.2), (1.95, 2.05))
"""Widths and heights of openings without a door."""

HALL_M = 1.1
"""Depth of the hall behind an opening."""


def wild_plan(rng: np.random.Generator) -> FloorPlan:
    """A room of 33 to 41 m2. Its walls from the first: before it a shelf, then alternately openings and windows."""
    x, y = float(rng.uniform(5.5, 6.1)), float(rng.uniform(6.0, 6.8))
    corners = np.array([[0.0, 0.0], [x, 0.0], [x, y], [0.0, y]])
    cut_corners = {int(k) for k in rng.permutation(4)[: int(rng.integers(1, 4))]}
    polygon: list[Array] = []
    for k, corner in enumerate(corners):
        if k not in cut_corners:
            polygon.append(corner)
            continue
        size = rng.uniform(*CUT_M, 2)
        before, after = corners[k - 1] - corner, corners[(k + 1) % 4] - corner
        polygon += [corner + size[0] * before / np.linalg.norm(before), corner + size[1] * after / np.linalg.norm(after)]
    outline = np.array(polygon)
    walls = _walls(outline)
    # Slanted walls are short: openings and furniture keep to the others.
    long = [k for k, wall in enumerate(walls) if np.abs(wall.along).max() > 1.0 - 1e-9]
    order = [long[int(k)] for k in rng.permutation(len(long))]
    shelved = max(order, key=lambda k: walls[k].length)
    order.remove(shelved)
    openings = [_opening("passage", walls[order[0]], order[0], rng), _opening("window", walls[order[1]], order[1], rng)]
    openings.append(_opening("door" if rng.random() < 0.5 else "passage", walls[order[2]], order[2], rng))
    room = PlannedRoom("living room", ((0.0, 0.0, x, y),), outline, walls, tuple(() for _ in walls))
    return FloorPlan((room,), float(rng.uniform(2.45, 2.75)), tuple(openings))


def shelved_wall(plan: FloorPlan) -> int:
    """Number of the longest wall without an opening."""
    taken = {opening.wall for opening in plan.openings}
    walls = plan.rooms[0].walls
    return max((k for k in range(len(walls)) if k not in taken), key=lambda k: walls[k].length)


def _walls(polygon: Array) -> tuple[Wall, ...]:
    after = np.roll(polygon, -1, axis=0)
    lengths = np.linalg.norm(after - polygon, axis=1)
    ways = (after - polygon) / lengths[:, None]
    return tuple(Wall(p, d, np.array([-d[1], d[0]]), float(n)) for p, d, n in zip(polygon, ways, lengths, strict=True))


def _opening(kind: str, wall: Wall, number: int, rng: np.random.Generator) -> Opening:
    """An opening somewhere along a wall, an arm's length from its ends."""
    width, low, high = DOOR_M[0], 0.0, DOOR_M[1]
    if kind == "passage":
        width, high = float(rng.uniform(*WAY_M[0])), float(rng.uniform(*WAY_M[1]))
    elif kind == "window":
        width, low, high = float(rng.uniform(1.2, 1.8)), float(rng.uniform(0.8, 1.0)), float(rng.uniform(2.05, 2.2))
    at = float(rng.uniform(0.5 * width + 0.25, wall.length - 0.5 * width - 0.25))
    return Opening(kind, 0, number, at, width, low, high)


def halls(plan: FloorPlan) -> list[tuple[str, trimesh.Trimesh]]:
    """Floor and far wall of the hall behind each opening without a door, as (node name, mesh) in the world frame."""
    import trimesh

    nodes = []
    ways = [opening for opening in plan.openings if opening.kind == "passage"]
    for number, opening in enumerate(ways):
        wall = plan.rooms[0].walls[opening.wall]
        point = wall.start + opening.at * wall.along
        frame = yaw_pose(wall.yaw, [point[0], point[1], 0.0])
        half = 0.5 * opening.width + 0.5
        slabs = {
            "floor": box((-OUTER_M - HALL_M, -OUTER_M), (-half, half), (-0.1, 0.0)),
            "wall": box((-OUTER_M - HALL_M - 0.1, -OUTER_M - HALL_M), (-half, half), (0.0, plan.height)),
        }
        for category, solid in slabs.items():
            moved = solid.moved(frame)
            mesh = trimesh.Trimesh(moved.vertices, moved.faces, process=False)
            tone = (188, 180, 168, 255) if category == "floor" else (222, 220, 212, 255)
            mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.tile(np.array(tone, dtype=np.uint8), (len(mesh.vertices), 1)))
            nodes.append((f"hall_{category}_{number:02d}|{category}|{category}", mesh))
    return nodes
