"""Rows of what a method chose where the truth is known, and the figures that follow from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from schemas.selection import SelectionOutcome
from tasks.selection.metrics.bootstrap import ConfidenceInterval, interval
from tasks.selection.metrics.rankings import hits, place_of, ranking_of
from tasks.selection.metrics.surfaces import HIGHER_IS_BETTER, METRICS, Agreement

REGRETS = tuple(f"regret_{metric}" for metric in METRICS)
FIGURES = ("top_1", "top_5", "top_1_without_own", "top_5_without_own", *METRICS, *REGRETS, "milliseconds")
"""What is said of a method, as `model_evaluations.metric` names it."""


@dataclasses.dataclass(frozen=True)
class KnownInstance:
    """An instance of which the scanned model is known, with its candidates by slot.

    assets: Asset by slot. true: Slots of what was scanned, or comes nearest to it: first of all candidates, then of those that are not
    `own`. own: Slots with the scanned model's own mesh, or of its crop. agreements: With the scanned model, by slot; empty where only the
    slots are known.
    """

    scene_id: str
    room_id: str
    instance_id: str
    category: str
    split: str
    is_held_out_category: bool
    assets: Mapping[int, str]
    true: Collection[int]
    true_without_own: Collection[int]
    own: Collection[int]
    agreements: Mapping[int, Agreement] = dataclasses.field(default_factory=dict)


def outcome_of(
    known: KnownInstance, scores: ArrayLike, slots: Sequence[int], *, method: str, dataset: str, training_id: str, seed: int = 0,
    model_id: str | None = None, is_fallback: bool = False, seconds: float | None = None,
) -> SelectionOutcome:  # fmt: skip
    """The row of an instance whose candidates, in the order of `slots`, a method gave some scores, shape (k,)."""
    ranking = ranking_of(scores, slots)
    chosen = ranking[0]
    figures: dict[str, float | None] = {}
    for metric in METRICS:
        values = {slot: getattr(known.agreements[slot], metric) for slot in ranking if slot in known.agreements}
        best = max if metric in HIGHER_IS_BETTER else min
        figures[metric] = values.get(chosen)
        figures[f"best_{metric}"] = best(values.values(), default=None)
    return SelectionOutcome(
        training_id=training_id, model_id=model_id, method=method, seed=seed, dataset=dataset, split=known.split, scene_id=known.scene_id,
        room_id=known.room_id, instance_id=known.instance_id, category=known.category, is_held_out_category=known.is_held_out_category,
        candidate_count=len(ranking), chosen_asset_id=known.assets[chosen], is_chosen_own=chosen in known.own, is_fallback=is_fallback,
        truth_rank=place_of(ranking, known.true), truth_rank_without_own=place_of(ranking, known.true_without_own, known.own),
        seconds=seconds, **figures,
    )  # fmt: skip


def figures_of(outcomes: Sequence[SelectionOutcome], seed: int) -> dict[str, ConfidenceInterval]:
    """Means over instances by figure (`FIGURES`), with intervals of 95 % over rooms; without those that no instance has.

    Rows of one method, dataset and split; those of several seeds count as so many instances of their rooms.
    """
    rooms = [row.room_id for row in outcomes]
    values: dict[str, ArrayLike] = {
        "top_1": hits([row.truth_rank for row in outcomes], 1),
        "top_5": hits([row.truth_rank for row in outcomes], 5),
        "top_1_without_own": hits([row.truth_rank_without_own for row in outcomes], 1),
        "top_5_without_own": hits([row.truth_rank_without_own for row in outcomes], 5),
    }
    for metric in METRICS:
        chosen, best = (_column(outcomes, name) for name in (metric, f"best_{metric}"))
        values |= {metric: chosen, f"regret_{metric}": np.abs(chosen - best)}
    values["milliseconds"] = 1000.0 * _column(outcomes, "seconds")
    figures = {name: interval(values[name], rooms, seed) for name in FIGURES}
    return {name: figure for name, figure in figures.items() if figure.examples}


def _column(outcomes: Sequence[SelectionOutcome], name: str) -> np.ndarray:
    return np.array([np.nan if getattr(row, name) is None else getattr(row, name) for row in outcomes], dtype=np.float64)
