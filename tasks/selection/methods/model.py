"""A model that was trained here, or ships (`tasks.selection.model`): image, text and points against the candidates' points."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from schemas.candidates import Asset
from schemas.errors import InputError
from tasks.geometry.transforms import yaw_pose
from tasks.models import Model
from tasks.selection.evidence import Evidence, InstanceQuery
from tasks.selection.methods.method import Array, Lacking, SelectionMethod, chances
from tasks.settings import Config, Share
from tasks.stage import Context, WantedModel

if TYPE_CHECKING:
    from tasks.selection.model.config import SelectionModel
    from tasks.selection.model.features import Contender, Scanned

SYSTEM = "selection"
"""The learned system whose models score."""


@dataclasses.dataclass(frozen=True)
class ModelScores(Config):
    """The scores of a learned model: of the lake's newest, else the one that ships, or of the one that is named."""

    kind: ClassVar[str] = "model"
    model_id: str = ""  # or how it begins, or the name of one that ships; without, the newest not withdrawn, else the first that ships
    within: Share = 0.05  # it chooses among candidates whose geometric score is this near to the best one: 1 among all, 0 as `geometric`


def wanted(config: Any) -> WantedModel | None:
    """Which model a method's config asks for; None where it asks for none."""
    return WantedModel(SYSTEM, config.model_id) if isinstance(config, ModelScores) else None


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: ModelScores, model: Model | None) -> Array:
    """Scores of the candidates, shape (k,).

    Among all: their chances, the softmax of the model's scores, as it was trained to. Among those that fit nearly as well as the best one:
    the best geometric score less `within`, 0 at least, and of the rest as much as they have of the chances among each other; the others
    keep their own geometric scores, which are less. So a score is never farther from the geometric one than `within`, and compares with it.

    Raises:
        Lacking: there is no model.
        InputError: the model cannot be used.
    """
    if model is None:
        raise Lacking("no model")
    scorer = _scorer(model.model_id, model.weights, model.config)
    logits = scorer.score(scanned_of(query, scorer.config), contenders_of(query, candidates, scorer.config))
    if config.within == 1.0:
        return chances(logits)
    fit = np.array([each.geometric for each in candidates])
    best = fit.max(initial=0.0)
    least = max(best - config.within, 0.0)
    competes = fit >= least
    return np.where(competes, least + (best - least) * chances(np.where(competes, logits, -np.inf)), fit)


def prepare(assets: Sequence[Asset], context: Context, config: ModelScores, model: Model | None) -> None:
    """Remember the clouds of assets."""
    from tasks.selection.model import sight

    if model is not None:
        own = _scorer(model.model_id, model.weights, model.config).config
        sight.remember_clouds((asset.mesh_blob for asset in assets), context, own, context.caches[sight.__name__])


MOST_WITHIN = 0.1
"""Scores that are farther from geometric ones say nothing of fit by their differences."""


def is_geometric(config: ModelScores) -> bool:
    """Whether scores are so near to geometric ones that what loses little of them fits nearly as well."""
    return config.within <= MOST_WITHIN


def scanned_of(query: InstanceQuery, config: SelectionModel) -> Scanned:
    """An instance as a model sees it; without a crop where that cannot be read."""
    from tasks.selection.model.sight import scanned

    try:
        image = query.image
    except InputError:
        image = None
    return scanned(query.points, query.colors, query.target.size, query.category, query.text, image, config)


def contenders_of(query: InstanceQuery, candidates: Sequence[Evidence], config: SelectionModel) -> list[Contender]:
    """Candidates as a model sees them."""
    from tasks.selection.model import sight
    from tasks.selection.model.clouds import unpacked
    from tasks.selection.model.features import Contender

    memory = query.context.caches[sight.__name__]
    contenders = []
    for each in candidates:
        vector = sight.evidence(
            coverage=each.distances.coverage, box_iou=each.box_iou, color=each.color, foreign=each.foreign,
            chamfer_m=each.distances.chamfer, diagonal_m=query.target.diagonal, scale=each.fit.scale, category=query.category,
            asset=each.asset, is_own=each.own,
        )  # fmt: skip
        cloud = unpacked(sight.surface_cloud(each.asset.mesh_blob, query.context.blobs, config, memory))
        extents = np.asarray(each.asset.extents, dtype=np.float32)
        contenders.append(Contender(cloud, extents, yaw_pose(each.fit.yaw, each.fit.offset), each.fit.scale, vector))
    return contenders


@lru_cache(maxsize=2)
def _scorer(model_id: str, weights: bytes, config: str) -> Any:
    """What scores by a model's weights, opened once in a process."""
    from tasks.selection.model.inference import load
    from tasks.selection.model.sight import config_from

    return load(weights, config_from(config), f"model {model_id[:12]}")


def label(config: ModelScores, model: Model | None) -> str:
    """Which model scored, and among which."""
    limit = "" if config.within >= 1.0 else f":{config.within!r}"
    return "" if model is None else model.model_id[:12] + limit


MODEL = SelectionMethod(
    name="model", config=ModelScores, version="2", score=score, needs=("model",), label=label, is_geometric=is_geometric, prepare=prepare
)
