"""Colliders reach down to what carries an object of which the scan has the upper part alone; the object stays where it was scanned."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.geometry.pieces import read_pieces
from tasks.geometry.transforms import translation, yaw_pose
from tasks.optimization.colliders.undersides import base_ring, holds
from tests.tasks.optimization.scenes import SHELF, TABLE, Scene, block, collider_bounds, poses_of, remains, solid


def test_what_was_seen_above_its_floor_stays_there_and_its_collider_reaches_down() -> None:
    """The rim of a trash can, whose lower part stood behind a desk."""
    scene = Scene()
    can = scene.add(block(0.25, 0.25, 0.06), translation([0.0, 0.0, 0.37]), "trash can")
    outcome = scene.run()
    support = next(row for row in outcome.rows["supports"] if row.instance_id == can)
    assert (support.relation, support.is_fixed, support.is_inferred) == ("floor", False, True)
    assert poses_of(outcome)[can][:3, 3] == pytest.approx([0.0, 0.0, 0.37], abs=0.002)
    assert collider_bounds(outcome, scene)[can][0, 2] == pytest.approx(0.0, abs=1e-4)
    assert remains(outcome)[can] is None
    assert any(can in line and "0.37 m down to the floor" in line for line in outcome.degradations)


def test_what_hangs_over_a_table_stands_on_that_and_not_on_the_floor() -> None:
    scene = Scene()
    table = scene.add(TABLE, np.eye(4), "table")
    box = scene.add(block(0.2, 0.2, 0.1), translation([0.1, 0.0, 1.2]), "box")
    outcome = scene.run()
    support = next(row for row in outcome.rows["supports"] if row.instance_id == box)
    assert (support.relation, support.parent_id, support.is_fixed) == ("on", table, False)
    assert poses_of(outcome)[box][2, 3] == pytest.approx(1.2, abs=0.002)
    assert remains(outcome)[box] is None


def test_no_base_reaches_into_what_lies_below() -> None:
    """What would have to stand on a wedge between two others hangs on, and is named."""
    scene = Scene()
    for x in (-0.09, 0.09):
        scene.add(block(0.175, 0.6, 0.3), translation([x, 0.0, 0.0]), "box")
    toy = scene.add(block(0.06, 0.06, 0.04), translation([0.0, 0.0, 1.6]), "toy")
    outcome = scene.run()
    assert remains(outcome)[toy] is not None


def add_picture(scene: Scene, lean: float, bottom: float) -> str:
    """Add a picture whose top is at the wall x = -2 and return its instance.

    Args:
        scene: the scene under construction.
        lean: angle between the picture and the vertical, positive towards the wall [rad].
        bottom: height of its lowest part [m].
    """
    parts = solid(((0.03, 0.6, 0.7), (0, 0, 0)))
    tilt = np.eye(4)
    tilt[:3, :3] = [[np.cos(lean), 0, -np.sin(lean)], [0, 1, 0], [np.sin(lean), 0, np.cos(lean)]]
    parts[0].apply_transform(tilt)
    low, high = parts[0].bounds
    parts[0].apply_translation([-0.5 * (low[0] + high[0]), 0.0, -low[2]])
    return scene.add(parts, translation([-2.0 + 0.5 * (high[0] - low[0]) + 0.002, 0.0, bottom]), "picture")


@pytest.mark.parametrize(("lean", "is_free"), [(0.15, True), (0.0, False), (-0.15, False)])
def test_what_leans_at_a_wall_stands_and_what_is_upright_hangs(lean: float, is_free: bool) -> None:
    """A picture of which the lowest 15 cm were not seen, its top at a wall."""
    scene = Scene()
    picture = add_picture(scene, lean, 0.15)
    outcome = scene.run()
    support = next(row for row in outcome.rows["supports"] if row.instance_id == picture)
    assert (support.relation, support.is_fixed) == (("floor", False) if is_free else ("wall", True))
    assert remains(outcome)[picture] is None
    if is_free:
        assert collider_bounds(outcome, scene)[picture][0, 2] == pytest.approx(0.0, abs=1e-3)
        assert poses_of(outcome)[picture][:3, 3] == pytest.approx(poses_of(outcome, "proposed")[picture][:3, 3], abs=0.02)


def test_a_picture_whose_foot_would_be_in_a_box_gets_no_stub() -> None:
    """Its base would end in the box before it, above the floor."""
    scene = Scene()
    picture = add_picture(scene, 0.35, 0.45)
    scene.add(block(0.3, 0.8, 0.44), translation([-1.5, 0.0, 0.0]), "box")
    outcome = scene.run()
    support = next(row for row in outcome.rows["supports"] if row.instance_id == picture)
    assert not support.is_inferred
    assert poses_of(outcome)[picture] == pytest.approx(poses_of(outcome, "proposed")[picture], abs=0.01)
    assert remains(outcome)[picture] is None


@pytest.mark.parametrize("category", ["tv", "camera"])
def test_what_stands_within_furniture_at_a_wall_does_not_hang_on_that_wall(category: str) -> None:
    scene = Scene()
    parts = [part for part in SHELF if not 0.4 < part.bounds[0][2] < 1.2]
    shelf = scene.add(parts, translation([-1.85, 0.0, 0.0]), "bookshelf", known=parts)
    thing = scene.add(block(0.2, 0.4, 0.3), translation([-1.88, 0.0, 0.8]), category)
    outcome = scene.run()
    support = next(row for row in outcome.rows["supports"] if row.instance_id == thing)
    assert (support.relation, support.parent_id, support.is_fixed, support.is_inferred) == ("inside", shelf, False, True)
    assert remains(outcome)[thing] is None


def test_a_plate_reaches_below_the_center_of_mass() -> None:
    """Half a bowl, whose rim leans out over what was seen of its foot."""
    scene = Scene()
    parts = solid(((0.06, 0.06, 0.03), (-0.06, 0, 0)), ((0.2, 0.2, 0.05), (0.05, 0, 0.03)))
    bowl = scene.add(parts, yaw_pose(0.3, [0.0, 0.0, 0.0]), "bowl", known=parts)
    outcome = scene.run()
    assert remains(outcome)[bowl] is None
    assert poses_of(outcome)[bowl] == pytest.approx(poses_of(outcome, "proposed")[bowl], abs=0.01)


def test_the_base_of_what_was_scanned_at_rest_is_below_its_center_of_mass() -> None:
    foot = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    ring = base_ring(foot, np.array([0.3, 0.05]))
    assert ring is not None
    assert holds(ring, np.array([0.3, 0.05]))
    inner = base_ring(foot, np.array([0.05, 0.05]))
    assert inner is not None
    assert sorted(map(tuple, inner.tolist())) == sorted(map(tuple, foot.tolist()))
    assert base_ring(np.zeros((0, 2)), np.zeros(2)) is None


@pytest.mark.parametrize("category", ["vase", "thing"])
def test_what_stood_on_a_shelf_that_no_scan_shows_stands_on_a_bracket_at_its_wall(category: str) -> None:
    scene = Scene()
    vase = scene.add(block(0.12, 0.2, 0.3), translation([-1.8, 0.3, 1.4]), category)
    outcome = scene.run()
    support = next(row for row in outcome.rows["supports"] if row.instance_id == vase)
    assert (support.relation, support.is_fixed, support.is_inferred) == ("none", False, True)
    assert support.against is not None
    assert support.bracket_blob is not None
    assert support.gap_m == 0.0
    (board,) = read_pieces(outcome.blobs[support.bracket_blob], "bracket")
    assert board.vertices[:, 2].max() == pytest.approx(1.4, abs=1e-4)
    assert np.ptp(board.vertices[:, 2]) == pytest.approx(0.02, abs=1e-4)
    assert board.vertices[:, 0].min() == pytest.approx(-2.0, abs=0.002), "it begins at the wall"
    assert remains(outcome)[vase] is None
    assert poses_of(outcome)[vase] == pytest.approx(poses_of(outcome, "proposed")[vase], abs=1e-6)
    assert all(row.is_stable_nudged and not row.is_fixed for row in outcome.rows["certificates"])


def test_what_hangs_in_the_middle_of_a_room_gets_no_bracket() -> None:
    scene = Scene()
    vase = scene.add(block(0.12, 0.2, 0.3), translation([0.0, 0.3, 1.6]), "vase")
    outcome = scene.run()
    support = next(row for row in outcome.rows["supports"] if row.instance_id == vase)
    assert (support.is_inferred, support.bracket_blob) == (False, None)
    assert remains(outcome)[vase] is not None


@pytest.mark.parametrize(("height", "is_free"), [(1.41, True), (1.6, False)])
def test_what_touches_a_wall_beside_a_bracket_at_its_level_stands_as_well(height: float, is_free: bool) -> None:
    """A spice rack hangs as often as it stands; beside a vase that stood on a shelf, at its level, it stood there too."""
    scene = Scene()
    scene.add(block(0.12, 0.2, 0.3), translation([-1.8, 0.3, 1.4]), "vase")
    rack = scene.add(block(0.12, 0.3, 0.2), translation([-1.935, 0.75, height]), "spice rack")
    outcome = scene.run()
    support = next(row for row in outcome.rows["supports"] if row.instance_id == rack)
    assert (support.is_fixed, support.bracket_blob is not None) == (not is_free, is_free)
    assert set(remains(outcome).values()) == {None}


def test_what_touches_a_partition_has_no_part_in_a_shelf_of_the_next_room() -> None:
    """The partition is 15 cm thick and ends 1.5 m before the opposite wall."""
    scene = Scene(((-2.0, -2.0), (0.0, -2.0), (0.0, 0.5), (0.15, 0.5), (0.15, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)))
    vase = scene.add(block(0.12, 0.2, 0.3), translation([-0.2, -1.0, 1.4]), "vase")
    rack = scene.add(block(0.12, 0.3, 0.2), translation([0.215, -0.9, 1.41]), "spice rack")
    outcome = scene.run()
    supports = {row.instance_id: row for row in outcome.rows["supports"]}
    assert supports[vase].bracket_blob is not None
    assert (supports[rack].relation, supports[rack].is_fixed, supports[rack].bracket_blob) == ("wall", True, None)


@pytest.mark.parametrize(("height", "seen", "is_free"), [(0.85, 0.13, True), (0.5, 0.48, False), (1.6, 0.13, False)])
def test_the_top_of_a_cabinet_stands_and_a_whole_one_on_a_wall_hangs(height: float, seen: float, is_free: bool) -> None:
    scene = Scene()
    cabinet = scene.add(block(0.4, 0.8, seen), translation([-1.795, 0.0, height]), "cabinet")
    outcome = scene.run()
    support = next(row for row in outcome.rows["supports"] if row.instance_id == cabinet)
    assert (support.relation, support.is_fixed) == (("floor", False) if is_free else ("wall", True))
    assert poses_of(outcome)[cabinet][:3, 3] == pytest.approx(poses_of(outcome, "proposed")[cabinet][:3, 3], abs=0.006)
    assert remains(outcome)[cabinet] is None
