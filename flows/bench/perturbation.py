"""Disturbances of furnished rooms, by a rule that no optimization knows: things pushed into others, shifted, turned, lifted.

A thing takes along what it carries. Every draw comes from one generator.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tasks.optimization.contacts import Colliders
from tasks.optimization.solids import Solid
from tasks.transforms import translation, yaw_pose

Array = NDArray[np.float64]
Kind = Literal["pushed", "shifted", "turned", "raised", "sunk"]

LEAST_M, MOST_M = 0.01, 0.10
"""Depths of pushes, lengths of shifts, and heights [m]: what scans and annotators are off by, up to a bad case."""

HUNG_MOST_M = 0.05
"""The same at most for what hangs [m]."""

MOST_TURN = float(np.radians(8.0))
"""Greatest turn [rad]."""

NEAR_M = 0.4
"""Farthest neighbor that a thing is pushed into [m]: more is no disturbance, but another room."""

SHARES: tuple[tuple[Kind, float], ...] = (("shifted", 0.2), ("turned", 0.15), ("raised", 0.1), ("sunk", 0.1), ("pushed", 0.25))
"""Share of the things that each disturbance is tried on, in the order in which they are done."""


@dataclasses.dataclass(frozen=True)
class Thing:
    """A thing of a furnished room. pose: to the world, 4x4 [m]. relation: `floor`, `on`, `wall` or `ceiling`; parent: what
    it stands on. is_let_in: it belongs to the room (doors, windows, rugs) and stays as it is."""

    name: str
    solid: Solid
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
    """What was done to a thing. amount: length of a shift, height, or depth of a push [m], or turn [rad]. target: what it
    was pushed into, an instance or a part of the room's shell."""

    name: str
    kind: Kind
    amount: float
    target: str | None = None


def disturb(
    things: Sequence[Thing], walls: Sequence[Solid], rng: np.random.Generator, shares: Sequence[tuple[Kind, float]] = SHARES
) -> tuple[dict[str, Array], list[Disturbance]]:
    """Poses after the disturbances, 4x4 by name [m], and what was done, in order. walls: in the world frame [m].

    Each thing is disturbed once at most. Pushes come last, and neither a pushed thing nor what it was pushed into is
    moved again, so that every planted overlap is there in the end.
    """
    room = _Room(things, walls)
    done: list[Disturbance] = []
    busy: set[str] = set()
    for kind, share in shares:
        free = [thing for thing in things if not thing.is_let_in and thing.name not in busy]
        count = min(round(share * len(things)), len(free))
        for index in rng.permutation(len(free))[:count]:
            thing = free[index]
            if thing.name in busy:
                continue
            found = room.push(thing, rng, busy) if kind == "pushed" else room.misplace(thing, kind, rng)
            if found is not None:
                done.append(found)
                busy |= {thing.name}
                if found.target is not None:
                    busy |= room.lineage(thing.name) | room.lineage(found.target)
    return room.poses, done


