"""Stability, supports and volumes over all scenes, each against a computation of its own."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.candidates import Asset
from schemas.capture import Instance, Room, Shell
from schemas.optimization import Certificate, Placement, Support
from tests.samples import sample
from tests.warehouse.questions.test_views_physics import physics
from tests.warehouse.questions.view_answers import ASSETS, CATEGORIES, EXACT, INSTANCES, SCENES, Database, by_key, degrees, of, quick, same


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's score interval by its definition: the shares that lie 1.96 of their own standard errors from what was seen."""
    seen, z = successes / trials, 1.96
    low, high = sorted(np.roots([1 + z * z / trials, -2 * seen - z * z / trials, seen * seen]).real)
    return 0.0 if successes == 0 else float(low), 1.0 if successes == trials else float(high)


@pytest.mark.whole
@quick
@given(rows=physics(), nobody=st.booleans())
def test_stability_is_counted_by_category(database: Database, rows: list[Any], nobody: bool) -> None:
    if nobody:  # whose instance is gone
        rows = [*rows, sample(Certificate, scene_id=SCENES[2], instance_id="0009", is_stable_5cm=False)]
    database.fill(*rows)
    category = {(r.scene_id, r.instance_id): r.category for r in of(rows, Instance)}
    groups: dict[tuple[str | None, str], list[Certificate]] = defaultdict(list)
    for row in of(rows, Certificate):
        groups[category.get((row.scene_id, row.instance_id)), row.engine].append(row)
    answer = by_key(database.ask("stability_by_category"), "category", "engine")
    assert answer.keys() == groups.keys()
    for key, group in groups.items():
        free = [c for c in group if not c.is_fixed]
        moved = [c.displacement_m for c in free if c.displacement_m is not None]
        tilted = [c.tilt_radians for c in free if c.tilt_radians is not None]
        nudged = [c.is_stable_nudged for c in free if c.is_stable_nudged is not None]
        one, five = sum(c.is_stable_1cm for c in free), sum(c.is_stable_5cm for c in free)
        same(
            answer[key], objects=len(group), scenes=len({c.scene_id for c in group}), free=len(free), fixed=len(group) - len(free),
            fixed_share=1 - len(free) / len(group), stable_1cm=one, stable_1cm_share=one / len(free) if free else None, stable_5cm=five,
            stable_5cm_share=five / len(free) if free else None, nudged=len(nudged), stable_nudged=sum(nudged),
            stable_nudged_share=sum(nudged) / len(nudged) if nudged else None,
            median_displacement_m=statistics.median(moved) if moved else None, worst_displacement_m=max(moved, default=None),
            worst_tilt_degrees=degrees(max(tilted, default=None)), refused=sum(c.problem is not None for c in group),
        )  # fmt: skip
        low, high = wilson(five, len(free)) if free else (None, None)
        for bound, value in (("low", low), ("high", high)):
            found = answer[key][f"stable_5cm_share_{bound}"]
            assert found == (None if value is None else pytest.approx(value, abs=1e-9))
    of_scenes = database.ask("SELECT engine, sum(stable_5cm) AS stable FROM stability GROUP BY engine ORDER BY engine")
    assert of_scenes == database.ask("SELECT engine, sum(stable_5cm) AS stable FROM stability_by_category GROUP BY engine ORDER BY engine")


@st.composite
def carried(draw: st.DrawFn) -> list[Any]:
    """Objects of two scenes, some of them on or inside others, of which some are gone."""
    rows: list[Any] = []
    for scene in SCENES[:2]:
        names = draw(st.lists(st.sampled_from(INSTANCES), unique=True))
        rows += [
            sample(Instance, scene_id=scene, instance_id=name, category=draw(st.sampled_from([*CATEGORIES, "floor"]))) for name in names
        ]
        for name in names:
            relation = draw(st.sampled_from(["floor", "on", "inside", "wall", "none"]))
            parent = draw(st.sampled_from([*INSTANCES, "0009"])) if relation in ("on", "inside") else None
            place = {"scene_id": scene, "instance_id": name}
            rows.append(sample(Support, **place, relation=relation, parent_id=parent, is_kept=draw(st.booleans())))
    return rows


