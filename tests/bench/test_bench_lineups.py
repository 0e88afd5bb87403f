"""Lineups of ten: what the catalog holds, that nothing but the scan tells which of a lineup was scanned, and what is colored anew."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.selection import catalog, lineups
from bench.selection.catalog import CatalogModel, cell, features, made_catalog, main_color, models_of_room, read_catalog
from bench.selection.lineups import LineupSettings, Offered, extents_of, lineup, near_models, recolored
from bench.selection.rooms import TrueModel
from tasks.furniture import generate as furniture
from tasks.geometry.meshes import surface_of


def true_model(seed: int = 0) -> TrueModel:
    model = furniture("chair", (0.5, 0.46, 0.88), np.random.default_rng(seed))
    return TrueModel("chair_000", "chair", model.parts, np.eye(4), (0.5, 0.46, 0.88))


@pytest.fixture(scope="module")
def chairs() -> dict[str, list[CatalogModel]]:
    """A catalog of sixty chairs, of sizes round the true one's."""
    rng = np.random.default_rng(7)
    models = []
    for seed in range(60):
        x, y, z = (np.array([0.5, 0.46, 0.88]) * np.exp(rng.normal(0.0, 0.1, 3))).tolist()
        parts = furniture("chair", (x, y, z), np.random.default_rng(seed)).parts
        models.append(CatalogModel("chair", (x, y, z), main_color(parts), seed))
    return {"chair": models}


