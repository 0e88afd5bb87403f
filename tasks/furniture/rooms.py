"""Furnished rooms: a floor plan with walls and a door, and a recipe per kind of room that fills it."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.furnishing import Furnisher, Furnishing, Wall
from tasks.furniture.palette import PAINTS, WOODS, Color, pick, shade
from tasks.furniture.solids import Solid, box
from tasks.geometry.transforms import yaw_pose

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

ROOM_TYPES: tuple[str, ...] = ("bedroom", "office", "living room", "kitchen", "dining room")

WALL_M = 0.12
"""Thickness of a wall: a plastered partition."""

DOOR_M = (0.9, 2.05)
"""Width and height of the door's opening."""

_SIZES: dict[str, tuple[float, float]] = {
    "bedroom": (3.9, 3.6), "office": (4.2, 3.6), "living room": (5.2, 4.2), "kitchen": (4.0, 3.4), "dining room": (4.4, 3.8),
}  # fmt: skip
"""Usual length and width of a room with 25 objects in it [m]."""

# A step: how to place, what, and where: `at` names the category of the object it belongs to.
RECIPES: dict[str, tuple[tuple[str, str, str], ...]] = {
    "bedroom": (
        ("wall", "bed", ""), ("beside", "nightstand", "bed"), ("on", "table lamp", "nightstand"), ("wall", "wardrobe", ""),
        ("wall", "dresser", ""), ("above", "mirror", "dresser"), ("beside", "nightstand", "bed"), ("on", "book", "nightstand"),
        ("on", "blanket", "bed"), ("on", "pillow", "bed"), ("hang", "window", ""), ("wall", "desk", ""), ("seat", "chair", "desk"),
        ("on", "laptop", "desk"), ("rug", "rug", "bed"), ("above", "picture", "bed"), ("on", "vase", "dresser"), ("floor", "plant", ""),
        ("on", "mug", "desk"), ("wall", "trash can", ""), ("on", "stuffed animal", "bed"), ("wall", "basket", ""),
        ("lamp", "ceiling lamp", ""), ("hang", "clock", ""), ("floor", "backpack", ""), ("wall", "bookshelf", ""),
        ("on", "book stack", "bookshelf"), ("on", "box", "bookshelf"), ("on", "candle", "dresser"), ("hang", "picture", ""),
    ),
    "office": (
        ("wall", "desk", ""), ("seat", "office chair", "desk"), ("on", "monitor", "desk"), ("on", "keyboard", "desk"),
        ("on", "mouse", "desk"), ("wall", "bookshelf", ""), ("on", "book stack", "bookshelf"), ("on", "book stack", "bookshelf"),
        ("wall", "desk", ""), ("seat", "office chair", "desk"), ("on", "laptop", "desk"), ("hang", "whiteboard", ""),
        ("wall", "file cabinet", ""), ("on", "printer", "file cabinet"), ("wall", "trash can", ""), ("floor", "plant", ""),
        ("hang", "window", ""), ("on", "mug", "desk"), ("on", "telephone", "desk"), ("on", "desk lamp", "desk"),
        ("on", "box", "bookshelf"), ("wall", "cabinet", ""), ("on", "coffee maker", "cabinet"), ("hang", "clock", ""),
        ("floor", "backpack", ""), ("on", "book stack", "bookshelf"), ("on", "bottle", "desk"), ("hang", "picture", ""),
        ("wall", "computer tower", ""), ("on", "desk organizer", "desk"), ("lamp", "ceiling lamp", ""), ("wall", "coat rack", ""),
        ("on", "speaker", "bookshelf"),
    ),
    "living room": (
        ("wall", "sofa", ""), ("before", "coffee table", "sofa"), ("wall", "tv stand", ""), ("on", "tv", "tv stand"),
        ("rug", "rug", "coffee table"), ("wall", "armchair", ""), ("wall", "bookshelf", ""), ("on", "book stack", "bookshelf"),
        ("beside", "side table", "sofa"), ("on", "table lamp", "side table"), ("on", "pillow", "sofa"), ("on", "pillow", "sofa"),
        ("on", "bowl", "coffee table"), ("on", "remote control", "coffee table"), ("on", "mug", "coffee table"),
        ("wall", "floor lamp", ""), ("floor", "plant", ""), ("above", "picture", "sofa"), ("hang", "window", ""),
        ("on", "book stack", "bookshelf"), ("on", "vase", "bookshelf"), ("floor", "ottoman", ""), ("on", "speaker", "tv stand"),
        ("wall", "basket", ""), ("lamp", "ceiling lamp", ""), ("hang", "clock", ""), ("on", "plant", "side table"),
        ("wall", "cabinet", ""), ("on", "sculpture", "cabinet"), ("hang", "picture", ""), ("floor", "ball", ""),
        ("on", "book", "coffee table"), ("on", "candle", "coffee table"),
    ),
    "kitchen": (
        ("wall", "kitchen counter", ""), ("beside", "oven", "kitchen counter"), ("beside", "refrigerator", "kitchen counter"),
        ("above", "kitchen cabinet", "kitchen counter"), ("centered", "table", ""), ("seat", "chair", "table"),
        ("seat", "chair", "table"), ("seat", "chair", "table"), ("on", "microwave", "kitchen counter"),
        ("on", "kettle", "kitchen counter"), ("on", "pot", "oven"), ("above", "range hood", "oven"), ("on", "plate", "table"),
        ("on", "cup", "table"), ("on", "bowl", "table"), ("wall", "trash can", ""), ("hang", "window", ""),
        ("on", "toaster", "kitchen counter"), ("on", "bottle", "kitchen counter"), ("wall", "washing machine", ""),
        ("seat", "chair", "table"), ("on", "kitchen utensils", "kitchen counter"), ("on", "plate", "table"), ("hang", "clock", ""),
        ("lamp", "ceiling lamp", "table"), ("floor", "plant", ""), ("on", "jar", "kitchen counter"), ("on", "pan", "oven"),
        ("wall", "shelf", ""), ("on", "box", "shelf"), ("on", "storage bin", "shelf"), ("on", "basket", "washing machine"),
    ),
    "dining room": (
        ("centered", "table", ""), ("seat", "chair", "table"), ("seat", "chair", "table"), ("seat", "chair", "table"),
        ("seat", "chair", "table"), ("wall", "cabinet", ""), ("on", "vase", "cabinet"), ("on", "plate", "table"),
        ("on", "plate", "table"), ("on", "wine glass", "table"), ("on", "wine glass", "table"), ("on", "bowl", "table"),
        ("rug", "rug", "table"), ("lamp", "chandelier", "table"), ("hang", "picture", ""), ("hang", "window", ""),
        ("floor", "plant", ""), ("above", "mirror", "cabinet"), ("wall", "floor lamp", ""), ("on", "bottle", "table"),
        ("wall", "shelf", ""), ("on", "book stack", "shelf"), ("on", "jar", "shelf"), ("wall", "bench", ""), ("hang", "clock", ""),
        ("on", "candle", "cabinet"), ("on", "bottle", "cabinet"), ("wall", "armchair", ""), ("hang", "picture", ""),
        ("on", "cup", "table"),
    ),
}  # fmt: skip

