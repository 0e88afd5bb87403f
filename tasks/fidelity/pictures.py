"""Renders of a scan and its replica from the same cameras, held against each other: color, structure, depth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.captions.colors import lab
from tasks.fidelity.colors import ciede2000, gray, structural_similarity
from tasks.fidelity.replicas import ReplicaRays
from tasks.geometry.rendering import Camera, RayScene

Array = NDArray[np.float64]

SAME_PLACE_M = 0.1
"""Pixels of an asset count for its color where scan and replica are no farther apart in depth [m]: elsewhere it is something else's."""

MIN_PIXELS = 20
"""Fewer pixels say little about an object's color."""


@dataclasses.dataclass(frozen=True)
class Likeness:
    """How alike the renders are; None where no pixel shows both. Fields as in `schemas.fidelity.SceneFidelity`.

    by_owner: Mean color difference of what each owner of parts looks like, where it has enough pixels.
    """

    color_difference: float | None
    structural_similarity: float | None
    median_depth_error_m: float | None
    mean_depth_error_m: float | None
    both_seen_share: float | None
    by_owner: dict[str, float]


def likeness(scan: RayScene, replica: ReplicaRays, owners: Sequence[str], cameras: Sequence[Camera]) -> Likeness:
    """Scan and replica rendered from the cameras, unlit: scans have their light in their colors.

    owners: Whose each part of the replica's objects is.
    """
    names = sorted(set(owners))
    owner_of = np.array([*(names.index(owner) for owner in owners), -1], dtype=np.int64)  # the shell is part -1
    differences, similarities, depths = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    totals, counts = np.zeros(len(names)), np.zeros(len(names))
    shown = 0
    for camera in cameras:
        rays = camera.rays()
        real = scan.render(camera, shade=False, rays=rays)
        made = replica.render(camera, rays)
        shown += int(np.isfinite(real.depth).sum())
        both = np.isfinite(real.depth) & np.isfinite(made.depth)
        if not both.any():
            continue
        difference = ciede2000(lab(real.color[both]), lab(made.color[both]))
        depth = np.abs(real.depth[both].astype(np.float64) - made.depth[both])
        owner = owner_of[made.part[both]]
        own = (owner >= 0) & (depth <= SAME_PLACE_M)
        totals += np.bincount(owner[own], difference[own], minlength=len(names))
        counts += np.bincount(owner[own], minlength=len(names))
        differences.append(difference)
        depths.append(depth)
        similarities.append(structural_similarity(gray(real.color), gray(made.color), both)[both])
    pooled, similar, apart = (np.concatenate(values) for values in (differences, similarities, depths))
    by_owner = {name: float(totals[i] / counts[i]) for i, name in enumerate(names) if counts[i] >= MIN_PIXELS}
    if not len(pooled):
        return Likeness(None, None, None, None, 0.0 if shown else None, by_owner)
    return Likeness(
        color_difference=float(pooled.mean()),
        structural_similarity=float(np.clip(similar.mean(), -1, 1)),
        median_depth_error_m=float(np.median(apart)),
        mean_depth_error_m=float(apart.mean()),
        both_seen_share=len(pooled) / shown,
        by_owner=by_owner,
    )
