"""What an instance that geometry found may be, by its size, its place and its level tops, and how probable that is.

Regions are often a part of a thing, or of a wall: rules of sizes that shops sell name them wrongly, nineteen of twenty. So a shape is held
against those of the regions that the same segmentation found in generated rooms, whose truth is known; most are of no category.
"""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.boxes import oriented_box
from tasks.settings import Config, Positive, Share

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

PROVIDER = "geometry"
"""Who found and named an instance, as rows and raw labels say it."""

UNKNOWN = "unknown"
"""The category of what no shape tells."""


SHAPES_FILE = Path(__file__).with_name("shapes.csv")
"""Shapes of regions that were found in generated rooms, and what they were truly of: `python -m bench.capture.shapes` makes it again."""

FEATURES = ("length", "width", "height", "bottom", "top", "level", "area")
"""Of a shape: logarithms of the box's sides in plan, the longer first, and of its height; heights of bottom and top [m]; share of the plan
that level surface in the upper half fills; logarithm of the surface [m2]."""

FARTHEST = 0.01
"""Sum of kernels below which no shape lies near: three deviations off the nearest one."""

_THIN_M = 0.02
"""Sides that are thinner are measured as thick as noise makes them [m]."""


@dataclasses.dataclass(frozen=True)
class ShapeNamingConfig(Config):
    """How shapes tell categories."""

    width: Positive = 0.45  # of the kernel, in deviations of each feature: told probabilities are those that come true, held out by rooms
    least: Share = 0.5  # a name that is more likely wrong than right is none


@dataclasses.dataclass(frozen=True)
class ShapeName:
    """A category, or `unknown`, and how probable it is, 0 to 1."""

    category: str
    probability: float


@dataclasses.dataclass(frozen=True)
class _Rule:
    """Sizes [m] that make a guess: length >= width of the box in plan, its height, and the height of its bottom."""

    category: str
    bottom: tuple[float, float]
    height: tuple[float, float]
    length: tuple[float, float]
    width: tuple[float, float]
    top_share: float = 0.0


_RULES = (
    # Standing on the floor. `top_share`: least share of the plan that a level surface in the upper half fills.
    _Rule("bed", (-1, 0.3), (0.3, 0.95), (1.7, 2.6), (1.1, 2.3)),
    _Rule("sofa", (-1, 0.3), (0.6, 1.15), (1.3, 3.2), (0.65, 1.8), 0.0),
    _Rule("coffee table", (-1, 0.3), (0.25, 0.58), (0.6, 1.7), (0.4, 1.2), 0.35),
    _Rule("table", (-1, 0.5), (0.58, 1.1), (0.75, 3.5), (0.5, 2.0), 0.25),
    _Rule("chair", (-1, 0.45), (0.65, 1.3), (0.35, 0.95), (0.25, 0.85)),
    _Rule("stool", (-1, 0.3), (0.35, 0.75), (0.25, 0.6), (0.25, 0.6), 0.3),
    _Rule("nightstand", (-1, 0.3), (0.35, 0.75), (0.3, 0.75), (0.25, 0.6)),
    _Rule("floor lamp", (-1, 0.5), (1.2, 2.1), (0.1, 0.6), (0.1, 0.6)),
    _Rule("wardrobe", (-1, 0.3), (1.6, 2.6), (0.8, 3.0), (0.35, 0.9)),
    _Rule("bookshelf", (-1, 0.4), (1.1, 2.6), (0.5, 3.0), (0.1, 0.6)),
    _Rule("cabinet", (-1, 0.4), (0.5, 2.6), (0.5, 3.5), (0.2, 1.0)),
    _Rule("box", (-1, 0.2), (0.08, 0.5), (0.1, 0.8), (0.05, 0.6)),
    # On a wall or below the ceiling.
    _Rule("picture", (0.7, 2.2), (0.2, 1.5), (0.2, 2.0), (0.0, 0.15)),
    _Rule("lamp", (1.5, 3.0), (0.1, 1.0), (0.1, 1.2), (0.05, 1.2)),
    # On a support.
    _Rule("monitor", (0.5, 1.2), (0.25, 0.7), (0.35, 1.3), (0.0, 0.28)),
    _Rule("book", (0.3, 1.6), (0.0, 0.07), (0.1, 0.4), (0.05, 0.3)),
    _Rule("bottle", (0.3, 1.8), (0.15, 0.4), (0.0, 0.15), (0.0, 0.15)),
    _Rule("cup", (0.3, 1.8), (0.04, 0.15), (0.0, 0.16), (0.0, 0.14)),
    _Rule("vase", (0.3, 1.8), (0.15, 0.6), (0.08, 0.35), (0.08, 0.35)),
    _Rule("box", (0.2, 1.8), (0.04, 0.5), (0.05, 0.7), (0.03, 0.6)),
)
"""Sizes of furniture as shops sell it, with room for parts that no camera saw. The first rule that fits decides."""

