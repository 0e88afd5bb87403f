"""Placed objects and the room as convex pieces: what collides, what certificates and contacts are computed from."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import OrderedDict
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Shell
from tasks.geometry.colliders import ColliderShares
from tasks.geometry.mass import MassProperties, mass_properties
from tasks.geometry.pieces import Hull
from tasks.shell import ShellConfig, room_shell, wall_of

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ConvexParts:
    """Convex pieces of one object. name: instance id, or the part of the room's shell. hulls: scaled, in the asset's own
    frame (+Z up, origin at the bottom center), in the world frame for the shell [m]. properties: mass properties of the
    pieces' union, shares: how well they stand for what is seen, where these are known already. blob: where pieces are kept that
    are this object's alone."""

    name: str
    hulls: tuple[Hull, ...]
    properties: MassProperties | None = None
    shares: ColliderShares | None = None
    blob: str | None = None

    @cached_property
    def volumes(self) -> tuple[float, ...]:
        """Volume of every piece [m3], not a number where a vertex is not finite."""
        return tuple(hull.volume if np.isfinite(hull.vertices).all() else np.nan for hull in self.hulls)

    def placed(self, pose: Array) -> tuple[Hull, ...]:
        """The pieces moved by a rigid pose, 4x4 [m]."""
        return tuple(hull.transformed(pose) for hull in self.hulls)


@dataclasses.dataclass(frozen=True)
class RigidBody:
    """A solid with what physics needs to know. materials: words of `tasks/captions/materials.csv`, most likely first.
    is_fixed: fastened to the room."""

    solid: ConvexParts
    mass_kg: float
    friction: float
    materials: tuple[str, ...]
    is_fixed: bool


def mass_properties_of(solid: ConvexParts) -> MassProperties:
    """Mass properties of the union of a solid's pieces for unit density, remembered by content: a union takes milliseconds."""
    if solid.properties is not None:
        return solid.properties
    key = hashlib.sha256(b"".join(part for hull in solid.hulls for part in (hull.vertices.tobytes(), b"|", hull.faces.tobytes()))).digest()
    if key not in _memo:
        _memo[key] = mass_properties(solid.hulls)
        while len(_memo) > _MEMO_SIZE:
            _memo.popitem(last=False)
    _memo.move_to_end(key)
    return _memo[key]


_memo: OrderedDict[bytes, MassProperties] = OrderedDict()
_MEMO_SIZE = 4096  # 200 bytes each


def shell_solids(room: Shell, thickness_m: float = ShellConfig.thickness_m) -> tuple[ConvexParts, ...]:
    """The room's walls as convex solids in the world frame: `wall_00`, ..., `inner_00`, ... The floor, z = 0, is none of them.

    `thickness_m`: of the outer walls, where they have room for it behind them.

    Raises:
        InputError: the floor polygon has no area or crosses itself, or an interior wall has no size.
    """
    walls: dict[str, list[Hull]] = {}
    for name, mesh in room_shell(room, ShellConfig(thickness_m=thickness_m)):
        if name != "floor":
            walls.setdefault(wall_of(name), []).append(Hull(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64)))
    return tuple(ConvexParts(name, tuple(hulls)) for name, hulls in walls.items())
