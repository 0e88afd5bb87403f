"""The inner faces of a room's walls: what hangs on them or stands against them, and where a hanging object's back belongs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Shell
from schemas.errors import InputError
from tasks.mounting import mounting
from tasks.shell import floor_ring, interior_footprints, is_open_side

if TYPE_CHECKING:
    from tasks.optimization.support.supports import Carrier, PlacedAsset

Array = NDArray[np.float64]

BEHIND_M = 0.3
"""An object that lies wholly farther behind a wall's inner face than this belongs to another room."""


_SAME_M = 1e-3
"""Ends of one face, stated twice, are no farther apart."""


@dataclasses.dataclass(frozen=True)
class WallFace:
    """A face of a wall that looks into the room, in the world frame [m].

    name: part of the room's shell; None for a wall that was scanned where the shell has none. start: one end, shape (2,).
    along: unit vector to the other end. inward: unit normal into the room. height: of its top over the floor. behind: what lies wholly
    farther behind it belongs to another room; an interior wall has one behind its other face, the middle of the wall between them.
    """

    name: str | None
    start: Array
    along: Array
    inward: Array
    length: float
    height: float
    behind: float = BEHIND_M


@dataclasses.dataclass(frozen=True)
class WallContact:
    """How an object lies to a wall's face [m]: distance of its back (negative when it sinks in), its depth and width."""

    face: WallFace
    distance: float
    depth: float
    width: float


def wall_faces(room: Shell) -> list[WallFace]:
    """Inner faces of the room's shell, and of scanned walls that are none of the shell's."""
    faces: list[WallFace] = []
    try:
        ring = floor_ring(room)
        sides = list(zip(ring, np.roll(ring, -1, axis=0), strict=True))
        faces += [_face(f"wall_{i:02d}", a, b, room.height_m) for i, (a, b) in enumerate(sides) if not is_open_side(room, a, b)]
        for i, (wall, corners) in enumerate(zip(room.interior_walls, interior_footprints(room), strict=True)):
            # the room lies to the right of the footprint's edges
            behind = min(BEHIND_M, 0.5 * wall[4])
            faces += [_face(f"inner_{i:02d}", b, a, wall[5], behind) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    except InputError:
        pass  # the shell cannot be built, which the stage says; the scanned walls are known all the same
    scanned = [
        _face(None, np.array(w[:2]), np.array(w[2:4]), room.height_m) for w in room.walls if np.hypot(w[2] - w[0], w[3] - w[1]) > 1e-6
    ]
    # what is a part of the shell ends where that ends, half-height walls below the ceiling
    return faces + [face for face in scanned if not any(_is_same(face, other) for other in faces)]


def _is_same(face: WallFace, other: WallFace) -> bool:
    """Whether two faces are one."""
    return bool(
        np.allclose(face.start, other.start, rtol=0.0, atol=_SAME_M)
        and np.allclose(face.start + face.length * face.along, other.start + other.length * other.along, rtol=0.0, atol=_SAME_M)
    )


def wall_contact(obj: PlacedAsset, faces: Sequence[WallFace], within: float) -> WallContact | None:
    """The face that an object's back is nearest to, at most `within` [m] before it; None when there is none.

    In a corner it is the face that more of the object lies along.
    """
    touching: list[WallContact] = []
    for face in faces:
        contact = _contact(obj, face, within)
        if contact is not None:
            touching.append(contact)
    if not touching:
        return None
    # parts of the shell before scanned walls, then broad backs, then near ones
    return min(touching, key=lambda c: (c.face.name is None, round(np.log2(c.depth / c.width)), abs(c.distance)))


def stands_against(obj: PlacedAsset, faces: Sequence[WallFace], within: float) -> str | None:
    """The part of the room's shell whose face a standing object's flat side is at, at most `within` [m] off; None without one."""
    contact = wall_contact(obj, [face for face in faces if face.name is not None], within)
    if contact is None:
        return None
    points = obj.plan_points
    near = points[(points - contact.face.start) @ contact.face.inward <= contact.distance + within]
    # a corner that touches a wall is no side that stands along it
    return contact.face.name if np.ptp(near @ contact.face.along) >= 0.4 * contact.width else None


def wall_snap(obj: PlacedAsset, room: Shell, carrier: Carrier, wall_m: float = 0.12) -> tuple[float, float]:
    """The shortest horizontal move (dx, dy) [m] that brings a hanging object's back onto its wall's inner face.

    Out of the wall however deep it sinks in, onto the wall from `wall_m` [m] at most. Zero for what hangs on no part of
    the room's shell, and for doors and windows, which are let into it.
    """
    if carrier.relation != "wall" or carrier.against is None or mounting(obj.category).kind == "let_in":
        return 0.0, 0.0
    contact = wall_contact(obj, [face for face in wall_faces(room) if face.name == carrier.against], wall_m)
    if contact is None:
        return 0.0, 0.0
    move = -contact.distance * contact.face.inward
    return float(move[0]), float(move[1])


def _face(name: str | None, a: Array, b: Array, height: float, behind: float = BEHIND_M) -> WallFace:
    """The face from `a` to `b`, with the room to its left."""
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    return WallFace(name, np.asarray(a, dtype=np.float64), along, np.array([-along[1], along[0]]), length, float(height), behind)


def _contact(obj: PlacedAsset, face: WallFace, within: float) -> WallContact | None:
    """How an object lies to one face; None when it is too far away, or mostly beside or above the face."""
    if obj.low[2] > face.height:
        return None
    # the box says no for nearly every pair
    center, half = 0.5 * (obj.low + obj.high)[:2] - face.start, 0.5 * (obj.high - obj.low)[:2]
    off, reach = float(center @ face.inward), float(half @ np.abs(face.inward))
    if off - reach > within or off + reach < -face.behind:
        return None
    at, spread = float(center @ face.along), float(half @ np.abs(face.along))
    if at + spread < 0 or at - spread > face.length:
        return None
    points = obj.plan_points - face.start
    along, away = points @ face.along, points @ face.inward
    low, high = float(along.min()), float(along.max())
    if min(high, face.length) - max(low, 0.0) < 0.5 * (high - low):
        return None
    distance, far = float(away.min()), float(away.max())
    if not (distance <= within and far >= -face.behind):
        return None
    return WallContact(face, distance, max(far - distance, 1e-4), max(high - low, 1e-4))
