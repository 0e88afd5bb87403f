"""A scan as its rescans are laid onto it: what stays where it is, and objects, as thinned points with normals."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Instance, Scene
from tasks.geometry.meshes import Surface, read_points, sample_surface, surface_of_glb
from tasks.geometry.transforms import matrix

Array = NDArray[np.float64]

SPACING_M = 0.05
"""Edge of the voxels that points are thinned to [m]: finer than what moves, coarser than the noise of scans."""

OBJECT_SPACING_M = 0.03
"""The same of an object's own points [m]: a mug has a few dozen."""

_SAMPLES = 4.0
"""Samples per voxel's face of surface: fewer leave holes, more only cost time."""

_OWN_M = 0.04
"""A surface point within this of an object's points is the object's [m]: as far as points of a thinned cloud lie apart."""


@dataclasses.dataclass(frozen=True)
class ScannedObject:
    """An object of a scan. pose: Box center to the scan's world frame, 4x4 [m]; size: of the box [m], shape (3,); points [m], (n, 3)."""

    instance_id: str
    category: str
    pose: Array
    size: Array
    points: Array

    @property
    def center(self) -> Array:
        """Center of its box [m], shape (3,)."""
        return self.pose[:3, 3]


@dataclasses.dataclass(frozen=True)
class RoomScan:
    """A scan in its own world frame, +Z up, floor at z = 0.

    points [m] and normals, shape (n, 3) each, of the whole surface, a voxel each; is_loose: those that are some object's, shape (n,).
    """

    scene_id: str
    points: Array
    normals: Array
    is_loose: NDArray[np.bool_]
    objects: tuple[ScannedObject, ...]

    @property
    def is_steep(self) -> NDArray[np.bool_]:
        """Which points are of surfaces that stand, by 70 degrees and more, shape (n,): these say where the scan lies in plan."""
        return np.abs(self.normals[:, 2]) < 0.34

    @property
    def is_wall(self) -> NDArray[np.bool_]:
        """Which points stand and are no object's, shape (n,)."""
        return self.is_steep & ~self.is_loose


def scanned_room(scene: Scene, instances: Sequence[Instance], blobs: Mapping[str, bytes], rng: np.random.Generator) -> RoomScan:
    """A scan as capture left it in the lake.

    Raises:
        InputError: a mesh or a cloud cannot be read.
    """
    objects = []
    for row in sorted(instances, key=lambda each: each.instance_id):
        if not row.is_structure:
            points, _ = read_points(blobs[row.points_blob], f"{scene.scene_id} {row.instance_id}.ply")
            points, _ = thinned(points, np.zeros_like(points), OBJECT_SPACING_M)
            objects.append(ScannedObject(row.instance_id, row.category, matrix(row.box_pose), np.array(row.box_size), points))
    surface = surface_of_glb(blobs[scene.mesh_blob], f"{scene.scene_id} scan.glb")
    return room_of_surface(scene.scene_id, surface, objects, rng)


def room_of_surface(scene_id: str, surface: Surface, objects: Sequence[ScannedObject], rng: np.random.Generator) -> RoomScan:
    """A scan of a surface and the objects in it, world frame."""
    from scipy.spatial import cKDTree

    corners = surface.vertices[surface.faces]
    area = 0.5 * float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum())
    samples, _, normals = sample_surface(surface, max(1, round(_SAMPLES * area / SPACING_M**2)), rng)
    points, normals = thinned(samples, normals, SPACING_M)
    is_loose = np.zeros(len(points), bool)
    if objects:
        is_loose = cKDTree(np.concatenate([each.points for each in objects])).query(points, distance_upper_bound=_OWN_M)[0] <= _OWN_M
    return RoomScan(scene_id, points, normals, is_loose, tuple(objects))


def thinned(points: Array, normals: Array, spacing: float) -> tuple[Array, Array]:
    """The mean point and the mean unit normal of every voxel with an edge [m], ordered by voxel; shape (n, 3) each."""
    if not len(points):
        return points, normals
    cells = np.floor(points / spacing).astype(np.int64)
    _, place, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    means = [
        np.stack([np.bincount(place.ravel(), values[:, axis]) for axis in range(3)], axis=1) / count[:, None]
        for values in (points, normals)
    ]
    lengths = np.linalg.norm(means[1], axis=1, keepdims=True)
    return means[0], means[1] / np.maximum(lengths, 1e-12)
