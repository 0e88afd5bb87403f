"""Outcomes and figures of the benchmark as rows of its lake, where the views of selection methods and the report find them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from flows.run.fingerprints import digest
from flows.worker import Job, lost_run
from schemas.selection import SelectionOutcome
from schemas.training import ModelEvaluation
from tasks.selection.metrics.outcomes import figures_of
from warehouse.lake import Lake

TRAINING = "bench-selection"
"""What the rows name as the training that measured them; those of a later command take their place."""


def keep(lake: Lake, outcomes: Sequence[SelectionOutcome], seed: int) -> None:
    """Commit outcomes, and figures of each method over all of its seeds with intervals of 95 % over rooms."""
    tables: dict[str, list[Any]] = {
        "models": [], "training_steps": [], "selection_outcomes": list(outcomes), "model_evaluations": evaluations_of(outcomes, seed),
    }  # fmt: skip
    counts = tuple(f"{table}={len(rows)}" for table, rows in sorted(tables.items()))
    content = digest(TRAINING, *(repr(dataclasses.replace(row, seconds=None)) for row in outcomes))
    job = Job(lake.address, TRAINING, "training", None, "{}", seed, content, (), (), 1)
    lake.stage_rows(dataclasses.replace(lost_run(job, None, None, 0.0), row_counts=counts), tables)
    lake.commit(note="what selection methods chose", scenes=[TRAINING])


def evaluations_of(outcomes: Sequence[SelectionOutcome], seed: int) -> list[ModelEvaluation]:
    """Figures by method, dataset and split; of several models of a method none is named."""
    groups: dict[tuple[str, str, str], list[SelectionOutcome]] = {}
    for row in outcomes:
        groups.setdefault((row.method, row.dataset, row.split), []).append(row)
    evaluations = []
    for (method, dataset, split), rows in sorted(groups.items()):
        models = {row.model_id for row in rows}
        model_id = models.pop() if len(models) == 1 else None
        evaluations += [
            ModelEvaluation(
                training_id=TRAINING, model_id=model_id, method=method, dataset=dataset, split=split,
                metric=metric, value=figure.value, low=figure.low, high=figure.high, examples=figure.examples,
            )
            for metric, figure in figures_of(rows, seed).items()
        ]  # fmt: skip
    return evaluations
