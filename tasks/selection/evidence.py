"""What selection knows of an instance and of each of its candidates once these are aligned to it: what every method scores by."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.errors import InputError
from tasks.alignment import (
    AlignmentConfig,
    Distances,
    Fit,
    Sample,
    ScannedInstance,
    align,
    by_sight,
    covered_within,
    instance_frame,
    lacking,
    sample_asset,
    sight_of,
)  # fmt: skip
from tasks.alignment.measures import f_score
from tasks.geometry.boxes import grown_box, oriented_iou
from tasks.geometry.transforms import inverse, transform_points, translation, yaw_pose
from tasks.mounting import mounting
from tasks.selection.coloring import color_error, color_histogram, color_similarity, is_uncolored
from tasks.selection.neighbors import Neighborhood, foreign_share
from tasks.selection.recognition import has_own_size, is_recognized, likeness_of, recognized_first
from tasks.selection.scoring import WITHIN, ScoreConfig, finest_first, is_own_geometry, pattern_first, score_of, whole_first
from tasks.stage import Context
from tasks.views.crops import Crop, crop_of, filling

if TYPE_CHECKING:
    from tasks.selection import SelectionConfig

Array = NDArray[np.float64]

PICTURE_PIXELS = 224
"""Of the side of a cut-out crop: about what crops have, and what DINOv2 looks at."""

PLAIN_KINDS = ("let_in", "covering")
"""Mountings of what patterns say little of: windows show what lies behind them, and crops of rugs are tattered at the rim."""


@dataclasses.dataclass(frozen=True)
class InstanceQuery:
    """An instance that candidates are scored for.

    frame: Its own frame in the world, 4x4 [m]: its box turned straight, x and y zero at the middle of the box, z zero at the height on
    which an asset is to stand. points, colors: All that the scan has of it in that frame, shapes (n, 3) [m] and (n, 3) uint8. target: The
    same, thinned, as alignment takes it. view, mask: The frame that sees it best, and where in it, as far as they are known.
    """

    instance: Instance
    caption: Caption | None
    context: Context
    frame: Array
    target: ScannedInstance
    points: Array
    colors: NDArray[np.uint8]
    view: Frame | None = None
    mask: Mask | None = None

    @property
    def category(self) -> str:
        """What the instance is called."""
        return self.instance.category

    @property
    def text(self) -> str | None:
        """A sentence about it; None where nobody wrote one."""
        return self.caption.sentence if self.caption is not None and self.caption.sentence else None

    @cached_property
    def crop(self) -> Crop | None:
        """The crop of its best view; None where it has none.

        Raises:
            InputError: the picture cannot be read.
        """
        return crop_of(self.instance, self.view, self.mask, self.context.blobs)

    @property
    def image(self) -> NDArray[np.uint8] | None:
        """The pixels of the crop, shape (h, w, 3); None where it has none. Raises as `crop` does."""
        return None if self.crop is None else self.crop.image


@dataclasses.dataclass(frozen=True)
class Evidence:
    """A candidate, aligned to its instance and measured.

    sample: Of the asset's surface, as it is in the lake. fit: Where it stands in the instance's frame. box_iou: Of its placed box and the
    instance's. color: Likeness of the color histograms. foreign: Share of what was seen in it that is another's, or was seen empty.
    own: It is made of the instance's own points. geometric: Its geometric score. All but distances in 0..1.
    """

    candidate: Candidate
    asset: Asset
    sample: Sample
    fit: Fit
    distances: Distances
    box_iou: float
    color: float
    foreign: float
    own: bool
    geometric: float

    @property
    def placed(self) -> tuple[Array, Array]:
        """Samples of its surface where it stands: points [m] and unit normals in the instance's frame, shapes (m, 3)."""
        points, normals, _ = self.sample.placed(self.fit)
        return points, normals

    @property
    def extents(self) -> Array:
        """Extents of its box along its own axes as it is placed, shape (3,) [m]."""
        return self.sample.extents * self.fit.scale


