"""Dwellings: several rooms with doorways, fitted kitchens, seats round tables, slopes and steps, 40 to 80 objects in all.

Hard rooms, beside the easy ones of `tasks.furniture.rooms`. A dwelling is a pure function of its seed and settings.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.furniture import generate
from tasks.furniture.dwellings.arrangements import fill, furnish_room
from tasks.furniture.dwellings.placing import RoomFurnisher
from tasks.furniture.dwellings.plans import OUTER_M, SLOPE_M, FloorPlan, Opening, floor_plan
from tasks.furniture.dwellings.shells import RoomFeature, half_wall, rectangle, shell, slanted_wall
from tasks.furniture.furnishing import Furnishing
from tasks.furniture.rooms import FurnishedRoom
from tasks.geometry.pieces import Hull
from tasks.geometry.transforms import yaw_pose

Array = NDArray[np.float64]

COUNTS = (40, 80)
"""Fewest and most objects of a dwelling."""

OVERLAP_M = 0.001
"""Objects that are free are in nothing deeper than this."""

HUNG: tuple[str, ...] = ("wall", "ceiling")
"""What is fastened, since it hangs."""


@dataclasses.dataclass(frozen=True)
class DwellingSettings:
    """How dwellings are made."""

    fewest: int = COUNTS[0]  # objects; a furnished room of a flat has about 20
    most: int = COUNTS[1]  # four such rooms
    half_walls: float = 0.5  # share of dwellings with one
    slanted_walls: float = 0.6  # where there is a wall for it: share of dwellings below a roof


@dataclasses.dataclass(frozen=True)
class TrueOpening:
    """A door, passage or window: its opening, corners on the wall's inner face [m], shape (4, 3), and the object in it, if any, with
    the corners of the object's face."""

    opening: Opening
    corners: Array
    instance: str | None
    leaf: Array | None


@dataclasses.dataclass(frozen=True)
class Dwelling:
    """A furnished dwelling in the world frame [m].

    objects: in the order of placing. room_of: number of the room by name of the object. fitted: names of what is fastened to the
    house or built in; everything else is free. features: (room, half or slanted wall).
    """

    plan: FloorPlan
    furnished: FurnishedRoom
    room_of: dict[str, int]
    fitted: frozenset[str]
    openings: tuple[TrueOpening, ...]
    features: tuple[tuple[int, RoomFeature], ...]

    @property
    def objects(self) -> list[Furnishing]:
        """Everything in it but its shell."""
        return self.furnished.objects


def dwelling(seed: int | tuple[int, ...], settings: DwellingSettings | None = None) -> Dwelling:
    """The dwelling of a seed."""
    use = settings or DwellingSettings()
    rng = np.random.default_rng(seed)
    count = int(rng.integers(use.fewest, use.most + 1))
    plan = floor_plan(count, rng)
    features = _features(plan, use, rng)
    areas = np.array([sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in room.rectangles) for room in plan.rooms])
    wanted = np.round(count * areas / areas.sum()).astype(int)
    furnishers = [RoomFurnisher(room, plan.height, rng, f"room{index}_") for index, room in enumerate(plan.rooms)]
    openings: list[TrueOpening] = []
    for index, furnisher in enumerate(furnishers):
        for at, feature in features:
            if at == index:
                furnisher.zones += feature.zones
        openings += fill_openings(furnisher, plan, index)
    for index, furnisher in enumerate(furnishers):
        furnish_room(furnisher, plan, index, int(wanted[index]))
    for _ in range(3):
        missing = count - sum(len(f.objects) for f in furnishers)
        for furnisher in furnishers:
            if missing > 0:
                fill(furnisher, len(furnisher.objects) + missing)
                missing = count - sum(len(f.objects) for f in furnishers)
    for furnisher in furnishers:
        part_objects(furnisher)
    objects = [obj for furnisher in furnishers for obj in furnisher.objects]
    fitted = frozenset(
        obj.name for furnisher in furnishers for obj in furnisher.objects if obj.name in furnisher.fitted or obj.parent in HUNG
    )
    objects = _thinned(objects, fitted, use.most)
    outline = _outline(plan)
    return Dwelling(
        plan,
        FurnishedRoom("apartment", outline, plan.height, shell(plan, features, rng), objects),
        {obj.name: int(obj.name.partition("_")[0].removeprefix("room")) for obj in objects},
        fitted,
        tuple(openings),
        tuple(features),
    )


