"""The views of scenes, objects, categories and volumes, each against a computation of its own in Python and NumPy."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.candidates import Asset
from schemas.capture import Instance, Room, Scene, Shell
from schemas.optimization import Placement
from tests.samples import sample
from tests.warehouse.questions.view_answers import (
    ASSETS,
    EXACT,
    Database,
    by_key,
    objects_of,
    of,
    quick,
    same,
    scenes,
)


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@pytest.mark.whole
@quick
@given(rows=scenes())
def test_objects_and_categories_per_scene(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    objects, shells = objects_of(rows), {row.scene_id: row for row in of(rows, Shell)}
    rooms = Counter(row.scene_id for row in of(rows, Room))
    counted, categories = by_key(database.ask("objects_per_scene"), "scene_id"), by_key(database.ask("categories_per_scene"), "scene_id")
    assert counted.keys() == categories.keys() == objects.keys()
    for scene, held in objects.items():
        area = shells[scene].floor_area_m2 if scene in shells else None
        structures = sum(row.is_structure for row in of(rows, Instance) if row.scene_id == scene)
        density = len(held) / area if area else None
        room_type = shells[scene].room_type if scene in shells else "unknown"
        same(counted[scene], objects=len(held), structures=structures, floor_area_m2=area, objects_per_m2=density, room_type=room_type)
        same(counted[scene], rooms=rooms[scene])
        frequency = Counter(row.category for row in held)
        first = min(frequency, key=lambda c: (-frequency[c], c)) if frequency else None
        same(categories[scene], categories=len(frequency), most_frequent_category=first, most_frequent_objects=frequency[first] or None)
    everywhere = [row for held in objects.values() for row in held]
    answer = database.ask("category_counts")
    assert [row["category"] for row in answer] == sorted(
        {row.category for row in everywhere}, key=lambda c: (-sum(r.category == c for r in everywhere), c)
    )
    for row in answer:
        having = [one for one in everywhere if one.category == row["category"]]
        same(row, objects=len(having), scenes=len({one.scene_id for one in having}), share=len(having) / len(everywhere))
    same(
        database.ask("headline")[0],
        scenes=len(objects), objects=len(everywhere), categories=len({row.category for row in everywhere}),
        floor_area_m2=float(sum(row.floor_area_m2 for row in shells.values())), rooms=len({row.room_id for row in of(rows, Scene)}),
    )  # fmt: skip


@quick
@given(rows=scenes())
def test_objects_area_and_kind_by_room(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    rooms = {(row.scene_id, row.room_index): row for row in of(rows, Room)}
    alone = {scene for scene, count in Counter(scene for scene, _ in rooms).items() if count == 1}
    held: dict[tuple[str, int], list[Instance]] = {key: [] for key in rooms}
    kinds: Counter[tuple[str, str]] = Counter()
    for row in of(rows, Instance):
        if not row.is_structure:
            key = (row.scene_id, 0 if row.scene_id in alone else row.room_index)
            held.get(key, []).append(row)
            kinds[rooms[key].room_type if key in rooms else "unknown", row.category] += 1
    answer = by_key(database.ask("room_overview"), "scene_id", "room_index")
    assert answer.keys() == rooms.keys()
    for key, room in rooms.items():
        count, area = len(held[key]), room.floor_area_m2
        same(
            answer[key], room_type=room.room_type, floor_area_m2=area, objects=count, categories=len({row.category for row in held[key]}),
            objects_per_m2=count / area if area else None, room_id=key[0].rsplit("_", 1)[0],
        )  # fmt: skip
    for scene in {scene for scene, _ in rooms}:
        shares = [row["floor_share"] for key, row in answer.items() if key[0] == scene]
        assert shares == [None] * len(shares) or math.isclose(sum(shares), 1.0)
    standing = database.ask("category_by_room_type")
    assert {(row["room_type"], row["category"]): row["objects"] for row in standing} == kinds


@quick
@given(rows=scenes())
def test_nyu40_classes(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    everywhere = [row for held in objects_of(rows).values() for row in held]
    counted = Counter(row.nyu40_id for row in everywhere)
    answer = database.ask("nyu40_counts")
    assert [row["nyu40_id"] for row in answer] == sorted(counted, key=lambda one: (-counted[one], one))
    for row in answer:
        having = [one for one in everywhere if one.nyu40_id == row["nyu40_id"]]
        same(
            row, objects=len(having), scenes=len({one.scene_id for one in having}), categories=len({one.category for one in having}),
            nyu40_label=having[0].nyu40_label, share=len(having) / len(everywhere),
        )  # fmt: skip
    assert sum(row["objects"] for row in answer) == sum(row["objects"] for row in database.ask("category_counts"))


@quick
@given(rows=scenes())
def test_volume_quartiles_whiskers_and_outliers_are_those_of_matplotlib(database: Database, rows: list[Any]) -> None:
    from matplotlib.cbook import boxplot_stats

    database.fill(*rows)
    volumes: dict[str, list[float]] = defaultdict(list)
    for held in objects_of(rows).values():
        for row in held:
            volumes[row.category].append(row.box_volume_m3)
    answer = database.ask("volume_by_category")
    order = sorted(volumes, key=lambda c: (-len(volumes[c]), c))
    assert [(row["frequency_rank"], row["category"]) for row in answer] == list(enumerate(order, start=1))
    strays = database.ask("volume_outliers")
    for row in answer:
        values = volumes[row["category"]]
        box = boxplot_stats(values)[0]
        fliers = sorted(float(value) for value in box["fliers"])
        same(
            row, objects=len(values), smallest_m3=min(values), largest_m3=max(values), q1_m3=float(box["q1"]), median_m3=float(box["med"]),
            q3_m3=float(box["q3"]), whisker_low_m3=float(box["whislo"]), whisker_high_m3=float(box["whishi"]), outliers=len(fliers),
        )  # fmt: skip
        assert sorted(stray["box_volume_m3"] for stray in strays if stray["category"] == row["category"]) == fliers
    volume = {(row.scene_id, row.instance_id): row.box_volume_m3 for held in objects_of(rows).values() for row in held}
    for stray in strays:
        assert volume[stray["scene_id"], stray["instance_id"]] == stray["box_volume_m3"]
    assert sum(row["outliers"] for row in answer) == len(strays)
    quartiles = by_key(database.ask("volume_quartiles"), "category")
    for row in answer:
        reach = 1.5 * (row["q3_m3"] - row["q1_m3"])
        same(
            quartiles[row["category"]], fence_low_m3=row["q1_m3"] - reach, fence_high_m3=row["q3_m3"] + reach,
            **{name: row[name] for name in ("objects", "smallest_m3", "q1_m3", "median_m3", "q3_m3", "largest_m3")},
        )  # fmt: skip


@st.composite
def placed(draw: st.DrawFn) -> list[Any]:
    """Scenes whose objects some assets stand for, scaled along their axes."""
    volumes = {asset: draw(EXACT) for asset in ASSETS}
    rows: list[Any] = [*draw(scenes()), *(sample(Asset, asset_id=asset, volume_m3=volume) for asset, volume in volumes.items())]
    factor = st.sampled_from([0.25, 0.5, 1.0, 2.0, 8.0])
    for held in objects_of(rows).values():
        for row in held:
            if draw(st.booleans()):
                asset, scale = draw(st.sampled_from(ASSETS)), (draw(factor), draw(factor), draw(factor))
                rows.append(sample(Placement, scene_id=row.scene_id, instance_id=row.instance_id, asset_id=asset, scale=scale))
    return rows


@pytest.mark.whole
@quick
@given(rows=placed())
def test_solids_are_the_assets_volumes_times_their_scales(database: Database, rows: list[Any]) -> None:
    from matplotlib.cbook import boxplot_stats

    database.fill(*rows)
    volume = {asset.asset_id: asset.volume_m3 for asset in of(rows, Asset)}
    category = {(row.scene_id, row.instance_id): row.category for held in objects_of(rows).values() for row in held}
    solids = {(p.scene_id, p.instance_id): volume[p.asset_id] * math.prod(p.scale) for p in of(rows, Placement)}
    listed = by_key(database.ask("placed_solids"), "scene_id", "instance_id")
    assert {key: row["solid_volume_m3"] for key, row in listed.items()} == solids
    assert all(row["category"] == category[key] for key, row in listed.items())
    of_category: dict[str, list[float]] = defaultdict(list)
    for key, solid in solids.items():
        of_category[category[key]].append(solid)
    answer, strays = database.ask("solid_volume_by_category"), by_key(database.ask("solid_volume_outliers"), "scene_id", "instance_id")
    order = sorted(of_category, key=lambda one: (-len(of_category[one]), one))
    assert [(row["frequency_rank"], row["category"]) for row in answer] == list(enumerate(order, start=1))
    for row in answer:
        values = of_category[row["category"]]
        box = boxplot_stats(values)[0]
        same(
            row, objects=len(values), smallest_m3=min(values), largest_m3=max(values), q1_m3=float(box["q1"]), median_m3=float(box["med"]),
            q3_m3=float(box["q3"]), whisker_low_m3=float(box["whislo"]), whisker_high_m3=float(box["whishi"]), outliers=len(box["fliers"]),
        )  # fmt: skip
        fliers = [stray["solid_volume_m3"] for stray in strays.values() if stray["category"] == row["category"]]
        assert sorted(fliers) == sorted(float(value) for value in box["fliers"])
        for stray in strays.values():
            if stray["category"] == row["category"]:
                same(stray, median_m3=row["median_m3"])
    assert all(solids[key] == stray["solid_volume_m3"] for key, stray in strays.items())


def test_a_whisker_never_ends_inside_its_box(database: Database) -> None:
    # the only volume below the lower quartile is an outlier, so that no volume lies between fence and box
    volumes = (0.0, 10.0, 10.0, 10.0)
    held = [
        sample(Instance, scene_id="demo/a", instance_id=f"{n:04d}", category="mug", is_structure=False, box_volume_m3=v)
        for n, v in enumerate(volumes)
    ]
    database.fill(*held)
    same(database.ask("volume_by_category")[0], whisker_low_m3=7.5, q1_m3=7.5, whisker_high_m3=10.0, outliers=1)
