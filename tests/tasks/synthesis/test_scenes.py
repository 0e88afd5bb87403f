"""Layouts as scenes: what was drawn is what the rows say, in words, boxes, assets and rooms; and what a simulator says of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.candidates import Asset
from schemas.errors import InputError
from schemas.optimization import Placement, Support
from schemas.record import check
from schemas.tables import TABLES
from tasks import micro_scenes
from tasks.candidates.assets import make_asset
from tasks.furniture import generate, tops
from tasks.geometry.meshes import read_points
from tasks.geometry.transforms import yaw_pose
from tasks.micro_scenes.categories import read_categories
from tasks.optimization import OptimizationConfig
from tasks.optimization.proposals import propose
from tasks.stage import Blobs, Context
from tasks.synthesis.layout import Large, Layout, layouts_of
from tasks.synthesis.scenes import rows as scene_rows
from tasks.synthesis.scenes.assets import MOST_SCALE, Pool, Style, chosen_assets, stand_for
from tasks.synthesis.scenes.drawn import Drawn, usable
from tasks.synthesis.scenes.rooms import plain_room
from tasks.synthesis.scenes.words import large_of, word_for
from tests.samples import sample

CATEGORIES = read_categories()
SCENE = "synthetic/test_0000"


def layout_of(word: str, room_type: str, seed: int) -> Layout:
    """What the rules put on a large object of a word."""
    rng = np.random.default_rng(seed)
    size = tops.typical_size(word, rng)
    top = tops.draw(word, size, room_type, rng)
    return Layout(
        Large(CATEGORIES.merged(word), size, room_type), tuple(map(CATEGORIES.merged, top.words)), top.centers, top.sizes, top.yaws
    )


def drawn_of(layout: Layout, word: str = "desk", number: int = 0) -> Drawn:
    return Drawn(SCENE, usable(layout), word, "a" * 64, "physcene", 0, number, "CC0-1.0")


def rows_of(drawn: Drawn, chosen: Sequence[Asset | None] | None = None, blobs: Blobs | None = None) -> dict[str, list[Any]]:
    """Rows by table, held against their schemas; their files are put among the blobs."""
    chosen = [None] * (1 + len(drawn.layout)) if chosen is None else chosen
    blobs = blobs if blobs is not None else Blobs()
    context = Context(SCENE, "synthesis", 0, blobs)
    outcomes = scene_rows.drawn_rows(drawn, "synthetic", chosen, None, context, OptimizationConfig())
    rows: dict[str, list[Any]] = {}
    for outcome in outcomes.values():
        for table, values in outcome.rows.items():
            check(values, TABLES[table].record)
            rows[table] = values
    for outcome in outcomes.values():
        blobs.update(outcome.blobs)
    named = {getattr(row, c) for table, values in rows.items() for row in values for c in TABLES[table].blob_columns} - {None}
    assert named <= set(blobs)
    return rows


def extracted(rows: dict[str, list[Any]]) -> Layout:
    """The layout that the stage `micro_scenes` finds where everything stands as it was drawn."""
    proposals, notes = propose(rows["instances"], rows["selections"], (), {row.asset_id for row in rows["assets"]})
    assert notes == []
    placements = [
        sample(Placement, scene_id=SCENE, instance_id=p.instance.instance_id, asset_id=p.asset_id, scale=tuple(map(float, p.scale)),
               optimized_pose=tuple(map(float, p.pose.ravel())))
        for p in proposals
    ]  # fmt: skip
    large = rows["syntheses"][0].instance_id
    supports = [
        sample(Support, scene_id=SCENE, instance_id=row.instance_id, relation="on", parent_id=large, against=None, is_kept=True)
        for row in rows["synthesis_objects"]
    ]
    found = micro_scenes.run(
        scenes=rows["scenes"], shells=rows["shells"], rooms=rows["rooms"], instances=rows["instances"], supports=supports,
        placements=placements, assets=rows["assets"], context=Context(SCENE, "micro_scenes", 0, {}),
        config=micro_scenes.MicroScenesConfig(),
    ).rows  # fmt: skip
    (layout,) = layouts_of(found["micro_scenes"], found["micro_scene_objects"])
    return layout


@pytest.fixture
def unjudged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody asks a simulator."""
    monkeypatch.setattr(scene_rows, "stable_as_drawn", lambda *_: {})