def gather(
    instances: Sequence[Instance],
    candidates: Sequence[Candidate],
    assets: Sequence[Asset],
    context: Context,
    config: SelectionConfig,
    degradations: list[str],
    *,
    captions: Sequence[Caption] = (),
    frames: Sequence[Frame] = (),
    masks: Sequence[Mask] = (),
) -> list[tuple[InstanceQuery, list[Evidence]]]:
    """Every instance that is no structure and has a candidate that can be read, in their order, with its candidates by slot.

    What is left out is said in `degradations`.
    """
    by_asset = {asset.asset_id: asset for asset in assets}
    by_instance: dict[str, list[Candidate]] = defaultdict(list)
    for candidate in sorted(candidates, key=lambda c: (c.instance_id, c.slot)):
        if candidate.outcome == "filled" and candidate.asset_id is not None:
            by_instance[candidate.instance_id].append(candidate)
    samples = _samples(
        sorted({c.asset_id for rows in by_instance.values() for c in rows if c.asset_id}), by_asset, context, config, degradations
    )
    described = {row.instance_id: row for row in captions}
    views, shown = {row.frame_id: row for row in frames}, {(row.frame_id, row.instance_id): row for row in masks}
    neighborhood, score = Neighborhood.of(instances, context.blobs, frames), config.score
    queries: list[tuple[InstanceQuery, list[Candidate], float]] = []
    for instance in sorted(instances, key=lambda i: i.instance_id):
        if instance.is_structure:
            continue
        usable = [c for c in by_instance[instance.instance_id] if samples.get(c.asset_id or "")]
        if not usable:
            degradations.append(f"{instance.instance_id}: no candidate to select from")
            continue
        best = instance.best_frames[0] if instance.best_frames else ""
        frame, target, points, colors = instance_frame(instance, context, config.alignment, config.floor_snap_m, config.beside_m)
        query = InstanceQuery(
            instance, described.get(instance.instance_id), context, frame, target, points, colors, views.get(best),
            shown.get((best, instance.instance_id)),
        )  # fmt: skip
        if by_sight(config.alignment):
            try:
                query = dataclasses.replace(query, target=_with_sight(query))
            except InputError as error:
                degradations.append(f"{instance.instance_id}: {error}")
        if lack := lacking(query.target, config.alignment):
            degradations.append(f"{instance.instance_id}: {lack}")
        queries.append(
            (query, usable, covered_within(query.target.diagonal, score.threshold_m, score.threshold_share, score.threshold_least_m))
        )
    work = [
        _Alignment(query.target, {c.asset_id: samples[c.asset_id] for c in usable if c.asset_id is not None}, threshold, config.alignment)
        for query, usable, threshold in queries
    ]
    fits = context.spread(_aligned, work)
    return [
        (query, evidence_of(query, usable, by_asset, samples, neighborhood, aligned, score, config.alignment))
        for (query, usable, _), aligned in zip(queries, fits, strict=True)
    ]


@dataclasses.dataclass(frozen=True)
class _Alignment:
    """An instance, and samples of the assets that are aligned to it, by id. threshold: Distance within which a point is covered [m]."""

    target: ScannedInstance
    samples: Mapping[str, Sample]
    threshold: float
    config: AlignmentConfig


def _aligned(work: _Alignment) -> dict[str, tuple[Fit, Distances]]:
    return {asset_id: align(work.target, sample, work.threshold, work.config) for asset_id, sample in work.samples.items()}


def _with_sight(query: InstanceQuery) -> ScannedInstance:
    """The scanned instance with how its crop was taken, as far as that is known. Raises as `InstanceQuery.crop` does."""
    crop = query.crop
    if crop is None or crop.camera is None:
        return query.target
    cut_out = None if crop.silhouette is None else filling(crop.image, crop.silhouette, PICTURE_PIXELS)
    return dataclasses.replace(query.target, sight=sight_of(crop.camera.pose, query.frame, float(query.target.size[2]), cut_out))


