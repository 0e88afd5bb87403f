"""Reviews of annotation batches as JSON files: read, checked against `review.schema.json`, refused with one line that says where."""

from __future__ import annotations

import dataclasses
from datetime import datetime
from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.annotation.batch import moment
from tasks.batches import BatchSchema, parse_json, read_limited

REVIEW_SCHEMA_FILE = Path(__file__).with_name("review.schema.json")
"""The published JSON Schema of a file of reviews."""

SCHEMA = BatchSchema(REVIEW_SCHEMA_FILE)

MAX_FILE_BYTES = BUDGET.review_bytes
"""A review takes 200 bytes: no batch is reviewed five thousand times."""


@dataclasses.dataclass(frozen=True)
class Review:
    """One reviewer's verdict on an annotation batch: of `sampled` answers, `wrong` would have been given otherwise."""

    review_id: str
    reviewer: str
    reviewed_at: datetime
    sampled: int
    wrong: int
    verdict: str
    note: str | None


@dataclasses.dataclass(frozen=True)
class ReviewBatch:
    """Reviews of one annotation batch, the outside input of the annotation stage. `batch_id` is that of the batch that was reviewed."""

    batch_id: str
    reviews: tuple[Review, ...]
    source_file: str


def read_reviews(path: Path) -> ReviewBatch:
    """The reviews in a JSON file, in the order of the file.

    Raises:
        InputError: the file cannot be read or breaks the schema; a review finds more answers wrong than it sampled, or is
            given twice. Names file and JSON path.
    """
    if not path.is_file():
        raise InputError(str(path), "", "is no file", "name a JSON file with reviews of an annotation batch")
    document = parse_json(read_limited(path, path.name, MAX_FILE_BYTES), path.name)
    SCHEMA.check(document, path.name)
    reviews: list[Review] = []
    for index, item in enumerate(document["reviews"]):
        where = f"reviews[{index}]"
        sampled, wrong = int(item["sampled"]), int(item["wrong"])
        if wrong > sampled:
            raise InputError(path.name, f"{where}.wrong", f"is {wrong} of {sampled} answers", "count only answers that were sampled")
        if any(review.review_id == item["review_id"] for review in reviews):
            raise InputError(path.name, f"{where}.review_id", f"{item['review_id']} is given twice", "give every review an id of its own")
        reviews.append(
            Review(
                review_id=item["review_id"],
                reviewer=item["reviewer"].strip(),
                reviewed_at=moment(item["reviewed_at"], path.name, f"{where}.reviewed_at"),
                sampled=sampled,
                wrong=wrong,
                verdict=item["verdict"],
                note=(item.get("note") or "").strip() or None,
            )
        )
    return ReviewBatch(document["batch_id"], tuple(reviews), path.name)


def check_reviews(batch: ReviewBatch, answers: int) -> None:
    """Hold reviews against the number of answers that the reviewed batch has.

    Raises:
        InputError: there is no such batch, or a review sampled more answers than it has.
    """
    if not answers:
        raise InputError(batch.source_file, "batch_id", f"{batch.batch_id} is not in the lake", "import the batch first")
    for index, review in enumerate(batch.reviews):
        if review.sampled > answers:
            problem = f"is {review.sampled}, the batch has {answers} answers"
            raise InputError(batch.source_file, f"reviews[{index}].sampled", problem, "count every answer once")
