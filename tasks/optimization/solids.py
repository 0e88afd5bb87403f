"""Placed things and the room as convex pieces: what collides, what certificates and contacts are computed from."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Room
from tasks.pieces import Hull
from tasks.replica import ShellConfig, room_shell

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Solid:
    """Convex pieces of one thing. name: instance id, or the part of the room's shell. hulls: scaled, in the asset's own
    frame (+Z up, origin at the bottom center), in the world frame for the shell [m]."""

    name: str
    hulls: tuple[Hull, ...]

    def placed(self, pose: Array) -> tuple[Hull, ...]:
        """The pieces moved by a rigid pose, 4x4 [m]."""
        return tuple(hull.transformed(pose) for hull in self.hulls)


@dataclasses.dataclass(frozen=True)
class Body:
    """A solid with what physics needs to know. materials: words of `tasks/captions/materials.csv`, most likely first.
    is_fixed: fastened to the room."""

    solid: Solid
    mass_kg: float
    friction: float
    materials: tuple[str, ...]
    is_fixed: bool


def shell_solids(room: Room, thickness_m: float = ShellConfig.thickness_m) -> tuple[Solid, ...]:
    """The room's walls as convex solids in the world frame: `wall_00`, ..., `inner_00`, ... The floor, z = 0, is none of them.

    `thickness_m`: of the outer walls, where they have room for it behind them.

    Raises:
        InputError: the floor polygon has no area or crosses itself, or an interior wall has no size.
    """
    parts = [(name, mesh) for name, mesh in room_shell(room, ShellConfig(thickness_m=thickness_m)) if name != "floor"]
    return tuple(Solid(name, (Hull(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64)),)) for name, mesh in parts)
