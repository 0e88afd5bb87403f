"""Annotation: what people were asked and what they chose, and what reviewers say of it. All of a file or nothing of it."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from schemas.annotation import (
    Annotation,
    AnnotationFigures,
    AnswerVerdict,
    Assignment,
    QualityReview,
    SampledAnswer,
    Submission,
    WorkBatch,
)
from schemas.candidates import Candidate
from schemas.capture import Instance
from schemas.errors import InputError
from tasks.annotation.agreement import borda, current, winning
from tasks.annotation.batch import SCHEMA_FILE, AnnotationBatch, AnnotatorAnswer, read_batch
from tasks.annotation.review import REVIEW_SCHEMA_FILE, Review, ReviewBatch, check_reviews, read_reviews
from tasks.geometry.transforms import matrix
from tasks.settings import Config, Count, Share
from tasks.stage import Context, Outcome, Stage

__all__ = [
    "REVIEW_SCHEMA_FILE", "SCHEMA_FILE", "STAGE", "AnnotationBatch", "AnnotationConfig", "AnnotatorAnswer", "BatchActs", "ReviewBatch",
    "borda", "check_reviews", "current", "read_batch", "read_reviews", "run", "winning",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class AnnotationConfig(Config):
    """What an answer may say before it is taken for a mistake."""

    reach_m: float = 5.0  # an asset put farther than a room's width from its instance is a wrong unit or a wrong scene
    smallest_scale: float = 0.02  # assets are in metres: one in centimetres by mistake needs 0.01, and is a wrong asset
    largest_scale: float = 50.0  # an asset in millimetres by mistake needs 1000
    sample_share: Share = 0.1  # of a batch's answers are reviewed, as in the paper
    least_sample: Count = 50  # answers are reviewed at least: of fewer, one that fails is more than the 2 % that may
    pass_share: Share = 0.98  # of the reviewed answers, of which more must pass, as in the paper
    unreviewed_imports_count: bool = False  # what nobody has reviewed reaches no scene; true trusts batches made elsewhere until a review


@dataclasses.dataclass(frozen=True)
class BatchActs:
    """What was done to a batch, as rows: of the table that each field is named after."""

    annotation_batches: tuple[WorkBatch, ...] = ()
    assignments: tuple[Assignment, ...] = ()
    annotations: tuple[Annotation, ...] = ()
    annotation_figures: tuple[AnnotationFigures, ...] = ()
    submissions: tuple[Submission, ...] = ()
    review_samples: tuple[SampledAnswer, ...] = ()
    answer_verdicts: tuple[AnswerVerdict, ...] = ()
    quality_reviews: tuple[QualityReview, ...] = ()


def run(
    *,
    annotation_batch: AnnotationBatch | None,
    review_batch: ReviewBatch | None,
    batch_acts: BatchActs | None = None,
    instances: Sequence[Instance],
    candidates: Sequence[Candidate],
    context: Context,
    config: AnnotationConfig,
) -> Outcome:
    """Annotations of a batch, or reviews of one, or what else was done to one: one of the three is given.

    `instances` and `candidates` are those of all scenes that the batch names.

    Slot numbers become asset ids, and every row keeps the instance's box, so that the answer is found again after a
    recapture.

    Raises:
        InputError: an answer names a scene, instance or asset that is not there, or puts an asset where it cannot be
            meant. Nothing of the batch is imported then.
    """
    known = {(row.scene_id, row.instance_id): row for row in instances}
    slots: dict[tuple[str, str], dict[int, str]] = defaultdict(dict)
    for row in candidates:
        if row.asset_id is not None and row.outcome == "filled":
            slots[row.scene_id, row.instance_id][row.slot] = row.asset_id
    scenes = {row.scene_id for row in instances}
    rows = []
    if annotation_batch is not None:
        for answer in annotation_batch.annotations:
            instance = _instance(answer, known, scenes)
            rows.append(_annotation(annotation_batch.batch_id, answer, instance, slots[answer.scene_id, answer.instance_id], config))
    reviews = [_quality_review(review_batch, review) for review in review_batch.reviews] if review_batch is not None else []
    acts = batch_acts or BatchActs()
    return Outcome(
        annotation_batches=acts.annotation_batches,
        assignments=acts.assignments,
        annotations=sorted([*rows, *acts.annotations], key=lambda r: (r.scene_id, r.instance_id, r.annotator)),
        annotation_figures=acts.annotation_figures,
        submissions=acts.submissions,
        review_samples=acts.review_samples,
        answer_verdicts=acts.answer_verdicts,
        quality_reviews=sorted([*reviews, *acts.quality_reviews], key=lambda r: r.review_id),
    )


STAGE = Stage(
    name="annotation",
    reads=("instances", "candidates"),
    writes=(
        "annotation_batches", "assignments", "annotations", "annotation_figures", "submissions", "review_samples", "answer_verdicts",
        "quality_reviews",
    ),
    config=AnnotationConfig,
    run=run,
    grain="annotation_batch",
    outside=("annotation_batch", "review_batch", "batch_acts"),
)  # fmt: skip


def _instance(answer: AnnotatorAnswer, known: Mapping[tuple[str, str], Instance], scenes: set[str]) -> Instance:
    """The instance that an answer is for."""
    if answer.scene_id not in scenes:
        raise InputError(
            answer.source_file, f"{answer.where}.scene_id", f"scene {answer.scene_id} is not in the lake", "replicate its scan first"
        )
    instance = known.get((answer.scene_id, answer.instance_id))
    if instance is None:
        problem = f"scene {answer.scene_id} has no instance {answer.instance_id}"
        raise InputError(answer.source_file, f"{answer.where}.instance_id", problem, "annotate the scene as it is in the lake")
    if instance.is_structure:
        problem = f"instance {answer.instance_id} is part of the room ({instance.category}), which no asset replaces"
        raise InputError(answer.source_file, f"{answer.where}.instance_id", problem, "leave it out")
    return instance


def _asset(value: str | int, slots: Mapping[int, str], answer: AnnotatorAnswer, field: str) -> str:
    """The asset that a slot number or an asset id means."""
    if isinstance(value, int):
        if value in slots:
            return slots[value]
        problem = f"slot {value} of instance {answer.instance_id} is not filled"
    else:
        if value in slots.values():
            return value
        problem = f"asset {value[:12]}... is no candidate of instance {answer.instance_id}"
    filled = f"filled slots are {', '.join(map(str, sorted(slots)))}" if slots else "the instance has no candidates; compute them first"
    raise InputError(answer.source_file, f"{answer.where}.{field}", problem, filled)


def _annotation(
    batch_id: str, answer: AnnotatorAnswer, instance: Instance, slots: Mapping[int, str], config: AnnotationConfig
) -> Annotation:
    """The row of an answer, checked against its instance."""
    choice = None if answer.choice is None else _asset(answer.choice, slots, answer, "choice")
    ranking: list[str] = []
    for index, value in enumerate(answer.ranking):
        asset = _asset(value, slots, answer, f"ranking[{index}]")
        if asset not in ranking:  # two slots may hold one asset
            ranking.append(asset)
    if choice is not None and choice in ranking[1:]:
        raise InputError(
            answer.source_file, f"{answer.where}.ranking", "puts another candidate before the choice", "begin it with the choice"
        )
    _check_transform(answer, instance, config)
    return Annotation(
        batch_id=batch_id,
        scene_id=answer.scene_id,
        instance_id=answer.instance_id,
        annotator=answer.annotator,
        answered_at=answer.answered_at,
        choice=choice,
        pose=answer.pose,
        scale=answer.scale,
        ranking=tuple(ranking),
        box_pose=instance.box_pose,
        box_size=instance.box_size,
        source_file=answer.source_file,
        seconds=answer.seconds,
        revision=1,
        is_withdrawn=answer.is_withdrawn,
        tool=answer.tool,
        is_simulated=answer.is_simulated,
    )


def _quality_review(batch: ReviewBatch, review: Review) -> QualityReview:
    """The row of a review."""
    return QualityReview(
        batch_id=batch.batch_id,
        review_id=review.review_id,
        reviewer=review.reviewer,
        reviewed_at=review.reviewed_at,
        sampled=review.sampled,
        wrong=review.wrong,
        verdict=review.verdict,
        note=review.note,
        source_file=batch.source_file,
        round=1,
        answers=None,
        handed_in_hashes=None,
        pass_low=None,
        pass_high=None,
        is_simulated=False,
    )


def _check_transform(answer: AnnotatorAnswer, instance: Instance, config: AnnotationConfig) -> None:
    """Refuse a transform that cannot be meant: its place and its scale against the instance."""
    if answer.pose is None or answer.scale is None:
        return
    distance = float(np.linalg.norm(matrix(answer.pose)[:3, 3] - matrix(instance.box_pose)[:3, 3]))
    if distance > config.reach_m + 0.5 * max(instance.box_size):
        problem = f"is {distance:.3g} m from the instance"
        raise InputError(answer.source_file, f"{answer.where}.transform.position", problem, "give metres in the world frame")
    if min(answer.scale) < config.smallest_scale or max(answer.scale) > config.largest_scale:
        problem = f"is not within {config.smallest_scale:g} to {config.largest_scale:g}"
        raise InputError(answer.source_file, f"{answer.where}.transform.scale", problem, "choose another candidate")
