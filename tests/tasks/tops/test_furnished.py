"""Furnished rooms with tops: models that stand where the rules put them, and rows that say the same as the micro-scenes of the stage."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from shapely.geometry import Polygon

from bench.synthesis.rooms import generated_rows, micro_scene_rows
from schemas.record import check, table_of
from schemas.tables import RECORDS
from tasks import micro_scenes
from tasks.furniture import tops
from tasks.furniture.dwellings import depths
from tasks.furniture.tops.furnishing import LARGE_COUNTS, PIECES
from tasks.furniture.tops.sizes import LARGE
from tasks.geometry.boxes import box_footprint
from tasks.scanner.scenery import scenery_of
from tasks.stage import Blobs, Context

SOFT = {"bed": 0.05, "sofa": 0.03}
"""How deep something may sink into the models of what gives way, their pillows and covers [m]."""


def assert_furnished(room_type: str, seed: int) -> None:
    room, again = (tops.furnished(room_type, np.random.default_rng(seed)) for _ in range(2))
    assert [obj.name for obj in room.objects] == [obj.name for obj in again.objects]
    assert all((a.pose == b.pose).all() and a.extents == b.extents for a, b in zip(room.objects, again.objects, strict=True))
    named = {obj.name: obj for obj in room.objects}
    assert len(named) == len(room.objects)
    larges = [obj for obj in room.objects if obj.category in LARGE and obj.parent == "floor"]
    assert LARGE_COUNTS[0] <= len(larges) <= LARGE_COUNTS[1]
    assert larges[0].category == PIECES[room_type][0][1]
    floor = Polygon(room.polygon).buffer(1e-6)
    for obj in room.objects:
        bounds = np.concatenate([part.vertices for part in obj.parts])
        assert np.allclose(np.ptp(bounds, axis=0), obj.extents, atol=1e-6)
        if obj.category != "door":
            assert floor.covers(Polygon(box_footprint(obj.box_pose, obj.extents)))
    for large in larges:
        loads = [obj for obj in room.objects if obj.parent == large.name]
        assert loads
        words = {item.word for item in tops.rule(large.category, room_type).items()}
        assert {obj.category for obj in loads} <= words
        if large.category not in (*SOFT, "bookshelf"):
            for obj in loads:
                assert obj.pose[2, 3] == pytest.approx(large.pose[2, 3] + large.extents[2])
                for other in (other for other in room.objects if other.parent == obj.name):
                    assert other.pose[2, 3] == pytest.approx(obj.pose[2, 3] + obj.extents[2])
    for a, b, depth in depths(room.objects):
        allowed = max(SOFT.get(named[name].category, 0.001) for name in (a, b))
        assert depth <= allowed, (a, b)
    scenery = scenery_of(room)
    assert {obj.name for obj in room.objects} <= {obj.name for obj in scenery.objects}


def test_a_furnished_room_has_models_that_stand_where_the_rules_put_them():
    assert_furnished("office", 3)


@pytest.mark.whole
@pytest.mark.parametrize("room_type", sorted(PIECES))
def test_furnished_rooms_of_all_kinds(room_type):
    for seed in range(3):
        assert_furnished(room_type, seed)


def test_kinds_of_rooms_without_rules_are_named():
    with pytest.raises(ValueError, match="garage"):
        tops.furnished("garage", np.random.default_rng(0))


def test_the_stage_finds_the_micro_scenes_as_they_were_drawn():
    scenes, objects = micro_scene_rows(12, 3)
    types = {table_of(record).name: record for record in RECORDS}
    found: dict[str, list] = {"micro_scenes": [], "micro_scene_objects": []}
    for rows in generated_rows(12, 3):
        for table, made in rows.items():
            check(made, types[table])
        context = Context(rows["scenes"][0].scene_id, "micro_scenes", 0, Blobs())
        outcome = micro_scenes.run(**rows, context=context, config=micro_scenes.MicroScenesConfig())
        for table in found:
            found[table] += outcome.rows[table]
    for made, rows in ((scenes, found["micro_scenes"]), (objects, found["micro_scene_objects"])):
        check(made, type(made[0]))
        by_key = {(row.scene_id, row.instance_id): dataclasses.asdict(row) for row in rows}
        assert len(by_key) == len(made) > 40
        for row in made:
            other = by_key[row.scene_id, row.instance_id]
            for name, value in dataclasses.asdict(row).items():
                is_number = isinstance(value, float | tuple)
                assert np.allclose(value, other[name], atol=1e-9) if is_number else value == other[name], (row, name)


def test_rooms_are_the_same_whatever_their_number():
    few, many = micro_scene_rows(3, 8), micro_scene_rows(5, 8)
    assert few[0] == many[0][: len(few[0])]
    assert few[1] == many[1][: len(few[1])]
    assert few[0] != micro_scene_rows(3, 9)[0]
