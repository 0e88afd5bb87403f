"""The room that a film shows from above, as meshes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from schemas.candidates import Asset
from schemas.capture import RoomSurface, Shell
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.replica import placed_parts
from tasks.shell import room_shell
from tasks.stats.scenes import RoomOutline
from tasks.surfaces import textured

if TYPE_CHECKING:
    import trimesh

INNER_M = 1.1
"""Interior walls are cut off at this height: below it the camera sees over them into the rooms behind."""


@dataclasses.dataclass(frozen=True)
class FilmedRoom:
    """Floor and walls, and the parts of every placed object by instance, in the world frame [m]."""

    walls: list[trimesh.Trimesh]
    objects: Mapping[str, list[trimesh.Trimesh]]
    outline: RoomOutline


def filmed_room(
    shell: Shell | None, surfaces: Sequence[RoomSurface], placements: Sequence[Placement], assets: Sequence[Asset],
    blobs: Mapping[str, bytes],
) -> FilmedRoom:  # fmt: skip
    """A room from its rows in the lake and the blobs that they name.

    Raises:
        InputError: nothing is there to be seen, or a mesh cannot be read.
    """
    named = {asset.asset_id: asset.mesh_blob for asset in assets}
    objects = {row.instance_id: placed_parts(row, blobs[named[row.asset_id]]) for row in placements}
    bare = textured(room_shell(shell), surfaces, blobs) if shell is not None else []
    every = [part for parts in objects.values() for part in parts]
    if shell is None and not every:
        raise InputError("placements", "scene", "has neither room nor objects", "run the capture and optimization stages again")
    outline = RoomOutline.of_room(shell) if shell is not None else RoomOutline.of_parts(every)
    return FilmedRoom([low for name, part in bare for low in _lowered(name, part)], objects, outline)


def _lowered(name: str, part: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """A part of the shell, of interior walls what is below `INNER_M`."""
    if not name.startswith("inner"):
        return [part]
    if part.bounds[0, 2] >= INNER_M:
        return []
    low = part.copy()
    vertices = np.array(part.vertices)
    vertices[:, 2] = np.minimum(vertices[:, 2], INNER_M)
    low.vertices = vertices
    return [low]
