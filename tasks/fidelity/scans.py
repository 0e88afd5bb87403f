"""The scanned surface of a scene with its labels, as capture left it in the lake."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from schemas.capture import Instance, Scene
from tasks.geometry.meshes import Surface, load_glb, read_points, surface_of, surface_of_glb, union_of

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class ScannedSurface:
    """Everything that was scanned, world frame [m].

    parts: The whole scan mesh as it looks. whole: The same as one surface. objects: Surface of every object, by instance.
    shell: Surface of floor, walls and ceiling. bare: Instances without faces, whose points stand in for them.
    """

    parts: Sequence[trimesh.Trimesh]
    whole: Surface
    objects: Mapping[str, Surface]
    shell: Surface
    bare: tuple[str, ...]


def scanned_surface(scene: Scene, instances: Sequence[Instance], blobs: Mapping[str, bytes]) -> ScannedSurface:
    """The scan mesh of a scene, and the faces of it that capture cut out for every instance.

    Raises:
        InputError: a mesh cannot be read.
    """
    parts = load_glb(blobs[scene.mesh_blob], f"{scene.scene_id} scan.glb")
    surfaces, bare = {}, []
    for instance in sorted(instances, key=lambda i: i.instance_id):
        name = f"{scene.scene_id} {instance.instance_id}"
        if instance.mesh_blob is not None:
            surfaces[instance.instance_id] = surface_of_glb(blobs[instance.mesh_blob], f"{name}.glb")
        else:
            surfaces[instance.instance_id] = _of_points(blobs[instance.points_blob], f"{name}.ply")
            bare.append(instance.instance_id)
    structure = {instance.instance_id for instance in instances if instance.is_structure}
    return ScannedSurface(
        parts=parts,
        whole=surface_of(parts),
        objects={name: surface for name, surface in surfaces.items() if name not in structure},
        shell=union_of([surface for name, surface in surfaces.items() if name in structure]),
        bare=tuple(bare),
    )


_POINT_M = 0.02
"""Edge of the triangle that stands for a point of an instance without faces [m]: as far as points of a scan lie apart."""


def _of_points(data: bytes, file: str) -> Surface:
    """A small level triangle around each point of a cloud."""
    points, colors = read_points(data, file)
    corners = _POINT_M / np.sqrt(3) * np.array([[0.0, 1.0, 0.0], [-np.sqrt(0.75), -0.5, 0.0], [np.sqrt(0.75), -0.5, 0.0]])
    vertices = (points[:, None] + corners).reshape(-1, 3)
    return Surface(vertices, np.arange(len(vertices)).reshape(-1, 3), np.repeat(colors, 3, axis=0))