def part_objects(furnisher: RoomFurnisher) -> None:
    """Take out what is in another object by more than `OVERLAP_M`, the later of the two, with all that stands on it."""
    objects = furnisher.objects
    number = {obj.name: index for index, obj in enumerate(objects)}
    gone: set[str] = set()
    for first, other, depth in depths(objects):
        if depth > OVERLAP_M and not (first in furnisher.fitted and other in furnisher.fitted):
            free = [name for name in (first, other) if name not in furnisher.fitted]
            gone.add(max(free, key=number.__getitem__))
    while more := {obj.name for obj in objects if obj.parent in gone and obj.name not in gone}:
        gone |= more
    furnisher.objects = [obj for obj in objects if obj.name not in gone]


def depths(objects: list[Furnishing]) -> list[tuple[str, str, float]]:
    """Pairs of objects whose convex pieces penetrate, by name, and how deep [m]."""
    from tasks.optimization.contacts import Colliders
    from tasks.optimization.solids import ConvexParts

    solids = []
    for obj in objects:
        hulls = [Hull(np.asarray(p.vertices, dtype=np.float64), np.asarray(p.faces, dtype=np.int64)) for p in obj.pieces]
        solids.append(ConvexParts(obj.name, tuple(hulls)))
    if not solids:
        return []
    pairs = Colliders(solids).penetrations(np.array([obj.pose for obj in objects]))
    return [(pair.a, pair.b, float(pair.depth_m)) for pair in pairs if pair.b != "floor"]


def _thinned(objects: list[Furnishing], fitted: frozenset[str], most: int) -> list[Furnishing]:
    """At most so many objects: the last ones that are free and carry nothing go."""
    kept = list(objects)
    while len(kept) > most:
        carrying = {obj.parent for obj in kept}
        small = [obj for obj in kept if obj.name not in fitted and obj.name not in carrying]
        if not small:
            break
        kept.remove(small[-1])
    return kept


def _features(plan: FloorPlan, use: DwellingSettings, rng: np.random.Generator) -> list[tuple[int, RoomFeature]]:
    """A half-height wall and a slope, where there is a wall for them."""
    features: list[tuple[int, RoomFeature]] = []
    if rng.random() < use.slanted_walls:
        walls = [
            (i, w) for i, room in enumerate(plan.rooms) for w, wall in enumerate(room.walls)
            if not plan.openings_of(i, w) and not room.shared[w] and wall.length > 2.0 and room.kind != "kitchen"
            and not any(
                _near_end(room.walls[beside].length, o, s)
                for s, beside in ((-1, (w - 1) % len(room.walls)), (1, (w + 1) % len(room.walls))) for o in plan.openings_of(i, beside)
            )
        ]  # fmt: skip
        if walls:
            room, wall = walls[int(rng.integers(len(walls)))]
            features.append((room, slanted_wall(plan.rooms[room], wall, plan.height, rng)))
    if rng.random() < use.half_walls:
        room = int(rng.integers(len(plan.rooms)))
        sloped = [f.wall for at, f in features if at == room]
        walls = [(room, w) for w, wall in enumerate(plan.rooms[room].walls) if wall.length > 3.2 and w not in sloped]
        for room, wall in walls:
            face = plan.rooms[room].walls[wall]
            at = float(rng.uniform(0.35, 0.65)) * face.length
            if all(abs(o.at - at) > 0.5 * o.width + 0.35 for o in plan.openings_of(room, wall)):
                features.append((room, half_wall(plan.rooms[room], wall, at, rng)))
                break
    return features


