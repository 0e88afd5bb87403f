"""The views over micro-scenes, each against plain Python over made-up rows."""

from __future__ import annotations

import statistics
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.micro_scenes import MicroScene, MicroSceneObject
from schemas.navigation import Split
from schemas.synthesis import Synthesis
from tests.samples import sample
from tests.warehouse.questions.view_answers import Database, by_key, of, quick, same

LARGE = ("desk", "shelf", "table")
SMALL = ("book", "kettle", "monitor", "mug")
ROOM_TYPES = ("kitchen", "office", "unknown")
SCENES = ("demo/a", "demo/b", "scannet/scene0001_00", "scannet/scene0001_01", "scannet/scene0002_00")
"""The scene0001 are scans of one room."""


few = settings(quick, max_examples=12)


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@st.composite
def micro_scenes(draw: st.DrawFn) -> list[Any]:
    """Scenes with micro-scenes, some of them drawn by a model, and the splits of some rooms."""
    rows: list[Any] = []
    rooms = set()
    for scene in draw(st.lists(st.sampled_from(SCENES), unique=True)):
        room = scene.removesuffix("_00").removesuffix("_01")
        rooms.add(room)
        if draw(st.sampled_from([False, False, True])):
            rows.append(sample(Synthesis, scene_id=scene))
        number = 0
        for _ in range(draw(st.integers(0, 3))):
            large_id = f"{number:04d}"
            count = draw(st.integers(1, 5))
            rows.append(
                sample(
                    MicroScene, scene_id=scene, instance_id=large_id, room_id=room, room_type=draw(st.sampled_from(ROOM_TYPES)),
                    category=draw(st.sampled_from(LARGE)), object_count=count,
                )
            )  # fmt: skip
            for at in range(1, count + 1):
                rows.append(
                    sample(
                        MicroSceneObject, scene_id=scene, large_id=large_id, instance_id=f"{number + at:04d}", parent_id=large_id,
                        category=draw(st.sampled_from(SMALL)), relation=draw(st.sampled_from(["on", "inside", "leans"])),
                        depth=draw(st.integers(1, 3)),
                    )
                )  # fmt: skip
            number += count + 1
    return rows + [
        sample(Split, room_id=room, split=draw(st.sampled_from(["train", "test"]))) for room in sorted(rooms) if draw(st.booleans())
    ]


def scanned(rows: Sequence[Any]) -> list[tuple[MicroScene, list[MicroSceneObject]]]:
    """Micro-scenes that no model drew, with their objects."""
    drawn = {row.scene_id for row in of(rows, Synthesis)}
    belonging: dict[tuple[str, str], list[MicroSceneObject]] = defaultdict(list)
    for row in of(rows, MicroSceneObject):
        belonging[row.scene_id, row.large_id].append(row)
    return [(row, belonging[row.scene_id, row.instance_id]) for row in of(rows, MicroScene) if row.scene_id not in drawn]


@given(rows=micro_scenes())
@few
def test_overview_counts_what_each_kind_of_large_object_carries(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    groups: dict[tuple[str, str], list[tuple[MicroScene, list[MicroSceneObject]]]] = defaultdict(list)
    for large, objects in scanned(rows):
        for room_type in ("all", large.room_type):
            groups[large.category, room_type].append((large, objects))
    answer = database.ask("micro_scene_overview")
    found = by_key(answer, "category", "room_type")
    assert found.keys() == groups.keys()
    for key, members in groups.items():
        counts = [len(objects) for _, objects in members]
        small = [row for _, objects in members for row in objects]
        same(
            found[key], micro_scenes=len(members), rooms=len({large.room_id for large, _ in members}), objects=len(small),
            mean_objects=statistics.fmean(counts), median_objects=float(statistics.median(counts)), max_objects=max(counts),
            chained_share=statistics.fmean(row.depth > 1 for row in small),
            inside_share=statistics.fmean(row.relation == "inside" for row in small),
            leaning_share=statistics.fmean(row.relation == "leans" for row in small),
            longest_chain=max(row.depth for row in small),
        )  # fmt: skip
    alone = [row for row in answer if row["room_type"] == "all"]
    assert [row["micro_scenes"] for row in alone] == sorted((row["micro_scenes"] for row in alone), reverse=True)
    assert all(first["room_type"] == "all" for category in LARGE for first in [row for row in answer if row["category"] == category][:1])


@given(rows=micro_scenes())
@few
def test_pairs_and_room_types_count_every_object_once(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    pairs: Counter[tuple[str, str]] = Counter()
    cells: Counter[tuple[str, str, str]] = Counter()
    holders: dict[tuple[str, ...], set[tuple[str, str]]] = defaultdict(set)
    for large, objects in scanned(rows):
        for row in objects:
            pairs[large.category, row.category] += 1
            cells[large.room_type, large.category, row.category] += 1
            for key in ((large.category,), (large.category, row.category), (large.room_type, large.category, row.category)):
                holders[key].add((large.scene_id, large.instance_id))
    found = by_key(database.ask("micro_scene_pairs"), "large_category", "category")
    assert found.keys() == pairs.keys()
    for pair, count in pairs.items():
        of_large = sum(n for (large_category, _), n in pairs.items() if large_category == pair[0])
        same(
            found[pair], objects=count, micro_scenes=len(holders[pair]), object_share=count / of_large,
            micro_scene_share=len(holders[pair]) / len(holders[pair[:1]]),
        )  # fmt: skip
    by_type = by_key(database.ask("micro_scene_by_room_type"), "room_type", "large_category", "category")
    assert by_type.keys() == cells.keys()
    for cell, count in cells.items():
        beside = sum(n for other, n in cells.items() if other[:2] == cell[:2])
        same(by_type[cell], objects=count, micro_scenes=len(holders[cell]), share=count / beside)


@given(rows=micro_scenes())
@few
def test_splits_are_those_of_the_rooms(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    split_of = {row.room_id: row.split for row in of(rows, Split)}
    parts: dict[str | None, list[tuple[MicroScene, list[MicroSceneObject]]]] = defaultdict(list)
    for large, objects in scanned(rows):
        parts[split_of.get(large.room_id)].append((large, objects))
    found = by_key(database.ask("micro_scene_splits"), "split")
    assert found.keys() == parts.keys()

    def figures(members: list[tuple[MicroScene, list[MicroSceneObject]]]) -> tuple[int, int, int]:
        return len(members), len({large.room_id for large, _ in members}), sum(len(objects) for _, objects in members)

    everything = figures([member for members in parts.values() for member in members])
    for split, members in parts.items():
        own = figures(members)
        same(found[split], **dict(zip(("micro_scenes", "rooms", "objects"), own, strict=True)))
        shares = (part / whole for part, whole in zip(own, everything, strict=True))
        same(found[split], **dict(zip(("micro_scene_share", "room_share", "object_share"), shares, strict=True)))
