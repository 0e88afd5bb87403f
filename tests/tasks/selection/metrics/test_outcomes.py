"""Rows of outcomes and the figures that follow, held against a second reading."""

from __future__ import annotations

import dataclasses
import random
from statistics import fmean

import pytest

from schemas.record import check
from schemas.selection import SelectionOutcome
from tasks.selection.metrics.outcomes import FIGURES, KnownInstance, figures_of, outcome_of
from tasks.selection.metrics.surfaces import METRICS, Agreement

ASSETS = {slot: f"{slot:064x}" for slot in range(1, 11)}


def known(seed: int, **more: object) -> KnownInstance:
    draw = random.Random(seed)
    agreements = {slot: Agreement(*(draw.random() for _ in METRICS)) for slot in ASSETS}
    values = {
        "scene_id": "demo/a", "room_id": f"demo/{seed % 3}", "instance_id": f"{seed:04d}", "category": "chair", "split": "test",
        "is_held_out_category": False, "assets": ASSETS, "true": (4,), "true_without_own": (7,), "own": (4, 9), "agreements": agreements,
    }  # fmt: skip
    return KnownInstance(**{**values, **more})  # type: ignore[arg-type]


def test_a_row_says_what_was_chosen_and_what_would_have_been_best() -> None:
    instance = known(0)
    scores = {slot: 0.1 * slot for slot in ASSETS}  # 10 9 8 7 6 5 4 ...
    slots = random.Random(1).sample(sorted(ASSETS), 10)
    row = outcome_of(instance, [scores[slot] for slot in slots], slots, method="extents", dataset="generated", training_id="bench")
    check([row], SelectionOutcome)
    assert (row.chosen_asset_id, row.truth_rank, row.truth_rank_without_own) == (ASSETS[10], 7, 3)
    assert (row.is_chosen_own, row.candidate_count, row.is_fallback, row.seed) == (False, 10, False, 0)
    for metric in METRICS:
        every = [getattr(agreement, metric) for agreement in instance.agreements.values()]
        assert getattr(row, metric) == getattr(instance.agreements[10], metric)
        assert getattr(row, f"best_{metric}") == (max(every) if metric.endswith("iou") else min(every))
    own = outcome_of(instance, [slot == 9 for slot in slots], slots, method="extents", dataset="generated", training_id="bench")
    assert own.is_chosen_own


def test_only_candidates_that_were_scored_compete() -> None:
    instance = known(1)
    row = outcome_of(instance, [0.5, 0.4], [2, 3], method="extents", dataset="generated", training_id="bench")
    assert (row.truth_rank, row.truth_rank_without_own, row.candidate_count) == (None, None, 2)
    assert row.best_chamfer_m == min(instance.agreements[slot].chamfer_m for slot in (2, 3))
    blind = dataclasses.replace(instance, agreements={})
    row = outcome_of(blind, [0.5, 0.4], [4, 7], method="extents", dataset="generated", training_id="bench")
    assert (row.truth_rank, row.chamfer_m, row.best_chamfer_m) == (1, None, None)


def test_figures_are_means_over_instances() -> None:
    draw = random.Random(0)
    rows = []
    for seed in range(40):
        scores = [draw.random() for _ in ASSETS]
        instance = known(seed, **({"agreements": {}} if seed % 5 == 0 else {}))
        rows.append(outcome_of(instance, scores, list(ASSETS), method="m", dataset="d", training_id="bench", milliseconds=float(seed)))
    figures = figures_of(rows, 3)
    assert list(figures) == list(FIGURES)
    assert figures["top_1"].value == pytest.approx(fmean(row.truth_rank == 1 for row in rows))
    assert figures["top_5"].value == pytest.approx(fmean((row.truth_rank or 99) <= 5 for row in rows))
    assert figures["top_1"].examples == 40
    measured = [row for row in rows if row.chamfer_m is not None]
    assert figures["chamfer_m"].examples == len(measured) == 32
    for metric in METRICS:
        regrets = [abs(getattr(row, metric) - getattr(row, f"best_{metric}")) for row in measured]
        assert figures[f"regret_{metric}"].value == pytest.approx(fmean(regrets))
        assert figures[metric].low <= figures[metric].value <= figures[metric].high
    assert figures["milliseconds"].value == pytest.approx(19.5)
    assert figures_of(list(reversed(rows)), 3) == figures
    assert set(figures_of([row for row in rows if row.chamfer_m is None], 3)) == {name for name in FIGURES if name[:3] in ("top", "mil")}
