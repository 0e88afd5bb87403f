"""Rows of the annotation stage: what people were asked, what they answered, and what reviewers say of it."""

from __future__ import annotations

from datetime import datetime

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record

BATCH_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]*"
"""What names an annotation batch, and a review of one."""

VERDICTS = ("accepted", "returned")
"""What a reviewer can say of a batch: good as it is, or back to the annotators. A returned batch is corrected, in itself or by a new
one; its answers count for nothing until they are accepted."""

STATES = ("open", "submitted", "in_review", "accepted", "returned")
"""What a batch can be at: people answer; all is handed in; a sample is being reviewed; it counts; it is back with the annotators."""

ACTS = ("answer", "submit", "sample", "judge", "accept", "return")
"""What can be done to a batch: save, correct or withdraw answers; hand them in; draw the sample; judge an answer of it; conclude."""

PICKS = ("all", "new", "doubtful")
"""Which objects a batch asks about: every one with candidates; those that nobody answered for yet; all, those first whose present choice
is most doubtful."""

ORIGINS = ("created", "elsewhere")
"""Where a batch comes from: `metascenes annotate create`, or a file that was written by others."""

TRANSITIONS: dict[str, dict[tuple[str, str], str]] = {
    "created": {
        ("open", "answer"): "open",
        ("open", "submit"): "submitted",
        ("submitted", "sample"): "in_review",
        ("in_review", "judge"): "in_review",
        ("in_review", "accept"): "accepted",
        ("in_review", "return"): "returned",
        ("accepted", "return"): "returned",
        ("returned", "answer"): "returned",
        ("returned", "submit"): "submitted",
    },
    "elsewhere": {
        ("submitted", "answer"): "submitted",
        ("submitted", "sample"): "in_review",
        ("submitted", "accept"): "accepted",
        ("submitted", "return"): "returned",
        ("in_review", "judge"): "in_review",
        ("in_review", "accept"): "accepted",
        ("in_review", "return"): "returned",
        ("accepted", "accept"): "accepted",
        ("accepted", "return"): "returned",
        ("returned", "answer"): "submitted",
        ("returned", "accept"): "accepted",
        ("returned", "return"): "returned",
    },
}
"""What may be done to a batch in which state, and the state that it has then, by the batch's origin. Nothing else may be done.

What was made elsewhere is handed in by being imported, and reviews of it may have been made elsewhere, too.
"""


@record("annotation_batches", key=("batch_id",), stage="annotation", grain="annotation_batch", rule="append")
class WorkBatch:
    """An annotation batch: who is asked what, and what its quality control demands. Batches from before the table have no row."""

    batch_id: str = column("Annotation batch", pattern=BATCH_PATTERN)
    origin: str = column("Where it comes from: assigned by this lake, or a file that others wrote", values=ORIGINS)
    created_at: datetime = column("When it was made; of what was made elsewhere, when its last answer was given then", volatile=True)
    pick: str | None = column("How its instances were picked; missing for batches made elsewhere", values=PICKS)
    overlap: int | None = column("How many annotators each instance was assigned to; missing for batches made elsewhere", minimum=1)
    seed: int = column("Seed of the assignment and of the samples")
    sample_share: float = column("Share of the answers that are reviewed", minimum=0, maximum=1)
    least_sample: int = column("Answers that are reviewed at least, if there are as many", minimum=1)
    pass_share: float = column("Share of the reviewed answers of which more must pass", minimum=0, maximum=1)
    counts_unreviewed: bool = column(
        "Its answers count while nobody has reviewed them (annotation.unreviewed_imports_count); never so for batches that were created"
    )


@record(
    "assignments", key=("batch_id", "scene_id", "instance_id", "annotator"), stage="annotation", grain="annotation_batch", rule="append"
)
class Assignment:
    """An instance that an annotator is asked about."""

    batch_id: str = column("Annotation batch", pattern=BATCH_PATTERN)
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    annotator: str = column("Annotator")
    place: int = column("Place in the annotator's list, from 1 on", minimum=1)
    doubt: float = column("How doubtful the present choice is, 0 to 1: see reasons", minimum=0, maximum=1)
    reasons: tuple[str, ...] = column("Why it is doubtful: never answered, low score, annotators disagree, unstable")
    proposed: str | None = column("Asset that selection ranks first; missing where it ranks none", pattern=r"[0-9a-f]{64}")


