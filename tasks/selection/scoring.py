"""What a candidate's geometric score is made of."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from tasks.alignment import Distances
from tasks.settings import Config, Texts

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ScoreConfig(Config):
    """What a candidate's score is made of. The weights but `foreign` add up to 1, every term lies in 0..1."""

    coverage: float = 0.30  # what was scanned must be there: the surest evidence there is
    scan_closeness: float = 0.25  # how near the surface is to the points: tells shapes apart that both cover
    asset_closeness: float = 0.25  # surface where nothing was scanned; less sure, for scans are partial
    box_iou: float = 0.10  # size and place; mostly settled by the alignment, so it separates only gross misfits
    color: float = 0.10  # light and exposure move colors about; a hint
    foreign: float = 0.6  # taken off as a share of all, per share of foreign or seen-empty space: two chairs in one place collide
    threshold_m: float = 0.03  # covered within 3 cm, the noise of a room scan ...
    threshold_share: float = 0.05  # ... or a twentieth of the diagonal, where that is less: a mug is not covered by a point 3 cm off
    threshold_least_m: float = 0.01  # but no scan is finer than this
    falloff: float = 0.04  # of the diagonal: the mean distance at which closeness falls to 1/e; never less than the scan's resolution
    look_loss: float = 0.02  # an asset that scores this much less than an instance's best does where it does for several
    own_geometry: Texts = ("scan_crop",)  # providers, by how their names begin, whose assets are the scan itself
    recognized_complete: float = 0.885  # of the points that a library's model covers: in a house true ones 0.89 and more, others 0.88
    recognized_consistent: float = 0.8  # of its surface that is near points or was not seen empty; scans lose rods, which then look empty
    recognized_near: float = 0.5  # the same without frames, where unseen sides are not near points either
    recognized_color: float = 0.3  # likeness of colors up to light: shadows and few samples leave that much of small true models
    recognized_lead: float = 0.06  # by which a recognized model goes first: more than `look_loss`, and than a learned method chooses among
    whole_least: float = 0.8  # F-score of a model that explains the scan: below, a box that fills a bend is as good as the sofa round it
    color_margin: float = 5.0  # in CIELAB, by which its colors may be farther off: plain ones differ by 6 to 20 from patterns, else by 2
    finest_margin: float = 0.03  # by which the pieces of a crop must fit better than the closed crop, which looks like the scan
    whole_margin: float = 0.05  # a whole model goes before the scan's own geometry where its F-score is no worse by more than this


def score_of(
    distances: Distances, box_iou: float, color: float, diagonal: float, config: ScoreConfig, foreign: float = 0.0, resolution: float = 0.0
) -> float:
    """Weighted agreement with the scan, 0 to 1, by the same weights whoever offers the asset.

    Args:
        distances: distances between the placed asset and the points.
        box_iou: intersection over union of their boxes, 0 to 1.
        color: likeness of their colors, 0 to 1.
        diagonal: diagonal of the instance's box [m].
        config: weights.
        foreign: share of foreign and seen-empty space in the asset, 0 to 1.
        resolution: distance between neighboring points of the scan [m].
    """
    falloff = max(config.falloff * diagonal, resolution)
    scan, asset = (float(np.exp(-d / falloff)) for d in (distances.scan, distances.asset))
    total = (
        config.coverage * distances.coverage
        + config.scan_closeness * scan
        + config.asset_closeness * asset
        + config.box_iou * box_iou
        + config.color * color
    )
    return float(np.clip(total * (1.0 - config.foreign * foreign), 0.0, 1.0))


LEAST_DIFFERENCE = 1e-6
"""Difference of scores that ranks one candidate after another; scores are compared to nine digits."""

CLOSED, PIECES = "scan_crop_closed", "scan_crop_pieces"
"""Providers of the scan's own geometry, by how their names begin."""

WITHIN = 5.0 / 3.0
"""F-scores are at so many times the distance within which a point counts as covered: 5 cm of furniture, less of small things."""


def whole_first(
    scores: Array, f_scores: Array, foreign: Array, is_own: Sequence[bool], margin: float, color_errors: Array | None = None,
    color_margin: float = np.inf, least: float = 0.0,
) -> Array:  # fmt: skip
    """Scores, shape (k,), in which the scan's own geometry comes after a whole model that explains the scan as well.

    Own geometry reproduces the scan with its noise and holes, so that a small lead says nothing. A model with worse evidence gains nothing.

    Args:
        scores: geometric scores, shape (k,).
        f_scores: of the placed assets and the scan, shape (k,).
        foreign: shares of foreign and seen-empty space, shape (k,).
        is_own: whether a candidate is made of scanned points.
        margin: by which a model may be worse in F-score or foreign space.
        color_errors: distances of colors where surfaces meet points, shape (k,); without them, colors do not count.
        color_margin: by which a model may be worse in these: a plain curtain does not go before the pattern that was scanned.
        least: F-score below which no model goes before own geometry.
    """
    ranked = scores.copy()
    models = ~np.asarray(is_own, dtype=np.bool_)
    explains = f_scores >= least
    errors = np.zeros(len(scores)) if color_errors is None else color_errors
    for k in np.flatnonzero(~models):
        is_as_good = models & explains & (f_scores >= f_scores[k] - margin) & (foreign <= foreign[k] + margin)
        is_as_good &= errors <= errors[k] + color_margin
        whole = scores[is_as_good]
        if len(whole):
            ranked[k] = min(scores[k], max(float(whole.max()) - LEAST_DIFFERENCE, 0.0))
    return ranked


def pattern_first(scores: Array, is_own: Sequence[bool], color_errors: Array, margin: float, color_margin: float) -> Array:
    """Scores, shape (k,), in which a model with other colors comes after own geometry that fits about as well.

    Args:
        scores: geometric scores, shape (k,).
        is_own: whether a candidate is made of scanned points.
        color_errors: distances of colors where surfaces meet points, shape (k,).
        margin: by which own geometry may score less.
        color_margin: by which the model's colors must be farther off: that of a patterned rug from a plain one.
    """
    ranked, own = scores.copy(), np.asarray(is_own, dtype=np.bool_)
    for k in np.flatnonzero(~own):
        is_like_scan = own & (scores >= scores[k] - margin) & (color_errors < color_errors[k] - color_margin)
        if is_like_scan.any():
            ranked[k] = min(scores[k], max(float(scores[is_like_scan].max()) - LEAST_DIFFERENCE, 0.0))
    return ranked


def finest_first(scores: Array, providers: Sequence[str], margin: float) -> Array:
    """Scores, shape (k,), in which the closed crop goes before the convex pieces of the same crop unless these are clearly better.

    Both collide as the same pieces; the closed crop alone looks like the scan.

    Args:
        scores: geometric scores, shape (k,).
        providers: of the assets.
        margin: lead of the pieces up to which the closed crop goes first.
    """
    closed = np.array([provider.startswith(CLOSED) for provider in providers], dtype=np.bool_)
    pieces = np.array([provider.startswith(PIECES) for provider in providers], dtype=np.bool_)
    if not closed.any():
        return scores
    best = float(scores[closed].max())
    is_near = pieces & (scores <= best + margin)
    return np.where(is_near, np.minimum(scores, max(best - LEAST_DIFFERENCE, 0.0)), scores)


def is_own_geometry(asset: Asset, provider: str, config: ScoreConfig) -> bool:
    """Whether an asset is made of scanned points, so that it fits whatever its unseen sides are."""
    return provider.startswith(config.own_geometry) or asset.provider.startswith(config.own_geometry)
