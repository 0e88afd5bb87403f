"""Pictures of assets: from the camera that took the crop of an instance, or from around."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from tasks.geometry.meshes import load_glb
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at, yaw_pose
from tasks.views.crops import filling

if TYPE_CHECKING:
    import trimesh

    from tasks.selection.evidence import Evidence, InstanceQuery

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

FOV_RADIANS = 0.6
"""Of cameras around an asset: as a photo from some steps away, with little perspective."""

DRAWN = 1.5
"""Pictures are drawn this much larger than asked for, then cut out and shrunk."""


def parts_of(asset: Asset, blobs: Mapping[str, bytes], scale: NDArray[np.float64] | None = None) -> list[trimesh.Trimesh]:
    """Meshes of an asset in its own frame [m], +Z up; stretched along its axes by `scale`, shape (3,), where one is given."""
    parts = load_glb(blobs[asset.mesh_blob], asset.mesh_blob)
    if scale is not None:
        for part in parts:
            part.vertices = np.asarray(part.vertices) * scale
    return parts


def seen_from(query: InstanceQuery, evidence: Evidence, camera: Camera) -> tuple[Image, Mask]:
    """A candidate where it stands, from a camera in the world frame: picture (h, w, 3) on white, and the pixels that show it (h, w)."""
    pose = query.frame @ yaw_pose(evidence.fit.yaw, evidence.fit.offset)
    parts = parts_of(evidence.asset, query.context.blobs, evidence.fit.scale)
    for part in parts:
        part.vertices = np.asarray(part.vertices) @ pose[:3, :3].T + pose[:3, 3]
    drawn = RayScene(parts).render(camera)
    return drawn.color, drawn.part >= 0


def around(parts: list[trimesh.Trimesh], yaws: int, pitches_radians: tuple[float, ...], side: int) -> Image:
    """Pictures of parts from all around, on white, each as large as its square lets it be: shape (pitches * yaws, side, side, 3).

    pitches_radians: How far the camera looks down. The first picture of each pitch is from +x, the others follow counter-clockwise.
    """
    corners = np.array([bound for part in parts for bound in part.bounds])
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, radius = 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-3)
    far = radius / np.sin(0.5 * FOV_RADIANS)
    scene = RayScene(parts)
    pictures, width = [], round(DRAWN * side)
    for pitch in pitches_radians:
        for yaw in 2 * np.pi * np.arange(yaws) / yaws:
            way = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
            drawn = scene.render(Camera.with_fov(look_at(middle + far * way, middle), width, width, FOV_RADIANS))
            pictures.append(filling(drawn.color, drawn.part >= 0, side))
    return np.stack(pictures)