@record(
    "annotations",
    key=("batch_id", "scene_id", "instance_id", "annotator", "revision"),
    stage="annotation",
    grain="annotation_batch",
    rule="append",
)
class Annotation:
    """One annotator's answer for one instance, each correction a row of its own. History is kept; of accepted batches the newest wins."""

    batch_id: str = column("Annotation batch", pattern=BATCH_PATTERN)
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance when the answer was given", pattern=INSTANCE_PATTERN)
    annotator: str = column("Annotator")
    revision: int = column("1 for the first answer in the batch, one more for each correction; the last holds", minimum=1, earlier=1)
    answered_at: datetime = column("When the answer was given")
    choice: str | None = column("Chosen asset; missing when none of the candidates fits, or withdrawn", pattern=r"[0-9a-f]{64}")
    pose: tuple[float, ...] | None = column(
        "Asset to world frame as placed by the annotator, 4x4 row by row; missing: as aligned by selection", unit="m", length=16
    )
    scale: tuple[float, ...] | None = column("Scale along the asset's own axes; missing: as aligned by selection", length=3, minimum=0.001)
    ranking: tuple[str, ...] = column("Candidates in the annotator's order, best first; may be partial")
    box_pose: tuple[float, ...] = column("The instance's oriented box when the answer was given, 4x4 row by row", unit="m", length=16)
    box_size: tuple[float, ...] = column("Extents of that box", unit="m", length=3, minimum=0)
    source_file: str = column("File that the answer came from, relative to its batch")
    seconds: float | None = column("Time that the annotator spent on the answer; missing when nobody measured it", unit="s", minimum=0)
    is_withdrawn: bool = column("The annotator took the answer back", earlier=False)
    tool: str | None = column("What the answer was given with; missing when nobody stated it")
    is_simulated: bool = column("A program answered in the place of a person", earlier=False)


@record(
    "annotation_figures",
    key=("batch_id", "scene_id", "instance_id", "annotator", "revision"),
    stage="annotation",
    grain="annotation_batch",
    rule="append",
)
class AnnotationFigures:
    """What the guidelines for annotators ask of an answer, in figures. The neighbors stand as the same annotator put them, else as
    selection aligned its first."""

    batch_id: str = column("Annotation batch", pattern=BATCH_PATTERN)
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    annotator: str = column("Annotator")
    revision: int = column("Revision of the answer", minimum=1)
    is_category_match: bool = column("The asset depicts what the instance is called")
    size_ratio: float = column("Volume of the placed asset's box over that of the instance's", minimum=0)
    lookalikes: int = column("Other instances of the scene with the same category and nearly the same size", minimum=0)
    lookalikes_alike: int = column("Those of them that stand as the same asset", minimum=0)
    collision_m: float = column("Deepest penetration with another object or a wall; 0 when it is in nothing", unit="m", minimum=0)
    collides_with: str | None = column("What it is deepest in: an instance, or a part of the room; missing when in nothing")
    floating_m: float | None = column(
        "Height of its bottom above what carries it, negative when it sinks in; missing when it hangs or nothing carries it", unit="m"
    )
    outside_share: float | None = column("Share of its footprint beyond the room's floor; missing without a room", minimum=0, maximum=1)
    scan_distance_m: float | None = column(
        "Mean distance of the instance's scanned points from the placed asset; missing without points", unit="m", minimum=0
    )


