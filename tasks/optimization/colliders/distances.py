"""Distances of colliders from the surfaces that cameras see, where no neighbor is near."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from tasks.geometry.meshes import asset_surface, sample_surface
from tasks.geometry.pieces import Hull
from tasks.geometry.proximity import closest_points
from tasks.geometry.triangles import face_planes, surface_area
from tasks.optimization.interior import Interior
from tasks.stage import Caches

Array = NDArray[np.float64]

SAMPLES = 1000
"""Points on an asset."""

SHARE = 95.0
"""Percentile of the distances of these points."""

SEAM_M = 0.02
"""Points this near to another object's pieces, a wall or the floor lie at a seam [m], where colliders are cut back."""


def collider_distances(
    interior: Interior, poses: Array, assets: Mapping[str, Asset], blobs: Mapping[str, bytes], caches: Caches
) -> dict[str, float]:
    """Distance from the collider within which `SHARE` percent of the points on an asset's surface lie [m], by instance. Points at seams
    do not count; an object with no other points, or no area, has no figure.

    poses: asset to world frame, shape (n, 4, 4) [m].
    """
    placed = [solid.placed(pose) for solid, pose in zip(interior.solids, poses, strict=True)]
    shell = [solid.hulls for solid in interior.shell]
    boxes = [_box(hulls) for hulls in (*placed, *shell)]
    distances: dict[str, float] = {}
    for i, (proposal, pose) in enumerate(zip(interior.proposals, poses, strict=True)):
        asset = assets[proposal.asset_id]
        surface = asset_surface(asset.mesh_blob, blobs, f"{asset.name}.glb", caches["tasks.geometry.meshes"])
        if not surface_area(surface.vertices, surface.faces) > 0.0:
            continue
        points = sample_surface(surface.transformed(pose, proposal.scale), SAMPLES, np.random.default_rng(0))[0]
        is_clear = points[:, 2] > SEAM_M
        low, high = points.min(axis=0) - SEAM_M, points.max(axis=0) + SEAM_M
        for j, hulls in enumerate((*placed, *shell)):
            if j != i and (boxes[j][0] < high).all() and (boxes[j][1] > low).all():
                is_clear &= depths(points, hulls) < -SEAM_M
        if is_clear.any():
            distances[proposal.instance.instance_id] = float(np.percentile(distance_from(points[is_clear], placed[i]), SHARE))
    return distances


def distance_from(points: Array, hulls: Sequence[Hull]) -> Array:
    """Distance of points, shape (n, 3) [m], from the surface of the convex pieces that they lie outside of, or of the piece that they
    are deepest in, shape (n,) [m]."""
    inside = depths(points, hulls)
    offsets = np.cumsum([0, *(len(hull.vertices) for hull in hulls[:-1])])
    vertices = np.concatenate([hull.vertices for hull in hulls])
    faces = np.concatenate([hull.faces + at for hull, at in zip(hulls, offsets, strict=True)])
    outside = closest_points(vertices, faces, points).distance
    return np.where(inside > 0.0, inside, outside)


def depths(points: Array, hulls: Sequence[Hull]) -> Array:
    """Depth of points, shape (n, 3) [m], in the convex piece that they are deepest in, shape (n,) [m]: negative outside of all, where it
    is at most the distance."""
    deepest = np.full(len(points), -np.inf)
    for hull in hulls:
        normals, offsets = face_planes(hull.vertices, hull.faces, 1e-14)
        deepest = np.maximum(deepest, -(points @ normals.T - offsets).max(axis=1))
    return deepest


def _box(hulls: Sequence[Hull]) -> tuple[Array, Array]:
    """Lowest and highest corner of the box around pieces, shapes (3,) [m]."""
    corners = np.concatenate([hull.vertices for hull in hulls])
    return corners.min(axis=0), corners.max(axis=0)
