"""Assets that cannot stand give way to candidates that can; worktops lie on all the cabinets below them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.annotation import Annotation
from tasks.geometry.transforms import flat, translation
from tasks.optimization import Released
from tasks.optimization.support.balance import draw_back
from tasks.optimization.support.resting import put_to_rest
from tests.samples import sample
from tests.tasks.optimization.interiors import Object, bodies_of, interior_of
from tests.tasks.optimization.interiors import block as solid
from tests.tasks.optimization.scenes import SCENE, Scene, block, remains


def chair_of(*feet: tuple[float, float]) -> list[trimesh.Trimesh]:
    """A seat with a back, and a leg at each place that is named."""
    parts = [*block(0.45, 0.45, 0.05), *block(0.05, 0.45, 0.45), *(leg for _ in feet for leg in block(0.04, 0.04, 0.42))]
    places = [(0.0, 0.0, 0.42), (-0.2, 0.0, 0.47), *((x, y, 0.0) for x, y in feet)]
    for part, place in zip(parts, places, strict=True):
        part.apply_translation(place)
    return parts


FEET = ((-0.2, -0.2), (-0.2, 0.2), (0.2, -0.2), (0.2, 0.2))


def fallen_chair(category: str = "chair", second: float = 0.95) -> tuple[Scene, str, str]:
    """A chair taken for a crop with two legs on one side; the whole one comes second, with a share of its score."""
    scene = Scene()
    crop, whole = chair_of(*FEET[2:]), chair_of(*FEET)
    name = scene.add(crop, translation([0.0, 0.0, 0.0]), category, known=crop)
    first = dataclasses.replace(scene.selections[0], score=0.8)
    better = scene.asset(whole, known=whole)
    scene.selections = [first, dataclasses.replace(first, rank=2, slot=2, asset_id=better, score=0.8 * second)]
    return scene, name, better


def test_a_crop_that_cannot_stand_gives_way_to_a_candidate_that_can() -> None:
    scene, name, better = fallen_chair()
    outcome = scene.run()
    (row,) = outcome.rows["placements"]
    assert row.asset_id == better
    assert all(row.is_stable_1cm and row.is_stable_nudged is not False for row in outcome.rows["certificates"])
    assert remains(outcome)[name] is None
    assert any(name in text and "stands by itself" in text for text in outcome.degradations)


def test_furniture_with_another_name_stands_as_well() -> None:
    scene, _, better = fallen_chair("tv console")
    assert scene.run().rows["placements"][0].asset_id == better


@pytest.mark.parametrize(("category", "second"), [("pillow", 0.95), ("chair", 0.5), ("picture", 0.95)])
def test_what_leans_or_hangs_or_has_no_like_candidate_stays(category: str, second: float) -> None:
    scene, _, better = fallen_chair(category, second)
    (row,) = scene.run().rows["placements"]
    assert row.asset_id != better


def test_what_people_chose_and_the_method_of_the_paper_stay() -> None:
    scene, name, better = fallen_chair()
    assert scene.run(Released()).rows["placements"][0].asset_id != better
    instance, first = scene.instances[0], scene.selections[0]
    scene.annotations.append(
        sample(
            Annotation, scene_id=SCENE, instance_id=name, batch_id="b", annotator="a", choice=first.asset_id, pose=None, scale=None,
            box_pose=instance.box_pose, box_size=instance.box_size,
        )
    )  # fmt: skip
    assert scene.run().rows["placements"][0].asset_id == first.asset_id


def cabinets(heights: tuple[float, ...]) -> list[Object]:
    """Cabinets in a row, 0.6 m wide each, one beside the other."""
    return [("kitchen cabinet", [solid((0.6, 0.6, h))], translation([0.6 * i, 0.0, 0.0])) for i, h in enumerate(heights)]


@given(st.lists(st.floats(0.82, 0.86), min_size=2, max_size=4), st.floats(-0.02, 0.03))
@settings(max_examples=25, deadline=None)
def test_a_worktop_comes_to_rest_on_the_highest_of_its_cabinets_and_is_not_drawn_to_any(heights: list[float], gap: float) -> None:
    length = 0.6 * len(heights)
    pose = translation([0.5 * length - 0.3, 0.0, max(heights) + gap])
    interior = interior_of([*cabinets(tuple(heights)), ("kitchen counter", [solid((length, 0.6, 0.04))], pose)])
    worktop = len(heights)
    assert interior.names[worktop] == f"{worktop:04d}"
    assert interior.parent[worktop] >= 0
    shapes, stand = bodies_of(interior)
    put_to_rest(interior, shapes, stand)
    assert stand.low[worktop, 2] == pytest.approx(max(heights), abs=1e-6)
    before = stand.place.copy()
    if heights.count(max(heights)) == len(heights):
        assert not draw_back(interior, shapes, stand)
        assert np.array_equal(stand.place, before)


@pytest.mark.parametrize("heights", [(0.86, 0.9, 0.86), (0.9, 0.86, 0.86), (0.84, 0.84, 0.84), (0.84, 0.82, 0.8)])
def test_a_worktop_at_its_wall_is_not_raised_by_what_is_built_in_below_it(heights: tuple[float, ...]) -> None:
    """A cabinet that was seen 4 cm too high is in the worktop; over lower ones the worktop comes down. What is on it stays on it."""
    scene = Scene()
    for i, height in enumerate(heights):
        scene.add(block(0.56, 0.58, height), translation([1.7, 0.6 * i - 0.6, 0.0]), "kitchen cabinet" if i % 2 else "dishwasher")
    scene.add(block(0.6, 1.8, 0.04), translation([1.7, 0.0, 0.86]), "kitchen counter")
    scene.add(block(0.2, 0.2, 0.2), translation([1.7, 0.0, 0.9]), "toaster")
    outcome = scene.run()
    placements = {row.instance_id: row for row in outcome.rows["placements"]}
    supports = {row.instance_id: row for row in outcome.rows["supports"]}
    assert [supports[f"{i:04d}"].is_fixed for i in range(5)] == [True, True, True, True, False]
    lowest = min(max(heights), 0.86)
    assert placements["0003"].optimized_pose[11] == pytest.approx(lowest, abs=1e-6)
    assert placements["0004"].optimized_pose[11] == pytest.approx(lowest + 0.04, abs=1e-5)
    assert all(row.displacement_m == pytest.approx(0.0, abs=1e-9) and tuple(row.scale) == (1.0, 1.0, 1.0) for row in placements.values())
    assert all(row.remains is None for row in placements.values())
    assert outcome.rows["optimizations"][0].deep_pairs == 0


def test_a_worktop_on_equal_cabinets_keeps_its_place() -> None:
    interior = interior_of(
        [*cabinets((0.86, 0.86, 0.86, 0.86)), ("kitchen counter", [solid((2.4, 0.6, 0.04))], translation([0.9, 0, 0.87]))]
    )
    shapes, stand = bodies_of(interior)
    put_to_rest(interior, shapes, stand)
    before = stand.place.copy()
    assert draw_back(interior, shapes, stand) == []
    assert np.array_equal(stand.place, before)
    assert stand.low[4, 2] == pytest.approx(0.86, abs=1e-6)


def test_what_stands_on_a_table_is_not_put_on_the_chair_beside_it() -> None:
    table = ("table", [solid((1.2, 0.8, 0.74))], np.eye(4))
    chair = ("chair", [solid((0.45, 0.45, 0.78))], translation([0.95, 0.0, 0.0]))
    vase = ("vase", [solid((0.1, 0.1, 0.3))], translation([0.58, 0.0, 0.75]))
    interior = interior_of([table, chair, vase])
    shapes, stand = bodies_of(interior)
    index = interior.names.index("0002")
    assert interior.parent[index] == interior.names.index("0000")
    put_to_rest(interior, shapes, stand)
    assert stand.low[index, 2] == pytest.approx(0.74, abs=1e-6)


def test_what_stands_on_furniture_in_its_own_way_keeps_its_asset() -> None:
    """A chair upside down on a table: on level ground it would fall over."""
    scene, name, better = fallen_chair()
    scene.selections = [dataclasses.replace(row, pose=flat(translation([0.0, 0.0, 0.75]))) for row in scene.selections]
    scene.add(block(1.2, 0.8, 0.75), translation([0.0, 0.0, 0.0]), "table")
    rows = {row.instance_id: row for row in scene.run().rows["placements"]}
    assert rows[name].asset_id != better


def test_what_cannot_stand_is_not_taken_again_for_its_neighbors_sake() -> None:
    scene, name, better = fallen_chair()
    first, second = scene.selections
    scene.selections = [dataclasses.replace(first, foreign_share=0.0), dataclasses.replace(second, foreign_share=0.3)]
    scene.add(block(0.7, 0.9, 0.38), translation([-0.25, 0.0, 0.0]), "box")
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    assert rows[name].asset_id == better
    notes = [text for text in outcome.degradations if text.startswith(f"{name}: another asset")]
    assert notes == [f"{name}: another asset, which stands by itself"]