_SMALL = ("mug", "book", "bottle", "box", "bowl", "candle", "vase", "can", "tissue box", "picture", "jar", "plant", "book stack", "cup")
"""What fills tops and shelves once the recipe is used up."""

_CLUTTER = ("box", "bag", "shoe", "ball", "backpack", "storage bin", "book", "clothes", "bottle", "stool", "suitcase", "dumbbell", "basket")
"""What lies about on the floor of an untidy room."""

_TOPS = (
    "desk",
    "table",
    "coffee table",
    "side table",
    "nightstand",
    "dresser",
    "cabinet",
    "bookshelf",
    "shelf",
    "tv stand",
    "kitchen counter",
)


@dataclasses.dataclass(frozen=True)
class FurnishedRoom:
    """A room and everything in it, in the world frame [m].

    polygon: Inner corners of the floor, counter-clockwise, shape (n, 2). structure: floor, walls and ceiling as
    (node name, mesh). objects: What stands, lies and hangs in it, in the order of placing.
    """

    room_type: str
    polygon: Array
    height: float
    structure: list[tuple[str, trimesh.Trimesh]]
    objects: list[Furnishing]

    def named_parts(self, ceiling: bool = True) -> list[tuple[str, trimesh.Trimesh]]:
        """Every part in the world frame under its node's name, `model|category|part`."""
        parts = [(name, mesh) for name, mesh in self.structure if ceiling or "|ceiling|" not in name]
        for obj in self.objects:
            for source, part in zip(obj.parts, obj.world_parts(), strict=True):
                parts.append((f"{obj.name}|{obj.category}|{source.metadata['name']}", part))
        return parts


