"""Figures of selection methods out of rows, held against the same from plain Python."""

from __future__ import annotations

import dataclasses
import math
import random
from collections import defaultdict
from statistics import fmean

import pytest

from schemas.selection import SelectionOutcome
from schemas.training import LearnedModel, ModelEvaluation
from tasks.selection.metrics.outcomes import FIGURES, figures_of
from tasks.selection.metrics.surfaces import METRICS
from tests.samples import fingerprint, sample
from tests.warehouse.questions.view_answers import Database


def outcomes(seed: int = 0, rooms: int = 30) -> list[SelectionOutcome]:
    """Rows of two methods on two splits; some lack distances, some a truth apart from the own mesh."""
    draw = random.Random(seed)
    rows = []
    for room in range(rooms):
        split = "train" if room % 3 else "test"
        level = draw.random()
        for instance in range(draw.randrange(1, 6)):
            category = draw.choice(["chair", "table", "lamp"])
            for method in ("geometric", "extents"):
                best = {metric: draw.random() * 0.1 for metric in METRICS}
                chosen = {metric: best[metric] + draw.random() * 0.2 for metric in METRICS}
                for metric in ("box_iou", "oriented_iou"):
                    chosen[metric], best[metric] = best[metric], chosen[metric]
                known = draw.random() < 0.9
                figures = {name: chosen[name] if known else None for name in METRICS}
                figures |= {f"best_{name}": best[name] if known else None for name in METRICS}
                rank = draw.randrange(1, 3 if draw.random() < level else 11)
                rows.append(
                    sample(
                        SelectionOutcome, training_id="bench", model_id=None, method=method, seed=0, dataset="generated", split=split,
                        scene_id=f"demo/{room:02d}", room_id=f"demo/{room:02d}", instance_id=f"{instance:04d}", category=category,
                        is_held_out_category=category == "lamp", candidate_count=10, is_chosen_own=draw.random() < 0.2, is_fallback=False,
                        chosen_asset_id=fingerprint(room, instance), truth_rank=rank,
                        truth_rank_without_own=None if draw.random() < 0.2 else draw.randrange(1, 11), seconds=draw.random() * 5,
                        **figures,
                    )
                )  # fmt: skip
    return rows


def test_figures_are_those_of_the_rows() -> None:
    """Means as `figures_of` has them, which `model_evaluations` is made of; intervals by a linearization in plain Python."""
    rows = outcomes()
    with Database() as database:
        database.fill(*rows)
        answer = database.ask("selection_figures")
    groups: dict[tuple[str, str, str], list[SelectionOutcome]] = defaultdict(list)
    for row in rows:
        for categories in ("all", "held out" if row.is_held_out_category else "known"):
            groups[row.method, row.split, categories].append(row)
    seen = set()
    for figure in answer:
        group = groups[figure["method"], figure["split"], figure["categories"]]
        expected = figures_of(group, 0)[figure["metric"]]
        assert (figure["value"], figure["examples"]) == (pytest.approx(expected.value), expected.examples)
        low, high = linearized(group, figure["metric"])
        assert (figure["low"], figure["high"]) == (pytest.approx(low), pytest.approx(high))
        if figure["metric"] == "top_1" and figure["categories"] == "all":
            assert figure["high"] - figure["low"] == pytest.approx(expected.high - expected.low, rel=0.35), "as wide as the bootstrap's"
        seen.add((figure["method"], figure["split"], figure["categories"], figure["metric"]))
    assert seen == {(*key, metric) for key in groups for metric in FIGURES}


def value_of(row: SelectionOutcome, metric: str) -> float | None:
    if metric.startswith("top_"):
        rank = row.truth_rank_without_own if metric.endswith("without_own") else row.truth_rank
        return None if rank is None else float(rank <= int(metric[4]))
    if metric.startswith("regret_"):
        name = metric.removeprefix("regret_")
        chosen, best = getattr(row, name), getattr(row, f"best_{name}")
        return None if chosen is None else abs(chosen - best)
    return 1000 * row.seconds if metric == "milliseconds" and row.seconds is not None else getattr(row, metric)


