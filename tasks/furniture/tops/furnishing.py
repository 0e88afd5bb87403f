"""Rooms whose large furniture stands along the walls and whose tops follow the rules, with models and a shell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.dwellings.plans import DOOR_M, FloorPlan, Opening, PlannedRoom
from tasks.furniture.dwellings.shells import shell
from tasks.furniture.furnishing import Furnisher, Furnishing, Wall
from tasks.furniture.rooms import FurnishedRoom
from tasks.furniture.tops.drawing import PAIRS, draw
from tasks.furniture.tops.laws import Extents
from tasks.furniture.tops.sizes import typical_size
from tasks.geometry.transforms import yaw_pose

Array = NDArray[np.float64]

LARGE_COUNTS = (3, 6)
"""Fewest and most large pieces of furniture of a room."""

SIDES_M: dict[str, tuple[float, float]] = {
    "bathroom": (3.4, 2.8),
    "bedroom": (4.4, 3.9),
    "dining room": (4.6, 4.0),
    "kitchen": (4.4, 3.8),
    "living room": (5.2, 4.4),
    "office": (4.8, 4.0),
}
"""Usual length and width of a room [m]."""

PIECES: dict[str, tuple[tuple[str, str], ...]] = {
    "bathroom": (
        ("wall", "cabinet"), ("wall", "washing machine"), ("wall", "dresser"), ("wall", "side table"), ("wall", "desk"), ("wall", "table"),
    ),
    "bedroom": (
        ("wall", "bed"), ("beside bed", "nightstand"), ("beside bed", "nightstand"), ("wall", "dresser"), ("wall", "desk"),
        ("wall", "bookshelf"), ("wall", "cabinet"), ("wall", "tv stand"), ("wall", "side table"), ("wall", "table"),
    ),
    "dining room": (
        ("middle", "table"), ("wall", "cabinet"), ("wall", "bookshelf"), ("wall", "side table"), ("wall", "cabinet"), ("wall", "desk"),
    ),
    "kitchen": (
        ("wall", "kitchen counter"), ("middle", "table"), ("wall", "cabinet"), ("wall", "washing machine"), ("wall", "side table"),
        ("wall", "bookshelf"), ("wall", "desk"),
    ),
    "living room": (
        ("wall", "sofa"), ("before sofa", "coffee table"), ("wall", "tv stand"), ("beside sofa", "side table"), ("wall", "bookshelf"),
        ("wall", "cabinet"), ("wall", "desk"), ("wall", "table"),
    ),
    "office": (
        ("wall", "desk"), ("wall", "bookshelf"), ("wall", "cabinet"), ("middle", "table"), ("wall", "desk"), ("wall", "side table"),
        ("wall", "sofa"), ("before sofa", "coffee table"),
    ),
}  # fmt: skip
"""Large pieces of a kind of room and where they stand. The first is in every room; what stands by another only where that is."""

SEATS = {"desk": 1, "table": 4}
"""How many chairs a piece has at most."""

GROWTH = 1.1
"""Factor by which a room becomes larger in which too little found a place."""


def furnished(room_type: str, rng: np.random.Generator) -> FurnishedRoom:
    """A room of a kind that has rules: three to six large pieces, seats, and what stands on tops, drawn by the rule of each.

    Raises:
        ValueError: the kind of room has no rules.
    """
    if room_type not in PIECES:
        raise ValueError(f"room type must be one of {', '.join(PIECES)}, is {room_type!r}")
    scale, count = float(rng.uniform(0.95, 1.15)), int(rng.integers(LARGE_COUNTS[0], LARGE_COUNTS[1] + 1))
    while True:
        length, width = (scale * side for side in SIDES_M[room_type])
        plan = _plan(room_type, length, width, rng)
        furnisher = Furnisher(plan.rooms[0].polygon, plan.height, rng)
        _hang_door(furnisher, plan.openings[0])
        larges = _place_larges(furnisher, room_type, count)
        if len(larges) >= LARGE_COUNTS[0]:
            break
        scale *= GROWTH
    for large in larges:
        for _ in range(min(SEATS.get(large.category, 0), int(rng.integers(1, 5)))):
            furnisher.seat_at(large, "office chair" if room_type == "office" else "chair")
    for large in larges:
        _put_top(furnisher, large, room_type)
    return FurnishedRoom(room_type, plan.rooms[0].polygon, plan.height, shell(plan, [], rng), furnisher.objects)


def _plan(room_type: str, length: float, width: float, rng: np.random.Generator) -> FloorPlan:
    """A rectangle with a door."""
    polygon = np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])
    walls = []
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        walls.append(Wall(start, along, np.array([-along[1], along[0]]), float(np.linalg.norm(end - start))))
    room = PlannedRoom(room_type, ((0.0, 0.0, length, width),), polygon, tuple(walls), ((),) * 4)
    wall = int(rng.integers(4))
    near = 0.5 * DOOR_M[0] + 0.15
    at = near if rng.random() < 0.5 else walls[wall].length - near
    return FloorPlan((room,), float(rng.uniform(2.4, 2.75)), (Opening("door", 0, wall, at, DOOR_M[0], 0.0, DOOR_M[1]),))


def _hang_door(furnisher: Furnisher, opening: Opening) -> None:
    """The door in its opening; the floor before it stays clear."""
    wall = furnisher.walls[opening.wall]
    point = wall.start + opening.at * wall.along
    furnisher.keep_clear(yaw_pose(wall.yaw, [*(point + 0.45 * wall.inward), 1.0]), (0.9, opening.width + 0.1, 2.0))
    leaf = yaw_pose(wall.yaw, [*(point - 0.08 * wall.inward), 0.006])
    furnisher.put("door", (0.05, opening.width - 0.012, opening.high - 0.012), leaf, "wall")


def _place_larges(furnisher: Furnisher, room_type: str, count: int) -> list[Furnishing]:
    """The first piece of the kind of room, and others by chance in their order until there are `count`."""
    pieces, rng = PIECES[room_type], furnisher.rng
    neighbors = 1 + np.sort(rng.permutation(len(pieces) - 1)[: count - 1])
    placed: list[Furnishing] = []
    for index in (0, *neighbors.tolist(), *(i for i in range(1, len(pieces)) if i not in neighbors)):
        if len(placed) == count:
            break
        how, word = pieces[index]
        matches = _place(furnisher, how, word, typical_size(word, rng))
        if matches is not None:
            placed.append(matches)
    return placed


def _place(furnisher: Furnisher, how: str, word: str, size: Extents) -> Furnishing | None:
    """A large piece along a wall, in the middle, or by another one; None where it finds no place."""
    if how == "wall":
        return furnisher.against_wall(word, size)
    if how == "middle":
        return furnisher.centered(word, size)
    side, _, of = how.partition(" ")
    for anchor in furnisher.all_of(of):
        matches = furnisher.beside(anchor, word, size=size) if side == "beside" else furnisher.before(anchor, word, 0.35)
        if matches is not None:
            return matches
    return None


def _put_top(furnisher: Furnisher, large: Furnishing, room_type: str) -> None:
    """What stands on a large piece, each object with a model of its own."""
    if (large.category, room_type) not in PAIRS:
        return
    top = draw(large.category, large.extents, room_type, furnisher.rng)
    names: list[str] = []
    for index, word in enumerate(top.words):
        x, y, z = map(float, top.sizes[index])
        bottom = top.centers[index] - [0.0, 0.0, 0.5 * z]
        parent = int(top.parents[index])
        pose = large.pose @ yaw_pose(float(top.yaws[index]), bottom)
        names.append(furnisher.put(word, (x, y, z), pose, large.name if parent < 0 else names[parent]).name)
