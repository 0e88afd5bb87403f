"""Finding places in a dwelling's rooms: round bends, on rugs and platforms, under slopes, without pieces that meet.

World frame: +Z up, metres, floor at z = 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.drafting import Extents, FurnitureModel
from tasks.furniture.dwellings.corners import ShapedModel, lying_pillow
from tasks.furniture.dwellings.plans import PlannedRoom
from tasks.furniture.dwellings.shells import Zone
from tasks.furniture.furnishing import TOUCH_M3, Furnisher, Furnishing, pieces_meet
from tasks.geometry.boxes import box_footprint, oriented_overlap
from tasks.geometry.transforms import yaw_pose

Array = NDArray[np.float64]

COVERINGS: tuple[str, ...] = ("rug",)
"""What lies under other things."""


class RoomFurnisher(Furnisher):
    """Places objects in one room of a dwelling. Nothing enters a zone, whatever it stands on; who stands on a rug stands
    on it with all its feet; objects with a bend keep to their blocks. `prefix` goes before the names of objects."""

    def __init__(self, room: PlannedRoom, height: float, rng: np.random.Generator, prefix: str) -> None:
        super().__init__(room.polygon, height, rng)
        self.room, self.prefix = room, prefix
        self.fitted: set[str] = set()
        self._blocks: dict[str, list[Zone]] = {}

    def shaped(self, category: str, shape: ShapedModel, pose: Array, parent: str = "floor") -> Furnishing | None:
        """A model with a bend, at a pose."""
        parts = [_block(pose, spans) for spans in shape.blocks]
        return self._settle(category, shape.extents, pose, parent, parts, shape.model)

    def modelled(self, category: str, model: FurnitureModel, size: Extents, pose: Array, parent: str, fitted: bool) -> Furnishing | None:
        """A model that is drawn already, at a pose."""
        placed = self._settle(category, size, pose, parent, [_whole(pose, size)], model)
        if placed is not None and fitted:
            self.fitted.add(placed.name)
        return placed

    def let_in(self, category: str, model: FurnitureModel, size: Extents, pose: Array, parent: str) -> Furnishing:
        """What fills a hole that was left for it: it is asked for no place."""
        placed = Furnishing(self._name(category), category, model.parts, model.pieces, pose, size, parent)
        self.objects.append(placed)
        self.fitted.add(placed.name)
        return placed

    def corner(self, shape: ShapedModel, category: str, gap: float) -> Furnishing | None:
        """A shaped model with its back at a wall, the return along the next one where it fits, else anywhere along a wall."""
        for index in self.rng.permutation(len(self.walls)):
            wall = self.walls[int(index)]
            room = wall.length - shape.extents[1] - 2 * gap
            if room < 0:
                continue
            for share in (0.0, 1.0, 0.5, float(self.rng.random())):
                pose = self._at_wall(wall, share * room + 0.5 * shape.extents[1] + gap, shape.extents[0], 0.0, gap)
                placed = self.shaped(category, shape, pose)
                if placed is not None:
                    return placed
        return None

    def lay_rug(self, model: FurnitureModel, size: Extents, pose: Array) -> Furnishing | None:
        """A rug where nothing stands yet."""
        if not self._inside(pose, size) or self._meets([_whole(pose, size)], ()):
            return None
        placed = Furnishing(self._name("rug"), "rug", model.parts, model.pieces, pose, size, "floor")
        self.objects.append(placed)
        return placed

    def on_floor_at(self, category: str, size: Extents | None, pose: Array, tucked: Furnishing | None = None) -> Furnishing | None:
        """On the floor, or on the rug there, at a pose in plan; it may reach under `tucked`."""
        return self._try(category, size or self._sizes(category), pose, "floor", tucked=tucked)

    def is_free(self, pose: Array, size: Extents) -> bool:
        """Whether nothing is in a box yet that stands at a pose."""
        return self._inside(pose, size) and not self._meets([_whole(pose, size)], ())

    def at_wall(self, wall: int, at: float, depth: float, z: float, gap: float) -> Array:
        """Pose with the back at a wall, `at` along it [m]."""
        return self._at_wall(self.walls[wall], at, depth, z, gap)

    def _ground(self, blocks: list[Zone]) -> tuple[float, str] | None:
        """Height and name of what lies below a footprint: the floor, or a rug that is below all of it; None for the edge of one."""
        from shapely.geometry import Polygon
        from shapely.ops import unary_union

        foot = unary_union([Polygon(box_footprint(pose, size)) for pose, size in blocks])
        for rug in (obj for obj in self.objects if obj.category in COVERINGS):
            cloth = Polygon(box_footprint(rug.box_pose, rug.extents))
            if cloth.buffer(1e-6).covers(foot):
                return float(rug.pose[2, 3] + rug.extents[2]), rug.name
            if cloth.intersects(foot) and cloth.intersection(foot).area > 1e-6:
                return None
        return 0.0, "floor"

    def _meets(self, blocks: list[Zone], besides: tuple[Furnishing | None, ...]) -> bool:
        """Whether boxes overlap a zone, or an object that is not a covering."""
        taken = list(self.zones)
        for obj in self.objects:
            if obj.category not in COVERINGS and not any(obj is other for other in besides):
                taken += self._blocks.get(obj.name) or [(obj.box_pose, obj.extents)]
        return any(oriented_overlap(*block, *zone) > TOUCH_M3 for block in blocks for zone in taken)

    def _try(
        self, category: str, size: Extents, pose: Array, parent: str, inside: Furnishing | None = None, tucked: Furnishing | None = None
    ) -> Furnishing | None:
        return self._settle(category, size, pose, parent, [_whole(pose, size)], None, inside, tucked)

    def _settle(
        self, category: str, size: Extents, pose: Array, parent: str, blocks: list[Zone], model: FurnitureModel | None,
        inside: Furnishing | None = None, tucked: Furnishing | None = None,
    ) -> Furnishing | None:  # fmt: skip
        """Place it if nothing is in its way: see `Furnisher._try`. What stands on the floor is lifted onto a rug."""
        if parent == "floor":
            ground = self._ground(blocks)
            if ground is None:
                return None
            rise = ground[0] - pose[2, 3]
            pose, parent = _raised(pose, rise), ground[1]
            blocks = [(_raised(at, rise), sides) for at, sides in blocks]
        if not self._inside(pose, size) or self._meets(blocks, (inside, tucked)):
            return None
        if model is None:
            placed = self._model(category, size, pose, parent)
        else:
            placed = Furnishing(self._name(category), category, model.parts, model.pieces, pose, size, parent)
        if any(other is not None and pieces_meet(placed, other) for other in (inside, tucked)):
            return None
        self.objects.append(placed)
        if len(blocks) > 1:
            self._blocks[placed.name] = blocks
        return placed

    def _model(self, category: str, size: Extents, pose: Array, parent: str) -> Furnishing:
        if category == "pillow":
            model = lying_pillow(self.rng, size)
            return Furnishing(self._name(category), category, model.parts, model.pieces, pose, size, parent)
        made = super()._model(category, size, pose, parent)
        return Furnishing(self._name(category), category, made.parts, made.pieces, pose, size, parent)

    def _name(self, category: str) -> str:
        return f"{self.prefix}{category.replace(' ', '_')}_{len(self.objects):03d}"


def _whole(pose: Array, size: Extents) -> Zone:
    return _raised(pose, 0.5 * size[2]), size


def _raised(pose: Array, rise: float) -> Array:
    moved = pose.copy()
    moved[2, 3] += rise
    return moved


def _block(pose: Array, spans: tuple[tuple[float, float], ...]) -> Zone:
    middle = [0.5 * (low + high) for low, high in spans]
    x, y, z = (high - low for low, high in spans)
    return pose @ yaw_pose(0.0, middle), (x, y, z)
