"""Detectors: boxes and names of what is in a picture."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from tasks.capture.small_objects.detectors.commanded import CommandDetector, CommandedDetector
from tasks.capture.small_objects.detectors.detector import WHERE, Detections, Detector
from tasks.capture.small_objects.detectors.grounding_dino import GroundingDino, grounding_dino_in
from tasks.capture.small_objects.detectors.owlv2 import Owlv2, owlv2_in
from tasks.capture.small_objects.detectors.rf_detr import RfDetr, rf_detr_in
from tasks.selection.methods.encoders import weights_digest
from tasks.settings import union_of

DetectorSettings = union_of((GroundingDino, Owlv2, RfDetr, CommandedDetector))
"""Whoever can detect."""


def detector_in(settings: GroundingDino | Owlv2 | RfDetr | CommandedDetector) -> Detector:
    """The detector that settings name, opened once in a process.

    Raises:
        InputError: packages, weights or device are not there, or the command line is none.
    """
    if isinstance(settings, CommandedDetector):
        return CommandDetector(settings)
    return _detector(settings, weights_digest(settings.weights, WHERE))


@lru_cache(maxsize=1)
def _detector(settings: Any, digest: str) -> Detector:
    if isinstance(settings, RfDetr):
        return rf_detr_in(settings)
    return owlv2_in(settings) if isinstance(settings, Owlv2) else grounding_dino_in(settings)


__all__ = ["CommandedDetector", "Detections", "Detector", "DetectorSettings", "GroundingDino", "Owlv2", "RfDetr", "detector_in"]