def furnish(room_type: str, rng: np.random.Generator, object_count: int = 25, clutter: float = 0.0) -> FurnishedRoom:
    """A room of one of ROOM_TYPES with about `object_count` objects; `clutter` from 0 to 1 adds up to ten on its floor.

    Raises:
        ValueError: the kind of room is unknown.
    """
    if room_type not in ROOM_TYPES:
        raise ValueError(f"room type must be one of {', '.join(ROOM_TYPES)}, is {room_type!r}")
    polygon, height = _plan(room_type, rng, object_count), float(rng.uniform(2.4, 2.9))
    furnisher = Furnisher(polygon, height, rng)
    door_wall, door_at = _door(furnisher, rng)
    for how, category, at in RECIPES[room_type]:
        if len(furnisher.objects) >= object_count:
            break
        place_step(furnisher, how, category, at)
    for _ in range(8 * object_count):
        if len(furnisher.objects) >= object_count:
            break
        carriers = [obj for obj in furnisher.objects if obj.category in _TOPS]
        if not carriers:
            break
        anchor = carriers[int(rng.integers(len(carriers)))]
        category = _SMALL[int(rng.integers(len(_SMALL)))]
        furnisher.on_top(anchor, category, small_size(category, rng), tries=6)
    for _ in range(round(10 * clutter)):
        category = _CLUTTER[int(rng.integers(len(_CLUTTER)))]
        furnisher.on_floor(category)
    structure = _structure(furnisher, door_wall, door_at, rng)
    return FurnishedRoom(room_type, polygon, height, structure, furnisher.objects)


def small_size(category: str, rng: np.random.Generator) -> tuple[float, float, float] | None:
    """Extents of objects that are smaller on a top than on the floor or at a wall [m]."""
    sizes = {"plant": (0.2, 0.2, 0.28), "picture": (0.03, 0.14, 0.18), "box": (0.16, 0.22, 0.12), "basket": (0.24, 0.24, 0.2)}
    if category not in sizes:
        return None
    x, y, z = np.array(sizes[category]) * rng.uniform(0.85, 1.15, 3)
    return float(x), float(y), float(z)


def place_step(furnisher: Furnisher, how: str, category: str, at: str) -> Furnishing | None:
    """One step of a recipe; None when its anchor is missing or no place is free."""
    anchors: list[Any] = furnisher.all_of(at) if at else [None]
    for index in furnisher.rng.permutation(len(anchors)):
        anchor = anchors[index]
        placed = None
        match how:
            case "wall":
                placed = furnisher.against_wall(category)
            case "beside":
                placed = furnisher.beside(anchor, category, 0.005 if at == "kitchen counter" else 0.04)
            case "before":
                placed = furnisher.before(anchor, category, 0.32)
            case "seat":
                placed = furnisher.seat_at(anchor, category)
            case "on":
                placed = furnisher.on_top(anchor, category, _on_size(furnisher, category, anchor))
            case "above":
                low = {"kitchen cabinet": (1.45, 1.5), "range hood": (1.5, 1.6)}.get(category, (1.2, 1.45))
                placed = furnisher.on_wall(category, low, above=anchor)
            case "hang":
                low = {"window": (0.9, 1.0), "whiteboard": (0.95, 1.1), "clock": (1.8, 2.0)}.get(category, (1.3, 1.5))
                placed = furnisher.on_wall(category, low)
            case "floor":
                placed = furnisher.on_floor(category)
            case "centered":
                placed = furnisher.centered(category)
            case "rug":
                placed = furnisher.lay(category, anchor, 0.35 if at == "bed" else 0.0)
            case "lamp":
                placed = furnisher.under_ceiling(category, anchor)
        if placed is not None:
            return placed
    return None


