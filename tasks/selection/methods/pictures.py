"""Pictures of assets where they stand: from the camera that took the crop of an instance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from tasks.geometry.meshes import load_glb
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import yaw_pose

if TYPE_CHECKING:
    import trimesh

    from tasks.selection.evidence import Evidence, InstanceQuery

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


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
