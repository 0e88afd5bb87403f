"""The authors' alignment of assets that stand upright with their sides along the axes (preprocess/pose_alignment of their release).

What their code does is `as_released`. Its defects, by name:

- half turn: it compares sizes of boxes in plan, which are the same after 180 degrees, so that a yaw is 0 or 90 degrees and
  every second object stands back to front;
- one scale for length and width, of the longer of both: what is wider than the asset for its length stays so;
- boxes are bounds of the oriented box of least volume: where that box leans, they are larger than the object;
- middles are means of surfaces, not of boxes: an asset moves toward what was scanned, and up or down from what it stands on.

That its matrix adds the translation before the rotation is none: it turns about the mean that was moved already.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from tasks.alignment.measures import coarse_costs
from tasks.alignment.method import AlignmentMethod
from tasks.alignment.samples import Fit, Sample, turned
from tasks.alignment.targets import ScannedInstance
from tasks.settings import Config

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig

Array = NDArray[np.float64]

THINNEST_M = 5e-3
"""Sides thinner than this are taken for this: no scan tells them, and no scale follows from them."""


@dataclasses.dataclass(frozen=True)
class FixedPose(Config):
    """Four yaws, of which the one whose box in plan is the object's is taken."""

    kind: ClassVar[str] = "fixed_pose"
    form: Literal["mended", "as_released"] = "mended"  # as_released: with its defects, to measure them


def pose(target: ScannedInstance, sample: Sample, threshold: float, config: AlignmentConfig, own: FixedPose) -> Fit:
    """The pose at one of four yaws.

    Mended: every axis has its scale, by the yaw; boxes stand on boxes, middle on middle; of four yaws the one with the least
    distances is taken, so that front and back differ.
    """
    if own.form == "as_released":
        return _released(target, sample)
    fits = []
    for quarter in range(4):
        size = target.size[[1, 0, 2]] if quarter % 2 else target.size
        fits.append(Fit(0.5 * np.pi * quarter, np.zeros(3), np.maximum(size, THINNEST_M) / np.maximum(sample.extents, THINNEST_M)))
    return fits[int(np.argmin(np.round(coarse_costs(target, sample, fits, config) / target.diagonal, 6)))]


def _released(target: ScannedInstance, sample: Sample) -> Fit:
    wanted, has = leaning_bounds(target.points), leaning_bounds(sample.points)
    across = wanted[:2].max() / has[:2].max()
    scale = np.array([across, across, wanted[2] / has[2]])
    placed = sample.points * scale
    overlaps = []
    for quarter in range(4):
        plan = np.ptp(placed @ turned(0.5 * np.pi * quarter).T, axis=0)[:2]
        shared = float(np.minimum(plan, wanted[:2]).prod())
        overlaps.append(shared / (float(plan.prod() + wanted[:2].prod()) - shared))
    yaw = 0.5 * np.pi * int(np.argmax(np.round(overlaps, 9)))
    return Fit(yaw, target.points.mean(axis=0) - turned(yaw) @ placed.mean(axis=0), scale)


def leaning_bounds(points: Array) -> Array:
    """Extents along the axes of the oriented box of least volume around points, shape (n, 3), and that box may lean: shape (3,) [m]."""
    import trimesh
    from scipy.spatial import QhullError

    try:
        to_box, size = trimesh.bounds.oriented_bounds(points)
        turn = np.linalg.inv(np.asarray(to_box))[:3, :3]
        extents = np.abs(turn) @ np.asarray(size)
    except (QhullError, ValueError):  # all of them in a plane or a line
        extents = np.ptp(points, axis=0)
    return np.maximum(extents, THINNEST_M)


FIXED_POSE = AlignmentMethod(name="fixed_pose", config=FixedPose, pose=pose)
