"""Annotation batches in the lake: what is asked, answered, handed in and reviewed. Does not import Prefect.

Whoever builds a page or another tool calls these; each holds the batch while it changes it, refuses what its state does not allow
(`warehouse.tables.gate`), and leaves all of what it does or nothing. Answers and verdicts are the JSON values of the published schemas.

    open_work(lake, "batch-1", "ada")                        # what ada is asked, what she answered, what reviewers remarked
    save_answers(lake, {"batch_id": "batch-1", "annotations": [...]})
    submit(lake, "batch-1", by="ada")
    draw_sample(lake, "batch-1")
    open_reviews(lake, "batch-1", "rita")
    save_verdicts(lake, {"batch_id": "batch-1", "reviewer": "rita", "verdicts": [...]})
    conclude(lake, "batch-1")
"""

from __future__ import annotations

from flows.inputs.annotation.creation import BatchPlan, create_batch
from flows.inputs.annotation.importing import import_alignments, import_annotations, import_export, import_reviews, save_answers
from flows.inputs.annotation.listing import batch_list, open_reviews, open_work
from flows.inputs.annotation.reviewing import conclude, draw_sample, save_verdicts, submit

__all__ = [
    "BatchPlan", "batch_list", "conclude", "create_batch", "draw_sample", "import_alignments", "import_annotations", "import_export",
    "import_reviews", "open_reviews", "open_work", "save_answers", "save_verdicts", "submit",
]  # fmt: skip
