"""Things that stand elsewhere than the map says: small furniture that was moved after the scan, with all that stands on it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.transforms import translation, yaw_pose
from tasks.robot.configuration import Displacement
from tasks.robot.floor_map import Envelope, Floor

if TYPE_CHECKING:
    import shapely

    from tasks.exports.bodies import Replica

Array = NDArray[np.float64]

GAP_M = 0.01
"""What is moved keeps this far from everything else [m]: nothing touches where it did not before."""

REST_M = 0.005
"""What stands on a thing may reach this far into it [m]; only what overlaps by more in height can be in each other's way."""

PLACES = 50
"""Places that are tried for a thing before it stays: of those in a room that is half full, one in ten is free."""


class PlanarMotion(NamedTuple):
    """A turn about an upright axis, then a move on the floor. dx, dy: How far that axis is moved [m]. turn: About +Z [rad].
    x, y: Where the axis was, world frame [m]."""

    dx: float
    dy: float
    turn: float
    x: float
    y: float

    @property
    def matrix(self) -> Array:
        """World to world, rigid 4x4 [m]."""
        moved: Array = translation([self.x + self.dx, self.y + self.dy, 0.0]) @ yaw_pose(self.turn) @ translation([-self.x, -self.y, 0.0])
        return moved

    def of_shape(self, shape: shapely.Geometry) -> shapely.Geometry:
        """A shape on the floor, moved."""
        from shapely.affinity import affine_transform

        m = self.matrix
        return affine_transform(shape, [m[0, 0], m[0, 1], m[1, 0], m[1, 1], m[0, 3], m[1, 3]])

    def of_segments(self, segments: Array) -> Array:
        """Segments, shape (n, 4) [m], moved."""
        m = self.matrix
        ends = segments.reshape(-1, 2) @ m[:2, :2].T + m[:2, 3]
        return ends.reshape(-1, 4)


@dataclasses.dataclass(frozen=True)
class Displaced:
    """A floor as it is, where the map has another.

    motions: By instance, what became of all that does not stand where it stood, carried things included. stayed: By instance, why it could
    not be moved.
    """

    floor: Floor
    motions: Mapping[str, PlanarMotion]
    stayed: Mapping[str, str]


def displaced(floor: Floor, displacement: Displacement, rng: np.random.Generator, keep_clear: ArrayLike, keep_m: float) -> Displaced:
    """A floor on which a share of the small furniture stands elsewhere, with all that it carries.

    What lies wholly below the lidar's plane, as shoes do, is no furniture and stays. A thing goes where it and what it carries overlap
    nothing, by convex hulls seen from above, of what shares their heights; things that lean against it without standing on it stay. Things
    that cannot be moved make place for the next ones.

    Args:
        floor: As the map has it.
        displacement: How many things, how large and how far; at least one thing if the share is above 0 and there is one.
        rng: Draws things and places.
        keep_clear: Points that nothing is moved to, world frame [m], shape (n, 2).
        keep_m: How near to them nothing comes [m].
    """
    furniture = floor.standing & floor.obstacles.keys() & floor.plane.keys()
    small = sorted(name for name in furniture if _side(floor, name) <= displacement.largest_m)
    wanted = max(1, round(displacement.share * len(small))) if displacement.share > 0 and small else 0
    points = np.asarray(keep_clear, dtype=np.float64).reshape(-1, 2)
    motions: dict[str, PlanarMotion] = {}
    stayed: dict[str, str] = {}
    now, count = floor, 0
    for index in rng.permutation(len(small)) if wanted else ():
        if count == wanted:
            break
        name = small[index]
        group = carried_by(floor, name)
        motion = _free_motion(now, name, group, displacement, rng, points, keep_m)
        if motion is None:
            stayed[name] = f"none of {PLACES} places within {displacement.reach_m:g} m is free"
            continue
        moved = dict.fromkeys(group, motion)
        now, count = _with(now, moved), count + 1
        motions |= moved
    return Displaced(now, motions, stayed)


def carried_by(floor: Floor, name: str) -> tuple[str, ...]:
    """A thing and all that stands on it, and on that; sorted, the thing first."""
    group, rest = {name}, dict(floor.carriers)
    while above := {carried for carried, carrier in rest.items() if carrier in group} - group:
        group |= above
    return (name, *sorted(group - {name}))


def moved_poses(replica: Replica, motions: Mapping[str, PlanarMotion]) -> Replica:
    """A replica whose instances are moved."""
    bodies = tuple(
        dataclasses.replace(body, pose=motions[body.instance_id].matrix @ body.pose) if body.instance_id in motions else body
        for body in replica.bodies
    )
    return dataclasses.replace(replica, bodies=bodies)


def _with(floor: Floor, motions: Mapping[str, PlanarMotion]) -> Floor:
    """A floor with some instances moved."""
    obstacles, plane, envelopes = dict(floor.obstacles), dict(floor.plane), dict(floor.envelopes)
    for name, motion in motions.items():
        if name in obstacles:
            obstacles[name] = motion.of_shape(obstacles[name])
        if name in plane:
            plane[name] = motion.of_segments(plane[name])
        if name in envelopes:
            envelopes[name] = envelopes[name]._replace(plan=motion.of_shape(envelopes[name].plan))
    return dataclasses.replace(floor, obstacles=obstacles, plane=plane, envelopes=envelopes)


def _free_motion(
    floor: Floor, name: str, group: Collection[str], displacement: Displacement, rng: np.random.Generator, points: Array, keep_m: float
) -> PlanarMotion | None:
    """A motion that takes a thing, with its group, to where nothing else is; None where none of `PLACES` is such a place. Distances are as
    often short as long, so that there is a way out of a corner, too."""
    import shapely

    center = floor.envelopes[name].plan.centroid if name in floor.envelopes else floor.obstacles[name].centroid
    members = [_envelope(floor, member) for member in group]
    rest = [_envelope(floor, other) for other in sorted({*floor.envelopes, *floor.obstacles}.difference(group))]
    barriers = [np.array([other.plan for other in rest if _share_heights(member, other)], dtype=object) for member in members]
    clear = shapely.multipoints(points)
    for _ in range(PLACES):
        away, toward = displacement.reach_m * rng.random(), 2.0 * math.pi * rng.random()
        turn = displacement.turn_radians * (2.0 * rng.random() - 1.0)
        motion = PlanarMotion(away * math.cos(toward), away * math.sin(toward), turn, center.x, center.y)
        plans = [motion.of_shape(member.plan) for member in members]
        if not all(shapely.covers(floor.polygon, plan) for plan in plans):
            continue
        if len(points) and min(shapely.distance(clear, plan) for plan in plans) < keep_m:
            continue
        if not any((shapely.distance(barrier, plan) < GAP_M).any() for barrier, plan in zip(barriers, plans, strict=True)):
            return motion
    return None


def _envelope(floor: Floor, name: str) -> Envelope:
    """The room that a thing takes; at all heights where only its outline is known."""
    known = floor.envelopes.get(name)
    return known if known is not None else Envelope(floor.obstacles[name].convex_hull, -math.inf, math.inf)


def _share_heights(first: Envelope, second: Envelope) -> bool:
    return min(first.high, second.high) - max(first.low, second.low) > REST_M


def _side(floor: Floor, name: str) -> float:
    """The longer side of a thing, seen from above [m]."""
    import shapely

    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(_envelope(floor, name).plan))
    return float(np.hypot(*np.diff(corners, axis=0).T).max())
