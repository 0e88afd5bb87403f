"""A replica as surfaces: the assets where they were placed, and what of the room's slabs looks into the room."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.capture import RoomSurface, Shell
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.geometry.meshes import Surface, surface_of, union_of
from tasks.geometry.rendering import Camera, RayScene, Rendering, reach
from tasks.geometry.triangles import face_crosses, face_normals
from tasks.replica import placed_parts
from tasks.shell import ShellConfig, floor_ring, room_shell, wall_of
from tasks.surfaces import textured

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

_OVERHEAD = -0.97
"""Vertical part of normals: what looks down more is a lintel; slopes of roofs look down less."""

_INSIDE_M = 0.01
"""A face of a wall looks into the room when the floor is this far before its middle [m]."""

_TURNED = 0.999
"""Cosine from which on a face is turned as its wall is: within 2.6 degrees."""


@dataclasses.dataclass(frozen=True)
class ReplicaSurface:
    """What stands in a replica, world frame [m].

    objects: Parts of every placed asset, by instance. shell: The faces of floor, walls and ceiling that look into the room: their
    backs are nobody's to see, and would pass for surface where a scan looks through a door. slabs: The same faces part by part, with
    their images.
    """

    objects: Mapping[str, Sequence[trimesh.Trimesh]]
    shell: Surface
    slabs: Sequence[trimesh.Trimesh] = ()

    @property
    def owners(self) -> list[str]:
        """The instance that each part of the objects belongs to, in their order."""
        return [name for name, parts in self.objects.items() for _ in parts]


class ReplicaRays:
    """What rays meet in a replica. A wall hides nothing from a camera behind it: the room's outline is estimated, and the
    scan's cameras stood where they stood."""

    def __init__(self, replica: ReplicaSurface) -> None:
        self._objects = RayScene([part for parts in replica.objects.values() for part in parts])
        self._slabs = [(slab, face_crosses(slab.vertices, slab.faces)) for slab in replica.slabs]

    def reach(self, camera: Camera, points: Array) -> Array:
        """How far the rays from a camera through points get before they meet something [m], infinite where they do not, (n,)."""
        return np.minimum(reach(camera, points, self._objects), reach(camera, points, self._before(camera)))

    def render(self, camera: Camera, rays: NDArray[np.float32]) -> Rendering:
        """What the camera sees, unlit. Parts are those of the objects, -1 for the shell."""
        objects, shell = (scene.render(camera, shade=False, rays=rays) for scene in (self._objects, self._before(camera)))
        near = shell.depth < objects.depth
        return Rendering(
            np.where(near, shell.depth, objects.depth), np.where(near, -1, objects.part),
            np.where(near[..., None], shell.color, objects.color), np.where(near[..., None], shell.normal, objects.normal),
        )  # fmt: skip

    def _before(self, camera: Camera) -> RayScene:
        """The faces of the shell whose front the camera sees."""
        eye = camera.pose[:3, 3]
        fronts = [np.einsum("nd,nd->n", crosses, eye - slab.vertices[slab.faces[:, 0]]) > 0 for slab, crosses in self._slabs]
        return RayScene([_with_faces(slab, front) for (slab, _), front in zip(self._slabs, fronts, strict=True) if front.any()])


def replica_surface(
    room: Shell | None, placements: Sequence[Placement], assets: Sequence[Asset], blobs: Mapping[str, bytes],
    surfaces: Sequence[RoomSurface] = (), shell: ShellConfig | None = None,
) -> ReplicaSurface:  # fmt: skip
    """The assets of a scene at their optimized poses, and its room, with the images of those of its surfaces that have one.

    Raises:
        InputError: a placement's asset is not there or cannot be read, or the room's floor has no area.
    """
    known = {asset.asset_id: asset for asset in assets}
    objects = {}
    for placement in sorted(placements, key=lambda p: p.instance_id):
        asset = known.get(placement.asset_id)
        if asset is None:
            problem = f"asset {placement.asset_id[:12]} is not in assets"
            raise InputError(placement.scene_id, f"placement {placement.instance_id}", problem, "run the candidates stage again")
        objects[placement.instance_id] = placed_parts(placement, blobs[asset.mesh_blob])
    if room is None:
        return ReplicaSurface(objects, union_of([]))
    slabs = [_with_faces(part, _inward(room, name, part)) for name, part in textured(room_shell(room, shell), surfaces, blobs)]
    slabs = [slab for slab in slabs if len(slab.faces)]
    return ReplicaSurface(objects, union_of([surface_of([slab]) for slab in slabs]), slabs)


def _with_faces(part: trimesh.Trimesh, chosen: NDArray[np.bool_]) -> trimesh.Trimesh:
    """A part with some of its faces, shape (n,), and all of its vertices."""
    import trimesh

    mesh = trimesh.Trimesh(part.vertices, part.faces[chosen], process=False)
    mesh.visual = part.visual
    return mesh


def _inward(room: Shell, name: str, slab: trimesh.Trimesh) -> NDArray[np.bool_]:
    """Which faces of a slab look into the room: the floor's top, the ceiling's underside, what has floor before it, and the backs of an
    outer wall's niches, however deep."""
    import shapely

    ring = floor_ring(room)
    floor = shapely.Polygon(ring)
    vertices, faces = np.asarray(slab.vertices, dtype=np.float64), np.asarray(slab.faces, dtype=np.int64)
    normals, middles = face_normals(vertices, faces), vertices[faces].mean(axis=1)
    if name == "ceiling":
        under: NDArray[np.bool_] = normals[:, 2] < -0.5
        return under
    looks_in: NDArray[np.bool_] = shapely.contains_xy(floor, *(middles + _INSIDE_M * normals)[:, :2].T)
    kind, _, number = wall_of(name).partition("_")
    if kind == "wall":
        looks_in |= _niche_backs(room, ring[int(number)], ring[(int(number) + 1) % len(ring)], normals, middles)
    is_top = (normals[:, 2] > 0.5) & (middles[:, 2] < _INSIDE_M)
    is_side = (normals[:, 2] > _OVERHEAD) & (normals[:, 2] < 0.5)
    inward: NDArray[np.bool_] = (is_side & looks_in) | is_top
    return inward


def _niche_backs(room: Shell, start: Array, end: Array, normals: Array, middles: Array) -> NDArray[np.bool_]:
    """Which faces of the outer wall from start to end, shape (2,), close an opening of it: those turned as the wall is, before
    which there is the opening, as deep as what fills it or the wall. Normals and middles of faces [m]: shape (n, 3)."""
    along = (end - start) / np.linalg.norm(end - start)
    inward = np.array([-along[1], along[0]])
    across, behind, z = (middles[:, :2] - start) @ along, -(middles[:, :2] - start) @ inward, middles[:, 2]
    backs = np.zeros(len(middles), dtype=bool)
    for opening in room.openings or ():
        ends = np.asarray(opening, dtype=np.float64)[:4].reshape(2, 2) - start
        if np.abs(ends @ inward).max() > _INSIDE_M:
            continue
        low, high = sorted(ends @ along)
        bottom, top, depth = opening[4:7]
        deepest = max(depth, ShellConfig().thickness_m) + _INSIDE_M
        backs |= (low < across) & (across < high) & (bottom < z) & (z < top) & (behind < deepest)
    return backs & (normals[:, :2] @ inward > _TURNED)
