"""Disturbances of furnished rooms, by a rule that no optimization knows: objects pushed into others, shifted, turned, lifted.

An object takes along what it carries. Every draw comes from one generator.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.transforms import translation, yaw_pose
from tasks.optimization.contacts import Colliders
from tasks.optimization.solids import ConvexParts

Array = NDArray[np.float64]
Kind = Literal["pushed", "shifted", "turned", "raised", "sunk"]

LEAST_M, MOST_M = 0.01, 0.10
"""Depths of pushes, lengths of shifts, and heights [m]: what scans and annotators are off by, up to a bad case."""

HUNG_MOST_M = 0.05
"""The same at most for what hangs [m]."""

MOST_TURN = float(np.radians(8.0))
"""Greatest turn [rad]."""

NEAR_M = 0.4
"""Farthest neighbor that an object is pushed into [m]: more is no disturbance, but another room."""

SHARES: tuple[tuple[Kind, float], ...] = (("shifted", 0.2), ("turned", 0.15), ("raised", 0.1), ("sunk", 0.1), ("pushed", 0.25))
"""Share of the objects that each disturbance is tried on, in the order in which they are done."""


@dataclasses.dataclass(frozen=True)
class PerturbedObject:
    """An object of a furnished room. pose: to the world, 4x4 [m]. relation: `floor`, `on`, `wall` or `ceiling`; parent: what
    it stands on. is_let_in: it belongs to the room (doors, windows, rugs) and stays as it is."""

    name: str
    solid: ConvexParts
    pose: Array
    relation: str
    parent: str | None
    is_let_in: bool = False

    @cached_property
    def points(self) -> Array:
        """Corners of its pieces in its own frame [m], shape (n, 3)."""
        return np.concatenate([hull.vertices for hull in self.solid.hulls])


@dataclasses.dataclass(frozen=True)
class Disturbance:
    """What was done to an object. amount: length of a shift, height, or depth of a push [m], or turn [rad]. target: what it
    was pushed into, an instance or a part of the room's shell."""

    name: str
    kind: Kind
    amount: float
    target: str | None = None


def disturb(
    objects: Sequence[PerturbedObject],
    walls: Sequence[ConvexParts],
    rng: np.random.Generator,
    shares: Sequence[tuple[Kind, float]] = SHARES,
) -> tuple[dict[str, Array], list[Disturbance]]:
    """Poses after the disturbances, 4x4 by name [m], and what was done, in order. walls: in the world frame [m].

    Each object is disturbed once at most. Pushes come last, and neither a pushed object nor what it was pushed into is
    moved again, so that every planted overlap is there in the end.
    """
    room = _Room(objects, walls)
    done: list[Disturbance] = []
    busy: set[str] = set()
    for kind, share in shares:
        free = [obj for obj in objects if not obj.is_let_in and obj.name not in busy]
        count = min(round(share * len(objects)), len(free))
        for index in rng.permutation(len(free))[:count]:
            obj = free[index]
            if obj.name in busy:
                continue
            pushed = room.push(obj, rng, busy) if kind == "pushed" else room.misplace(obj, kind, rng)
            if pushed is not None:
                done.append(pushed)
                busy |= {obj.name}
                if pushed.target is not None:
                    busy |= room.lineage(obj.name) | room.lineage(pushed.target)
    return room.poses, done


