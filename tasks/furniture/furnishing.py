"""Finding places for furniture: along walls, beside and in front of other objects, on tops, in shelves, on walls.

World frame: +Z up, metres, floor at z = 0. Every object stands in the oriented box of its model.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.furniture import generate, typical_extents
from tasks.furniture.halves import Half
from tasks.furniture.storage import shelf_levels
from tasks.geometry.boxes import box_footprint, oriented_overlap
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import inverse, transform_points, yaw_of, yaw_pose

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Extents = tuple[float, float, float]

TOUCH_M3 = 1e-7
"""Overlap of two boxes that is rounding, not collision."""

SETS: tuple[str, ...] = ("chair", "office chair", "bar stool", "nightstand", "wine glass", "plate", "cup")
"""What comes in sets: all of a room are of one design and size."""

GAP_M = 0.015
"""Between furniture and the wall behind it: baseboards keep it that far off."""


@dataclasses.dataclass(frozen=True)
class Furnishing:
    """A model in a room. pose: Object to world, 4x4 [m]; extents: of its model [m]; parent: what it stands on or hangs at."""

    name: str
    category: str
    parts: list[trimesh.Trimesh]
    pieces: list[trimesh.Trimesh]
    pose: Array
    extents: Extents
    parent: str

    @property
    def box_pose(self) -> Array:
        """Pose of the box's center, 4x4 [m]."""
        pose = self.pose.copy()
        pose[2, 3] += 0.5 * self.extents[2]
        return pose

    @property
    def yaw(self) -> float:
        """Turn of its front about +Z from world +x [rad]."""
        return yaw_of(self.pose)

    def world_parts(self) -> list[trimesh.Trimesh]:
        """What is seen of it, in the world frame."""
        return [part.copy().apply_transform(self.pose) for part in self.parts]


@dataclasses.dataclass(frozen=True)
class Wall:
    """The inner face of a wall: from `start` along unit `along` for `length` [m]; the room lies along unit `inward`."""

    start: Array
    along: Array
    inward: Array
    length: float

    @property
    def yaw(self) -> float:
        """Yaw of an object whose back is at this wall [rad]."""
        return float(np.arctan2(self.inward[1], self.inward[0]))