@quick
@given(rows=carried())
def test_what_stands_on_what_is_counted_by_category(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    category = {(r.scene_id, r.instance_id): r.category for r in of(rows, Instance)}
    groups: dict[tuple[Any, str, str], list[Support]] = defaultdict(list)
    by_object: dict[str, int] = defaultdict(int)
    by_carrier: dict[tuple[Any, str], int] = defaultdict(int)
    for row in of(rows, Support):
        carrier = category.get((row.scene_id, row.parent_id))
        groups[carrier, row.relation, category[row.scene_id, row.instance_id]].append(row)
        by_object[category[row.scene_id, row.instance_id]] += 1
        by_carrier[carrier, "" if carrier else row.relation] += 1
    answers = database.ask("support_pairs")
    assert [-row["objects"] for row in answers] == sorted(-row["objects"] for row in answers)
    answer = by_key(answers, "carrier_category", "relation", "category")
    assert answer.keys() == groups.keys()
    for (carrier, relation, name), group in groups.items():
        kept = sum(s.is_kept for s in group)
        same(
            answer[carrier, relation, name], objects=len(group), scenes=len({s.scene_id for s in group}), kept=kept,
            kept_share=kept / len(group), category_share=len(group) / by_object[name],
            carrier_share=len(group) / by_carrier[carrier, "" if carrier else relation],
        )  # fmt: skip


@st.composite
def furnished(draw: st.DrawFn) -> list[Any]:
    """Scenes of no, one or two rooms, with objects in them or in none, some with a solid in their place."""
    rows: list[Any] = [sample(Asset, asset_id=asset, volume_m3=draw(EXACT)) for asset in ASSETS]
    for scene in draw(st.lists(st.sampled_from(SCENES), unique=True)):
        count = draw(st.integers(0, 2))
        if draw(st.booleans()):
            rows.append(sample(Shell, scene_id=scene, height_m=draw(st.sampled_from([2.0, 2.5, 4.0]))))
        for index in range(count):
            kind = draw(st.sampled_from(["office", "kitchen", "unknown"]))
            rows.append(sample(Room, scene_id=scene, room_index=index, room_type=kind, floor_area_m2=draw(EXACT)))
        for name in draw(st.lists(st.sampled_from(INSTANCES), unique=True)):
            place = {"scene_id": scene, "instance_id": name}
            index = draw(st.sampled_from([None, *range(count)]))
            is_structure = draw(st.sampled_from([False, False, True]))
            rows.append(sample(Instance, **place, is_structure=is_structure, box_volume_m3=draw(EXACT), room_index=index))
            if draw(st.booleans()):
                rows.append(sample(Placement, **place, asset_id=draw(st.sampled_from(ASSETS)), scale=(2.0, 0.5, 0.5)))
    return rows


@pytest.mark.whole
@quick
@given(rows=furnished())
def test_volumes_are_summed_by_the_kind_of_room(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    rooms = {scene: [r for r in of(rows, Room) if r.scene_id == scene] for scene in SCENES}
    height = {s.scene_id: s.height_m for s in of(rows, Shell)}
    volume = {a.asset_id: a.volume_m3 for a in of(rows, Asset)}
    solid = {(p.scene_id, p.instance_id): volume[p.asset_id] * math.prod(p.scale) for p in of(rows, Placement)}
    held: dict[str, list[Instance]] = defaultdict(list)
    for row in of(rows, Instance):
        if not row.is_structure:
            kinds = [r.room_type for r in rooms[row.scene_id] if len(rooms[row.scene_id]) == 1 or r.room_index == row.room_index]
            held[kinds[0] if kinds else "unknown"].append(row)
    answer = by_key(database.ask("volume_by_room_type"), "room_type")
    assert answer.keys() == held.keys() | {r.room_type for r in of(rows, Room)}
    for kind, row in answer.items():
        of_kind = [r for r in of(rows, Room) if r.room_type == kind]
        floor = sum(r.floor_area_m2 for r in of_kind) if of_kind else None
        spaces = [r.floor_area_m2 * height[r.scene_id] for r in of_kind if r.scene_id in height]
        space = sum(spaces) if spaces else None
        boxes = [i.box_volume_m3 for i in held[kind]]
        solids = [solid[i.scene_id, i.instance_id] for i in held[kind] if (i.scene_id, i.instance_id) in solid]
        quartiles = [float(q) for q in np.percentile(boxes, [0, 25, 50, 75, 100])] if boxes else [None] * 5
        same(
            row, rooms=len(of_kind), floor_area_m2=floor, room_volume_m3=space, objects=len(boxes),
            scenes=len({i.scene_id for i in held[kind]}), box_volume_m3=float(sum(boxes)), placed=len(solids),
            solid_volume_m3=float(sum(solids)), box_m3_per_m2=sum(boxes) / floor if floor else None,
            filled_share=sum(boxes) / space if space else None,
            **dict(zip(("smallest_m3", "q1_m3", "median_m3", "q3_m3", "largest_m3"), quartiles, strict=True)),
        )  # fmt: skip
