"""What a small object is, by its size alone: categories that the generator knows, or `unknown`, each with a probability."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.captions.physics import SMALL_M, known_name
from tasks.capture.instances.boxes import oriented_box
from tasks.furniture import CATEGORIES, typical_extents
from tasks.settings import Config, Positive, Share

Array = NDArray[np.float64]

UNKNOWN = "unknown"
"""The category of what no size tells."""

_LARGEST = 1.5
"""Times `SMALL_M` [m], the longest side of a category that stands on other furniture."""

_FLAT_M = 0.012
"""Sides that are thinner are measured as thick as depth noise makes them [m]."""


@dataclasses.dataclass(frozen=True)
class NamingConfig(Config):
    """How sizes tell categories."""

    spread: Positive = 0.18  # of the logarithm of a side, within a category: things sold under one name differ by a fifth
    unknown_size: Positive = 0.02  # likelihood of anything else with that size: three deviations off a category are none of it
    least: Share = 0.5  # a name that is more likely wrong than right is none


@dataclasses.dataclass(frozen=True)
class SizeName:
    """A category, or `unknown`, and how probable it is, 0 to 1."""

    category: str
    probability: float


@cache
def _sizes() -> tuple[tuple[str, ...], Array]:
    """Categories that have physical attributes and stand on others, and their sides: two in plan, the longer first, and height [m]."""
    names = [name for name in CATEGORIES if known_name(name) is not None and max(typical_extents(name)) <= _LARGEST * SMALL_M]
    return tuple(names), np.array([_sides(typical_extents(name)) for name in names])


def _sides(extents: Sequence[float] | Array) -> Array:
    x, y, z = (max(float(side), _FLAT_M) for side in extents)
    return np.array([max(x, y), min(x, y), z])


def name_by_size(points: Array, board_m: float | None, config: NamingConfig) -> SizeName:
    """What an object is by the box of its points, world frame [m], shape (n, 3).

    board_m: Height of what it stands on [m]: its lowest points are seldom seen.
    """
    _, size = oriented_box(points)
    if board_m is not None:
        size = np.array([size[0], size[1], max(float(np.quantile(points[:, 2], 0.995)) - board_m, float(size[2]))])
    names, sides = _sizes()
    off = np.log(sides) - np.log(_sides(size))
    likely = np.exp(-0.5 * (off**2).sum(axis=1) / config.spread**2)
    total = float(likely.sum()) + config.unknown_size
    best = int(likely.argmax())
    probability = float(likely[best]) / total
    if probability < config.least:
        return SizeName(UNKNOWN, config.unknown_size / total if likely[best] < config.unknown_size else 1 - probability)
    return SizeName(names[best], probability)
