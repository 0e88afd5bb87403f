"""Rooms of plates and boxes, scanned in whatever frame, for tests of rescans."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface, sample_surface
from tasks.geometry.transforms import transform_points, yaw_pose
from tasks.rescans.surfaces import OBJECT_SPACING_M, RoomScan, ScannedObject, room_of_surface, thinned
from tests.capture_scans import box_plates, plate

Array = NDArray[np.float64]
Mesh = tuple[Array, NDArray[np.int64]]


@dataclasses.dataclass(frozen=True)
class Thing:
    """An object of boxes: name, category, where (x, y, z of its bottom) and how it is turned, and its boxes (center, size) in its frame."""

    name: str
    category: str
    place: tuple[float, float, float]
    yaw: float
    boxes: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]
    is_named: bool = True

    def mesh(self) -> Mesh:
        """Its surface in the room."""
        own = yaw_pose(self.yaw, self.place)
        parts = [box_plates(size, own @ yaw_pose(0.0, center)) for center, size in self.boxes]
        return joined(parts)


def joined(parts: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return np.concatenate([v for v, _ in parts]), np.concatenate([f + start for (_, f), start in zip(parts, starts, strict=False)])


def box(name: str, category: str, place: tuple[float, float, float], size: tuple[float, float, float], yaw: float = 0.0) -> Thing:
    """An object of one box."""
    return Thing(name, category, place, yaw, (((0.0, 0.0, size[2] / 2), size),))


def chair(name: str, place: tuple[float, float, float], yaw: float) -> Thing:
    """A seat with a back: it looks one way."""
    return Thing(name, "chair", place, yaw, (((0.0, 0.0, 0.22), (0.45, 0.45, 0.44)), ((-0.2, 0.0, 0.66), (0.05, 0.45, 0.44))))


SIZE = (4.4, 3.2)

FIXED = (
    box("bed", "bed", (0.9, 0.8, 0.0), (1.6, 1.4, 0.5)),
    box("cabinet", "cabinet", (4.1, 1.0, 0.0), (0.5, 1.2, 1.8)),
    box("desk", "desk", (2.6, 2.85, 0.0), (1.4, 0.6, 0.74)),
    chair("still", (2.6, 2.2, 0.0), -1.57),
)


def scanned(
    name: str, things: Sequence[Thing], size: tuple[float, float] = SIZE, frame: Array | None = None, walls: Sequence[int] = (0, 1, 2, 3),
    floor: tuple[float, float] | None = None,
) -> RoomScan:  # fmt: skip
    """A scan of a room with things in it, in a frame: pose of the room in it, 4x4 [m]. walls: Those that were seen; floor: how much of it
    was, from the corner on."""
    frame = np.eye(4) if frame is None else frame
    x, y = size
    corners = [(0.0, 0.0), (x, 0.0), (x, y), (0.0, y)]
    parts = [plate((0.0, 0.0, 0.0), (*((floor or size)[:1]), 0.0, 0.0), (0.0, (floor or size)[1], 0.0))]
    for index in walls:
        (a, b), (c, d) = corners[index], corners[(index + 1) % 4]
        parts.append(plate((a, b, 0.0), (c - a, d - b, 0.0), (0.0, 0.0, 2.5)))
    parts += [thing.mesh() for thing in things]
    vertices, faces = joined(parts)
    surface = Surface(transform_points(vertices, frame), faces, np.zeros((len(vertices), 3), np.uint8))
    named = [(number, thing) for number, thing in enumerate(things) if thing.is_named]
    rngs = [np.random.default_rng([ord(name[-1]), number]) for number, _ in named]
    objects = [_object(f"{number:04d}", thing, frame, rng) for (number, thing), rng in zip(named, rngs, strict=True)]
    return room_of_surface(name, surface, objects, np.random.default_rng(7))


def _object(instance_id: str, thing: Thing, frame: Array, rng: np.random.Generator) -> ScannedObject:
    """An object with points of its own of every scan: no two scans meet a surface in the same places."""
    vertices, faces = thing.mesh()
    own = yaw_pose(thing.yaw, thing.place)
    local = transform_points(vertices, np.linalg.inv(own))
    low, high = local.min(axis=0), local.max(axis=0)
    pose = frame @ own @ yaw_pose(0.0, 0.5 * (low + high))
    points, _, normals = sample_surface(Surface(vertices, faces, np.zeros((len(vertices), 3), np.uint8)), 4000, rng)
    points, _ = thinned(transform_points(points, frame), normals, OBJECT_SPACING_M)
    return ScannedObject(instance_id, thing.category, pose, high - low, points)
