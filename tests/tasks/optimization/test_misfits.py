"""Assets that fill each other's place give way before anything is moved; what people chose stays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from schemas.annotation import Annotation
from tasks.geometry.transforms import translation
from tasks.optimization import Default, Released
from tests.samples import sample
from tests.tasks.optimization.scenes import SCENE, SHELF, Scene, are_apart, block, collider_bounds, poses_of, remains


def corner_sofa() -> tuple[Scene, str, str, str]:
    """A sofa around a corner, first taken for a solid block that fills its bend, and the table in that; the L that it is comes second."""
    scene = Scene()
    sofa = scene.add(block(1.8, 1.8, 0.7), translation([-0.4, 0.0, 0.0]), "sofa")
    table = scene.add(block(0.5, 0.5, 0.4), translation([0.1, -0.4, 0.0]), "coffee table")
    (seat,), (back,) = block(1.8, 0.7, 0.7), block(0.7, 1.1, 0.7)
    seat.apply_translation([0.0, 0.55, 0.0])
    back.apply_translation([-0.55, -0.35, 0.0])
    bent = scene.asset([seat, back], known=[seat, back])
    first = scene.selections[0]
    scene.selections[0] = dataclasses.replace(first, foreign_share=0.3)
    scene.selections[1] = dataclasses.replace(scene.selections[1], foreign_share=0.1)
    scene.selections.append(dataclasses.replace(first, rank=2, slot=2, asset_id=bent, foreign_share=0.0))
    return scene, sofa, table, bent


def test_a_solid_that_fills_a_bend_gives_way_to_the_shape_that_leaves_it_free() -> None:
    scene, sofa, table, bent = corner_sofa()
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    assert rows[sofa].asset_id == bent
    assert rows[table].displacement_m < 0.01
    assert set(remains(outcome).values()) == {None}
    assert any(sofa in text and "another asset" in text for text in outcome.degradations)


def test_the_method_of_the_paper_moves_what_it_was_given() -> None:
    scene, sofa, _, bent = corner_sofa()
    rows = {row.instance_id: row for row in scene.run(Released()).rows["placements"]}
    assert rows[sofa].asset_id != bent


def test_what_people_chose_stays_and_the_other_gives_way() -> None:
    scene, sofa, table, _ = corner_sofa()
    instance = scene.instances[0]
    scene.annotations.append(
        sample(
            Annotation, scene_id=SCENE, instance_id=sofa, batch_id="b", annotator="a", choice=scene.selections[0].asset_id, pose=None,
            scale=None, box_pose=instance.box_pose, box_size=instance.box_size,
        )
    )  # fmt: skip
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    assert (rows[sofa].asset_id, rows[sofa].scale) == (scene.selections[0].asset_id, (1.0, 1.0, 1.0))
    assert rows[table].scale == (1.0, 1.0, 1.0)
    assert rows[table].displacement_m < 0.01
    assert outcome.rows["optimizations"][0].deep_pairs == 0


@pytest.mark.parametrize("overlap", [0.01, 0.05, 0.3])
def test_what_has_no_other_shape_stays_as_large_as_it_is_where_it_is(overlap: float) -> None:
    scene = Scene()
    large = scene.add(block(1.5, 1.5, 0.8), np.eye(4), "cabinet")
    small = scene.add(block(0.8, 0.8, 0.6), translation([1.15 - overlap, 0.0, 0.0]), "box")
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    assert all(row.scale == (1.0, 1.0, 1.0) for row in rows.values())
    assert all(row.displacement_m <= 0.015 for row in rows.values())
    assert (rows[large].collider_blob is not None) == (overlap > 0.02), "the larger one ends at the seam"
    assert rows[small].collider_blob is None
    assert are_apart(outcome, scene, large, small)
    assert outcome.rows["optimizations"][0].deep_pairs == 0


@pytest.mark.parametrize("gap", [0.59, 0.55])
def test_what_is_between_fitted_cabinets_keeps_its_size(gap: float) -> None:
    scene = Scene()
    left, right = (
        scene.add(block(0.6, 1.2, 0.9), translation([1.7, side * (0.5 * gap + 0.6), 0.0]), "kitchen counter") for side in (-1.0, 1.0)
    )
    oven = scene.add(block(0.6, 0.6, 0.9), translation([1.7, 0.0, 0.0]), "oven")
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    fixed = {row.instance_id for row in outcome.rows["supports"] if row.is_fixed}
    assert {left, right} <= fixed
    assert {rows[name].scale for name in (left, right, oven)} == {(1.0, 1.0, 1.0)}
    assert all(row.displacement_m <= 0.1 for row in rows.values())
    assert outcome.rows["optimizations"][0].deep_pairs == 0


def test_what_nothing_else_helps_goes_farther_and_is_named() -> None:
    """Two wardrobes in one place, as people chose them: of neither would enough be left beside the other."""
    scene = Scene()
    names = [scene.add(block(1.0, 1.0, 0.8), translation([x, 0.0, 0.0]), "cabinet") for x in (-0.001, 0.001)]
    for name, instance, selection in zip(names, scene.instances, list(scene.selections), strict=True):
        scene.annotations.append(
            sample(
                Annotation, scene_id=SCENE, instance_id=name, batch_id="b", annotator="a", choice=selection.asset_id, pose=None,
                scale=None, box_pose=instance.box_pose, box_size=instance.box_size,
            )
        )  # fmt: skip
    outcome = scene.run()
    ways = {n: np.hypot(*(poses_of(outcome)[n] - poses_of(outcome, "proposed")[n])[:2, 3]) for n in names}
    assert outcome.rows["optimizations"][0].deep_pairs == 0
    far = [name for name in names if ways[name] > 0.15]
    assert far
    for name in far:
        assert f"moved by {ways[name]:.2f} m" in (remains(outcome)[name] or "")


def test_nothing_goes_farther_than_it_may_while_something_else_helps() -> None:
    """Two cabinets nearly in one place: neither is sent across the room."""
    scene = Scene()
    names = [scene.add(block(0.9, 0.9, 0.8), translation([x, 0.0, 0.0]), "cabinet") for x in (0.0, 0.35)]
    outcome = scene.run(Default())
    ways = [np.hypot(*(poses_of(outcome)[n] - poses_of(outcome, "proposed")[n])[:2, 3]) for n in names]
    assert max(ways) <= 0.15 + 1e-6
    (summary,) = outcome.rows["optimizations"]
    assert summary.deep_pairs == 0


def test_what_is_stuck_between_boards_is_taken_for_the_shape_that_leaves_them_their_place() -> None:
    """Books of two compartments, annotated as one: the pile through the board between them is none of them."""
    scene = Scene()
    boards = [part for _ in range(5) for part in block(0.8, 0.3, 0.02)]
    sides = [part for _ in range(2) for part in block(0.02, 0.3, 1.62)]
    for number, part in enumerate(boards):
        part.apply_translation([0.0, 0.0, 0.4 * number])
    for x, part in zip((-0.41, 0.41), sides, strict=True):
        part.apply_translation([x, 0.0, 0.0])
    shelf = scene.add([*boards, *sides], np.eye(4), "bookshelf", known=[*boards, *sides])
    books = [part for _ in range(14) for part in block(0.5, 0.2, 0.05)]
    for number, part in enumerate(books):
        part.apply_translation([0.0, 0.0, 0.05 * number])
    stack = scene.add(books, translation([0.0, 0.0, 0.425]), "book stack", known=books)
    (lower,), (upper,) = block(0.5, 0.2, 0.35), block(0.5, 0.2, 0.28)
    upper.apply_translation([0.0, 0.0, 0.41])
    first = dataclasses.replace(scene.selections[1], foreign_share=0.1)
    apart = scene.asset([lower, upper], known=[lower, upper])
    scene.selections[1:] = [first, dataclasses.replace(first, rank=2, slot=2, asset_id=apart, foreign_share=0.0)]
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    assert rows[stack].asset_id == apart
    assert rows[stack].displacement_m < 0.02
    assert abs(rows[stack].lift_m) < 0.02
    assert rows[shelf].displacement_m < 0.02
    (summary,) = outcome.rows["optimizations"]
    assert summary.deep_pairs == 0


@pytest.mark.parametrize("overlap", [0.05, 0.2])
def test_a_shelf_keeps_its_boards_while_things_stand_on_them(overlap: float) -> None:
    """A box reaches through the board above it. The shape of the shelf that leaves it its place has no boards."""
    scene = Scene()
    shelf = scene.add(SHELF, np.eye(4), "bookshelf", known=SHELF)
    stacks = [scene.add(block(0.2, 0.3, 0.2), translation([0.0, -0.2, z]), "book stack") for z in (0.52, 1.02)]
    box = scene.add(block(0.2, 0.2, 0.46 + overlap), translation([0.0, 0.25, 0.52]), "box")
    whole, fits = scene.asset(block(0.3, 0.8, 0.04)), scene.asset(block(0.2, 0.2, 0.4))
    first = {row.instance_id: row for row in scene.selections}
    scene.selections = [
        dataclasses.replace(first[shelf], foreign_share=0.2),
        dataclasses.replace(first[shelf], foreign_share=0.0, rank=2, slot=2, asset_id=whole),
        dataclasses.replace(first[box], foreign_share=0.1),
        dataclasses.replace(first[box], foreign_share=0.0, rank=2, slot=2, asset_id=fits),
        *(dataclasses.replace(first[stack], foreign_share=0.0) for stack in stacks),
    ]
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    assert (rows[shelf].asset_id, rows[box].asset_id) == (first[shelf].asset_id, fits)
    assert {row.parent_id for row in outcome.rows["supports"] if row.instance_id in {box, *stacks}} == {shelf}
    assert max(abs(row.lift_m) + row.displacement_m for row in rows.values()) < 0.02
    assert set(remains(outcome).values()) == {None}
    assert outcome.rows["optimizations"][0].deep_pairs == 0


def test_the_next_candidate_is_tried_where_the_first_would_drop_what_stands_on_it() -> None:
    """The second shelf leaves the box its place and has no boards; the third leaves it its place and has them."""
    scene = Scene()
    shelf = scene.add(SHELF, np.eye(4), "bookshelf", known=SHELF)
    stacks = [scene.add(block(0.2, 0.3, 0.2), translation([0.0, -0.2, z]), "book stack") for z in (0.52, 1.02)]
    box = scene.add(block(0.2, 0.2, 0.66), translation([0.0, 0.25, 0.52]), "box")
    lacking = [part for part in SHELF if not (part.bounds[0][2] > 0.9 and part.bounds[1][2] < 1.1)]
    first = {row.instance_id: row for row in scene.selections}
    boardless = scene.asset(block(0.3, 0.8, 0.04))
    (board,) = block(0.3, 0.4, 0.02)
    board.apply_translation([0.0, -0.2, 1.0])
    fits = scene.asset([*lacking, board], known=[*lacking, board])
    scene.selections = [
        dataclasses.replace(first[shelf], foreign_share=0.2),
        dataclasses.replace(first[shelf], foreign_share=0.0, rank=2, slot=2, asset_id=boardless),
        dataclasses.replace(first[shelf], foreign_share=0.0, rank=3, slot=3, asset_id=fits),
        dataclasses.replace(first[box], foreign_share=0.0),
        *(dataclasses.replace(first[stack], foreign_share=0.0) for stack in stacks),
    ]
    rows = {row.instance_id: row for row in scene.run().rows["placements"]}
    assert rows[shelf].asset_id == fits
    assert max(abs(rows[stack].lift_m) for stack in stacks) < 0.03


def test_what_is_too_wide_for_its_niche_ends_at_its_walls() -> None:
    """A refrigerator that is 6 cm too wide for its niche."""
    scene = Scene()
    scene.shells = [
        dataclasses.replace(scene.shells[0], interior_walls=((-0.35, 1.0, -0.35, 2.0, 0.1, 2.5), (0.35, 1.0, 0.35, 2.0, 0.1, 2.5)))
    ]  # fmt: skip
    scene.add(block(0.66, 0.6, 1.7), translation([0.0, 1.65, 0.0]), "refrigerator")
    outcome = scene.run()
    (row,) = outcome.rows["placements"]
    (summary,) = outcome.rows["optimizations"]
    assert summary.deep_pairs == 0
    assert row.displacement_m < 0.05
    assert row.scale == (1.0, 1.0, 1.0)
    (ends,) = collider_bounds(outcome, scene).values()
    assert ends[:, 0] == pytest.approx([-0.3, 0.3], abs=0.003)
    assert row.collider_cut_share == pytest.approx(0.06 / 0.66, abs=0.01)