class _Room:
    """Objects at their present poses, and what moves along with what."""

    def __init__(self, objects: Sequence[PerturbedObject], walls: Sequence[ConvexParts]) -> None:
        self.objects: Mapping[str, PerturbedObject] = {obj.name: obj for obj in objects}
        self.poses = {obj.name: obj.pose.copy() for obj in objects}
        self.walls = {wall.name: wall for wall in walls}
        self.names = list(self.objects)
        self.everything = Colliders([obj.solid for obj in objects], list(walls))

    def group(self, name: str) -> list[str]:
        """An object and all it carries, directly or through others."""
        return [other for other in self.names if name in self.below(other)]

    def below(self, name: str) -> list[str]:
        """An object and what carries it, down to the floor."""
        chain = [name]
        while (parent := self.objects[chain[-1]].parent) is not None:
            chain.append(parent)
        return chain

    def lineage(self, name: str) -> set[str]:
        """Everything whose motion could move an object, and all it carries; nothing for a part of the room."""
        return {*self.below(name), *self.group(name)} if name in self.objects else set()

    def move(self, name: str, motion: Array) -> None:
        """Move an object and all it carries by a rigid motion of the world, 4x4 [m]."""
        for other in self.group(name):
            self.poses[other] = motion @ self.poses[other]

    def world(self, name: str) -> Array:
        """Corners of an object's pieces in the world frame [m], shape (n, 3)."""
        pose = self.poses[name]
        return np.asarray(self.objects[name].points @ pose[:3, :3].T + pose[:3, 3], dtype=np.float64)

    def misplace(self, obj: PerturbedObject, kind: Kind, rng: np.random.Generator) -> Disturbance | None:
        """Shift, turn, raise or sink an object; None where a carried one would leave its carrier, or a hanging one its wall."""
        hangs = obj.relation in ("wall", "ceiling")
        if hangs and kind != "shifted":
            return None
        length = float(rng.uniform(LEAST_M, HUNG_MOST_M if hangs else MOST_M))
        if kind == "shifted":
            angle = float(rng.uniform(-np.pi, np.pi))
            offset = length * np.array([np.cos(angle), np.sin(angle), 0.0])
            if obj.parent is not None and not self._stays_over(obj.parent, self.world(obj.name).mean(axis=0) + offset):
                return None
            self.move(obj.name, translation(offset))
            return Disturbance(obj.name, kind, length)
        if kind == "turned":
            turn = float(rng.uniform(np.radians(1.0), MOST_TURN)) * float(rng.choice([-1.0, 1.0]))
            at = self.poses[obj.name][:3, 3]
            self.move(obj.name, translation(at) @ yaw_pose(turn) @ translation(-at))
            return Disturbance(obj.name, kind, abs(turn))
        self.move(obj.name, translation([0.0, 0.0, length if kind == "raised" else -length]))
        return Disturbance(obj.name, kind, length)

    def _stays_over(self, parent: str, point: Array) -> bool:
        """Whether a point lies over or under what a carrier covers in plan."""
        from shapely.geometry import MultiPoint, Point

        return bool(MultiPoint(self.world(parent)[:, :2]).convex_hull.contains(Point(point[:2])))

    def push(self, obj: PerturbedObject, rng: np.random.Generator, busy: set[str]) -> Disturbance | None:
        """Push an object sideways into its nearest neighbor or wall until it is in it by a drawn depth.

        Neighbors stand on the same object, at the same height. A depth that a thin neighbor has no room for is halved.
        None where nothing is near, or where the object would get deeper into something else.
        """
        depth = float(rng.uniform(LEAST_M, MOST_M))
        if obj.relation in ("wall", "ceiling"):
            return None
        nearest = self._nearest(obj, busy)
        if nearest is None:
            return None
        target, way, gap = nearest
        pair = self._pair(obj, target)
        travel = None
        while travel is None and depth >= LEAST_M:
            travel = _travel(pair, self.poses[obj.name], way, gap, depth)
            depth = depth if travel is not None else 0.5 * depth
        if travel is None:
            return None
        before, group = dict(self.poses), set(self.group(obj.name))
        was = self._depths(group)
        self.move(obj.name, translation(travel * way))
        leaves = obj.parent is not None and not self._stays_over(obj.parent, self.world(obj.name).mean(axis=0))
        deeper = any(now > max(depth + 1e-3, was.get(key, 0.0)) for key, now in self._depths(group).items())
        if leaves or deeper:
            self.poses = before
            return None
        return Disturbance(obj.name, "pushed", depth, target)

    def _pair(self, obj: PerturbedObject, target: str) -> Colliders:
        """An object against a target that stays where it is."""
        if target in self.walls:
            return Colliders([obj.solid], [self.walls[target]])
        return Colliders([obj.solid], [ConvexParts(target, self.objects[target].solid.placed(self.poses[target]))])

    def _depths(self, group: set[str]) -> dict[tuple[str, str], float]:
        """Depths of the pairs of which one object is in a group and the other is not [m]."""
        contacts = self.everything.penetrations(np.array([self.poses[name] for name in self.names]))
        return {(p.a, p.b): p.depth_m for p in contacts if (p.a in group) != (p.b in group)}

    def _nearest(self, obj: PerturbedObject, busy: set[str]) -> tuple[str, Array, float] | None:
        """The nearest neighbor or wall, the horizontal unit vector to it, shape (3,), and its distance [m]."""
        from shapely.geometry import MultiPoint
        from shapely.ops import nearest_points

        own, points = set(self.group(obj.name)), self.world(obj.name)
        ring, low, high = MultiPoint(points[:, :2]).convex_hull, points[:, 2].min(), points[:, 2].max()
        candidates = {name: wall.hulls[0].vertices for name, wall in self.walls.items()}
        for name, other in self.objects.items():
            if name not in own and name not in busy and not other.is_let_in and other.parent == obj.parent:
                candidates[name] = self.world(name)
        ways: list[tuple[float, str, Array]] = []
        for name, corners in candidates.items():
            if min(high, corners[:, 2].max()) - max(low, corners[:, 2].min()) < 2 * LEAST_M:
                continue
            outline = MultiPoint(corners[:, :2]).convex_hull
            gap = float(ring.distance(outline))
            if gap > NEAR_M:
                continue
            here, there = nearest_points(ring, outline)
            way = np.array([there.x - here.x, there.y - here.y])
            if gap < 1e-6:  # a seat under a table: towards its middle
                way = np.array(outline.centroid.coords[0]) - np.array(ring.centroid.coords[0])
            if np.linalg.norm(way) > 1e-9:
                ways.append((gap, name, np.array([*(way / np.linalg.norm(way)), 0.0])))
        if not ways:
            return None
        gap, name, way = min(ways, key=lambda choice: (choice[0], choice[1]))
        return name, way, gap


def _travel(pair: Colliders, pose: Array, way: Array, gap: float, depth: float) -> float | None:
    """How far an object is to be moved along `way`, shape (3,), until it is in its target by `depth` [m]; None if never."""

    def deep(travel: float) -> float:
        contacts = pair.penetrations((translation(travel * way) @ pose)[None])
        return max((p.depth_m for p in contacts if p.b != "floor"), default=0.0)

    step = 0.005
    reached = gap
    while deep(reached) < depth:
        reached += step
        if reached > gap + 3 * MOST_M:
            return None
    low, high = max(reached - step, 0.0), reached
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if deep(middle) >= depth else (middle, high)
    return high
