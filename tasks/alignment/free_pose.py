"""The authors' alignment of what was made from one photo, and comes in that photo's camera frame (their pose_alignment/match_free_pose).

An asset looks into the camera: its front, +x in the canonical frame, is what the photo saw. What their code does is
`as_released`. Its defects, by name:

- no turn: of camera pose and initial pose it keeps the 2 x 2 block of x and y, which is no rotation where the camera looks
  down: the asset becomes narrower by the cosine of the pitch;
- one scale of the longest edges, by bounds of oriented boxes that may lean, as in `fixed_pose`;
- middles are means of surfaces, as in `fixed_pose`.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from tasks.alignment.fixed_pose import leaning_bounds
from tasks.alignment.method import AlignmentMethod
from tasks.alignment.refined import REFINED, Refined
from tasks.alignment.samples import Fit, Sample, turned
from tasks.alignment.targets import ScannedInstance
from tasks.settings import Config

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig


@dataclasses.dataclass(frozen=True)
class FreePose(Config):
    """The asset's front turned to the camera that took the instance's crop, one scale of the longest edges."""

    kind: ClassVar[str] = "free_pose"
    form: Literal["mended", "as_released"] = "mended"  # as_released: with its defects, to measure them


def lacks(target: ScannedInstance, own: FreePose) -> str | None:
    """Without the camera there is no such pose."""
    return "nobody knows its camera; aligned by nearest points" if target.sight is None else None


def pose(target: ScannedInstance, sample: Sample, threshold: float, config: AlignmentConfig, own: FreePose) -> Fit:
    """The pose that looks into the camera, or ours where the camera is unknown.

    Mended: a turn alone, boxes middle on middle, on what the object stands on.
    """
    if target.sight is None:
        return REFINED.pose(target, sample, threshold, config, Refined())
    yaw = target.sight.azimuth
    turn = turned(yaw)
    if own.form == "mended":
        placed = sample.points @ turn.T
        scale = target.size.max() / max(np.ptp(placed, axis=0).max(), 1e-3)
        return Fit(yaw, np.zeros(3), np.full(3, scale))
    narrowed = np.array([1.0, math.cos(target.sight.elevation), 1.0])
    placed = (sample.points * narrowed) @ turn.T
    scale = leaning_bounds(target.points).max() / leaning_bounds(placed).max()
    return Fit(yaw, target.points.mean(axis=0) - scale * placed.mean(axis=0), scale * narrowed)


FREE_POSE = AlignmentMethod(name="free_pose", config=FreePose, pose=pose, lacks=lacks, reads_sight=True)
