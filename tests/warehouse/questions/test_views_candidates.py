"""The views of candidates, selections, assets and licenses, each against a computation of its own."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance
from schemas.optimization import RELATIONS, Certificate, Placement, Support
from schemas.selection import Selection
from tests.samples import START, sample
from tests.warehouse.questions.view_answers import (
    ASSETS,
    CATEGORIES,
    EXACT,
    INSTANCES,
    SCENES,
    Database,
    by_key,
    degrees,
    of,
    quick,
    same,
)


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@st.composite
def choices(draw: st.DrawFn) -> list[Any]:
    """Instances with candidates, selections, placements, captions, supports and annotations."""
    known = zip(ASSETS, ("MIT", "MIT", "CC0-1.0"), ("Q", None, "Q"), strict=True)
    rows: list[Any] = [sample(Asset, asset_id=asset, license=terms, author=author) for asset, terms, author in known]
    for scene in SCENES[:2]:
        for instance in draw(st.lists(st.sampled_from(INSTANCES), unique=True)):
            place = {"scene_id": scene, "instance_id": instance}
            rows.append(sample(Instance, **place, category=draw(st.sampled_from(CATEGORIES)), is_structure=False))
            if draw(st.booleans()):
                body = draw(st.sampled_from(["rigid", "cloth", "soft"]))
                rows.append(sample(Caption, **place, mass_kg=1 + draw(EXACT), body_type=body, is_fallback=draw(st.booleans())))
            slots = draw(st.lists(st.integers(1, 3), unique=True))
            filled = [slot for slot in slots if draw(st.booleans())]
            for slot in slots:
                outcome = "filled" if slot in filled else draw(st.sampled_from(["empty", "failed"]))
                rows.append(
                    sample(
                        Candidate, **place, slot=slot, provider=draw(st.sampled_from(["library", "procedural"])), outcome=outcome,
                        is_fallback=draw(st.booleans()), asset_id=ASSETS[slot - 1] if slot in filled else None,
                    )
                )  # fmt: skip
            ranked = draw(st.permutations(filled))
            for rank, slot in enumerate(ranked, start=1):
                score, chamfer = draw(st.integers(0, 64)) / 64, draw(EXACT)
                rows.append(sample(Selection, **place, rank=rank, slot=slot, asset_id=ASSETS[slot - 1], score=score, chamfer_m=chamfer))
            if ranked:
                origin = draw(st.sampled_from(["annotation", "selection"]))
                asset = ASSETS[draw(st.sampled_from(ranked)) - 1]  # not always the first: it gives way to its neighbors
                rows.append(sample(Placement, **place, asset_id=asset, origin=origin, displacement_m=draw(EXACT), lift_m=-draw(EXACT)))
                rows.append(sample(Support, **place, relation=draw(st.sampled_from(RELATIONS)), is_fixed=draw(st.booleans())))
                for engine in draw(st.lists(st.sampled_from(["mujoco", "newton"]), unique=True)):
                    moved = draw(st.none() | EXACT)
                    turned = None if moved is None else draw(EXACT)
                    rows.append(sample(Certificate, **place, engine=engine, displacement_m=moved, tilt_radians=turned))
            for batch in range(draw(st.integers(0, 2))):
                choice = draw(st.sampled_from([None, *ASSETS]))
                when = START + timedelta(days=batch)
                rows.append(sample(Annotation, **place, batch_id=f"b{batch}", annotator="ann", answered_at=when, choice=choice))
    return rows


@pytest.mark.whole
@quick
@given(rows=choices())
def test_candidates_selections_and_placements(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    best = {(r.scene_id, r.instance_id): r for r in of(rows, Selection) if r.rank == 1}
    placed = {(r.scene_id, r.instance_id): r for r in of(rows, Placement)}
    category = {(r.scene_id, r.instance_id): r.category for r in of(rows, Instance)}
    groups: dict[tuple[str, int], list[Candidate]] = defaultdict(list)
    for row in of(rows, Candidate):
        groups[row.provider, row.slot].append(row)
    wins = by_key(database.ask("candidate_wins"), "provider", "slot")
    assert wins.keys() == groups.keys()
    for key, group in groups.items():
        won = [b.score for c in group if (b := best.get((c.scene_id, c.instance_id))) and b.slot == c.slot]
        filled = sum(c.outcome == "filled" for c in group)
        same(
            wins[key], candidates=len(group), filled=filled, fallbacks=sum(c.is_fallback for c in group), wins=len(won),
            win_share=len(won) / filled if filled else None, mean_winning_score=float(np.mean(won)) if won else None,
            placed=sum(
                (p := placed.get((c.scene_id, c.instance_id))) is not None
                and p.origin == "selection"
                and p.asset_id == best[c.scene_id, c.instance_id].asset_id
                and best[c.scene_id, c.instance_id].slot == c.slot
                for c in group
            ),
        )  # fmt: skip
    assert sum(row["wins"] for row in wins.values()) == len(best)
    assert sum(row["placed"] for row in wins.values()) == sum(
        p.origin == "selection" and p.asset_id == best[key].asset_id for key, p in placed.items()
    )
    chosen = Counter(
        (c.provider, c.slot)
        for c in of(rows, Candidate)
        if (p := placed.get((c.scene_id, c.instance_id))) and p.origin == "annotation" and p.asset_id == c.asset_id
    )
    assert {key: row["placed"] for key, row in by_key(database.ask("annotation_wins"), "provider", "slot").items()} == dict(chosen)
    for row in database.ask("selection_quality"):
        scores = [r.score for key, r in best.items() if category[key] == row["category"]]
        same(row, objects=len(scores), median_score=float(np.median(scores)), lowest_score=min(scores))
    for row in database.ask("displacement_by_category"):
        moved = [p.displacement_m for key, p in placed.items() if category[key] == row["category"]]
        same(row, objects=len(moved), moved=sum(m > 0 for m in moved), median_displacement_m=float(np.median(moved)))
    assert sum(row["objects"] for row in database.ask("displacement_by_category")) == len(placed)
    licenses = {asset.asset_id: asset.license for asset in of(rows, Asset)}
    used = by_key([row for row in database.ask("license_counts") if row["material"] == "asset"], "license")
    assert {key: row["uses"] for key, row in used.items()} == Counter(licenses[p.asset_id] for p in placed.values())
    for name, row in used.items():
        of_license = [p for p in placed.values() if licenses[p.asset_id] == name]
        same(row, items=len({p.asset_id for p in of_license}), scenes=len({p.scene_id for p in of_license}))
    assert sum(row["uses"] for row in database.ask("attributions")) == len(placed)
    assert sum(row["assets"] for row in database.ask("attributions")) == len({p.asset_id for p in placed.values()})
    by_scene = by_key(database.ask("license_by_scene"), "scene_id", "material", "license")
    of_scene: dict[tuple[str, str, str], list[str]] = defaultdict(list)
    for (scene, _), p in placed.items():
        of_scene[scene, "asset", licenses[p.asset_id]].append(p.asset_id)
    assert {key: (row["items"], row["uses"]) for key, row in by_scene.items()} == {
        key: (len(set(assets)), len(assets)) for key, assets in of_scene.items()
    }


@pytest.mark.whole
@quick
@given(rows=choices())
def test_one_row_per_object_and_what_is_known_of_it(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    answer = by_key(database.ask("scene_objects"), "scene_id", "instance_id")
    assert answer.keys() == {(r.scene_id, r.instance_id) for r in of(rows, Instance)}
    captions, placed, supports = ({(r.scene_id, r.instance_id): r for r in of(rows, kind)} for kind in (Caption, Placement, Support))
    scores = {(r.scene_id, r.instance_id, r.asset_id): r.score for r in of(rows, Selection)}
    certified = {(r.scene_id, r.instance_id): r for r in of(rows, Certificate) if r.engine == "mujoco"}
    for key, row in answer.items():
        placement = placed.get(key)
        same(
            row, mass_kg=captions[key].mass_kg if key in captions else None,
            displacement_m=placement.displacement_m if placement else None, score=scores[(*key, placement.asset_id)] if placement else None,
            support=supports[key].relation if key in supports else None, is_fixed=supports[key].is_fixed if key in supports else None,
            settled_displacement_m=certified[key].displacement_m if key in certified else None,
            settled_tilt_degrees=degrees(certified[key].tilt_radians) if key in certified else None,
        )  # fmt: skip
    for row in database.ask("mass_by_category"):
        masses = [captions[key].mass_kg for key, one in answer.items() if one["category"] == row["category"] and key in captions]
        same(row, objects=len(masses), median_kg=float(np.median(masses)), heaviest_kg=max(masses), total_kg=float(sum(masses)))
        assert row["rigid"] + row["cloth"] + row["soft"] == len(masses)
    fallbacks = {(r["stage"], r["provider"]): (r["answers"], r["fallbacks"]) for r in database.ask("fallback_counts")}
    candidates = of(rows, Candidate)
    assert sum(a for (stage, _), (a, _) in fallbacks.items() if stage == "candidates") == len(candidates)
    assert sum(f for (stage, _), (_, f) in fallbacks.items() if stage == "candidates") == sum(c.is_fallback for c in candidates)
    assert sum(f for (stage, _), (_, f) in fallbacks.items() if stage == "captions") == sum(c.is_fallback for c in captions.values())
