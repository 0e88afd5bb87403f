"""Furniture out of boxes, placed in a room, and the room."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from schemas.capture import Shell
from tasks.geometry.meshes import surface_of
from tasks.geometry.transforms import translation, yaw_pose
from tasks.mounting import mounting
from tasks.optimization.support.supports import (
    PlacedAsset,
    SupportConfig,
)
from tests.samples import sample

SCENE = "demo/room_a"
SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))
CONFIG = SupportConfig()
Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def solid(*boxes: Box) -> list[trimesh.Trimesh]:
    """Boxes of (size, bottom center)."""
    parts = []
    for size, (x, y, z) in boxes:
        part = trimesh.creation.box(size)
        part.apply_translation([x, y, z + size[2] / 2])
        parts.append(part)
    return parts


def block(x: float, y: float, z: float) -> list[trimesh.Trimesh]:
    return solid(((x, y, z), (0, 0, 0)))


def legs(x: float, y: float, thick: float, height: float) -> list[Box]:
    return [((thick, thick, height), (a * x, b * y, 0)) for a in (-1, 1) for b in (-1, 1)]


TABLE = solid(((1.2, 0.8, 0.04), (0, 0, 0.71)), *legs(0.55, 0.35, 0.06, 0.71))
SHELF = solid(*[((0.3, 0.8, 0.02), (0, 0, z)) for z in (0.02, 0.5, 1.0, 1.48)], *[((0.3, 0.02, 1.5), (0, y, 0)) for y in (-0.41, 0.41)])
CHAIR = solid(((0.44, 0.44, 0.04), (0, 0, 0.43)), ((0.04, 0.44, 0.45), (-0.2, 0, 0.47)), *legs(0.2, 0.2, 0.04, 0.43))
SEAT = solid(((0.44, 0.44, 0.04), (0, 0, 0.0)), ((0.04, 0.44, 0.45), (-0.2, 0, 0.04)))  # a chair whose legs no camera saw
BIN = solid(((0.3, 0.3, 0.01), (0, 0, 0)), *[((0.3, 0.01, 0.4), (0, s * 0.145, 0)) for s in (-1, 1)],
            *[((0.01, 0.3, 0.4), (s * 0.145, 0, 0)) for s in (-1, 1)])  # fmt: skip
SOFA = solid(((0.9, 2.0, 0.45), (0, 0, 0)), ((0.2, 2.0, 0.4), (-0.35, 0, 0.45)), *[((0.9, 0.2, 0.15), (0, s * 0.9, 0.45)) for s in (-1, 1)])
CLOTH = solid(((1.3, 0.9, 0.005), (0, 0, 0.2)), *[((1.3, 0.005, 0.2), (0, s * 0.45, 0)) for s in (-1, 1)])
SMALL, STOOL, MAT, FRAME = block(0.1, 0.1, 0.1), block(0.4, 0.4, 0.5), block(1.5, 1, 0.02), block(0.04, 0.5, 0.5)


def upside_down(parts: Sequence[trimesh.Trimesh], top: float) -> list[trimesh.Trimesh]:
    """Turned over about x, so that what was at height `top` is at 0."""
    turned = [part.copy() for part in parts]
    for part in turned:
        part.apply_transform(translation([0, 0, top]) @ np.diag([1.0, -1.0, -1.0, 1.0]))
    return turned


def placed(name: str, parts: Sequence[trimesh.Trimesh], pose: np.ndarray, category: str = "thing") -> PlacedAsset:
    return PlacedAsset.of(name, category, surface_of(parts).transformed(pose), watertight=True)


def at(name: int, parts: Sequence[trimesh.Trimesh], x: float, y: float, z: float, category: str = "thing", yaw: float = 0.0) -> PlacedAsset:
    return placed(f"{name:04d}", parts, yaw_pose(yaw, [x, y, z]), category)


def small(x: float, y: float, z: float, parts: Sequence[trimesh.Trimesh] = SMALL, category: str = "thing") -> PlacedAsset:
    return at(0, parts, x, y, z, category)


def room(polygon: Any = SQUARE, interior: Any = (), walls: Any = ()) -> Shell:
    return sample(Shell, scene_id=SCENE, floor_polygon=polygon, walls=walls, interior_walls=interior, height_m=2.5)


def is_boxy(obj: PlacedAsset) -> bool:
    return mounting(obj.category).is_boxy


BELOW = at(1, TABLE, 0, 0, 0, "table")
