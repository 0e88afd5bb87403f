"""Fidelity that the optimization costs: F-scores of objects in the end against those where selection, or a person, put them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from tasks.geometry.meshes import asset_surface, sample_surface
from tasks.geometry.transforms import transform_points
from tasks.geometry.triangles import surface_area
from tasks.optimization.proposals import Proposal
from tasks.stage import Caches

Array = NDArray[np.float64]

WITHIN_M = 0.05
"""Surface and scan agree within this distance [m]: the F-score that rooms are judged by."""

SAMPLES = 3000
"""Points on an asset: 3 cm apart on a wardrobe."""

POINTS = 3000
"""Scanned points that are looked at, at most."""

MOST_LOSS = 0.05
"""A greater loss is said."""

STILL_M = 0.005
"""Objects that moved less [m] have lost nothing."""


def fidelity_losses(
    points: Mapping[str, Array], before: Sequence[Proposal], after: Sequence[Proposal], poses: Array, assets: Mapping[str, Asset],
    blobs: Mapping[str, bytes], caches: Caches,
) -> dict[str, float]:  # fmt: skip
    """Loss of F-score of objects at `WITHIN_M`, by instance; zero where it is not less, nothing where an object has
    no scanned points.

    points: scanned points in the world frame, shape (n, 3) [m], by instance. before: assets as they were proposed. after, poses: assets in
    the end and where they stand, shape (n, 4, 4) [m].
    """
    first = {proposal.instance.instance_id: proposal for proposal in before}
    losses: dict[str, float] = {}
    for proposal, pose in zip(after, poses, strict=True):
        name = proposal.instance.instance_id
        scanned = points.get(name, np.zeros((0, 3)))
        if not len(scanned):
            continue
        was = first[name]
        is_same = was.asset_id == proposal.asset_id and np.array_equal(was.scale, proposal.scale)
        if is_same and _way(was, pose) < STILL_M:
            losses[name] = 0.0
            continue
        thinned = scanned[:: max(1, -(-len(scanned) // POINTS))]
        scores = [
            _f_score(thinned, _surface_points(each, assets[each.asset_id], where, blobs, caches))
            for each, where in ((was, was.pose), (proposal, pose))
        ]
        losses[name] = max(0.0, scores[0] - scores[1])
    return losses


def _way(was: Proposal, pose: Array) -> float:
    """The farthest that a corner of an object's box went [m]."""
    half = 0.5 * np.array(was.instance.box_size)
    corners = np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * half + [0.0, 0.0, half[2]]
    return float(np.abs(transform_points(corners, pose) - transform_points(corners, was.pose)).max())


def _surface_points(proposal: Proposal, asset: Asset, pose: Array, blobs: Mapping[str, bytes], caches: Caches) -> Array:
    """Points on an asset where it stands, world frame, shape (`SAMPLES`, 3) [m]; none on one without area."""
    surface = asset_surface(asset.mesh_blob, blobs, f"{asset.name}.glb", caches["tasks.geometry.meshes"])
    if not surface_area(surface.vertices, surface.faces) > 0.0:
        return np.zeros((0, 3))
    return sample_surface(surface.transformed(pose, proposal.scale), SAMPLES, np.random.default_rng(0))[0]


def _f_score(scanned: Array, surface: Array) -> float:
    """Harmonic mean of the shares of scanned points near a surface, and of its points near the scan, shapes (n, 3) and (m, 3) [m]."""
    from scipy.spatial import KDTree

    if not len(surface):
        return 0.0
    complete = float((KDTree(surface).query(scanned, distance_upper_bound=WITHIN_M)[0] < WITHIN_M).mean())
    accurate = float((KDTree(scanned).query(surface, distance_upper_bound=WITHIN_M)[0] < WITHIN_M).mean())
    return 2.0 * complete * accurate / (complete + accurate) if complete + accurate > 0.0 else 0.0
