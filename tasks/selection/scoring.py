"""What a candidate's geometric score is made of."""

from __future__ import annotations

import dataclasses

import numpy as np

from schemas.candidates import Asset
from tasks.alignment import Distances
from tasks.settings import Config, Texts


@dataclasses.dataclass(frozen=True)
class ScoreConfig(Config):
    """What a candidate's score is made of. The weights but `foreign` add up to 1, every term lies in 0..1."""

    coverage: float = 0.25  # what was scanned must be there: the surest evidence there is
    scan_closeness: float = 0.20  # how near the surface is to the points: tells shapes apart that both cover
    asset_closeness: float = 0.20  # surface where nothing was scanned; less sure, for scans are partial
    box_iou: float = 0.10  # size and place; mostly settled by the alignment, so it separates only gross misfits
    color: float = 0.10  # light and exposure move colors about; a hint
    foreign: float = 0.6  # taken off as a share of all, per share of foreign space: two chairs in one place throw each other about
    completeness: float = 0.15  # a closed, clean model is worth more in a simulator than a slightly better fit
    threshold_m: float = 0.03  # covered within 3 cm, the noise of a room scan ...
    threshold_share: float = 0.05  # ... or a twentieth of the diagonal, where that is less: a mug is not covered by a point 3 cm off
    threshold_least_m: float = 0.01  # but no scan is finer than this
    falloff: float = 0.04  # of the diagonal: the mean distance at which closeness falls to 1/e; never less than the scan's resolution
    look_loss: float = 0.02  # an asset that scores this much less than an instance's best does where it does for several
    own_geometry: Texts = ("scan_crop",)  # providers, by how their names begin, whose assets are the scan itself
    own_fit_ceiling: float = 0.8  # such an asset fits itself; its fit counts like that of a good model, never as a perfect one
    own_completeness: float = 0.4  # it shows what the scan saw: its back and inside are a guess
    open_completeness: float = 0.1  # and when it is not even closed, physics has to guess too


def score_of(
    distances: Distances, box_iou: float, color: float, complete: float, own: bool, diagonal: float, config: ScoreConfig,
    foreign: float = 0.0, resolution: float = 0.0,
) -> float:  # fmt: skip
    """Weighted score in 0..1. `own`: the asset is made of the instance's own points. `diagonal`: of its box, `resolution`: distance
    between neighboring points of its scan [m]. `foreign`: share of what was seen in it that is not the instance's."""
    falloff = max(config.falloff * diagonal, resolution)
    scan, asset = (float(np.exp(-d / falloff)) for d in (distances.scan, distances.asset))
    coverage = distances.coverage
    if own:
        coverage, scan, asset = (min(v, config.own_fit_ceiling) for v in (coverage, scan, asset))
    total = (
        config.coverage * coverage
        + config.scan_closeness * scan
        + config.asset_closeness * asset
        + config.box_iou * box_iou
        + config.color * color
        + config.completeness * complete
    )
    return float(np.clip(total * (1.0 - config.foreign * foreign), 0.0, 1.0))


def is_own_geometry(asset: Asset, provider: str, config: ScoreConfig) -> bool:
    """Whether an asset is made of scanned points, so that a good fit says nothing about it."""
    return provider.startswith(config.own_geometry) or asset.provider.startswith(config.own_geometry)


def completeness(asset: Asset, own: bool, config: ScoreConfig) -> float:
    """How much of the whole object an asset shows, in 0..1: a model shows all of it, scan geometry what was seen."""
    if not own:
        return 1.0
    return config.own_completeness if asset.is_watertight else config.open_completeness
