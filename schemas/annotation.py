"""Rows of the annotation stage: what people chose."""

from __future__ import annotations

from datetime import datetime

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record

BATCH_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]*"
"""What names an annotation batch, and a review of one."""

VERDICTS = ("accepted", "returned")
"""What a reviewer can say of a batch: good as it is, or back to the annotators. A returned batch is corrected by a new one;
its own answers count for nothing, until a later review accepts it."""


@record(
    "annotations", key=("batch_id", "scene_id", "instance_id", "annotator"), stage="annotation", grain="annotation_batch", rule="append"
)
class Annotation:
    """One annotator's answer for one instance. History is kept; the newest batch wins that was not returned."""

    batch_id: str = column("Annotation batch", pattern=BATCH_PATTERN)
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance when the answer was given", pattern=INSTANCE_PATTERN)
    annotator: str = column("Annotator")
    answered_at: datetime = column("When the answer was given")
    choice: str | None = column("Chosen asset; missing when none of the candidates fits", pattern=r"[0-9a-f]{64}")
    pose: tuple[float, ...] | None = column(
        "Asset to world frame as placed by the annotator, 4x4 row by row; missing: as aligned by selection", unit="m", length=16
    )
    scale: tuple[float, ...] | None = column("Scale along the asset's own axes; missing: as aligned by selection", length=3, minimum=0.001)
    ranking: tuple[str, ...] = column("Candidates in the annotator's order, best first; may be partial")
    box_pose: tuple[float, ...] = column("The instance's oriented box when the answer was given, 4x4 row by row", unit="m", length=16)
    box_size: tuple[float, ...] = column("Extents of that box", unit="m", length=3, minimum=0)
    source_file: str = column("File that the answer came from, relative to its batch")
    seconds: float | None = column("Time that the annotator spent on the answer; missing when nobody measured it", unit="s", minimum=0)


@record("quality_reviews", key=("batch_id", "review_id"), stage="annotation", grain="annotation_batch", rule="append")
class QualityReview:
    """What a reviewer found in a sample of a batch's answers. History is kept: a batch may be reviewed again, the last verdict holds."""

    batch_id: str = column("Annotation batch that was reviewed", pattern=BATCH_PATTERN)
    review_id: str = column("Review, unique among those of its batch", pattern=BATCH_PATTERN)
    reviewer: str = column("Who reviewed")
    reviewed_at: datetime = column("When the review was finished")
    sampled: int = column("Answers of the batch that were looked at", minimum=1)
    wrong: int = column("Answers among them that the reviewer would have given otherwise", minimum=0)
    verdict: str = column(
        "What is to become of the batch: 'returned' answers are given again, in a batch of their own, and no scene is made from them",
        values=VERDICTS,
    )
    note: str | None = column("What the reviewer has to say; missing when nothing")
    source_file: str = column("File that the review came from")
