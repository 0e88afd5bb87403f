"""Layouts: what is on, in or leans on a large object, as arrays, in the frame of the large object."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.micro_scenes import MicroScene, MicroSceneObject

Array = NDArray[np.float64]

UNKNOWN_ROOM = "unknown"
"""Kind of a room of which nobody says what it is."""


@dataclasses.dataclass(frozen=True)
class Large:
    """A large object that is given. size: Extents of its box [m], shape (3,): depth (x, front to back), width (y), height (z)."""

    category: str
    size: tuple[float, float, float]
    room_type: str = UNKNOWN_ROOM


@dataclasses.dataclass(frozen=True)
class Layout:
    """Small objects of a large one, in its frame: right-handed, +Z up, origin at the middle of the bottom of its box, +X its front.

    categories: Of the small objects, n of them. centers: Middles of their boxes [m], shape (n, 3). sizes: Extents of these boxes along
    axes turned by the yaws [m], shape (n, 3). yaws: Turns of their fronts about +Z from the front of the large object [rad], shape (n,).
    """

    large: Large
    categories: tuple[str, ...]
    centers: Array
    sizes: Array
    yaws: Array

    def __post_init__(self) -> None:
        count = len(self.categories)
        for name, shape in (("centers", (count, 3)), ("sizes", (count, 3)), ("yaws", (count,))):
            value = np.asarray(getattr(self, name), dtype=np.float64).reshape(shape)
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.categories)


def layouts_of(micro_scenes: Sequence[MicroScene], objects: Iterable[MicroSceneObject]) -> list[Layout]:
    """Micro-scenes as layouts, in the order of the micro-scenes; their objects in the order of their ids."""
    belonging: dict[tuple[str, str], list[MicroSceneObject]] = {}
    for row in objects:
        belonging.setdefault((row.scene_id, row.large_id), []).append(row)
    made = []
    for scene in micro_scenes:
        rows = sorted(belonging.get((scene.scene_id, scene.instance_id), []), key=lambda row: row.instance_id)
        depth, width, height = scene.box_size
        made.append(
            Layout(
                Large(scene.category, (depth, width, height), scene.room_type),
                tuple(row.category for row in rows),
                np.array([row.box_center for row in rows]),
                np.array([row.box_size for row in rows]),
                np.array([row.yaw_radians for row in rows]),
            )
        )
    return made
