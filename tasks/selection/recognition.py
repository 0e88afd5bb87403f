"""Models that are recognized in the scan: they are the scanned object itself, as far as anything that was seen can tell.

Assets that are made for an instance (crops, fitted templates, furniture made to its box and in its color) agree with the scan because they
come from it. A model of a library does not: where it covers the points in its own size, stands in nothing that was seen empty, and has the
object's colors up to light, chance is no explanation. Its unseen sides are then better than those that anything else makes up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.alignment import AlignmentConfig, Fit, Sample, ScannedInstance
from tasks.alignment.distances import disc_distances, nearest_indices
from tasks.geometry.transforms import transform_points
from tasks.selection.coloring import color_histogram, color_similarity, is_uncolored
from tasks.selection.scoring import ScoreConfig
from tasks.views.sightlines import DepthMap, is_seen_empty

Array = NDArray[np.float64]

SIZE_SHARE, SIZE_M = 0.05, 0.03
"""A model keeps its own size if no side changes by more than a share of it, or by less than a scan tells [m]."""

GAINS = tuple(float(gain) for gain in np.geomspace(0.7, 1.6, 9))
"""Light and exposure of a scan make colors darker or lighter by factors in this range."""


@dataclasses.dataclass(frozen=True)
class ModelLikeness:
    """Likeness of a placed model and the scanned object, all 0 to 1.

    complete: share of the scanned points that its surface covers. consistent: share of the surface that could be seen and is near points,
    or was not seen empty. color: likeness of the colors up to light.
    """

    complete: float
    consistent: float
    color: float

    @property
    def strength(self) -> float:
        """Certainty that the model is the object, 0 to 1: unlike the geometric score, it takes nothing off for unseen sides."""
        return self.complete * self.consistent * self.color


def has_own_size(sample: Sample, fit: Fit) -> bool:
    """True if a model has a size of its own and is placed in it."""
    change = np.abs(fit.scale - 1.0)
    return sample.has_own_size and bool(((change <= SIZE_SHARE) | (change * sample.extents <= SIZE_M)).all())


def likeness_of(
    target: ScannedInstance, sample: Sample, fit: Fit, within: float, frame: Array, views: Sequence[DepthMap], alignment: AlignmentConfig
) -> ModelLikeness:
    """Likeness of a placed model to a scanned instance.

    Args:
        target: scanned instance.
        sample: samples of the model.
        fit: where it stands in the instance's frame.
        within: distance within which surfaces are the same [m].
        frame: instance to world, 4x4 [m].
        views: depth maps of the scan; without any, surface far from points is inconsistent.
        alignment: settings of the alignment.
    """
    placed, normals, radius = sample.placed(fit)
    complete = float((disc_distances(target.points, placed, normals, radius) <= within).mean())
    could_be_seen = target.weights(placed, normals, alignment) >= 1.0
    is_far = nearest_indices(placed, target.points)[1] - target.spacing > within
    if views:
        is_far &= is_seen_empty(transform_points(placed, frame), views)
    consistent = 1.0 - float(is_far[could_be_seen].mean()) if could_be_seen.any() else 0.0
    return ModelLikeness(complete, consistent, lit_similarity(target.colors, sample.colors))


def lit_similarity(scanned: NDArray[np.uint8], model: NDArray[np.uint8]) -> float:
    """Likeness of two sets of colors, 0 to 1, under the light that makes them most alike; 1 if the scan has no colors.

    Args:
        scanned: colors of the scan, shape (n, 3), which its light has changed.
        model: colors of the model, shape (m, 3).
    """
    if is_uncolored(scanned):
        return 1.0
    histogram = color_histogram(model)
    lit = [np.clip(scanned.astype(np.float64) * gain, 0, 255).astype(np.uint8) for gain in GAINS]
    return max(color_similarity(color_histogram(colors), histogram) for colors in lit)


def is_recognized(
    likeness: ModelLikeness, best_complete: float, foreign: float, least_foreign: float, config: ScoreConfig, is_seen: bool
) -> bool:
    """True if a model in its own size is the scanned object.

    Args:
        likeness: of the model.
        best_complete: largest share of the points that a candidate covers.
        foreign: share of foreign and seen-empty space in the model.
        least_foreign: the same of the candidate that has least.
        config: least values.
        is_seen: frames tell which space is empty; without them, unseen sides of the model look inconsistent.
    """
    return (
        likeness.complete >= max(config.recognized_complete, best_complete - (1.0 - config.recognized_complete))
        and likeness.consistent >= (config.recognized_consistent if is_seen else config.recognized_near)
        and likeness.color >= config.recognized_color
        and foreign <= least_foreign + config.whole_margin
    )


def recognized_first(scores: Array, strengths: Sequence[float], lead: float) -> Array:
    """Scores, shape (k,), in which the strongest of the recognized models goes before all others by a lead, as far as scores above 0 allow.

    Args:
        scores: geometric scores, shape (k,).
        strengths: how sure it is that a model is the scanned object, shape (k,); 0 of what is not recognized.
        lead: least difference of scores.
    """
    strongest = max(strengths)
    if strongest <= 0.0:
        return scores
    # One model may fill several slots.
    is_first = np.asarray(strengths) >= strongest
    return np.where(is_first, scores, np.minimum(scores, max(float(scores[is_first].max()) - lead, 0.0)))