class Furnisher:
    """Places objects in a room without collisions; every method returns None when it finds no place. half: templates to draw from."""

    half: Half = "all"

    def __init__(self, polygon: Array, height: float, rng: np.random.Generator) -> None:
        from shapely.geometry import Polygon

        self.polygon, self.height, self.rng = polygon, height, rng
        self.objects: list[Furnishing] = []
        self.zones: list[tuple[Array, Extents]] = []
        self._floor = Polygon(polygon)
        after = np.roll(polygon, -1, axis=0)
        lengths = np.linalg.norm(after - polygon, axis=1)
        directions = (after - polygon) / lengths[:, None]
        self.walls = [Wall(p, d, np.array([-d[1], d[0]]), float(n)) for p, d, n in zip(polygon, directions, lengths, strict=True)]
        self._casts: dict[str, RayScene] = {}
        self._sets: dict[str, tuple[int, Extents]] = {}

    def keep_clear(self, pose: Array, size: Extents) -> None:
        """Nothing that stands on the floor may enter this box: a pose of its center, and its sides [m]."""
        self.zones.append((pose, size))

    def all_of(self, category: str) -> list[Furnishing]:
        """Objects of a category placed so far."""
        return [obj for obj in self.objects if obj.category == category]

    def against_wall(self, category: str, extents: Extents | None = None, tries: int = 40) -> Furnishing | None:
        """With its back at some wall, preferring corners a little."""
        size = extents or self._sizes(category)
        for _ in range(tries):
            wall = self.walls[int(self.rng.choice(len(self.walls), p=self._wall_weights()))]
            room = wall.length - size[1] - 2 * GAP_M
            if room < 0:
                continue
            at = float(self.rng.choice([0.0, 1.0, self.rng.random()])) * room + 0.5 * size[1] + GAP_M
            placed = self._try(category, size, self._at_wall(wall, at, size[0], 0.0), "floor")
            if placed:
                return placed
        return None

    def beside(self, anchor: Furnishing, category: str, gap: float = 0.03, size: Extents | None = None) -> Furnishing | None:
        """Next to an object, backs in line, on either side."""
        size = size or self._sizes(category)
        for side in self.rng.permutation([-1, 1]):
            local = yaw_pose(0.0, [0.5 * (size[0] - anchor.extents[0]), side * (0.5 * (anchor.extents[1] + size[1]) + gap), 0])
            placed = self._try(category, size, anchor.pose @ local, "floor")
            if placed:
                return placed
        return None

    def before(self, anchor: Furnishing, category: str, distance: float) -> Furnishing | None:
        """In front of an object at a distance [m], looking back at it."""
        size = self._sizes(category)
        for shift in (0.0, 0.15, -0.15, 0.3):
            local = yaw_pose(np.pi, [0.5 * (anchor.extents[0] + size[0]) + distance + shift, 0, 0])
            placed = self._try(category, size, anchor.pose @ local, "floor")
            if placed:
                return placed
        return None

    def seat_at(self, table: Furnishing, category: str) -> Furnishing | None:
        """At a free side of a table, or at the front of a desk, facing it, pushed under as far as its parts allow."""
        size = self._sizes(category)
        x, y = 0.5 * table.extents[0], 0.5 * table.extents[1]
        spots = [(np.pi, x, 0.0)] if "desk" in table.category else self._table_sides(x, y, size[1])
        for side, reach, shift in spots:
            out = side - np.pi
            for tuck in (0.45, 0.3, 0.15, -0.04):
                away = reach + (0.5 - tuck) * size[0]
                turn = self.rng.normal(0, 0.05) if tuck < 0 else 0.0
                for squeeze in (1.0, 0.75):  # between a trestle's legs there is room only nearer the middle
                    along = squeeze * shift
                    offset = [away * np.cos(out) - along * np.sin(out), away * np.sin(out) + along * np.cos(out), 0]
                    placed = self._try(category, size, table.pose @ yaw_pose(side + turn, offset), "floor", tucked=table)
                    if placed:
                        return placed
        return None

    def _table_sides(self, x: float, y: float, width: float) -> list[tuple[float, float, float]]:
        """Yaw of a seat, distance of the edge from the center, shift along the edge: long sides first."""
        spots = []
        for out, reach, half in ((0.0, x, y), (np.pi, x, y), (np.pi / 2, y, x), (-np.pi / 2, y, x)):
            count = max(1, int(2 * half / (width + 0.12)))
            spots += [(out + np.pi, reach, half * (2 * (i + 0.5) / count - 1)) for i in range(count)]
        return spots

    def on_top(self, anchor: Furnishing, category: str, size: Extents | None = None, tries: int = 25) -> Furnishing | None:
        """On what carries in an object: its top, its seat, or one of its shelves."""
        size = size or self._sizes(category)
        levels = self._levels(anchor)
        for _ in range(tries):
            low, clearance = levels[int(self.rng.integers(len(levels)))]
            if size[2] > clearance:
                continue
            turn = float(self.rng.uniform(-0.3, 0.3)) + float(self.rng.choice([0.0, 0.0, 0.0, np.pi / 2]) if size[2] < 0.12 else 0.0)
            if category in ("monitor", "tv", "laptop", "keyboard", "microwave", "printer", "toaster", "coffee maker", "book stack"):
                turn = float(self.rng.uniform(-0.1, 0.1))
            reach = np.abs(np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])) @ np.array(size[:2])
            free = 0.5 * (np.array(anchor.extents[:2]) - reach) - 0.02
            if anchor.category in ("bookshelf", "shelf"):
                free -= [0.0, 0.02]
            if (free < 0).any():
                continue
            x, y = self.rng.uniform(-free, free)
            if category in ("monitor", "tv"):
                x = -0.7 * free[0]
            elif category in ("keyboard", "plate"):
                x = 0.7 * free[0] if category == "keyboard" else np.sign(x) * 0.8 * free[0]
            z = self._rest(anchor, (x, y), reach, low, clearance)
            if z is None or z > low + 0.12 or z + size[2] > low + clearance:
                continue
            placed = self._try(category, size, anchor.pose @ yaw_pose(turn, [x, y, z]), anchor.name, inside=anchor)
            if placed:
                return placed
        return None

    def on_wall(
        self, category: str, low: tuple[float, float], size: Extents | None = None, above: Furnishing | None = None
    ) -> Furnishing | None:
        """Hung at a wall with its bottom in a range of heights [m], centered above an object when one is given."""
        size = size or self._sizes(category)
        for _ in range(40):
            z = float(self.rng.uniform(*low))
            if z + size[2] > self.height - 0.02:
                z = self.height - 0.02 - size[2]
            if above is not None:
                z = max(z, above.pose[2, 3] + above.extents[2] + 0.05)
                back = -0.5 * above.extents[0] - GAP_M + 0.5 * size[0]
                pose = above.pose @ yaw_pose(0.0, [back, float(self.rng.uniform(-0.15, 0.15)) * above.extents[1], z - above.pose[2, 3]])
            else:
                wall = self.walls[int(self.rng.choice(len(self.walls), p=self._wall_weights()))]
                if wall.length < size[1] + 0.1:
                    continue
                pose = self._at_wall(wall, float(self.rng.uniform(0.5 * size[1], wall.length - 0.5 * size[1])), size[0], z, gap=0.0)
            if pose[2, 3] + size[2] > self.height:
                return None
            placed = self._try(category, size, pose, "wall")
            if placed:
                return placed
        return None

    def on_floor(self, category: str, size: Extents | None = None, tries: int = 40) -> Furnishing | None:
        """Anywhere on the floor, turned by chance."""
        size = size or self._sizes(category)
        low, high = self.polygon.min(axis=0), self.polygon.max(axis=0)
        for _ in range(tries):
            x, y = self.rng.uniform(low, high)
            placed = self._try(category, size, yaw_pose(float(self.rng.uniform(-np.pi, np.pi)), [x, y, 0]), "floor")
            if placed:
                return placed
        return None

    def centered(self, category: str, size: Extents | None = None) -> Furnishing | None:
        """Near the middle of the floor, along the walls."""
        size = size or self._sizes(category)
        center = np.array(self._floor.representative_point().coords[0])
        for spread in np.linspace(0, 1.2, 25):
            x, y = center + self.rng.uniform(-spread, spread, 2)
            placed = self._try(category, size, yaw_pose(self.walls[0].yaw + float(self.rng.choice([0.0, np.pi / 2])), [x, y, 0]), "floor")
            if placed:
                return placed
        return None

    def under_ceiling(self, category: str, over: Furnishing | None = None) -> Furnishing | None:
        """Hung from the ceiling, over an object or near the middle."""
        size = self._sizes(category)
        x, y = over.pose[:2, 3] if over is not None else self._floor.representative_point().coords[0]
        return self._try(category, size, yaw_pose(0.0, [x, y, self.height - size[2]]), "ceiling")

    def lay(self, category: str, under: Furnishing | None, shift: float = 0.0) -> Furnishing | None:
        """A rug: it may lie below anything, but inside the room."""
        size = self._sizes(category)
        middle = yaw_pose(0.0, [*np.array(self._floor.representative_point().coords[0]), 0])
        pose = under.pose @ yaw_pose(0.0, [shift, 0, 0]) if under is not None else middle
        for factor in (1.0, 0.85, 0.7):
            small = (size[0] * factor, size[1] * factor, size[2])
            if self._inside(pose, small):
                return self.put(category, small, pose, "floor")
        return None

    def _sizes(self, category: str) -> Extents:
        if category in self._sets:
            return self._sets[category][1]
        x, y, z = np.array(typical_extents(category)) * self.rng.uniform(0.92, 1.08, 3)
        return float(x), float(y), float(z)

    def _wall_weights(self) -> Array:
        lengths = np.array([wall.length for wall in self.walls])
        return np.asarray(lengths / lengths.sum(), dtype=np.float64)

    def _at_wall(self, wall: Wall, at: float, depth: float, z: float, gap: float = GAP_M) -> Array:
        point = wall.start + at * wall.along + (0.5 * depth + gap) * wall.inward
        return yaw_pose(wall.yaw, [point[0], point[1], z])

    def _levels(self, anchor: Furnishing) -> list[tuple[float, float]]:
        """Heights of what carries in an object, in its frame, with the clearance above each [m]."""
        top = anchor.extents[2]
        over = self.height - anchor.pose[2, 3] - top - 0.05
        if anchor.category == "bookshelf" or (anchor.category == "shelf" and top > 0.4):
            levels = [*shelf_levels(anchor.extents), top]
            return [(a, b - a - 0.03) for a, b in pairwise(levels)]
        if anchor.category in ("sofa", "armchair"):
            return [(0.48 * top, 1.0)]
        if anchor.category == "bed":
            return [(0.52 * top, 1.0)]
        return [(top, over)]

    def _rest(self, anchor: Furnishing, at: tuple[float, float], reach: Array, low: float, clearance: float) -> float | None:
        """Height at which an object over a part of an anchor comes to rest, in the anchor's frame; None over a hole."""
        if anchor.name not in self._casts:
            self._casts[anchor.name] = RayScene(anchor.parts)
        grid = np.stack(np.meshgrid(*[np.linspace(-0.45, 0.45, 5)] * 2, indexing="ij"), axis=-1).reshape(-1, 2) * reach + at
        start = low + clearance
        rays = np.column_stack([grid, np.full(len(grid), start), np.tile([0.0, 0.0, -1.0], (len(grid), 1))]).astype(np.float32)
        heights = start - self._casts[anchor.name].cast(rays)["t_hit"].astype(np.float64)
        if not (heights > low - 0.06).all():
            return None
        return float(heights.max())

    def _inside(self, pose: Array, size: Extents) -> bool:
        from shapely.geometry import Polygon

        center = pose.copy()
        center[2, 3] += 0.5 * size[2]
        return bool(self._floor.buffer(1e-6).covers(Polygon(box_footprint(center, size)))) and pose[2, 3] + size[2] <= self.height + 1e-9

    def _try(
        self, category: str, size: Extents, pose: Array, parent: str, inside: Furnishing | None = None, tucked: Furnishing | None = None
    ) -> Furnishing | None:
        """Place it if it lies in the room and meets nothing: but `inside`, whose box may hold it, and `tucked`, which it may
        reach under as long as no two pieces meet."""
        if not self._inside(pose, size):
            return None
        center = pose.copy()
        center[2, 3] += 0.5 * size[2]
        on_floor = parent == "floor"
        if on_floor and any(oriented_overlap(center, size, zone, sides) > TOUCH_M3 for zone, sides in self.zones):
            return None
        for obj in self.objects:
            if obj is inside or obj is tucked or obj.category == "rug":
                continue
            if oriented_overlap(center, size, obj.box_pose, obj.extents) > TOUCH_M3:
                return None
        placed = self._model(category, size, pose, parent)
        if tucked is not None and pieces_meet(placed, tucked):
            return None
        self.objects.append(placed)
        return placed

    def put(self, category: str, size: Extents, pose: Array, parent: str) -> Furnishing:
        """Place it without asking whether it fits: what belongs to the house itself, and rugs."""
        placed = self._model(category, size, pose, parent)
        self.objects.append(placed)
        return placed

    def _model(self, category: str, size: Extents, pose: Array, parent: str) -> Furnishing:
        if category in SETS:
            self._sets.setdefault(category, (int(self.rng.integers(2**63)), size))
            model = generate(category, size, np.random.default_rng(self._sets[category][0]), half=self.half)
        else:
            model = generate(category, size, self.rng, half=self.half)
        name = f"{category.replace(' ', '_')}_{len(self.objects):03d}"
        return Furnishing(name, category, model.parts, model.pieces, pose, size, parent)


def pieces_meet(first: Furnishing, other: Furnishing) -> bool:
    """Whether boxes around two objects' pieces, along the other's axes, overlap by more than a millimetre."""
    into = inverse(other.pose) @ first.pose
    moved = [transform_points(piece.vertices, into) for piece in first.pieces]
    low = np.array([points.min(axis=0) for points in moved])
    high = np.array([points.max(axis=0) for points in moved])
    bounds = np.array([piece.bounds for piece in other.pieces])
    reach = np.minimum(high[:, None], bounds[None, :, 1]) - np.maximum(low[:, None], bounds[None, :, 0])
    return bool((reach > 1e-3).all(axis=2).any())
