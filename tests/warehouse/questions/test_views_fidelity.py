"""Fidelity of scenes and by category, and in the headline."""

from __future__ import annotations

import pytest

from schemas.capture import Instance
from schemas.fidelity import Fidelity, SceneFidelity
from tests.samples import sample
from tests.warehouse.questions.view_answers import Database

OBJECTS = [
    # scene, category, placed, F at 5 cm, completeness, seen empty
    ("demo/a", "chair", True, 1.0, 1.0, 0.0),
    ("demo/a", "chair", True, 0.5, 0.5, 0.25),
    ("demo/b", "chair", False, 0.0, 0.0, None),
    ("demo/b", "door", True, None, 1.0, None),
    ("demo/b", "lamp", True, 0.25, 0.125, 0.5),
]


def test_categories_are_listed_from_the_least_alike_and_unseen_assets_are_counted() -> None:
    rows = []
    for number, (scene, category, placed, score, complete, empty) in enumerate(OBJECTS):
        of = {"scene_id": scene, "instance_id": f"{number:04d}"}
        rows.append(sample(Instance, **of, category=category))
        rows.append(sample(Fidelity, **of, is_placed=placed, f_5cm=score, completeness_5cm=complete, seen_empty_share=empty))
    with Database() as database:
        database.fill(*rows)
        found = database.ask("fidelity_by_category")
    named = [(row["category"], row["objects"], row["placed"], row["unseen"], row["mean_f_5cm"], row["least_f_5cm"]) for row in found]
    assert named == [("lamp", 1, 1, 0, 0.25, 0.25), ("chair", 3, 2, 0, 0.5, 0.0), ("door", 1, 1, 1, None, None)]
    assert [row["mean_completeness_5cm"] for row in found] == [0.125, 0.5, 1.0]
    assert [row["mean_seen_empty_share"] for row in found] == [0.5, 0.125, None]


@pytest.mark.parametrize("scores", [(0.25, None, 0.75), (None,), ()])
def test_scenes_are_listed_from_the_least_alike_and_the_headline_has_their_median(scores: tuple[float | None, ...]) -> None:
    rows = [
        sample(SceneFidelity, scene_id=f"demo/{n}", object_f_5cm=score, scan_area_m2=80.0, unlabeled_area_m2=4.0)
        for n, score in enumerate(scores)
    ]
    with Database() as database:
        database.fill(*rows)
        found = database.ask("scene_fidelity_overview")
        (headline,) = database.ask("headline")
    known = sorted(score for score in scores if score is not None)
    assert [row["object_f_5cm"] for row in found] == [*known, *(None for score in scores if score is None)]
    assert all(row["unlabeled_share"] == 0.05 for row in found)
    assert headline["median_object_f_5cm"] == (sum(known) / len(known) if known else None)
