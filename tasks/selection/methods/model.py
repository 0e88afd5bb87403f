"""A model that was trained here, or ships (`tasks.selection.model`): image, text and points against the candidates' points."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from schemas.errors import InputError
from tasks.geometry.transforms import yaw_pose
from tasks.models import Model
from tasks.selection.evidence import Evidence, InstanceQuery
from tasks.selection.methods.method import Array, Lacking, SelectionMethod, chances
from tasks.settings import Config, adapter
from tasks.stage import WantedModel

if TYPE_CHECKING:
    from tasks.selection.model.features import Contender, Scanned

SYSTEM = "selection"
"""The learned system whose models score."""


@dataclasses.dataclass(frozen=True)
class ModelScores(Config):
    """The scores of a learned model: of the lake's newest, else the one that ships, or of the one that is named."""

    kind: ClassVar[str] = "model"
    model_id: Annotated[str, Field(pattern=r"[0-9a-f]{0,64}")] = ""  # or how it begins; without, the newest that was not withdrawn


def wanted(config: Any) -> WantedModel | None:
    """Which model a method's config asks for; None where it asks for none."""
    return WantedModel(SYSTEM, config.model_id) if isinstance(config, ModelScores) else None


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: ModelScores, model: Model | None) -> Array:
    """Chances of the candidates, shape (k,): the softmax of the model's scores, as it was trained to.

    Raises:
        Lacking: there is no model.
        InputError: the model cannot be used.
    """
    if model is None:
        raise Lacking("no model")
    return chances(_scorer(model.model_id, model.weights, model.config).score(scanned_of(query), contenders_of(query, candidates)))


def scanned_of(query: InstanceQuery) -> Scanned:
    """An instance as the model sees it."""
    from tasks.selection.model.examples import scan_cloud
    from tasks.selection.model.features import Scanned

    cloud = scan_cloud(query.points, query.colors, CLOUD)
    try:
        image = query.image
    except InputError:  # it is scored without
        image = None
    return Scanned(cloud, query.target.size.astype(np.float32), query.category, query.text, image)


CLOUD = 512
"""Points of a cloud; models take the first of them, which lie apart."""


def contenders_of(query: InstanceQuery, candidates: Sequence[Evidence]) -> list[Contender]:
    """Candidates as the model sees them."""
    from tasks.selection.model.clouds import spread_cloud
    from tasks.selection.model.features import Contender, evidence_of

    contenders = []
    for each in candidates:
        measured = evidence_of(
            coverage=each.distances.coverage, box_iou=each.box_iou, color=each.color, foreign=each.foreign,
            chamfer_m=each.distances.chamfer, diagonal_m=query.target.diagonal, score=each.geometric, scale=each.fit.scale,
            is_category=each.asset.category.lower() == query.category, is_own=each.own, is_closed=each.asset.is_watertight,
        )  # fmt: skip
        cloud = spread_cloud(each.sample.points, each.sample.colors, CLOUD, each.sample.normals)
        pose = yaw_pose(each.fit.yaw, each.fit.offset)
        contenders.append(Contender(cloud, each.sample.extents.astype(np.float32), pose, each.fit.scale, measured))
    return contenders


@lru_cache(maxsize=2)
def _scorer(model_id: str, weights: bytes, config: str) -> Any:
    """What scores by a model's weights, opened once in a process."""
    from tasks.selection.model.config import SelectionModel
    from tasks.selection.model.inference import load

    return load(weights, adapter(SelectionModel).validate_python(json.loads(config)), f"model {model_id[:12]}")


def label(config: ModelScores, model: Model | None) -> str:
    """Which model scored."""
    return "" if model is None else model.model_id[:12]


MODEL = SelectionMethod(name="model", config=ModelScores, version="1", score=score, needs=("model",), label=label)
