"""A made-up alignment method: every asset as it is, in the middle."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tasks.alignment.method import AlignmentMethod
from tasks.alignment.samples import Fit, Sample
from tasks.alignment.targets import ScannedInstance
from tasks.settings import Config

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig


@dataclasses.dataclass(frozen=True)
class ToyAlignment(Config):
    """Nothing is looked at."""

    kind: ClassVar[str] = "toy_alignment"


def pose(target: ScannedInstance, sample: Sample, threshold: float, config: AlignmentConfig, own: ToyAlignment) -> Fit:
    """The asset as it is, in the middle."""
    return Fit(0.0, np.zeros(3), np.ones(3))


TOY_ALIGNMENT = AlignmentMethod(name="toy_alignment", config=ToyAlignment, pose=pose)
