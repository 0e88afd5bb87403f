"""Selection: every candidate of an instance aligned to it and scored by a method; rank 1 is the choice."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.selection import Selection
from tasks.alignment import AlignmentConfig
from tasks.alignment.instances import BESIDE_M, FLOOR_SNAP_M
from tasks.geometry.transforms import flat, yaw_pose
from tasks.models import Model
from tasks.selection.evidence import Evidence, InstanceQuery, gather
from tasks.selection.looks import shared
from tasks.selection.methods.geometric import GEOMETRIC, Geometric
from tasks.selection.methods.members import METHODS, method_of
from tasks.selection.methods.method import Array, Lacking, MethodConfig, missing
from tasks.selection.methods.model import wanted
from tasks.selection.scoring import ScoreConfig, is_own_geometry, score_of
from tasks.settings import Config, union_of
from tasks.stage import Context, Outcome, Stage

__all__ = ["STAGE", "AlignmentConfig", "ScoreConfig", "SelectionConfig", "is_own_geometry", "run", "score_of", "scored"]

if TYPE_CHECKING:
    Provider = MethodConfig
else:
    Provider = union_of(method.config for method in METHODS)


@dataclasses.dataclass(frozen=True)
class SelectionConfig(Config):
    """How candidates are aligned and scored."""

    alignment: AlignmentConfig = dataclasses.field(default_factory=AlignmentConfig)
    provider: Provider = dataclasses.field(default_factory=Geometric)  # learned scores choose worse where no candidate is the true model
    score: ScoreConfig = dataclasses.field(default_factory=ScoreConfig)
    beside_m: float = BESIDE_M  # points farther out of the instance's box than its own noise are another object's
    floor_snap_m: float = FLOOR_SNAP_M  # scans bleed: what ends this near the floor stands on it


def run(
    *,
    instances: Sequence[Instance],
    candidates: Sequence[Candidate],
    assets: Sequence[Asset],
    captions: Sequence[Caption] = (),
    frames: Sequence[Frame] = (),
    masks: Sequence[Mask] = (),
    context: Context,
    config: SelectionConfig,
    model: Model | None = None,
) -> Outcome:
    """Selections: one row per filled slot of every instance, ranked by score; equal scores by slot, and, where the method
    scores by fit, first what several share: `score.look_loss` is a distance of geometric scores, and says nothing in those of others.

    A candidate whose mesh cannot be read is left out, and so is an instance without any candidate; where the method lacks what it needs,
    the geometric score stands in. All of this is said.

    Raises:
        InputError: the config does not name weights or an endpoint that its method needs, or these cannot be used.
    """
    check = method_of(config.provider).check
    if check is not None:
        check(config.provider)
    degradations: list[str] = []
    rankings: dict[str, list[Selection]] = {}
    gathered = gather(instances, candidates, assets, context, config, degradations, captions=captions, frames=frames, masks=masks)
    prepare = method_of(config.provider).prepare
    if prepare is not None:
        prepare([each.asset for _, evidence in gathered for each in evidence], context, config.provider, model)
    for query, evidence in gathered:
        scores, provider, version, lacks = scored(query, evidence, config.provider, model)
        if lacks is not None:
            degradations.append(f"{query.instance.instance_id}: {config.provider.kind}: {lacks}; scored by {provider}")
        rankings[query.instance.instance_id] = _ranked(query, evidence, scores, provider, version)
    if method_of(config.provider).is_geometric(config.provider):
        categories = {row.instance_id: row.category for row in instances}
        rankings = shared(rankings, categories, config.score.look_loss)
    return Outcome(selections=[row for rows in rankings.values() for row in rows], degradations=degradations)


def scored(
    query: InstanceQuery, evidence: Sequence[Evidence], config: MethodConfig, model: Model | None = None
) -> tuple[Array, str, str, str | None]:
    """Scores of an instance's candidates, shape (k,), name and version of who scored, and what the method that was asked for lacked: then
    the geometric score stood in. None where it lacked nothing."""
    method = method_of(config)
    try:
        lacks = missing(method, query, model)
        if lacks is None:
            return method.score(query, evidence, config, model), method.name, method.row_version(config, model), None
    except Lacking as problem:
        lacks = str(problem)
    return GEOMETRIC.score(query, evidence, Geometric(), None), GEOMETRIC.name, GEOMETRIC.version, lacks


def _ranked(query: InstanceQuery, evidence: Sequence[Evidence], scores: Array, provider: str, version: str) -> list[Selection]:
    """Rows of one instance, best first."""
    rows = [
        Selection(
            scene_id=query.instance.scene_id,
            instance_id=query.instance.instance_id,
            rank=1,
            slot=each.candidate.slot,
            asset_id=each.asset.asset_id,
            score=float(score),
            chamfer_m=each.distances.chamfer,
            coverage=each.distances.coverage,
            box_iou=each.box_iou,
            foreign_share=each.foreign,
            color_similarity=each.color,
            pose=flat(query.frame @ yaw_pose(each.fit.yaw, each.fit.offset)),
            scale=tuple(float(v) for v in each.fit.scale),
            look=None,
            provider=provider,
            provider_version=version,
        )
        for each, score in zip(evidence, scores, strict=True)
    ]
    rows.sort(key=lambda row: (-round(row.score, 9), row.slot))
    return [dataclasses.replace(row, rank=rank) for rank, row in enumerate(rows, start=1)]


STAGE = Stage(
    name="selection",
    reads=("instances", "frames", "masks", "captions", "candidates", "assets"),
    writes=("selections",),
    config=SelectionConfig,
    run=run,
    outside=("model",),
    model_wanted=lambda config: wanted(config.provider),
)