def _near_end(length: float, opening: Opening, side: int) -> bool:
    """Whether an opening lies where the slope of the wall before (-1: it follows) or after its own begins."""
    return opening.span[0] < SLOPE_M - 0.01 if side > 0 else opening.span[1] > length - SLOPE_M + 0.01


def fill_openings(furnisher: RoomFurnisher, plan: FloorPlan, index: int) -> list[TrueOpening]:
    """Doors and windows into their openings; the floor before doors, and the air before windows, stay clear."""
    rng = furnisher.rng
    openings: list[TrueOpening] = []
    for opening in plan.openings_of(index):
        corners, instance, leaf = rectangle(plan, opening), None, None
        middle = 0.5 * (opening.low + opening.high)
        if opening.kind == "window":
            size = (0.1, opening.width - 0.01, opening.high - opening.low - 0.01)
            pose = furnisher.at_wall(opening.wall, opening.at, size[0], opening.low + 0.005, -size[0] - float(rng.uniform(0.01, 0.06)))
            placed = furnisher.let_in("window", generate("window", size, rng, half=furnisher.half), size, pose, "wall")
            instance, leaf = placed.name, face_of(placed)
            zone = furnisher.at_wall(opening.wall, opening.at, 0.3, max(middle, opening.low), 0.14)
            furnisher.zones.append((zone, (0.3, opening.width, opening.high - opening.low - 0.04)))
        else:
            zone = furnisher.at_wall(opening.wall, opening.at, 0.75, 0.5 * opening.high, 0.0)
            furnisher.zones.append((zone, (0.75, opening.width + 0.1, opening.high - 0.02)))
        if opening.kind == "door":
            instance, leaf = _door(furnisher, opening, rng)
        openings.append(TrueOpening(opening, corners, instance, leaf))
    return openings


def _door(furnisher: RoomFurnisher, opening: Opening, rng: np.random.Generator) -> tuple[str, Array]:
    """A leaf in its opening, or, between rooms, often opened into the room at a right angle."""
    size = (0.05, opening.width - 0.012, opening.high - 0.012)
    pose = furnisher.at_wall(opening.wall, opening.at, size[0], 0.006, -0.06 if opening.to >= 0 else -0.08)
    wall = furnisher.walls[opening.wall]
    hinge = opening.span[0] if rng.random() < 0.5 else opening.span[1]
    fits = 0.12 < hinge < wall.length - 0.12
    if opening.to >= 0 and fits and rng.random() < 0.65:
        pose = furnisher.at_wall(opening.wall, hinge, 0.0, 0.006, 0.02) @ yaw_pose(0.5 * np.pi, [0.5 * size[1], 0.0, 0.0])
    placed = furnisher.let_in("door", generate("door", size, rng, half=furnisher.half), size, pose, "wall")
    return placed.name, face_of(placed)


def face_of(obj: Furnishing) -> Array:
    """Corners of an object's front, in the middle of its depth [m], shape (4, 3)."""
    half, tall = 0.5 * obj.extents[1], obj.extents[2]
    local = np.array([[0.0, -half, 0.0], [0.0, half, 0.0], [0.0, half, tall], [0.0, -half, tall]])
    return np.asarray(local @ obj.pose[:3, :3].T + obj.pose[:3, 3])


def _outline(plan: FloorPlan) -> Array:
    """Corners of the dwelling's inside with its partitions [m], counter-clockwise, shape (n, 2)."""
    from shapely.geometry import Polygon
    from shapely.geometry.polygon import orient
    from shapely.ops import unary_union

    grown = unary_union([Polygon(room.polygon).buffer(OUTER_M, join_style="mitre") for room in plan.rooms])
    return np.asarray(orient(grown.buffer(-OUTER_M, join_style="mitre").simplify(1e-6)).exterior.coords)[:-1].astype(np.float64)
