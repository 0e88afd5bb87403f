"""Colliders end at seams, so that what was scanned in one another stays where it was scanned, as large as it was."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tasks.geometry.meshes import dump_points
from tasks.geometry.transforms import translation, yaw_pose
from tests.tasks.optimization.scenes import (
    SHELF,
    SOFA,
    TABLE,
    Scene,
    are_apart,
    block,
    collider_bounds,
    poses_of,
    remains,
    solid,
)


def scanned(scene: Scene, name: str, points: np.ndarray) -> None:
    """Give an object scanned points in the world frame, shape (n, 3) [m]."""
    at = int(name)
    blob = scene.blobs.add(dump_points(points, np.full((len(points), 3), 128, dtype=np.uint8)), "ply")
    scene.instances[at] = dataclasses.replace(scene.instances[at], points_blob=blob)


def in_box(low: tuple[float, ...], high: tuple[float, ...], count: int = 300) -> np.ndarray:
    return np.random.default_rng(1).uniform(low, high, (count, 3))


@pytest.mark.parametrize("whose", ["cabinet", "box"])
def test_space_that_two_share_belongs_to_the_one_whose_points_lie_there(whose: str) -> None:
    scene = Scene()
    cabinet = scene.add(block(1.0, 1.0, 0.8), np.eye(4), "cabinet")
    box = scene.add(block(0.8, 0.8, 0.8), translation([0.8, 0.0, 0.0]), "box")  # 10 cm in the cabinet
    scanned(scene, cabinet if whose == "cabinet" else box, in_box((0.42, -0.3, 0.1), (0.48, 0.3, 0.7)))
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    cut, kept = (box, cabinet) if whose == "cabinet" else (cabinet, box)
    assert rows[kept].collider_blob is None
    assert rows[kept].collider_cut_share == 0.0
    assert rows[cut].collider_cut_share > 0.05
    assert are_apart(outcome, scene, cabinet, box)
    for name in (cabinet, box):
        assert poses_of(outcome)[name] == pytest.approx(poses_of(outcome, "proposed")[name], abs=0.003)
        assert remains(outcome)[name] is None


def test_a_table_in_the_bend_of_a_sofa_that_fills_it_stays_there() -> None:
    scene = Scene()
    sofa = scene.add(block(2.4, 2.4, 0.4), translation([-0.4, 0.0, 0.0]), "sofa")
    table = scene.add(block(0.6, 0.6, 0.35), translation([0.4, 0.0, 0.0]), "coffee table")
    scanned(scene, table, in_box((0.12, -0.28, 0.0), (0.68, 0.28, 0.35)))
    outcome = scene.run()
    assert {row.displacement_m < 0.005 and abs(row.lift_m) < 0.005 for row in outcome.rows["placements"]} == {True}
    assert are_apart(outcome, scene, sofa, table)
    assert set(remains(outcome).values()) == {None}
    assert all(row.is_stable_1cm for row in outcome.rows["certificates"])


def test_what_sank_into_its_carrier_ends_at_its_top_and_what_it_carries_comes_along() -> None:
    scene = Scene()
    chest = scene.add(block(0.8, 0.8, 0.6), translation([0.0, 0.0, -0.08]), "chest")
    mug = scene.add(block(0.1, 0.1, 0.1), translation([0.0, 0.0, 0.52]), "mug")
    outcome = scene.run()
    assert collider_bounds(outcome, scene)[chest][0, 2] == pytest.approx(0.0, abs=1e-4)
    assert poses_of(outcome)[chest][2, 3] == pytest.approx(-0.08, abs=1e-3)
    assert poses_of(outcome)[mug][2, 3] == pytest.approx(0.52, abs=1e-3)
    assert set(remains(outcome).values()) == {None}


def test_what_stands_on_a_board_that_the_scan_lost_stays_there() -> None:
    """A shelf of which the scan has the sides and the top, and a box in it."""
    scene = Scene()
    parts = [part for part in SHELF if not 0.4 < part.bounds[0][2] < 1.2]
    shelf = scene.add(parts, np.eye(4), "bookshelf", known=parts)
    box = scene.add(block(0.2, 0.3, 0.2), translation([0.0, 0.0, 0.9]), "box")
    outcome = scene.run()
    supports = {row.instance_id: row for row in outcome.rows["supports"]}
    assert (supports[box].relation, supports[box].parent_id, supports[box].is_inferred) == ("inside", shelf, True)
    assert poses_of(outcome)[box][:3, 3] == pytest.approx([0.0, 0.0, 0.9], abs=0.005)
    assert all(row.is_stable_1cm for row in outcome.rows["certificates"])


def test_what_would_roll_off_a_ridge_gets_a_plate() -> None:
    """A toy that touches a table with an edge alone."""
    scene = Scene()
    table = scene.add(TABLE, np.eye(4), "table")
    wedge = solid(((0.2, 0.1, 0.1), (0, 0, 0)))
    wedge[0].vertices[wedge[0].vertices[:, 2] < 0.01, 1] *= 0.01
    toy = scene.add(wedge, translation([0.2, 0.1, 0.75]), "decoration")
    outcome = scene.run()
    assert remains(outcome)[toy] is None
    assert poses_of(outcome)[toy] == pytest.approx(poses_of(outcome, "proposed")[toy], abs=0.01)
    support = next(row for row in outcome.rows["supports"] if row.instance_id == toy)
    assert (support.parent_id, support.is_inferred) == (table, True)


def test_losses_of_fidelity_are_told() -> None:
    """Two equal wardrobes in one place, one of which has to go."""
    scene = Scene()
    names = [scene.add(block(1.0, 1.0, 0.8), translation([x, 0.0, 0.0]), "cabinet") for x in (-0.001, 0.001)]
    scene.selections[1] = dataclasses.replace(scene.selections[1], asset_id=scene.selections[0].asset_id)
    for name in names:
        scanned(scene, name, in_box((-0.5, -0.5, 0.0), (0.5, 0.5, 0.8), 2000))
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    (far,) = (name for name in names if rows[name].displacement_m > 0.15)
    assert rows[far].fidelity_loss > 0.1
    assert rows[next(name for name in names if name != far)].fidelity_loss < rows[far].fidelity_loss
    assert any(text.startswith(f"{far}: it covers its scan less well") for text in outcome.degradations)


def test_the_same_scene_in_another_order_ends_at_the_same_seams() -> None:
    def scene() -> Scene:
        made = Scene()
        made.add(SOFA, yaw_pose(0.1, [-1.2, 0.0, 0.0]), "sofa")
        made.add(block(0.5, 1.6, 0.4), translation([-0.8, 0.1, 0.0]), "ottoman")
        made.add(block(0.9, 0.9, 0.5), translation([-0.2, 0.9, 0.0]), "chest")
        return made

    first, second = scene().run(), scene().reversed().run()
    assert first.rows == second.rows
    assert dict(first.blobs) == dict(second.blobs)
    assert any(row.collider_blob is not None for row in first.rows["placements"])


def test_what_stands_on_another_over_an_unseen_top_ends() -> None:
    """A pot on a plate that nothing carries, a little sunk into it: neither is the board of the other."""
    scene = Scene()
    plate = scene.add(block(0.3, 0.3, 0.03), translation([0.0, 0.0, 0.75]), "thing")
    pot = scene.add(block(0.26, 0.26, 0.25), translation([0.0, 0.0, 0.765]), "thing")
    supports = {row.instance_id: row for row in scene.run().rows["supports"]}
    assert supports[pot].parent_id == plate
    assert supports[plate].parent_id is None


def test_points_that_cannot_be_read_are_told_and_cost_nothing_else() -> None:
    scene = Scene()
    names = [scene.add(block(0.8, 0.8, 0.8), translation([x, 0.0, 0.0]), "cabinet") for x in (-0.3, 0.4)]
    scene.instances[0] = dataclasses.replace(scene.instances[0], points_blob=scene.blobs.add(b"no cloud", "ply"))
    outcome = scene.run()
    assert len(outcome.rows["placements"]) == 2
    assert are_apart(outcome, scene, *names)
    assert any(text.startswith(f"{names[0]}: its neighbors keep the space") for text in outcome.degradations)
