"""Which assets stand for several objects, and how libraries do against what is made instead, each against a computation of its own."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene
from schemas.optimization import Placement
from schemas.selection import Selection
from tests.samples import fingerprint, sample
from tests.warehouse.questions.view_answers import ASSETS, CATEGORIES, INSTANCES, SCENES, Database, by_key, of, quick, same


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@st.composite
def placed(draw: st.DrawFn) -> list[Any]:
    """Placements of three scenes, the last two of one room; some of instances and scenes that are gone."""
    rows: list[Any] = [sample(Asset, asset_id=asset, name=asset[:4], category="thing") for asset in ASSETS[: draw(st.integers(0, 3))]]
    for scene in SCENES:
        if draw(st.integers(0, 5)):
            rows.append(sample(Scene, scene_id=scene, room_id=scene.rsplit("_", 1)[0]))
        for name in draw(st.lists(st.sampled_from(INSTANCES), unique=True)):
            place = {"scene_id": scene, "instance_id": name}
            if draw(st.integers(0, 5)):
                rows.append(sample(Instance, **place, category=draw(st.sampled_from(CATEGORIES))))
            rows.append(sample(Placement, **place, asset_id=draw(st.sampled_from(ASSETS))))
    return rows


@quick
@given(rows=placed())
def test_assets_that_stand_for_several_objects(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    category = {(r.scene_id, r.instance_id): r.category for r in of(rows, Instance)}
    room = {r.scene_id: r.room_id for r in of(rows, Scene)}
    known = {r.asset_id: r for r in of(rows, Asset)}
    used: dict[str, list[Placement]] = defaultdict(list)
    for row in of(rows, Placement):
        used[row.asset_id].append(row)
    expected = {asset: uses for asset, uses in used.items() if len(uses) > 1}
    answers = database.ask("asset_reuse")
    assert [-row["objects"] for row in answers] == sorted(-row["objects"] for row in answers)
    answer = by_key(answers, "asset_id")
    assert answer.keys() == expected.keys()
    for asset, uses in expected.items():
        scenes = Counter(p.scene_id for p in uses)
        held = Counter(category[p.scene_id, p.instance_id] for p in uses if (p.scene_id, p.instance_id) in category)
        same(
            answer[asset], name=known[asset].name if asset in known else None, category="thing" if asset in known else None,
            objects=len(uses), scenes=len(scenes), rooms=len({room[s] for s in scenes if s in room}), most_in_scene=max(scenes.values()),
            categories=sorted(held, key=lambda name: (-held[name], name)),
        )  # fmt: skip


@st.composite
def offered(draw: st.DrawFn) -> list[Any]:
    """Candidates in slots of which some are a library's, ranked or not, and what stands in the scene."""
    rows: list[Any] = []
    for scene in SCENES[:2]:
        for name in draw(st.lists(st.sampled_from(INSTANCES), unique=True)):
            place = {"scene_id": scene, "instance_id": name}
            if draw(st.integers(0, 5)):
                rows.append(sample(Instance, **place, category=draw(st.sampled_from(CATEGORIES))))
            filled = []
            for slot in draw(st.lists(st.integers(1, 4), unique=True)):
                provider, fallback = draw(st.sampled_from([("library", False), ("procedural", True), ("procedural", False)]))
                outcome = draw(st.sampled_from(["filled", "filled", "filled", "empty", "failed"]))
                score = draw(st.integers(-16, 16)) / 16 if provider == "library" and outcome == "filled" else None
                asset = fingerprint(scene, name, slot) if outcome == "filled" else None
                filled += [slot] if outcome == "filled" else []
                values = {"provider": provider, "is_fallback": fallback, "outcome": outcome, "asset_id": asset, "library_score": score}
                rows.append(sample(Candidate, **place, slot=slot, **values))
            ranked = draw(st.permutations(filled)) if draw(st.integers(0, 3)) else []
            rows += [
                sample(Selection, **place, rank=rank, slot=slot, asset_id=fingerprint(scene, name, slot))
                for rank, slot in enumerate(ranked, start=1)
            ]
            if filled and draw(st.booleans()):
                rows.append(sample(Placement, **place, asset_id=fingerprint(scene, name, draw(st.sampled_from(filled)))))
    return rows


@quick
@given(rows=offered())
def test_what_libraries_have_and_when_it_wins(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    candidates = of(rows, Candidate)
    slots = {c.slot for c in candidates if c.provider == "library"}
    category = {(r.scene_id, r.instance_id): r.category for r in of(rows, Instance)}
    rank = {(r.scene_id, r.instance_id, r.slot): r.rank for r in of(rows, Selection)}
    stands = {(r.scene_id, r.instance_id): r.asset_id for r in of(rows, Placement)}
    groups: dict[tuple[Any, int], list[Candidate]] = defaultdict(list)
    best: dict[tuple[str, str], int] = {}
    for c in candidates:
        if c.slot in slots:
            groups[category.get((c.scene_id, c.instance_id)), c.slot].append(c)
            place = rank.get((c.scene_id, c.instance_id, c.slot))
            if c.is_fallback and place is not None:
                best[c.scene_id, c.instance_id] = min(place, best.get((c.scene_id, c.instance_id), place))
    answer = by_key(database.ask("retrieval_by_category"), "category", "slot")
    assert answer.keys() == groups.keys()
    for key, group in groups.items():
        filled = [(c, rank.get((c.scene_id, c.instance_id, c.slot))) for c in group if c.outcome == "filled"]
        got = [(c, place) for c, place in filled if c.provider == "library"]
        made = [(c, place) for c, place in filled if c.is_fallback]
        pairs = [(place, other) for c, place in got if place and (other := best.get((c.scene_id, c.instance_id)))]
        scores = [c.library_score for c, _ in got]
        wins, losses = sum(place == 1 for _, place in got), sum(place == 1 for _, place in made)
        above = sum(place < other for place, other in pairs)
        same(
            answer[key], objects=len(group), retrieved=len(got), fallbacks=len(made), retrieved_share=len(got) / len(group), wins=wins,
            win_share=wins / len(got) if got else None, fallback_wins=losses, fallback_win_share=losses / len(made) if made else None,
            compared=len(pairs), above=above, above_share=above / len(pairs) if pairs else None,
            mean_library_score=sum(scores) / len(scores) if scores else None,
            placed=sum(stands.get((c.scene_id, c.instance_id)) == c.asset_id for c, _ in got),
        )  # fmt: skip
