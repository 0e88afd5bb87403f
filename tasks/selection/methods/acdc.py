"""ACDC (Dai et al., 2024, "digital cousins"): the asset one of whose snapshots is nearest to the crop in DINOv2's patches; before, CLIP
may narrow the categories (specs C.6)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tasks.models import Model
from tasks.selection.evidence import Evidence, InstanceQuery
from tasks.selection.methods.encoders import check_installed, clip_in, dino_in, remembered, weights_digest
from tasks.selection.methods.method import Array, Lacking, SelectionMethod
from tasks.selection.methods.pictures import parts_of
from tasks.settings import Config, Count, Positive
from tasks.views.crops import filling, squared
from tasks.views.pictures import around


@dataclasses.dataclass(frozen=True)
class AcdcScores(Config):
    """Likeness of DINOv2's patches of the crop and of the nearest of an asset's snapshots. Needs weights that the user names."""

    kind: ClassVar[str] = "acdc"
    weights: str = ""  # folder of DINOv2 that transformers wrote; ACDC has ViT-S/14
    clip: str = ""  # folder of CLIP for the choice of categories; without one all candidates are compared
    categories: Count = 3  # that CLIP's text finds nearest to the instance's, as published; assets of others come after all of these
    yaws: Count = 12  # snapshots per height: every 30 degrees; 50 at two heights are ACDC's hundred
    pitch_radians: Positive = 0.35  # furniture lies below the eye


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: AcdcScores, model: Model | None) -> Array:
    """Mean cosine of patches at the same place, of the nearest snapshot, shape (k,): -1..1 put into 0.5..1 for the categories that CLIP
    chose, into 0..0.5 for the others.

    Raises:
        Lacking: there is no crop.
        InputError: a folder of weights cannot be used.
    """
    if query.crop is None:
        raise Lacking("no crop of it")
    encoder = dino_in(config.weights)
    crop = query.crop
    shown = squared(crop.image, encoder.side) if crop.silhouette is None else filling(crop.image, crop.silhouette, encoder.side)
    asked = encoder.patches(shown[None])[0]
    near: dict[str, float] = {}
    for each in candidates:
        if each.asset.asset_id not in near:
            near[each.asset.asset_id] = nearest(asked, _snapshots(query, each, config))
    chosen = likely_categories(query.category, [each.asset.category for each in candidates], config)
    agreement = np.array([0.5 + 0.5 * near[each.asset.asset_id] for each in candidates])
    return np.array([0.5 * value + 0.5 * (each.asset.category in chosen) for each, value in zip(candidates, agreement, strict=True)])


def nearest(asked: NDArray[np.float32], snapshots: NDArray[np.float32]) -> float:
    """Mean cosine of patches at the same place, shape (p, d), of the snapshot that has most, (n, p, d); -1..1."""
    return float(np.clip(np.einsum("pd,npd->np", asked.astype(np.float64), snapshots.astype(np.float64)).mean(axis=1).max(), -1.0, 1.0))


def likely_categories(category: str, offered: Sequence[str], config: AcdcScores) -> frozenset[str]:
    """The categories among those offered that CLIP's text finds nearest to an instance's; all where no CLIP is named or nothing known."""
    names = sorted(set(offered))
    if not config.clip or not category or len(names) <= config.categories:
        return frozenset(names)
    vectors = clip_in(config.clip).texts([f"A photo of a {name}." for name in (category, *names)]).astype(np.float64)
    order = np.argsort(-np.round(vectors[1:] @ vectors[0], 9), kind="stable")
    return frozenset(names[i] for i in order[: config.categories])


def _snapshots(query: InstanceQuery, candidate: Evidence, config: AcdcScores) -> NDArray[np.float32]:
    """Patches of an asset's snapshots, shape (n, p, d), remembered by content."""
    encoder, asset = dino_in(config.weights), candidate.asset

    def make() -> NDArray[np.float32]:
        return encoder.patches(around(parts_of(asset, query.context.blobs), config.yaws, (config.pitch_radians,), encoder.side))

    key = f"{weights_digest(config.weights)}:{asset.mesh_blob}:{config.yaws}:{config.pitch_radians!r}"
    return remembered(query.context.caches[__name__], key, make, half=True)  # megabytes an asset


def label(config: AcdcScores, model: Model | None) -> str:
    """Which weights scored."""
    return "+".join(weights_digest(folder)[:12] for folder in (config.weights, config.clip) if folder)


def check(config: AcdcScores) -> None:
    """Raises InputError where a folder of weights is not there, or packages are not installed."""
    label(config, None)
    weights_digest(config.weights)
    check_installed()


ACDC = SelectionMethod(name="acdc", config=AcdcScores, version="1", score=score, needs=("image", "dinov2"), label=label, check=check)
