"""The main paper's heuristic: center on center, longest edge on longest edge, then the yaw of twelve that fits best."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tasks.alignment.measures import coarse_costs
from tasks.alignment.method import AlignmentMethod
from tasks.alignment.samples import Fit, Sample
from tasks.alignment.targets import ScannedInstance
from tasks.settings import Config, Count

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig


@dataclasses.dataclass(frozen=True)
class Heuristic(Config):
    """Center, one scale from the longest edges of both boxes, yaw by search."""

    kind: ClassVar[str] = "heuristic"
    yaw_count: Count = 12  # the paper's steps of 30 degrees


def pose(target: ScannedInstance, sample: Sample, threshold: float, config: AlignmentConfig, own: Heuristic) -> Fit:
    """The pose of least distance, both ways, among those of a few yaws. The paper does not say by what it compares them."""
    scale = np.full(3, target.size.max() / sample.extents.max())
    fits = [Fit(float(yaw), np.zeros(3), scale) for yaw in 2 * np.pi * np.arange(own.yaw_count) / own.yaw_count]
    return fits[int(np.argmin(np.round(coarse_costs(target, sample, fits, config) / target.diagonal, 6)))]


HEURISTIC = AlignmentMethod(name="heuristic", config=Heuristic, pose=pose)