def linearized(rows: list[SelectionOutcome], metric: str) -> tuple[float, float]:
    by_room: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        value = value_of(row, metric)
        if value is not None:
            by_room[row.room_id].append(value)
    every = [value for values in by_room.values() for value in values]
    mean, count = fmean(every), len(by_room)
    square = sum((sum(values) - mean * len(values)) ** 2 for values in by_room.values()) * count / (count - 1)
    reach = 1.959964 * math.sqrt(square) / len(every)
    return mean - reach, mean + reach


def test_one_room_has_no_interval() -> None:
    row = outcomes()[0]
    with Database() as database:
        database.fill(row)
        answer = database.ask("selection_figures")
    assert answer
    assert all(figure["low"] is None and figure["high"] is None and figure["rooms"] == 1 for figure in answer)


def test_categories_are_those_of_the_rows() -> None:
    rows = outcomes()
    with Database() as database:
        database.fill(*rows)
        answer = database.ask("selection_by_category")
    groups: dict[tuple[str, str, str], list[SelectionOutcome]] = defaultdict(list)
    for row in rows:
        groups[row.method, row.split, row.category].append(row)
    assert len(answer) == len(groups)
    for found in answer:
        group = groups[found["method"], found["split"], found["category"]]
        assert found["examples"] == len(group)
        assert found["rooms"] == len({row.room_id for row in group})
        assert found["is_held_out_category"] == (found["category"] == "lamp")
        assert found["chosen_own"] == sum(row.is_chosen_own for row in group)
        for metric in ("top_1", "top_5", "top_1_without_own", "chamfer_m", "ecd_m", "box_iou", "color_kl", "regret_chamfer_m"):
            values = [value for row in group if (value := value_of(row, metric)) is not None]
            assert found[metric] == (pytest.approx(fmean(values)) if values else None), metric


def test_the_table_of_methods_is_the_figures_side_by_side() -> None:
    rows = [row for row in outcomes() if row.split == "test"]
    evaluations = []
    for method in ("geometric", "extents"):
        for metric, figure in figures_of([row for row in rows if row.method == method], 0).items():
            evaluations.append(
                sample(
                    ModelEvaluation, training_id="bench", model_id=None, method=method, dataset="generated", split="test", metric=metric,
                    value=figure.value, low=figure.low, high=figure.high, examples=figure.examples,
                )
            )  # fmt: skip
    good, withdrawn = (
        sample(LearnedModel, model_id=fingerprint(name), training_id=name, is_withdrawn=name == "bad") for name in ("good", "bad")
    )
    for model, value in ((good, 0.8), (withdrawn, 0.9)):
        evaluations.append(
            dataclasses.replace(
                evaluations[0], training_id=model.training_id, model_id=model.model_id, method="selection", metric="top_1", value=value
            )
        )
    loss = dataclasses.replace(evaluations[0], method="something", metric="perplexity")
    with Database() as database:
        database.fill(*evaluations, loss, good, withdrawn)
        answer = database.ask("selection_methods")
    assert {(row["method"], row["model_id"]) for row in answer} == {("geometric", None), ("extents", None), ("selection", good.model_id)}
    assert [row["top_1"] for row in answer] == sorted((row["top_1"] for row in answer), reverse=True)
    for row in answer:
        for figure in evaluations:
            if (figure.method, figure.model_id) == (row["method"], row["model_id"]) and figure.metric in row:
                assert row[figure.metric] == figure.value
                if f"{figure.metric}_low" in row:
                    assert (row[f"{figure.metric}_low"], row[f"{figure.metric}_high"]) == (figure.low, figure.high)
        (took,) = [each for each in evaluations if (each.method, each.metric) == (row["method"], "milliseconds")] or [None]
        assert row["seconds_per_object"] == (None if took is None else took.value / 1000)
    (model,) = [row for row in answer if row["method"] == "selection"]
    assert (model["top_1"], model["top_5"], model["chamfer_m"]) == (0.8, None, None)