def _on_size(furnisher: Furnisher, category: str, anchor: Furnishing) -> tuple[float, float, float] | None:
    """Extents that suit what an object is put on: books fill a shelf's height, a pillow lies flat on a bed [m]."""
    rng = furnisher.rng
    if category == "book stack" and anchor.category in ("bookshelf", "shelf"):
        return 0.19, float(rng.uniform(0.3, 0.55)), 0.25
    if category == "pillow":
        return (0.42, 0.42, 0.14) if anchor.category == "bed" else (0.16, 0.42, 0.4)
    if category == "tv":
        return 0.2, min(1.1, 0.8 * anchor.extents[1]), 0.62
    if category == "blanket":
        return 0.5, min(1.1, 0.75 * anchor.extents[1]), 0.09
    return small_size(category, rng)


def _plan(room_type: str, rng: np.random.Generator, object_count: int) -> Array:
    """Corners of a rectangle or an L [m], counter-clockwise, shape (n, 2)."""
    grow = np.sqrt(np.clip(object_count / 25, 0.6, 3.0))
    length, width = (float(side * grow * rng.uniform(0.95, 1.15)) for side in _SIZES[room_type])
    if rng.random() < 0.35:
        x, y = length * float(rng.uniform(0.62, 0.75)), width * float(rng.uniform(0.62, 0.75))
        length, width = 1.1 * length, 1.1 * width
        return np.array([[0, 0], [length, 0], [length, y], [x, y], [x, width], [0, width]])
    return np.array([[0, 0], [length, 0], [length, width], [0, width]])


def _door(furnisher: Furnisher, rng: np.random.Generator) -> tuple[int, float]:
    """Wall and place along it of the door; it goes into the opening, and the floor before it stays clear."""
    walls = [i for i, wall in enumerate(furnisher.walls) if wall.length > DOOR_M[0] + 0.5]
    index = int(rng.choice(walls))
    wall = furnisher.walls[index]
    margin = 0.5 * DOOR_M[0] + 0.15
    at = margin if rng.random() < 0.5 else wall.length - margin
    point = wall.start + at * wall.along
    zone = point + 0.45 * wall.inward
    furnisher.keep_clear(yaw_pose(wall.yaw, [*zone, 1.0]), (0.9, DOOR_M[0] + 0.1, 2.0))
    # hung objects keep off too: the door itself takes part in every test of collision
    leaf = yaw_pose(wall.yaw, [*(point - 0.5 * WALL_M * wall.inward), 0.0])
    furnisher.put("door", (WALL_M, DOOR_M[0] - 0.01, DOOR_M[1] - 0.005), leaf, "wall")
    return index, at


