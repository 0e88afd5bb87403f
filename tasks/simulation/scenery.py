"""What cameras see of a replica: floor, walls and ceiling with their pictures, and the assets where they were placed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from schemas.candidates import Asset
from schemas.capture import Instance, RoomSurface, Shell
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.replica import placed_parts
from tasks.shell import room_shell
from tasks.simulation.soups import Soup, soup_of
from tasks.surfaces import textured

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class VisibleParts:
    """The triangles of a scene, world frame, and what each part is.

    soup: Triangles. instance_ids: Instance of each part, None for floor, walls and ceiling. categories: Of each part; names of slabs, as
    `tasks.shell.room_shell` gives them, for floor, walls and ceiling.
    """

    soup: Soup
    instance_ids: tuple[str | None, ...]
    categories: tuple[str, ...]

    def things(self, instances: Sequence[Instance]) -> list[str]:
        """Category of each part that is of an object; empty for floor, walls and ceiling, and for instances of structure."""
        structure = {instance.instance_id for instance in instances if instance.is_structure}
        owned = zip(self.instance_ids, self.categories, strict=True)
        return ["" if owner is None or owner in structure else category for owner, category in owned]


def scenery(
    shell: Shell | None, surfaces: Sequence[RoomSurface], placements: Sequence[Placement], assets: Sequence[Asset],
    instances: Sequence[Instance], blobs: Mapping[str, bytes],
) -> VisibleParts:  # fmt: skip
    """A scene from its rows in the lake and the blobs that they name; without a shell nothing but its objects.

    Raises:
        InputError: a placement's asset or instance, or a blob, is not there, or a mesh cannot be read.
    """
    gone = sorted(row.surface for row in surfaces if row.texture_blob not in blobs) if shell is not None else []
    if shell is not None and gone:
        raise InputError(shell.scene_id, f"surface {gone[0]}", "its image is not in the lake", "run the capture stage again")
    known, named = {asset.asset_id: asset for asset in assets}, {instance.instance_id: instance for instance in instances}
    parts: list[trimesh.Trimesh] = []
    owners: list[tuple[str | None, str]] = []
    for name, slab in textured(room_shell(shell), surfaces, blobs) if shell is not None else ():
        parts.append(slab)
        owners.append((None, name))
    for placement in sorted(placements, key=lambda row: row.instance_id):
        asset, instance = known.get(placement.asset_id), named.get(placement.instance_id)
        if asset is None or instance is None:
            what, stage = ("asset", "candidates") if asset is None else ("instance", "capture")
            problem = f"its {what} is not in {what}s"
            raise InputError(placement.scene_id, f"placement {placement.instance_id}", problem, f"run the {stage} stage again")
        if asset.mesh_blob not in blobs:
            problem = f"its mesh {asset.mesh_blob[:12]} is not in the lake"
            raise InputError(placement.scene_id, f"placement {placement.instance_id}", problem, "run the candidates stage again")
        placed = placed_parts(placement, blobs[asset.mesh_blob])
        parts += placed
        owners += [(instance.instance_id, instance.category)] * len(placed)
    return VisibleParts(soup_of(parts), tuple(owner for owner, _ in owners), tuple(category for _, category in owners))