@record(
    "submissions",
    key=("batch_id", "round", "scene_id", "instance_id", "annotator"),
    stage="annotation",
    grain="annotation_batch",
    rule="append",
)
class Submission:
    """An answer as it was handed in. Only what was handed in, and accepted in that very revision, ever counts."""

    batch_id: str = column("Annotation batch", pattern=BATCH_PATTERN)
    round: int = column("1 when the batch was handed in first, one more each time after it was returned", minimum=1)
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    annotator: str = column("Annotator")
    revision: int = column("Revision of the answer", minimum=1)
    answers: int = column("Answers that were handed in together; fewer rows say that scenes were erased since", minimum=1)
    submitted_by: str = column("Who handed the batch in")
    submitted_at: datetime = column("When; of what was made elsewhere, when the last of the answers was given", volatile=True)


@record(
    "review_samples",
    key=("batch_id", "round", "scene_id", "instance_id", "annotator"),
    stage="annotation",
    grain="annotation_batch",
    rule="append",
)
class SampledAnswer:
    """An answer that was drawn to be reviewed."""

    batch_id: str = column("Annotation batch", pattern=BATCH_PATTERN)
    round: int = column("Round in which the answers were handed in", minimum=1)
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    annotator: str = column("Whose answer it is")
    revision: int = column("Revision of the answer", minimum=1)
    place: int = column("Place in the order in which they were drawn, from 1 on", minimum=1)
    sampled: int = column("Answers that were drawn together; fewer rows say that scenes were erased since", minimum=1)
    drawn_at: datetime = column("When the sample was drawn", volatile=True)


@record(
    "answer_verdicts",
    key=("batch_id", "round", "scene_id", "instance_id", "annotator", "number"),
    stage="annotation",
    grain="annotation_batch",
    rule="append",
)
class AnswerVerdict:
    """What a reviewer says of one sampled answer. A reviewer may change their mind until the review is concluded: the last number holds."""

    batch_id: str = column("Annotation batch", pattern=BATCH_PATTERN)
    round: int = column("Round in which the answers were handed in", minimum=1)
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    annotator: str = column("Whose answer it is")
    number: int = column("1 for the first verdict on the answer, one more for each that replaces it", minimum=1)
    reviewer: str = column("Who judged; never the annotator")
    reviewed_at: datetime = column("When")
    passes: bool = column("The reviewer would have answered so, too")
    remark: str | None = column("What is to be mended; missing when there is nothing to say")
    source_file: str = column("File that the verdict came from")
    is_simulated: bool = column("A program judged in the place of a person")


@record("quality_reviews", key=("batch_id", "review_id"), stage="annotation", grain="annotation_batch", rule="append")
class QualityReview:
    """What became of a review of a sample of a batch's answers. History is kept: a batch may be reviewed again, the last verdict holds."""

    batch_id: str = column("Annotation batch that was reviewed", pattern=BATCH_PATTERN)
    review_id: str = column("Review, unique among those of its batch", pattern=BATCH_PATTERN)
    reviewer: str = column("Who reviewed; several names are parted by commas")
    reviewed_at: datetime = column("When the review was finished")
    sampled: int = column("Answers of the batch that were looked at", minimum=1)
    wrong: int = column("Answers among them that the reviewer would have given otherwise", minimum=0)
    verdict: str = column(
        "What is to become of the batch: 'returned' answers are given again, and no scene is made from them", values=VERDICTS
    )
    note: str | None = column("What the reviewer has to say; missing when nothing")
    source_file: str = column("File that the review came from")
    round: int = column("Round in which the answers were handed in", minimum=1, earlier=1)
    answers: int | None = column("Answers that were handed in; missing where nobody counted them", minimum=1)
    handed_in_hashes: tuple[str, ...] | None = column(
        "Hash of what was handed in of each scene and reviewed, sorted: a verdict holds for nothing else; missing in reviews from before "
        "there were rounds"
    )
    pass_low: float | None = column(
        "Least share of right answers in the batch that the sample leaves possible, 95 %, exact; missing where nobody computed it",
        minimum=0,
        maximum=1,
    )
    pass_high: float | None = column("Greatest such share", minimum=0, maximum=1)
    is_simulated: bool = column("A program reviewed in the place of a person", earlier=False)