@pytest.fixture
def drawn_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is made of a scan."""
    monkeypatch.setattr(lineups, "_of_scan", lambda kind, request: [])


def drawn_lineup(
    seed: int, models: catalog.Catalog, settings: LineupSettings | None = None, true: TrueModel | None = None
) -> list[Offered]:
    request: Any = None
    return lineup(
        true or true_model(), request, ("chair", "stool", "armchair", "bar stool", "bench", "ottoman", "table"), models,
        settings or LineupSettings(), np.random.default_rng(seed),
    )  # fmt: skip


@given(st.integers(0, 10**6), st.sampled_from([(32, 4), (24, 6), (40, 5), (3, 6)]))
def test_whichever_of_a_cell_was_scanned_the_cell_is_the_same(seed: int, sizes: tuple[int, int]) -> None:
    many, count = sizes
    rng = np.random.default_rng(seed)
    values = np.round(rng.normal(size=(many, 6)), 1)  # with ties
    first = cell(values, int(rng.integers(many)), count, np.random.default_rng(seed))
    assert len(set(first)) == len(first) == min(count, many)
    assert all(set(cell(values, at, count, np.random.default_rng(seed))) == set(first) for at in first)


def test_the_scanned_one_is_anywhere_in_its_cell_and_any_may_be_beside_it() -> None:
    values = np.random.default_rng(0).normal(size=(11, 6))  # 6 of 11, all of which are one cell
    drawn = [cell(values, 3, 6, np.random.default_rng(seed)) for seed in range(400)]
    assert {row.index(3) for row in drawn} == set(range(6))
    beside = Counter(row for rows in drawn for row in rows if row != 3)
    assert set(beside) == set(range(11)) - {3}
    assert min(beside.values()) > 140, "of 200"


def test_what_is_near_is_nearer_than_what_is_any() -> None:
    values = np.random.default_rng(0).normal(size=(400, 6))
    near = [np.linalg.norm(values[cell(values, at, 6, np.random.default_rng(at))] - values[at], axis=1).sum() / 5 for at in range(100)]
    any_distance = np.linalg.norm(values[:, None] - values[None, :100], axis=2).mean()
    assert np.mean(near) < 0.75 * any_distance


def test_a_catalog_is_drawn_again_as_it_was_and_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalog, "ROOMS", 2)
    made_catalog(tmp_path / "catalog.json", 0)
    models = [model for listed in read_catalog(tmp_path / "catalog.json").values() for model in listed]
    assert sorted(models, key=str) == sorted([*models_of_room(0, 0), *models_of_room(0, 1)], key=str)
    for model in models[:12]:
        assert extents_of(model.parts()) == pytest.approx(model.extents, abs=1e-6)
        assert main_color(model.parts()) == model.color
    monkeypatch.setattr(catalog, "models_of_room", lambda *args: pytest.fail("it is there"))
    made_catalog(tmp_path / "catalog.json", 0)


@pytest.mark.usefixtures("drawn_alone")
def test_no_slot_no_middle_and_no_even_sides_give_the_scanned_model_away(chairs: catalog.Catalog) -> None:
    places: Counter[int] = Counter()
    firsts: Counter[str] = Counter()
    for seed, chosen in enumerate(chairs["chair"]):  # each is the scanned one once, and the others are the catalog
        true = TrueModel("chair_000", "chair", chosen.parts(), np.eye(4), chosen.extents)
        others = {"chair": [model for model in chairs["chair"] if model is not chosen]}
        offered = drawn_lineup(seed, others, LineupSettings(scanned_share=1.0), true)
        places[[one.kind for one in offered].index("scanned")] += 1
        models = near_models(true, others, 6, True, np.random.default_rng(seed))
        near = features([extents_of(parts) for _, parts in models], [main_color(parts) for _, parts in models])
        middle = np.linalg.norm(near - near.mean(axis=0), axis=1)
        for rule, values in (("middle", middle), ("even", np.abs(near[:, 0] - near[:, 1])), ("largest", -near[:, :3].sum(axis=1))):
            firsts[rule] += models[int(values.argmin())][0] == "scanned"
    assert len(places) == 10
    assert max(places.values()) <= 15
    assert set(firsts) == {"middle", "even", "largest"}
    assert all(2 <= count <= 20 for count in firsts.values()), "of 60 by chance 10"


@pytest.mark.usefixtures("drawn_alone")
def test_two_of_one_mesh_are_as_often_the_scanned_one_as_any(chairs: catalog.Catalog) -> None:
    kinds = [[one.kind for one in drawn_lineup(seed, chairs, LineupSettings(scanned_share=1.0))] for seed in range(90)]
    assert 5 <= sum("recolored" in row for row in kinds) <= 28  # by chance 15
    assert all(row.count("scanned") == 1 and row.count("variant") == 5 for row in kinds)


@pytest.mark.usefixtures("drawn_alone")
def test_the_scanned_model_is_offered_as_often_as_stated_and_lineups_follow_from_their_seed(chairs: catalog.Catalog) -> None:
    kinds = [[one.kind for one in drawn_lineup(seed, chairs)] for seed in range(40)]
    assert 26 <= sum("scanned" in row for row in kinds) <= 39
    assert all(row.count("reshaped") == 1 and row.count("other") == 2 and row.count("recolored") + row.count("twin") == 1 for row in kinds)
    assert all("recolored" not in row or "scanned" in row for row in kinds)
    assert [one.made.asset for one in drawn_lineup(5, chairs)] == [one.made.asset for one in drawn_lineup(5, chairs)]


@pytest.mark.usefixtures("drawn_alone")
def test_a_category_of_which_the_catalog_has_few_is_filled_up_with_others() -> None:
    kinds = Counter(one.kind for one in drawn_lineup(1, {}, LineupSettings(scanned_share=0.0)))
    assert kinds == {"scanned": 1, "recolored": 1, "reshaped": 1, "other": 6}, "of six other categories, and nothing twice"


def test_another_color_leaves_the_mesh_and_moves_the_main_color_alone() -> None:
    parts = true_model().parts
    main = main_color(parts)
    moved = recolored(parts, main, (10, 200, 30))
    assert np.linalg.norm(np.array(main_color(moved)) - (10, 200, 30)) < 20
    for before, after in zip(parts, moved, strict=True):
        assert np.array_equal(before.vertices, after.vertices)
        old, new = surface_of([before]).colors, surface_of([after]).colors
        far = np.linalg.norm(old.astype(np.float64) - main, axis=1) > 60
        assert np.array_equal(old[far], new[far])
