"""The stage: a row per filled slot, ranks, ties, and what cannot be used."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from tasks.geometry.transforms import matrix, yaw_pose
from tests.tasks.selection.rooms import GRAY, RED, WOOD, Room, cabinet, chair, scan, table


def test_every_filled_slot_has_one_row_and_equal_assets_rank_by_slot() -> None:
    rng = np.random.default_rng(0)
    room = Room()
    points, colors = scan(table(), yaw_pose(0.3), (1, 1, 1), rng)
    instance = room.instance(points, colors, 0.3)
    asset_id = room.asset(table(), "table")
    for slot, value in ((4, asset_id), (2, asset_id), (7, None), (9, room.asset(cabinet(), "cabinet"))):
        room.candidate(instance, slot, value)
    rows, _ = room.select()
    assert [(row.rank, row.slot) for row in rows] == [(1, 2), (2, 4), (3, 9)]
    assert rows[0].score == rows[1].score
    assert rows[0].pose == rows[1].pose


def test_a_crop_of_the_scan_wins_only_when_clearly_better() -> None:
    """The crop is the scanned surface itself, so it fits best; the clean model is preferred all the same, a wrong one is not."""
    rng = np.random.default_rng(1)
    pose = yaw_pose(0.4, [1.0, 1.0, 0.0])
    points, colors = scan(chair(), pose, (1, 1, 1), rng, view=0.4)
    crop = trimesh.util.concatenate([p.subdivide() for p in chair()[1:]])  # a leg was not seen, and noise is baked in
    crop.vertices += rng.normal(0, 0.006, crop.vertices.shape)
    crop.visual.vertex_colors = np.tile([*WOOD, 255], (len(crop.vertices), 1)).astype(np.uint8)
    for model, winner in ((chair, "chair"), (cabinet, "crop")):
        room = Room()
        instance = room.instance(points, colors, 0.4)
        ids = {model.__name__: room.asset(model(), model.__name__), "crop": room.asset([crop], "crop", "scan_crop_closed", watertight=True)}
        room.candidate(instance, 1, ids["crop"], "scan_crop_closed")
        room.candidate(instance, 2, ids[model.__name__])
        rows, _ = room.select()
        assert rows[0].asset_id == ids[winner], [(r.slot, r.score) for r in rows]


def test_color_decides_between_equal_shapes() -> None:
    rng = np.random.default_rng(2)
    room = Room()
    points, colors = scan(chair(RED), yaw_pose(1.0), (1, 1, 1), rng)
    instance = room.instance(points, colors, 1.0)
    ids = [room.asset(chair(c), "chair") for c in (GRAY, RED, WOOD)]
    for slot, asset_id in enumerate(ids, start=1):
        room.candidate(instance, slot, asset_id)
    rows, _ = room.select()
    assert rows[0].asset_id == ids[1]
    assert rows[0].color_similarity > rows[1].color_similarity + 0.2


@pytest.mark.parametrize(("bottom", "expected"), [(0.04, 0.0), (-0.045, 0.0), (0.3, 0.3), (-0.2, -0.2)])
def test_what_ends_near_the_floor_stands_on_it(bottom: float, expected: float) -> None:
    room = Room()
    points, colors = scan(cabinet(), yaw_pose(0, [0, 0, bottom]), (1, 1, 1), np.random.default_rng(0), noise=0)
    points = np.vstack([points, [[0, 0, bottom]]])
    instance = room.instance(points, np.vstack([colors, colors[:1]]), 0.0)
    room.candidate(instance, 1, room.asset(cabinet(), "cabinet"))
    rows, _ = room.select()
    assert matrix(rows[0].pose)[2, 3] == pytest.approx(expected, abs=1e-6)
    assert (matrix(rows[0].pose)[2, 3] == 0.0) == (expected == 0.0)
    top = matrix(rows[0].pose)[2, 3] + rows[0].scale[2] * 0.92
    assert top == pytest.approx(bottom + 0.92, abs=0.02)


@pytest.mark.whole
def test_the_same_rows_in_any_order_and_run_give_the_same_selections() -> None:
    rng = np.random.default_rng(3)
    room = Room()
    for index in range(3):
        points, colors = scan(chair(), yaw_pose(index, [index, 0, 0]), (1, 1, 1), rng)
        instance = room.instance(points, colors, float(index))
        for slot, parts in enumerate((table(), chair(), cabinet()), start=1):
            room.candidate(instance, slot, room.asset(parts, "x"))
    first, _ = room.select()
    room.instances.reverse()
    room.candidates.reverse()
    room.assets = dict(reversed(room.assets.items()))
    second, _ = room.select()
    assert first == second


def test_what_cannot_be_used_is_said_and_stops_nothing() -> None:
    rng = np.random.default_rng(4)
    room = Room()
    points, colors = scan(table(), yaw_pose(0), (1, 1, 1), rng)
    good, bare, wall = (room.instance(points, colors, 0.0, structure=s) for s in (False, False, True))
    broken = room.asset(cabinet(), "broken")
    room.assets[broken] = dataclasses.replace(room.assets[broken], mesh_blob=room.blobs.add(b"no mesh", "glb"))
    room.candidate(good, 1, broken)
    room.candidate(good, 2, room.asset(table(), "table"))
    room.candidate(bare, 1, None)
    rows, degradations = room.select()
    assert [(row.instance_id, row.slot, row.rank) for row in rows] == [(good.instance_id, 2, 1)]
    assert any(broken[:12] in text and "GLB" in text for text in degradations)
    assert any(text.startswith(bare.instance_id) for text in degradations)
    assert not any(text.startswith(wall.instance_id) for text in degradations)


def test_one_flat_or_single_point_instance_is_no_error() -> None:
    room = Room()
    for points in (np.zeros((1, 3)), np.column_stack([np.random.default_rng(0).random((50, 2)), np.zeros(50)])):
        instance = room.instance(points, np.zeros((len(points), 3), dtype=np.uint8), 0.0)
        room.candidate(instance, 1, room.asset(table(), "table"))
    rows, _ = room.select()
    assert len(rows) == 2