def evidence_of(
    query: InstanceQuery,
    candidates: Sequence[Candidate],
    assets: Mapping[str, Asset],
    samples: Mapping[str, Sample],
    neighborhood: Neighborhood,
    fits: Mapping[str, tuple[Fit, Distances]],
    score: ScoreConfig,
    alignment: AlignmentConfig,
) -> list[Evidence]:
    """Candidates of an instance, aligned and measured, in their order. fits: Of each asset, by its id."""
    instance, frame, target = query.instance, query.frame, query.target
    histogram = color_histogram(target.colors)
    reach = np.array([0.5 * target.diagonal, 0.5 * target.diagonal, 0.0])
    beside = neighborhood.within(instance.instance_id, frame[:3, 3] - reach, frame[:3, 3] + reach + [0.0, 0.0, target.size[2]])
    beside, own_cubes = transform_points(beside, inverse(frame)), len(neighborhood.seen.get(instance.instance_id, ()))
    empty = neighborhood.empty_within(frame, target.size, target.points)
    done: dict[str, tuple[float, float, float]] = {}
    measured: list[Evidence] = []
    for candidate in candidates:
        asset_id = candidate.asset_id or ""
        sample, (fit, distances) = samples[asset_id], fits[asset_id]
        if asset_id not in done:
            placed, normals, _ = sample.placed(fit)
            foreign = foreign_share(beside, own_cubes, placed, normals, empty)
            done[asset_id] = (
                color_similarity(histogram, color_histogram(sample.colors)),
                _placed_iou(frame, fit, sample, instance),
                foreign,
            )
        color, iou, foreign = done[asset_id]
        asset = assets[asset_id]
        own = is_own_geometry(asset, candidate.provider, score)
        agreement = score_of(distances, iou, color, target.diagonal, score, foreign, target.resolution)
        measured.append(Evidence(candidate, asset, sample, fit, distances, iou, color, foreign, own, agreement))
    within = WITHIN * covered_within(target.diagonal, score.threshold_m, score.threshold_share, score.threshold_least_m)
    f_scores = np.array([f_score(target, each.sample, each.fit, within, alignment) for each in measured])
    scores, foreign_shares = np.array([each.geometric for each in measured]), np.array([each.foreign for each in measured])
    scores = finest_first(scores, [each.asset.provider for each in measured], score.finest_margin)
    is_own, kind = [each.own for each in measured], mounting(query.category).kind
    errors = None
    if kind not in PLAIN_KINDS and not is_uncolored(query.colors):
        errors = np.array([color_error(query.points, query.colors, each.placed[0], each.sample.colors) for each in measured])
    # Of what is let into a wall, strips are scanned, which a whole window cannot explain.
    least = 0.0 if kind == "let_in" else score.whole_least
    scores = whole_first(scores, f_scores, foreign_shares, is_own, score.whole_margin, errors, score.color_margin, least)
    if errors is not None:
        scores = pattern_first(scores, is_own, errors, score.whole_margin, score.color_margin)
    scores = recognized_first(scores, _recognized(query, measured, neighborhood, within, score, alignment), score.recognized_lead)
    return [dataclasses.replace(each, geometric=float(value)) for each, value in zip(measured, scores, strict=True)]


def _recognized(
    query: InstanceQuery, measured: Sequence[Evidence], neighborhood: Neighborhood, within: float, score: ScoreConfig,
    alignment: AlignmentConfig,
) -> list[float]:  # fmt: skip
    """Certainty that each candidate is the scanned object, 0 to 1; 0 if it is not recognized."""
    target, views = query.target, neighborhood.views
    sized = [has_own_size(each.sample, each.fit) for each in measured]
    if not any(sized):
        return [0.0] * len(measured)
    likenesses = [likeness_of(target, each.sample, each.fit, within, query.frame, views, alignment) for each in measured]
    best, least = max(each.complete for each in likenesses), min(each.foreign for each in measured)
    return [
        likeness.strength if is_sized and is_recognized(likeness, best, each.foreign, least, score, bool(views)) else 0.0
        for is_sized, likeness, each in zip(sized, likenesses, measured, strict=True)
    ]


@dataclasses.dataclass(frozen=True)
class _Sampling:
    """An asset and what it is sampled by. mesh: Its file."""

    asset: Asset
    mesh: bytes
    config: AlignmentConfig
    rng: np.random.Generator


def _sampled(work: _Sampling) -> Sample | str:
    """Samples of an asset, or why there are none."""
    try:
        return sample_asset(work.asset, work.mesh, work.config, work.rng)
    except (InputError, ValueError, KeyError) as error:
        return str(error)


def _samples(
    asset_ids: Sequence[str], assets: Mapping[str, Asset], context: Context, config: SelectionConfig, degradations: list[str]
) -> dict[str, Sample]:
    """Samples of assets by id; those that cannot be sampled are said in `degradations`, in their order."""
    sampled: dict[str, Sample | str] = {}
    work: list[_Sampling] = []
    for asset_id in asset_ids:
        asset = assets.get(asset_id)
        try:
            if asset is None:
                raise ValueError("has no row in assets")
            work.append(_Sampling(asset, context.blobs[asset.mesh_blob], config.alignment, context.rng("asset", asset_id)))
        except (InputError, ValueError, KeyError) as error:
            sampled[asset_id] = str(error)
    sampled |= {each.asset.asset_id: made for each, made in zip(work, context.spread(_sampled, work), strict=True)}
    degradations += [f"asset {name[:12]}: left out: {why}" for name in asset_ids if isinstance(why := sampled[name], str)]
    return {name: made for name in asset_ids if isinstance(made := sampled[name], Sample)}


def _placed_iou(frame: Array, fit: Fit, sample: Sample, instance: Instance) -> float:
    """Intersection over union of the placed asset's box and the instance's box."""
    size = sample.extents * fit.scale
    center = frame @ yaw_pose(fit.yaw, fit.offset) @ translation([0.0, 0.0, 0.5 * size[2]])
    return oriented_iou(center, size, *grown_box(instance.box_pose, instance.box_size, instance.hidden_m))
