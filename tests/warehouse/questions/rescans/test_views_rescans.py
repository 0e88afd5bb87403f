"""Changes between scans of a room, and how well the scans fit, against Python."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.capture import Instance
from schemas.rescans import CHANGES, Rescan, RescanObject
from tests.samples import sample
from tests.warehouse.questions.view_answers import EXACT, Database, quick

PAIRS = (("demo/b", "demo/a"), ("demo/c", "demo/a"), ("demo/c", "demo/b"))
HAS_BOTH = ("unchanged", "moved")


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@st.composite
def changed_rooms(draw: st.DrawFn) -> tuple[list[Rescan], list[RescanObject]]:
    rescans, objects = [], []
    for later, earlier in draw(st.sets(st.sampled_from(PAIRS))):
        pair = {"scene_id": later, "reference_scene_id": earlier}
        outcome = draw(st.sampled_from(["registered", "refused"]))
        rescans.append(sample(Rescan, **pair, room_id="demo/room", outcome=outcome, wall_share=draw(EXACT) / 16, conflict_share=0.0))
        for number in range(draw(st.integers(0, 4)) if outcome == "registered" else 0):
            change = draw(st.sampled_from(CHANGES))
            objects.append(
                sample(
                    RescanObject, **pair, number=number, change=change, category=draw(st.sampled_from(["chair", "mug"])),
                    instance_id=None if change == "removed" else f"{number:04d}", seen_share=None if change in HAS_BOTH else 1.0,
                    reference_instance_id=None if change == "added" else f"{number:04d}", shift=(0.0, 0.0, 0.0),
                    distance_m=draw(EXACT) if change in HAS_BOTH else None, turn_radians=0.5 if change in HAS_BOTH else None,
                )
            )  # fmt: skip
    return rescans, objects


@quick
@given(changed_rooms())
def test_changes_are_those_of_the_tables(database: Database, rooms: tuple[list[Rescan], list[RescanObject]]) -> None:
    rescans, objects = rooms
    finders = {"demo/a": "file", "demo/b": "classical", "demo/c": "learned"}
    instances = [
        sample(Instance, scene_id=scene, instance_id=f"{number:04d}", found_by=found_by)
        for scene, found_by in finders.items()
        for number in range(4)
    ]
    database.fill(*rescans, *objects, *instances)
    answers = database.ask("rescan_changes")
    expected = []
    for row in sorted(objects, key=lambda row: (row.scene_id, row.reference_scene_id, row.number)):
        if row.change in ("added", "moved", "removed"):
            is_moved = row.change == "moved"
            scene = row.reference_scene_id if row.change == "removed" else row.scene_id
            expected.append(
                (row.reference_scene_id, row.scene_id, row.change, row.category, row.distance_m if is_moved else None, finders[scene])
            )
    told = [tuple(row[name] for name in ("from_scene", "to_scene", "change", "category", "distance_m", "found_by")) for row in answers]
    assert told == expected
    assert all(row["turn_degrees"] is None or math.isclose(row["turn_degrees"], math.degrees(0.5)) for row in answers)
    assert all((row["turn_degrees"] is None) == (row["change"] != "moved") for row in answers)
    assert {row["room_id"] for row in answers} <= {"demo/room"}

    counted = Counter((row.scene_id, row.reference_scene_id, row.change) for row in objects)
    overview = {(row["to_scene"], row["from_scene"]): row for row in database.ask("rescan_overview")}
    assert set(overview) == {(row.scene_id, row.reference_scene_id) for row in rescans}
    for row in rescans:
        pair = (row.scene_id, row.reference_scene_id)
        one = overview[pair]
        assert (one["outcome"], one["wall_share"]) == (row.outcome, row.wall_share)
        for change in ("unchanged", "moved", "added", "removed"):
            assert one[change] == counted[*pair, change]
        assert one["unsure"] == counted[*pair, "unnamed"] + counted[*pair, "not_seen"]