class _Room:
    """Things at their present poses, and what moves along with what."""

    def __init__(self, things: Sequence[Thing], walls: Sequence[Solid]) -> None:
        self.things: Mapping[str, Thing] = {thing.name: thing for thing in things}
        self.poses = {thing.name: thing.pose.copy() for thing in things}
        self.walls = {wall.name: wall for wall in walls}
        self.names = list(self.things)
        self.everything = Colliders([thing.solid for thing in things], list(walls))

    def group(self, name: str) -> list[str]:
        """A thing and all it carries, directly or through others."""
        return [other for other in self.names if name in self.below(other)]

    def below(self, name: str) -> list[str]:
        """A thing and what carries it, down to the floor."""
        chain = [name]
        while (parent := self.things[chain[-1]].parent) is not None:
            chain.append(parent)
        return chain

    def lineage(self, name: str) -> set[str]:
        """Everything whose motion could move a thing, and all it carries; nothing for a part of the room."""
        return {*self.below(name), *self.group(name)} if name in self.things else set()

    def move(self, name: str, motion: Array) -> None:
        """Move a thing and all it carries by a rigid motion of the world, 4x4 [m]."""
        for other in self.group(name):
            self.poses[other] = motion @ self.poses[other]

    def world(self, name: str) -> Array:
        """Corners of a thing's pieces in the world frame [m], shape (n, 3)."""
        pose = self.poses[name]
        return np.asarray(self.things[name].points @ pose[:3, :3].T + pose[:3, 3], dtype=np.float64)

    def misplace(self, thing: Thing, kind: Kind, rng: np.random.Generator) -> Disturbance | None:
        """Shift, turn, raise or sink a thing; None where a carried one would leave its carrier, or a hanging one its wall."""
        hangs = thing.relation in ("wall", "ceiling")
        if hangs and kind != "shifted":
            return None
        length = float(rng.uniform(LEAST_M, HUNG_MOST_M if hangs else MOST_M))
        if kind == "shifted":
            angle = float(rng.uniform(-np.pi, np.pi))
            offset = length * np.array([np.cos(angle), np.sin(angle), 0.0])
            if thing.parent is not None and not self._stays_over(thing.parent, self.world(thing.name).mean(axis=0) + offset):
                return None
            self.move(thing.name, translation(offset))
            return Disturbance(thing.name, kind, length)
        if kind == "turned":
            turn = float(rng.uniform(np.radians(1.0), MOST_TURN)) * float(rng.choice([-1.0, 1.0]))
            at = self.poses[thing.name][:3, 3]
            self.move(thing.name, translation(at) @ yaw_pose(turn) @ translation(-at))
            return Disturbance(thing.name, kind, abs(turn))
        self.move(thing.name, translation([0.0, 0.0, length if kind == "raised" else -length]))
        return Disturbance(thing.name, kind, length)

    def _stays_over(self, parent: str, point: Array) -> bool:
        """Whether a point lies over or under what a carrier covers in plan."""
        from shapely.geometry import MultiPoint, Point

        return bool(MultiPoint(self.world(parent)[:, :2]).convex_hull.contains(Point(point[:2])))

    def push(self, thing: Thing, rng: np.random.Generator, busy: set[str]) -> Disturbance | None:
        """Push a thing sideways into its nearest neighbor or wall until it is in it by a drawn depth.

        Neighbors stand on the same thing, at the same height. A depth that a thin neighbor has no room for is halved.
        None where nothing is near, or where the thing would get deeper into something else.
        """
        depth = float(rng.uniform(LEAST_M, MOST_M))
        if thing.relation in ("wall", "ceiling"):
            return None
        found = self._nearest(thing, busy)
        if found is None:
            return None
        target, way, gap = found
        pair = self._pair(thing, target)
        travel = None
        while travel is None and depth >= LEAST_M:
            travel = _travel(pair, self.poses[thing.name], way, gap, depth)
            depth = depth if travel is not None else 0.5 * depth
        if travel is None:
            return None
        before, group = dict(self.poses), set(self.group(thing.name))
        was = self._depths(group)
        self.move(thing.name, translation(travel * way))
        leaves = thing.parent is not None and not self._stays_over(thing.parent, self.world(thing.name).mean(axis=0))
        deeper = any(now > max(depth + 1e-3, was.get(key, 0.0)) for key, now in self._depths(group).items())
        if leaves or deeper:
            self.poses = before
            return None
        return Disturbance(thing.name, "pushed", depth, target)

    def _pair(self, thing: Thing, target: str) -> Colliders:
        """A thing against a target that stays where it is."""
        if target in self.walls:
            return Colliders([thing.solid], [self.walls[target]])
        return Colliders([thing.solid], [Solid(target, self.things[target].solid.placed(self.poses[target]))])

    def _depths(self, group: set[str]) -> dict[tuple[str, str], float]:
        """Depths of the pairs of which one thing is in a group and the other is not [m]."""
        found = self.everything.penetrations(np.array([self.poses[name] for name in self.names]))
        return {(p.a, p.b): p.depth_m for p in found if (p.a in group) != (p.b in group)}

    def _nearest(self, thing: Thing, busy: set[str]) -> tuple[str, Array, float] | None:
        """The nearest neighbor or wall, the horizontal unit vector to it, shape (3,), and its distance [m]."""
        from shapely.geometry import MultiPoint
        from shapely.ops import nearest_points

        own, points = set(self.group(thing.name)), self.world(thing.name)
        ring, low, high = MultiPoint(points[:, :2]).convex_hull, points[:, 2].min(), points[:, 2].max()
        candidates = {name: wall.hulls[0].vertices for name, wall in self.walls.items()}
        for name, other in self.things.items():
            if name not in own and name not in busy and not other.is_let_in and other.parent == thing.parent:
                candidates[name] = self.world(name)
        found: list[tuple[float, str, Array]] = []
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
                found.append((gap, name, np.array([*(way / np.linalg.norm(way)), 0.0])))
        if not found:
            return None
        gap, name, way = min(found, key=lambda one: (one[0], one[1]))
        return name, way, gap


def _travel(pair: Colliders, pose: Array, way: Array, gap: float, depth: float) -> float | None:
    """How far a thing is to be moved along `way`, shape (3,), until it is in its target by `depth` [m]; None if never."""

    def deep(travel: float) -> float:
        found = pair.penetrations((translation(travel * way) @ pose)[None])
        return max((p.depth_m for p in found if p.b != "floor"), default=0.0)

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
