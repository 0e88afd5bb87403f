"""The views of libraries, each against a computation of its own."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.candidates import Candidate
from schemas.indexing import IndexedLibrary, LibraryModel, RefusedModel
from schemas.optimization import Placement
from tests.samples import sample
from tests.warehouse.questions.view_answers import ASSETS, CATEGORIES, EXACT, INSTANCES, SCENES, Database, of, quick

LIBRARIES = ("aws", "own")
FILES = ("a.glb", "b.glb", "c/d.obj")


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@st.composite
def libraries(draw: st.DrawFn) -> list[Any]:
    """Libraries, candidates that were found in them or in what they were before, others, and placements."""
    rows: list[Any] = []
    for library in draw(st.lists(st.sampled_from(LIBRARIES), unique=True)):
        files = draw(st.lists(st.sampled_from(FILES), unique=True))
        refused = draw(st.lists(st.tuples(st.sampled_from(FILES), st.sampled_from(("size", "content"))), unique_by=lambda pair: pair[0]))
        rows.append(sample(IndexedLibrary, library=library, model_count=len(files), refused_count=len(refused)))
        for file in files:
            first, by = draw(st.sampled_from(((None, None), ("a.glb", "bytes"), ("a.glb", "geometry"))))
            values = {"category": draw(st.sampled_from(CATEGORIES)), "asset_id": draw(st.sampled_from(ASSETS)), "duplicate_by": by}
            noncommercial = draw(st.booleans())
            rows.append(
                sample(LibraryModel, library=library, file=file, duplicate_of=first, is_noncommercial=noncommercial, **values)  # type: ignore[arg-type]
            )
        rows += [sample(RefusedModel, library=library, file=f"x/{file}", field=field, reason=f"{file} is odd") for file, field in refused]
    for scene in SCENES[:2]:
        for instance in draw(st.lists(st.sampled_from(INSTANCES), unique=True)):
            place = {"scene_id": scene, "instance_id": instance}
            for slot in draw(st.lists(st.integers(1, 3), unique=True)):
                library = draw(st.sampled_from((*LIBRARIES, None)))
                found = {"library": library, "library_file": draw(st.sampled_from(FILES)), "library_score": draw(EXACT) / 16}
                rows.append(sample(Candidate, **place, slot=slot, outcome="filled", asset_id=draw(st.sampled_from(ASSETS)), **found))
            if draw(st.booleans()):
                rows.append(sample(Placement, **place, asset_id=draw(st.sampled_from(ASSETS))))
    return rows


@quick
@given(libraries())
def test_what_scenes_take_is_counted_by_category(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    models = {(row.library, row.file): row for row in of(rows, LibraryModel)}
    placed = {(row.scene_id, row.instance_id): row.asset_id for row in of(rows, Placement)}
    expected: dict[tuple[str, str], dict[str, Any]] = defaultdict(
        lambda: {"models": 0, "noncommercial_models": 0, "files": set(), "slots": [], "chosen": set(), "scenes": set()}
    )
    for model in models.values():
        if model.duplicate_by != "bytes":
            expected[model.library, model.category]["models"] += 1
            expected[model.library, model.category]["noncommercial_models"] += model.is_noncommercial
    for row in of(rows, Candidate):
        model = models.get((row.library, row.library_file))
        if model is None or model.asset_id != row.asset_id:
            continue
        one = expected[model.library, model.category]
        one["files"].add(row.library_file)
        one["slots"].append(row.library_score)
        one["scenes"].add(row.scene_id)
        if placed.get((row.scene_id, row.instance_id)) == row.asset_id:
            one["chosen"].add((row.scene_id, row.instance_id))
    answers = database.ask("library_usage")
    assert [-row["candidates"] for row in answers] == sorted(-row["candidates"] for row in answers)
    assert {(row["library"], row["category"]) for row in answers} == set(expected)
    for row in answers:
        one = expected[row["library"], row["category"]]
        counts = {"offered": len(one["files"]), "candidates": len(one["slots"]), "chosen": len(one["chosen"]), "scenes": len(one["scenes"])}
        assert {name: row[name] for name in counts} == counts
        assert (row["models"], row["noncommercial_models"]) == (one["models"], one["noncommercial_models"])
        mean = sum(one["slots"]) / len(one["slots"]) if one["slots"] else None
        assert row["mean_score"] == (pytest.approx(mean) if mean is not None else None)


@quick
@given(libraries())
def test_refusals_are_counted_by_what_is_wrong(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    sizes = {row.library: row.model_count + row.refused_count for row in of(rows, IndexedLibrary)}
    expected: dict[tuple[str, str], list[RefusedModel]] = defaultdict(list)
    for row in of(rows, RefusedModel):
        expected[row.library, row.field].append(row)
    answers = {(row["library"], row["field"]): row for row in database.ask("library_refusals")}
    assert set(answers) == set(expected)
    for (library, field), refused in expected.items():
        answer, first = answers[library, field], min(refused, key=lambda row: row.file)
        assert (answer["files"], answer["example"], answer["reason"]) == (len(refused), first.file, first.reason)
        assert answer["share"] == pytest.approx(len(refused) / sizes[library])