RULED = tuple(dict.fromkeys(rule.category for rule in _RULES))
"""Categories that are guessed."""


def shape_of(points: Array, normals: Array, areas: Array) -> Array:
    """The `FEATURES` of an instance, shape (7,).

    points: World frame, floor at z = 0 [m], shape (n, 3). normals: Unit, shape (n, 3). areas: Of each point [m2], shape (n,).
    """
    length, width, height, bottom, level = _measures(points, normals, areas)
    sides = np.log(np.maximum([length, width, height], _THIN_M))
    return np.array([*sides, max(bottom, -0.1), bottom + height, min(level, 1.5), np.log(max(float(areas.sum()), 1e-4))])


def name_by_shape(shape: Array, config: ShapeNamingConfig) -> ShapeName:
    """What an instance of a shape, from `shape_of`, most probably is: by the shapes that lie near it among those of generated rooms."""
    return named_among(shape, *_shapes(), config)


def named_among(shape: Array, names: Sequence[str], whose: Indices, shapes: Array, config: ShapeNamingConfig) -> ShapeName:
    """The same among any shapes. names: Categories, `unknown` among them. whose: Which of them each of `shapes` has, shape (n,)."""
    scale = np.maximum(shapes.std(axis=0), 1e-9) * config.width
    weights = np.exp(-0.5 * (((shapes - shape) / scale) ** 2).sum(axis=1))
    by_name = np.bincount(whose, weights=weights, minlength=len(names))
    total = float(by_name.sum())
    if total < FARTHEST:  # unlike anything that was seen
        return ShapeName(UNKNOWN, 1.0)
    best = int(by_name.argmax())
    if by_name[best] >= config.least * total:
        return ShapeName(names[best], float(by_name[best]) / total)
    return ShapeName(UNKNOWN, float(by_name[list(names).index(UNKNOWN)]) / total)


@cache
def _shapes() -> tuple[tuple[str, ...], Indices, Array]:
    """Categories, which of them each shape is of, shape (n,), and the shapes, shape (n, 7)."""
    with SHAPES_FILE.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.reader(stream))[1:]
    names = sorted({UNKNOWN, *(row[0] for row in rows)})
    return tuple(names), np.array([names.index(row[0]) for row in rows]), np.array([row[1:] for row in rows], dtype=np.float64)


def guessed(points: Array, normals: Array, areas: Array) -> str:
    """Category by the first rule of sizes that fits, of what is known to be whole; `unknown` when none does. As `shape_of`."""
    length, width, height, bottom, level = _measures(points, normals, areas)
    for rule in _RULES:
        fits = all(
            low <= value <= high
            for value, (low, high) in ((bottom, rule.bottom), (height, rule.height), (length, rule.length), (width, rule.width))
        )
        if fits and level >= rule.top_share:
            return rule.category
    return UNKNOWN


def _measures(points: Array, normals: Array, areas: Array) -> tuple[float, float, float, float, float]:
    """Longer and shorter side of the box in plan, its height, that of its bottom [m], and the share of its plan that is level above."""
    pose, size = oriented_box(points)
    length, width, height = float(size[:2].max()), float(size[:2].min()), float(size[2])
    bottom = float(pose[2, 3] - height / 2)
    upper = (normals[:, 2] > 0.8) & (points[:, 2] > bottom + 0.5 * height)
    return length, width, height, bottom, float(areas[upper].sum() / max(length * width, 1e-6))
