"""Simulated annotators: programs that answer in the place of people, for scans whose models are known.

The rule. Candidates are ranked by how much they differ from the model that was scanned, `dissimilarity`, a sum of what a person would see:

- shape: chamfer distance [m] to the true model after both stand on one point and the candidate was sized to it within `resize`, turned by
  the quarter turn that is best, as a share of the true model's diagonal, per `shape_unit`;
- color: mean CIE 1976 difference between points of one and the likest of the `NEAREST` points of the other as they then stand, both
  ways, per `color_unit`;
- category: 1 minus the similarity of the words (`tasks.library.categories`), times `category_weight`;
- `scan_penalty` where the candidate is a piece of the scan itself: its surface is lumpy and its back a guess.

The choice and the ranks after it are the order of minus that sum plus Gumbel noise of scale `noise`: of two candidates the nearer is taken
with the probability of a logistic function (the Plackett-Luce model). In a share of `mistakes` of the answers, the order is by chance.
Answers are written as `simulated`, which no row made of them loses.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.alignment import Fit, Sample
from tasks.alignment.distances import disc_distances
from tasks.geometry.colors import linear_of
from tasks.geometry.meshes import Surface, sample_surface
from tasks.geometry.triangles import surface_area
from tasks.library.categories import category_similarity
from tasks.settings import Config, Count, NonNegative, Positive, Share

Array = NDArray[np.float64]

SAMPLES, COMPARED = 1024, 256
"""Points of a surface, and how many of them are held against another's: means are then known to a few percent."""

NEAREST = 4
"""Points nearby of which the likest in color counts: two samples of one surface never have the same points at a seam of colors."""

TOOL = "simulated annotator"
"""What every answer names as the tool that it was given with."""

FIRST_MOMENT = datetime(2026, 1, 1, tzinfo=UTC)
"""When the first answer of a batch is said to be given; nobody was there to look at a clock."""


@dataclasses.dataclass(frozen=True)
class AnnotatorRule(Config):
    """How simulated annotators rank; see the module for the rule."""

    shape_unit: Positive = 0.03  # of the diagonal: two chairs of one style differ by less, chair and stool by twice that
    color_unit: Positive = 15.0  # a difference that everybody calls another color is above 10
    category_weight: NonNegative = 1.5  # as much as half a model in the wrong place: the one error that everybody sees
    scan_penalty: NonNegative = 1.0  # guidelines of the paper prefer whole, clean models
    resize: Positive = 1.1  # candidates are sized by so much at most before shapes are compared: more looks stretched
    noise: NonNegative = 0.08  # scale of the Gumbel noise: who is nearer by 0.3 wins 98 times of 100
    mistakes: Share = 0.03  # answers by chance; reviews of people's answers find two percent
    ranked: Count = 5  # places that are ranked, as in the paper


@dataclasses.dataclass(frozen=True)
class ShownModel:
    """What an annotator sees of a model. sample: of its surface, in its own frame, bottom center of its box at the origin, +Z up [m];
    is_scan: it is a piece of the scan."""

    category: str
    sample: Sample
    is_scan: bool = False

    @staticmethod
    def of(category: str, surface: Surface, rng: np.random.Generator, is_scan: bool = False) -> ShownModel:
        """What is seen of a surface in a frame with +Z up [m]."""
        points, colors, normals = sample_surface(surface, SAMPLES, rng)
        low, high = surface.bounds
        shift = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
        area = surface_area(surface.vertices, surface.faces)
        return ShownModel(category, Sample(points - shift, normals, colors, np.maximum(high - low, 1e-4), area), is_scan)


@dataclasses.dataclass(frozen=True)
class ModelDifference:
    """How much a candidate differs. chamfer_m: after alignment [m]; color: CIE 1976; category: 0..1; total: by the rule."""

    chamfer_m: float
    color: float
    category: float
    total: float


def dissimilarity(true: ShownModel, other: ShownModel, rule: AnnotatorRule) -> ModelDifference:
    """How much a candidate differs from the true model. Distances are to small discs round samples, so that two samples of one surface
    are nearly 0 m apart."""
    from scipy.spatial import cKDTree

    own = true.sample
    own_points, own_normals, own_radius = own.placed(Fit(0.0, np.zeros(3), np.ones(3)))
    diagonal = float(np.linalg.norm(own.extents))
    best, placed = np.inf, own_points
    for quarter in range(4):
        sides = other.sample.extents[[1, 0, 2]] if quarter % 2 else other.sample.extents
        scale = np.clip(own.extents / sides, 1 / rule.resize, rule.resize)
        fit = Fit(0.5 * np.pi * quarter, np.zeros(3), scale[[1, 0, 2]] if quarter % 2 else scale)
        points, normals, radius = other.sample.placed(fit)
        there = disc_distances(points[:COMPARED], own_points, own_normals, own_radius)
        back = disc_distances(own_points[:COMPARED], points, normals, radius)
        chamfer = 0.5 * float(there.mean() + back.mean())
        if chamfer < best:
            best, placed = chamfer, points
    lab, other_lab = lab_of(own.colors), lab_of(other.sample.colors)
    near, back_near = cKDTree(own_points).query(placed, k=NEAREST)[1], cKDTree(placed).query(own_points, k=NEAREST)[1]
    shades = _least(other_lab, lab[near]) + _least(lab, other_lab[back_near])
    color, category = 0.5 * shades, 1.0 - category_similarity(true.category, other.category)
    total = best / diagonal / rule.shape_unit + color / rule.color_unit + rule.category_weight * category
    return ModelDifference(best, color, category, total + (rule.scan_penalty if other.is_scan else 0.0))


def order(totals: Sequence[float], rule: AnnotatorRule, rng: np.random.Generator) -> tuple[list[int], bool]:
    """Indices of candidates as an annotator ranks them, best first, and whether the answer is a mistake."""
    noise, mistaken, chance = rng.gumbel(0.0, 1.0, len(totals)), bool(rng.random() < rule.mistakes), rng.permutation(len(totals))
    if mistaken:
        return [int(k) for k in chance], True
    return [int(k) for k in np.argsort(np.asarray(totals) - rule.noise * noise, kind="stable")], False


def answer(scene_id: str, instance_id: str, annotator: str, slots: Sequence[int], number: int) -> dict[str, Any]:
    """An answer as `batch.schema.json` has it, marked as simulated. slots: ranked, best first; number: of the answer in its batch."""
    moment = FIRST_MOMENT + timedelta(seconds=number)
    return {
        "scene_id": scene_id,
        "instance_id": instance_id,
        "annotator": annotator,
        "answered_at": moment.isoformat(),
        "choice": slots[0],
        "ranking": list(slots),
        "tool": TOOL,
        "simulated": True,
    }


def _least(colors: Array, nearby: Array) -> float:
    """Mean of the least difference of each color, shape (n, 3), from several, shape (n, k, 3)."""
    return float(np.linalg.norm(nearby - colors[:, None], axis=2).min(axis=1).mean())


def lab_of(colors: NDArray[np.uint8]) -> Array:
    """sRGB colors, shape (n, 3), in CIE L*a*b* under D65 (IEC 61966-2-1; CIE 15), shape (n, 3)."""
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    ratio = linear_of(colors / 255.0) @ to_xyz.T / np.array([0.9505, 1.0, 1.089])
    root = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.column_stack([116 * root[:, 1] - 16, 500 * (root[:, 0] - root[:, 1]), 200 * (root[:, 1] - root[:, 2])])
