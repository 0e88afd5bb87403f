"""How well a candidate fits the scanned points, in shape, size and color (`tasks.selection.scoring`)."""

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
class Geometric(Config):
    """Weighted agreement with the scan, as `selection.score` says. Needs nothing but points."""

    kind: ClassVar[str] = "geometric"


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: Geometric, model: Model | None) -> Array:
    """The scores that came of measuring, shape (k,)."""
    return np.array([each.geometric for each in candidates])


GEOMETRIC = SelectionMethod(name="geometric", config=Geometric, version="7", score=score, is_geometric=lambda config: True)
