"""Selection: every candidate of an instance aligned to it and scored by geometry and color; rank 1 is the choice."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from schemas.candidates import Asset, Candidate
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.selection import Selection
from tasks.geometry.boxes import grown_box, oriented_iou
from tasks.geometry.meshes import read_points
from tasks.geometry.transforms import flat, inverse, transform_points, translation, yaw_of, yaw_pose
from tasks.mounting import mounting
from tasks.selection.alignment import AlignmentConfig, Distances, Fit, Sample, ScannedInstance, align, make_target, sample_asset
from tasks.selection.coloring import color_histogram, color_similarity
from tasks.selection.looks import shared
from tasks.selection.neighbors import Neighborhood, foreign_share
from tasks.settings import Config, Texts
from tasks.stage import Context, Outcome, Stage

__all__ = ["STAGE", "AlignmentConfig", "ScoreConfig", "SelectionConfig", "completeness", "is_own_geometry", "run", "score_of"]

PROVIDER = "geometric"
PROVIDER_VERSION = "5"

LEAST_WITHIN = 0.3
"""A box that holds less than this share of its points is none to go by."""


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


@dataclasses.dataclass(frozen=True)
class SelectionConfig(Config):
    """How candidates are aligned and scored."""

    alignment: AlignmentConfig = dataclasses.field(default_factory=AlignmentConfig)
    score: ScoreConfig = dataclasses.field(default_factory=ScoreConfig)
    beside_m: float = 0.05  # points farther out of the instance's box than its own noise are another object's
    floor_snap_m: float = 0.05  # scans bleed: what ends this near the floor stands on it


def run(
    *,
    instances: Sequence[Instance],
    candidates: Sequence[Candidate],
    assets: Sequence[Asset],
    context: Context,
    config: SelectionConfig,
) -> Outcome:
    """Selections: one row per filled slot of every instance, ranked by score; equal scores by slot, and first what several share.

    A candidate whose mesh cannot be read is left out, and so is an instance without any candidate; both are said.
    """
    by_asset = {asset.asset_id: asset for asset in assets}
    by_instance: dict[str, list[Candidate]] = defaultdict(list)
    for candidate in sorted(candidates, key=lambda c: (c.instance_id, c.slot)):
        if candidate.outcome == "filled" and candidate.asset_id is not None:
            by_instance[candidate.instance_id].append(candidate)
    samples: dict[str, Sample | None] = {}
    degradations: list[str] = []
    for asset_id in sorted({c.asset_id for rows in by_instance.values() for c in rows if c.asset_id}):
        samples[asset_id] = _sample(by_asset.get(asset_id), asset_id, context, config, degradations)
    rankings: dict[str, list[Selection]] = {}
    neighborhood = Neighborhood.of(instances, context.blobs)
    for instance in sorted(instances, key=lambda i: i.instance_id):
        if instance.is_structure:
            continue
        usable = [c for c in by_instance[instance.instance_id] if samples.get(c.asset_id or "")]
        if not usable:
            degradations.append(f"{instance.instance_id}: no candidate to select from")
            continue
        rankings[instance.instance_id] = _rank(instance, usable, by_asset, samples, neighborhood, context, config)
    categories = {row.instance_id: row.category for row in instances}
    rankings = shared(rankings, categories, config.score.look_loss)
    return Outcome(selections=[row for rows in rankings.values() for row in rows], degradations=degradations)


STAGE = Stage(
    name="selection",
    reads=("instances", "candidates", "assets"),
    writes=("selections",),
    config=SelectionConfig,
    run=run,
)


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


def _sample(asset: Asset | None, asset_id: str, context: Context, config: SelectionConfig, degradations: list[str]) -> Sample | None:
    """Samples of an asset, or None and the reason among the degradations."""
    try:
        if asset is None:
            raise ValueError("has no row in assets")
        return sample_asset(asset, context.blobs[asset.mesh_blob], config.alignment, context.rng("asset", asset_id))
    except (InputError, ValueError, KeyError) as error:
        degradations.append(f"asset {asset_id[:12]}: left out: {error}")
        return None


def _rank(
    instance: Instance,
    candidates: Sequence[Candidate],
    assets: Mapping[str, Asset],
    samples: Mapping[str, Sample | None],
    neighborhood: Neighborhood,
    context: Context,
    config: SelectionConfig,
) -> list[Selection]:
    """Rows of one instance, best first."""
    frame, target = instance_frame(instance, context, config)
    histogram = color_histogram(target.colors)
    score = config.score
    threshold = max(min(score.threshold_m, score.threshold_share * target.diagonal), score.threshold_least_m)
    reach = np.array([0.5 * target.diagonal, 0.5 * target.diagonal, 0.0])
    beside = neighborhood.within(instance.instance_id, frame[:3, 3] - reach, frame[:3, 3] + reach + [0.0, 0.0, target.size[2]])
    beside, own_cubes = transform_points(beside, inverse(frame)), len(neighborhood.seen.get(instance.instance_id, ()))
    done: dict[str, tuple[Fit, Distances, float, float, float]] = {}
    rows: list[Selection] = []
    for candidate in candidates:
        asset_id = candidate.asset_id or ""
        sample = samples[asset_id]
        if sample is None:
            continue
        if asset_id not in done:
            fit, distances = align(target, sample, threshold, config.alignment)
            color = color_similarity(histogram, color_histogram(sample.colors))
            placed, normals, _ = sample.placed(fit)
            foreign = foreign_share(beside, own_cubes, placed, normals)
            done[asset_id] = (fit, distances, color, _placed_iou(frame, fit, sample, instance), foreign)
        fit, distances, color, iou, foreign = done[asset_id]
        asset = assets[asset_id]
        own = is_own_geometry(asset, candidate.provider, score)
        complete = completeness(asset, own, score)
        rows.append(
            Selection(
                scene_id=instance.scene_id,
                instance_id=instance.instance_id,
                rank=1,
                slot=candidate.slot,
                asset_id=asset_id,
                score=score_of(distances, iou, color, complete, own, target.diagonal, score, foreign, target.resolution),
                chamfer_m=distances.chamfer,
                coverage=distances.coverage,
                box_iou=iou,
                foreign_share=foreign,
                color_similarity=color,
                pose=flat(frame @ yaw_pose(fit.yaw, fit.offset)),
                scale=tuple(float(v) for v in fit.scale),
                look=None,
                provider=PROVIDER,
                provider_version=PROVIDER_VERSION,
            )
        )
    rows.sort(key=lambda row: (-round(row.score, 9), row.slot))
    return [dataclasses.replace(row, rank=rank) for rank, row in enumerate(rows, start=1)]


def instance_frame(instance: Instance, context: Context, config: SelectionConfig) -> tuple[np.ndarray, ScannedInstance]:
    """The instance's frame in the world, 4x4 [m], standing where the asset is to stand, and its points in that frame."""
    box, size = grown_box(instance.box_pose, instance.box_size, instance.hidden_m)
    bottom, top = box[2, 3] - 0.5 * size[2], box[2, 3] + 0.5 * size[2]
    if abs(bottom) <= config.floor_snap_m < top:
        bottom = 0.0
    frame = yaw_pose(yaw_of(box), [box[0, 3], box[1, 3], bottom])
    points, colors = read_points(context.blobs[instance.points_blob], instance.points_blob)
    local = transform_points(points, inverse(frame))
    extent = np.array([size[0], size[1], top - bottom])
    within = (np.abs(local - [0.0, 0.0, 0.5 * extent[2]]) <= 0.5 * extent + config.beside_m).all(axis=1)
    if within.mean() >= LEAST_WITHIN:  # what lies farther off was annotated with it and is another object
        local, colors = local[within], colors[within]
    rng = context.rng("instance", instance.instance_id)
    is_let_in = mounting(instance.category).kind == "let_in"
    return frame, make_target(local, colors, extent, config.alignment, rng, instance.hidden_m, is_let_in)


def _placed_iou(frame: np.ndarray, fit: Fit, sample: Sample, instance: Instance) -> float:
    """Intersection over union of the placed asset's box and the instance's box."""
    size = sample.extents * fit.scale
    center = frame @ yaw_pose(fit.yaw, fit.offset) @ translation([0.0, 0.0, 0.5 * size[2]])
    return oriented_iou(center, size, *grown_box(instance.box_pose, instance.box_size, instance.hidden_m))