def _structure(furnisher: Furnisher, door_wall: int, door_at: float, rng: np.random.Generator) -> list[tuple[str, trimesh.Trimesh]]:
    """Floor of planks, walls with baseboards and the door's opening, ceiling; closed solids in the world frame."""
    wood, paint, white = pick(WOODS[2:5], rng), pick((*PAINTS[:2], (206, 214, 208), (226, 214, 198)), rng), (236, 234, 228)
    height, polygon = furnisher.height, furnisher.polygon
    nodes = [("floor_000|floor|floor", _planks(polygon, wood, rng, _threshold(furnisher.walls[door_wall], door_at)))]
    for index, wall in enumerate(furnisher.walls):
        openings = [(door_at - 0.5 * DOOR_M[0], door_at + 0.5 * DOOR_M[0])] if index == door_wall else []
        edges = [-WALL_M, *[v for span in openings for v in span], wall.length + WALL_M]
        solids: list[tuple[Color, Solid]] = []
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            solids.append((paint, box((-WALL_M, 0.0), (a, b), (0.0, height))))
            inner = (max(a, 0.0), min(b, wall.length))
            if inner[1] > inner[0]:
                solids.append((white, box((-0.01, 0.012), inner, (0.0, 0.08))))
        for a, b in openings:
            solids.append((paint, box((-WALL_M, 0.0), (a, b), (DOOR_M[1], height))))
        # x inward, y against `along`: a proper rotation
        pose = yaw_pose(wall.yaw, [*wall.start, 0.0])
        flip = np.diag([1.0, -1.0, 1.0, 1.0])
        nodes.append((f"wall_{index:03d}|wall|wall", _mesh(solids, pose @ flip, mirrored=True)))
    ceiling = [(white, solid) for solid in _plates(polygon, (height, height + 0.1))]
    return [*nodes, ("ceiling_000|ceiling|ceiling", _mesh(ceiling, np.eye(4)))]


def _plates(polygon: Array, z: tuple[float, float]) -> list[Solid]:
    """Boxes over a rectangle or an L as `_plan` makes them."""
    if len(polygon) == 4:
        return [box((0.0, float(polygon[2, 0])), (0.0, float(polygon[2, 1])), z)]
    x, y = float(polygon[3, 0]), float(polygon[3, 1])
    return [box((0.0, x), (0.0, float(polygon[4, 1])), z), box((x, float(polygon[1, 0])), (0.0, y), z)]


def _threshold(wall: Wall, at: float) -> Solid:
    """The floor in the door's opening."""
    sill = box((-WALL_M, 0.0), (-0.5 * DOOR_M[0], 0.5 * DOOR_M[0]), (-0.1, 0.0))
    return sill.moved(yaw_pose(wall.yaw, [*(wall.start + at * wall.along), 0.0]))


def _planks(polygon: Array, wood: Color, rng: np.random.Generator, threshold: Solid) -> trimesh.Trimesh:
    """A floor of boards 14 cm wide in tones of one wood, top at z = 0."""
    solids: list[tuple[Color, Solid]] = [(shade(wood, 0.85), threshold)]
    for plate in _plates(polygon, (-0.1, 0.0)):
        low, high = plate.vertices.min(axis=0), plate.vertices.max(axis=0)
        edges = np.linspace(low[1], high[1], max(2, round((high[1] - low[1]) / 0.14)) + 1)
        for y0, y1 in pairwise(edges):
            cut = float(rng.uniform(low[0] + 0.2, high[0] - 0.2))
            for x0, x1 in ((low[0], cut), (cut, high[0])):
                tone = shade(wood, float(rng.uniform(0.9, 1.1)))
                solids.append((tone, box((float(x0), float(x1)), (float(y0), float(y1)), (-0.1, 0.0))))
    return _mesh(solids, np.eye(4))


def _mesh(solids: list[tuple[Color, Solid]], matrix: Array, mirrored: bool = False) -> trimesh.Trimesh:
    """One mesh of colored solids moved by a 4x4 matrix, faces turned round where it mirrors."""
    import trimesh

    offsets = np.cumsum([0] + [len(solid.vertices) for _, solid in solids])
    vertices = np.concatenate([solid.vertices for _, solid in solids]) @ matrix[:3, :3].T + matrix[:3, 3]
    faces = np.concatenate([solid.faces + offset for (_, solid), offset in zip(solids, offsets, strict=False)])
    mesh = trimesh.Trimesh(vertices, faces[:, ::-1] if mirrored else faces, process=False)
    colors = np.concatenate([np.tile(np.array([*color, 255], dtype=np.uint8), (len(s.vertices), 1)) for color, s in solids])
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors)
    return mesh
