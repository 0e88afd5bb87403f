"""Segmenters: masks of whatever fills a box."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from tasks.capture.small_objects.segmenters.sam import Sam, sam_in
from tasks.capture.small_objects.segmenters.sam2 import Sam2, sam2_in
from tasks.capture.small_objects.segmenters.segmenter import WHERE, Segmenter, Segments
from tasks.selection.methods.encoders import weights_digest
from tasks.settings import union_of

SegmenterSettings = union_of((Sam2, Sam))
"""Whoever can segment."""


def segmenter_in(settings: Sam2 | Sam) -> Segmenter:
    """The segmenter that settings name, opened once in a process.

    Raises:
        InputError: packages, weights or device are not there.
    """
    return _segmenter(settings, weights_digest(settings.weights, WHERE))


@lru_cache(maxsize=1)
def _segmenter(settings: Any, digest: str) -> Segmenter:
    return sam_in(settings) if isinstance(settings, Sam) else sam2_in(settings)


__all__ = ["Sam", "Sam2", "Segmenter", "SegmenterSettings", "Segments", "segmenter_in"]
