"""The assets that were placed in a scene, as meshes in the world frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from schemas.optimization import Placement
from tasks.geometry.meshes import load_glb
from tasks.geometry.transforms import matrix

if TYPE_CHECKING:
    import trimesh

Phase = Literal["proposed", "optimized"]


def scaled_parts(glb: bytes, scale: ArrayLike, file: str = "asset.glb") -> list[trimesh.Trimesh]:
    """Parts of a canonical asset, scaled along its own axes, shape (3,), in its own frame [m]; textures kept.

    Raises:
        InputError: the GLB cannot be read.
    """
    stretch = np.diag([*np.asarray(scale, dtype=np.float64), 1.0])
    parts = load_glb(glb, file)
    for part in parts:
        part.apply_transform(stretch)
    return parts


def placed_parts(placement: Placement, glb: bytes, phase: Phase = "optimized") -> list[trimesh.Trimesh]:
    """Parts of a placed asset in the world frame [m]: scale first, then the pose of `phase`; textures kept.

    Raises:
        InputError: the GLB cannot be read.
    """
    pose = matrix(placement.optimized_pose if phase == "optimized" else placement.proposed_pose)
    parts = scaled_parts(glb, placement.scale, f"{placement.asset_id}.glb")
    for part in parts:
        part.apply_transform(pose)
    return parts
