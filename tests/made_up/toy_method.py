"""A selection method: the slots from the last to the first."""

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
class Toy(Config):
    kind: ClassVar[str] = "toy_method"


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: Toy, model: Model | None) -> Array:
    return np.array([each.candidate.slot / 10 for each in candidates])


TOY_METHOD = SelectionMethod(name="toy_method", config=Toy, version="7", score=score)