@pytest.mark.usefixtures("unjudged")
@pytest.mark.parametrize("pair", tops.PAIRS[::5], ids="-".join)
def test_the_micro_scene_of_a_drawn_scene_is_the_layout_that_was_drawn(pair: tuple[str, str]) -> None:
    for seed in range(2):
        layout = layout_of(*pair, seed)
        rows = rows_of(drawn_of(layout, pair[0], seed))
        again = extracted(rows)
        assert (again.large.category, again.large.room_type) == (layout.large.category, layout.large.room_type)
        assert again.categories == layout.categories
        for name in ("centers", "sizes"):
            np.testing.assert_allclose(getattr(again, name), getattr(layout, name), atol=1e-4)
        np.testing.assert_allclose(again.large.size, layout.large.size, atol=1e-4)
        turned = np.abs(np.remainder(again.yaws - layout.yaws + np.pi, 2 * np.pi) - np.pi)
        assert turned.max(initial=0.0) < 1e-6
        for row, center, size in zip(rows["synthesis_objects"], layout.centers, layout.sizes, strict=True):
            np.testing.assert_allclose([*row.box_center, *row.box_size], [*center, *size], atol=1e-9)


@pytest.mark.usefixtures("unjudged")
def test_a_scene_follows_from_seed_and_number_alone() -> None:
    layout = layout_of("desk", "office", 1)
    first, again = rows_of(drawn_of(layout)), rows_of(dataclasses.replace(drawn_of(layout), seconds=5.0))
    assert {row.asset_id for row in first["assets"]} == {row.asset_id for row in again["assets"]}
    other = rows_of(drawn_of(layout, number=1))
    assert {row.asset_id for row in first["assets"]} != {row.asset_id for row in other["assets"]}


@given(st.sampled_from([name for name in CATEGORIES.names if CATEGORIES.is_small(name)]), st.integers(0, 99), st.data())
@settings(max_examples=60, deadline=None)
def test_a_word_for_a_box_is_merged_into_its_category(category: str, seed: int, data: st.DataObject) -> None:
    size = data.draw(st.tuples(*[st.floats(0.004, 1.5)] * 3))
    assert CATEGORIES.merged(word_for(category, size, np.random.default_rng(seed))) == category


def test_large_objects_are_told_from_others() -> None:
    assert large_of("Desk") == "desk"
    assert large_of("kitchen counter") == "counter"
    assert [large_of(word) for word in ("mug", "dsk", "", "object")] == [None, None, None, "object"]


def asset(asset_id: str, category: str, extents: tuple[float, ...], **values: Any) -> Asset:
    return sample(
        Asset, asset_id=asset_id * 64, category=category, extents=extents, **{"license": "CC0-1.0", "provider": "library", **values}
    )


def test_only_assets_that_may_stand_there_and_fit_are_taken() -> None:
    near, far = asset("1", "mug", (0.1, 0.08, 0.1)), asset("2", "mug", (0.3, 0.3, 0.3))
    barred = [
        asset("3", "mug", (0.1, 0.08, 0.1), license="LicenseRef-scan"), asset("4", "mug", (0.1, 0.08, 0.1), license="unknown"),
        asset("5", "mug", (0.1, 0.08, 0.1), provider="synthesis"), asset("6", "book", (0.1, 0.08, 0.1)),
    ]  # fmt: skip
    pool = Pool([*barred, near, far])
    assert pool.asset_ids == (near.asset_id, far.asset_id, barred[3].asset_id)
    assert pool.fitting("mug", (0.11, 0.08, 0.1)) == [near]
    assert pool.fitting("mug", (0.1 * MOST_SCALE * 1.01, 0.08, 0.1)) == []
    assert pool.fitting("lamp", (0.1, 0.08, 0.1)) == []
    stand = stand_for("mug", (0.12, 0.08, 0.11), near, Style.drawn(np.random.default_rng(0)), np.random.default_rng(0))
    assert (stand.word, stand.files) == ("mug", {})
    np.testing.assert_allclose(np.array(stand.scale) * near.extents, (0.12, 0.08, 0.11))


def test_of_assets_that_fit_alike_one_scene_takes_one() -> None:
    pool = Pool([asset(str(i), "cup", (0.08, 0.08, 0.1)) for i in range(8)])
    large = Large("desk", (0.7, 1.4, 0.74), "office")
    centers = np.column_stack([np.zeros(6), np.linspace(-0.5, 0.5, 6), np.full(6, 0.79)])
    layout = Layout(large, ("cup",) * 6, centers, np.tile([0.08, 0.08, 0.1], (6, 1)), np.zeros(6))
    taken = [chosen_assets(drawn_of(layout, number=number), pool, with_large=True) for number in range(20)]
    assert all(one[0] is None for one in taken), "there is no desk in the pool"
    assert all(len({row.asset_id for row in one[1:] if row}) == 1 for one in taken)
    assert len({one[1].asset_id for one in taken if one[1]}) > 3, "other scenes have other sets"


