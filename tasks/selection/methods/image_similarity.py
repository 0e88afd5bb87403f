"""Pictures by their structure: a baseline that learns nothing (specs C.6, SSIM of image and image)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tasks.fidelity.colors import gray, structural_similarity
from tasks.models import Model
from tasks.selection.evidence import Evidence, InstanceQuery
from tasks.selection.methods.method import Array, Lacking, SelectionMethod
from tasks.selection.methods.pictures import parts_of, seen_from
from tasks.settings import Config, Count
from tasks.views.crops import Crop, filling, squared
from tasks.views.pictures import around

PITCHES_RADIANS = (0.2, 0.5)
"""People hold a camera above furniture: from afar they look down a little, from nearby more."""


@dataclasses.dataclass(frozen=True)
class ImageSimilarity(Config):
    """Structural similarity of the instance's crop and a picture of the candidate: where it stands, from the crop's camera; where nobody
    knows that camera, from around, and the best of these counts."""

    kind: ClassVar[str] = "image_similarity"
    pixels: Count = 96  # of the longer side: details finer than a hundredth of an object are texture and noise
    yaws: Count = 12  # from around, at two heights: every 30 degrees


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: ImageSimilarity, model: Model | None) -> Array:
    """Similarity to the crop, shape (k,), -1..1 put into 0..1.

    Raises:
        Lacking: there is no crop.
    """
    if query.crop is None:
        raise Lacking("no crop of it")
    crop = query.crop.shrunk(config.pixels)
    known: dict[str, float] = {}
    for each in candidates:
        if each.asset.asset_id not in known:
            known[each.asset.asset_id] = _from_its_camera(query, crop, each) if crop.camera else _from_around(query, crop, each, config)
    return np.array([0.5 + 0.5 * known[each.asset.asset_id] for each in candidates])


def similarity(first: NDArray[np.uint8], second: NDArray[np.uint8], where: NDArray[np.bool_]) -> float:
    """Mean structural similarity of two pictures, shapes (h, w, 3), over some of their pixels (h, w); 0 where there is none."""
    return float(structural_similarity(gray(first), gray(second))[where].mean()) if where.any() else 0.0


def _from_its_camera(query: InstanceQuery, crop: Crop, candidate: Evidence) -> float:
    assert crop.camera is not None
    picture, drawn = seen_from(query, candidate, crop.camera)
    seen = np.ones(drawn.shape, dtype=bool) if crop.silhouette is None else crop.silhouette
    return similarity(crop.on_white(), picture, seen | drawn)


def _from_around(query: InstanceQuery, crop: Crop, candidate: Evidence, config: ImageSimilarity) -> float:
    shown = squared(crop.image, config.pixels) if crop.silhouette is None else filling(crop.image, crop.silhouette, config.pixels)
    parts = parts_of(candidate.asset, query.context.blobs, candidate.fit.scale)
    everywhere = np.ones(shown.shape[:2], dtype=bool)
    return max(similarity(shown, picture, everywhere) for picture in around(parts, config.yaws, PITCHES_RADIANS, config.pixels))


IMAGE_SIMILARITY = SelectionMethod(name="image_similarity", config=ImageSimilarity, version="1", score=score, needs=("image",))
