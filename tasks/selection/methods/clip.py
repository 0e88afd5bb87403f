"""CLIP: how well a text about the instance goes with pictures of the candidate (specs C.6, text to image)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np

from schemas.candidates import Asset
from tasks.models import Model
from tasks.selection.evidence import Evidence, InstanceQuery
from tasks.selection.methods.encoders import ClipEncoder, Vectors, check_installed, clip_in, remembered, weights_digest
from tasks.selection.methods.method import Array, SelectionMethod, chances
from tasks.selection.methods.pictures import parts_of
from tasks.settings import Config, Count
from tasks.views.pictures import around

PITCH_RADIANS = 0.35


@dataclasses.dataclass(frozen=True)
class Clip(Config):
    """Cosine of CLIP's vectors of a text and of the mean of an asset's pictures. Needs weights that the user names."""

    kind: ClassVar[str] = "clip"
    weights: str = ""  # folder that transformers wrote; none ships, as theirs are of hundreds of megabytes
    text: Literal["caption", "category"] = "caption"  # a caption tells materials and colors too; the paper's release has the category alone
    views: Count = 4  # pictures of an asset from around: front, back and sides


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: Clip, model: Model | None) -> Array:
    """Chances of the candidates, shape (k,): the softmax of their cosines by CLIP's own scale, which tells ten apart.

    Raises:
        InputError: the folder of weights cannot be used.
    """
    encoder = clip_in(config.weights)
    vectors = {each.asset.asset_id: asset_vector(each.asset, query, encoder, config) for each in candidates}
    text = encoder.texts([text_of(query, config.text)])[0]
    return chances(np.array([encoder.scale * float(vectors[each.asset.asset_id] @ text) for each in candidates]))


def text_of(query: InstanceQuery, kind: str) -> str:
    """What is asked for: the caption where it is wanted and there is one, else the category as in the paper's release."""
    return query.text if kind == "caption" and query.text else f"A photo of a {query.category}."


def asset_vector(asset: Asset, query: InstanceQuery, encoder: ClipEncoder, config: Clip) -> Array:
    """Mean of CLIP's vectors of an asset's pictures, length 1, shape (d,); remembered by content."""

    def make() -> Vectors:
        return encoder.images(around(parts_of(asset, query.context.blobs), config.views, (PITCH_RADIANS,), encoder.side))

    key = f"{weights_digest(config.weights)}:{asset.mesh_blob}:{config.views}"
    mean = remembered(query.context.caches[__name__], key, make).astype(np.float64).mean(axis=0)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-9))


def label(config: Clip, model: Model | None) -> str:
    """Which weights scored."""
    return weights_digest(config.weights)[:12]


def check(config: Clip) -> None:
    """Raises InputError where the folder of weights is not there, or packages are not installed."""
    weights_digest(config.weights)
    check_installed()


CLIP = SelectionMethod(name="clip", config=Clip, version="1", score=score, needs=("text", "clip"), label=label, check=check)
