"""Colors alone: a baseline that learns nothing (specs C.6)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from tasks.models import Model
from tasks.selection.evidence import Evidence, InstanceQuery
from tasks.selection.methods.method import Array, SelectionMethod
from tasks.settings import Config


@dataclasses.dataclass(frozen=True)
class ColorHistogram(Config):
    """1 - Jensen-Shannon distance of the color histograms of scan and asset, in CIELAB."""

    kind: ClassVar[str] = "color_histogram"


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: ColorHistogram, model: Model | None) -> Array:
    """Likeness of the colors, shape (k,)."""
    return np.array([each.color for each in candidates])


COLOR_HISTOGRAM = SelectionMethod(name="color_histogram", config=ColorHistogram, version="1", score=score)
