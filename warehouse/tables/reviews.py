"""Answers that stand: those of annotation batches which no review has returned to their annotators.

Of several reviews of a batch the last one decides, as `quality_history.is_last` says it. All that reads answers for a
layout reads them here.
"""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa
import pyarrow.compute as pc

from schemas.annotation import QualityReview
from warehouse.tables.snapshot import Reader


def returned(reviews: Iterable[QualityReview]) -> frozenset[str]:
    """Batches whose last review returned them."""
    last: dict[str, QualityReview] = {}
    for row in sorted(reviews, key=lambda row: (row.reviewed_at, row.review_id)):
        last[row.batch_id] = row
    return frozenset(batch for batch, row in last.items() if row.verdict == "returned")


def returned_batches(reader: Reader) -> frozenset[str]:
    """The batches of a snapshot whose last review returned them."""
    return returned(reader.rows(QualityReview))


def standing_answers(reader: Reader, scene_id: str | None = None) -> pa.Table:
    """Rows of `annotations` that count, sorted by key: those of no returned batch; of one scene when `scene_id` is given."""
    rows = reader.arrow("annotations", scene_id)
    if not rows.num_rows:
        return rows
    gone = pa.array(sorted(returned_batches(reader)), pa.string())
    return rows.filter(pc.invert(pc.is_in(rows["batch_id"], gone)))
