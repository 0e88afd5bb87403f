"""Where an asset stands on an instance: yaw, place and scale that bring its surface onto the scanned points.

Everything here is in the instance's frame: its oriented box turned straight, x and y zero at the box center, z zero
at the height on which the asset is to stand. How a pose is found is a method's affair (`ALIGNMENT_METHODS`).
"""

from __future__ import annotations

from tasks.alignment.configuration import AlignmentConfig
from tasks.alignment.instances import covered_within, instance_frame
from tasks.alignment.measures import Distances, measure
from tasks.alignment.methods import method_of
from tasks.alignment.refined import clamp_scale, refine
from tasks.alignment.samples import Fit, Sample
from tasks.alignment.sampling import sample_asset, sample_of
from tasks.alignment.targets import HIDDEN_M, ScannedInstance, Viewpoint, make_target, sight_of

__all__ = [
    "HIDDEN_M",
    "AlignmentConfig",
    "Distances",
    "Fit",
    "Sample",
    "ScannedInstance",
    "Viewpoint",
    "align",
    "by_sight",
    "clamp_scale",
    "covered_within",
    "instance_frame",
    "lacking",
    "make_target",
    "measure",
    "refine",
    "sample_asset",
    "sample_of",
    "sight_of",
]


def align(target: ScannedInstance, sample: Sample, threshold: float, config: AlignmentConfig) -> tuple[Fit, Distances]:
    """The pose of an asset on an instance that the config's method finds, and how it fits.

    threshold: Distance within which a point counts as covered [m].
    """
    fit = method_of(config.method).pose(target, sample, threshold, config, config.method)
    return fit, measure(target, sample, fit, threshold, config)


def lacking(target: ScannedInstance, config: AlignmentConfig) -> str | None:
    """What of an instance the config's method wants and does not find, and what it does without; None where all is there."""
    missing = method_of(config.method).lacks(target, config.method)
    return None if missing is None else f"{config.method.kind}: {missing}"


def by_sight(config: AlignmentConfig) -> bool:
    """Whether the config's method goes by how an instance's crop was taken; ours does where it is told to."""
    method = method_of(config.method)
    return method.reads_sight and bool(getattr(config.method, "camera", True))