@pytest.mark.usefixtures("unjudged")
def test_an_asset_of_the_lake_fills_the_box_that_was_drawn() -> None:
    model = generate("mug", (0.1, 0.08, 0.1), np.random.default_rng(5))
    made = make_asset(
        model.parts, provider="library", name="mug", category="coffee mug", source="mug.glb", license="CC-BY-4.0", pieces=model.pieces
    )
    blobs = Blobs()
    blobs.update(made.files)
    large = Large("desk", (0.7, 1.4, 0.74), "office")
    layout = Layout(large, ("mug", "book"), [[0, 0, 0.8], [0, 0.4, 0.76]], [[0.12, 0.07, 0.12], [0.2, 0.14, 0.04]], [0.5, 0.0])
    drawn = drawn_of(layout)
    chosen = chosen_assets(drawn, Pool([made.asset]), with_large=True)
    assert chosen == [None, made.asset, None]
    rows = rows_of(drawn, chosen, blobs)
    assert [row.category for row in rows["instances"]][:2] == ["desk", "coffee mug"]
    assert [row.provider for row in rows["candidates"]] == ["synthesis", "library", "synthesis"]
    again = extracted(rows)
    assert again.categories == layout.categories
    np.testing.assert_allclose(again.sizes, layout.sizes, atol=1e-6)
    np.testing.assert_allclose(again.centers, layout.centers, atol=1e-6)
    points = read_points(blobs[rows["instances"][1].points_blob])[0]
    reach = np.abs((points - layout.centers[0]) @ yaw_pose(0.5)[:3, :3]).max(axis=0)
    np.testing.assert_allclose(2 * reach, layout.sizes[0], rtol=0.05)


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_the_room_is_around_everything(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 6))
    layout = Layout(
        Large("desk", tuple(rng.uniform(0.3, 3.0, 3)), "office"), ("box",) * count, rng.uniform(-2, 2, (count, 3)),
        rng.uniform(0.01, 1.0, (count, 3)), rng.uniform(-4, 4, count),
    )  # fmt: skip
    shell, room = plain_room(drawn_of(layout))
    reach, height = np.abs(np.array(shell.floor_polygon)).min(axis=0), shell.height_m
    corners = np.array([[x, y] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    for center, size, yaw in zip(layout.centers, layout.sizes, layout.yaws, strict=True):
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        plan = (corners * size[:2]) @ turn.T + center[:2]
        assert (np.abs(plan) < reach - 1.0).all()
        assert center[2] + 0.5 * size[2] < height
    assert height >= max(2.6, layout.large.size[2])
    assert shell.floor_area_m2 == pytest.approx(room.floor_area_m2) == pytest.approx(float(np.prod(2 * reach)))
    assert len(shell.walls) == 4


@pytest.mark.parametrize("what", ["centers", "sizes", "yaws"])
def test_layouts_that_are_nowhere_are_refused(what: str) -> None:
    layout = layout_of("desk", "office", 0)
    values = getattr(layout, what).copy()
    values.flat[0] = np.nan
    with pytest.raises(InputError):
        usable(dataclasses.replace(layout, **{what: values}))
    values.flat[0] = 1e6
    if what == "centers":
        with pytest.raises(InputError):
            usable(dataclasses.replace(layout, **{what: values}))


@pytest.mark.whole
def test_a_simulator_tells_what_would_stay_from_what_would_not() -> None:
    large = Large("desk", (0.8, 1.5, 0.75), "office")
    size = (0.1, 0.1, 0.1)
    centers = np.array([[0.0, -0.4, 0.8], [0.0, 0.0, 1.0], [0.0, 0.5, 0.8], [0.03, 0.53, 0.82], [0.6, 0.0, 0.8]])
    layout = Layout(large, ("box",) * 5, centers, np.array([size] * 5), np.zeros(5))
    rows = rows_of(drawn_of(layout))
    said = [(row.is_stable, row.is_colliding, row.is_off_support) for row in rows["synthesis_objects"]]
    assert said[0] == (True, False, False), "it stands on the desk"
    assert said[1] == (False, False, True), "it floats"
    assert [one[1] for one in said[2:4]] == [True, True], "they are in each other"
    assert said[4] == (False, False, True), "it is beyond the edge"
    (synthesis,) = rows["syntheses"]
    assert (synthesis.object_count, synthesis.colliding_count) == (5, 2)
    assert synthesis.off_support_count == sum(one[2] for one in said)
    assert synthesis.stable_share == pytest.approx(sum(one[0] is True for one in said) / 5)
