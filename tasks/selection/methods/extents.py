"""Sizes alone: a baseline that learns nothing (specs C.6)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from tasks.models import Model
from tasks.selection.evidence import Evidence, InstanceQuery
from tasks.selection.methods.method import Array, SelectionMethod
from tasks.settings import Config

LEAST_M = 0.005
"""Thinner sides are scanned as this thick."""


@dataclasses.dataclass(frozen=True)
class Extents(Config):
    """exp(-d), d the sum of |log ratio| of the asset's unscaled sides to the box's, the better of both ways to lay it."""

    kind: ClassVar[str] = "extents"


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: Extents, model: Model | None) -> Array:
    """Agreement of sizes, shape (k,), 1 where all sides are equal."""
    return np.array([size_agreement(each.sample.extents, query.target.size) for each in candidates])


def size_agreement(first: Array, second: Array) -> float:
    """exp(-sum of |log ratio|) of extents, shape (3,) [m], in 0..1; the horizontal ones in the order that agrees better."""
    a, b = np.log(np.maximum(first, LEAST_M)), np.log(np.maximum(second, LEAST_M))
    return float(np.exp(-min(np.abs(a - b).sum(), np.abs(a - b[[1, 0, 2]]).sum())))


EXTENTS = SelectionMethod(name="extents", config=Extents, version="1", score=score)
