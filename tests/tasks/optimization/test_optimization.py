"""Optimization: placements that rest, stay apart and follow from their steps, by both methods."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest

from schemas.optimization import APPLIED
from schemas.record import arrow_to_rows, rows_to_arrow
from tasks.furniture import generate
from tasks.geometry.transforms import matrix, translation, yaw_pose
from tasks.optimization import Default, Released, replayed_poses
from tasks.shell import room_shell
from tasks.stage import in_turn
from tests.tasks.optimization.scenes import (
    CHAIR,
    DEEP_M,
    METHODS,
    RECORDS,
    SHELF,
    TABLE,
    TOUCH_M,
    Scene,
    block,
    bounds,
    collider_bounds,
    crowded_scene,
    hulls_of,
    penetration_depth,
    poses_of,
    room_scene,
)

# at rest and apart


@pytest.mark.whole
@METHODS
def test_a_room_is_put_to_rest_and_apart(method: Released | Default) -> None:
    scene = room_scene()
    outcome = scene.run(method)
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    supports = {row.instance_id: row for row in outcome.rows["supports"]}
    table, mug, cabinet, shelf, book, picture, rug = sorted(rows)
    carried = {name: (row.relation, row.parent_id) for name, row in supports.items()}
    assert carried == {
        table: ("floor", None), mug: ("on", table), cabinet: ("floor", None), shelf: ("floor", None), book: ("inside", shelf),
        picture: ("wall", None), rug: ("floor", None),
    }  # fmt: skip
    assert {name for name, row in supports.items() if row.is_fixed} == {picture}
    assert all(row.is_kept for row in supports.values())
    boxes = bounds(outcome, scene)
    for name, height in ((mug, 0.75), (book, 0.52), (cabinet, 0.0), (table, 0.0), (shelf, 0.0), (rug, 0.0)):
        assert boxes[name][0, 2] == pytest.approx(height, abs=2e-4), name
    assert not [row for row in rows.values() if row.remains]
    (summary,) = outcome.rows["optimizations"]
    assert summary.ended in ("zero_loss", "nothing_to_do")
    assert (summary.loss_final, summary.deep_pairs, summary.remains) == (0.0, 0, ())
    assert all(row.is_stable_5cm and row.start_penetration_m < DEEP_M for row in outcome.rows["certificates"])
    assert max(row.displacement_m for row in rows.values()) < 0.4
    assert rows[rug].displacement_m == 0.0
    assert rows[picture].lift_m == 0.0
    if isinstance(method, Released):
        assert rows[picture].displacement_m == 0.0
        moves = {name: matrix(row.optimized_pose)[:2, 3] - matrix(row.proposed_pose)[:2, 3] for name, row in rows.items()}
        assert all(np.allclose(move, np.round(move / method.step_m) * method.step_m, atol=1e-9) for move in moves.values())
    else:
        assert boxes[picture][1, 0] == pytest.approx(2.0, abs=2e-3), "hung on its wall"


@pytest.mark.whole
@pytest.mark.parametrize("seed", range(2))
def test_the_default_moves_objects_less_than_the_paper(seed: int) -> None:
    scene = crowded_scene()
    away = []
    for method in (Released(), Default()):
        rows = scene.run(method, seed).rows
        # the last resort, which the paper's method has not, parts the two tables that it leaves in each other
        steps = [step for step in rows["optimization_steps"] if step.outcome != "relocated"]
        poses = replayed_poses(rows["placements"], rows["supports"], steps)
        away.append(np.mean([np.hypot(*(poses[row.instance_id] - matrix(row.proposed_pose))[:2, 3]) for row in rows["placements"]]))
    assert away[1] <= away[0] + 0.01
    assert rows["optimizations"][0].deep_pairs == 0


@METHODS
@pytest.mark.parametrize("height", [0.0, 0.02, 0.1])
def test_what_floats_comes_down_onto_what_carries_it(method: Released | Default, height: float) -> None:
    scene = Scene()
    scene.add(TABLE, yaw_pose(0.2, [0.0, 0.0, height]), "table")
    scene.add(block(0.1, 0.1, 0.1), translation([0.2, 0.0, 0.75 + height]), "mug")
    scene.add(block(0.3, 0.2, 0.04), translation([-0.3, 0.0, 0.75 + 2 * height]), "book")
    scene.add(CHAIR, yaw_pose(1.0, [-1.3, 1.0, height]), "chair")
    scene.add(block(0.4, 0.4, 0.4), translation([1.3, 1.0, -height]), "box")
    outcome = scene.run(method)
    boxes = bounds(outcome, scene)
    # what sank or floats so far stays where it was scanned: its collider ends at the floor, or reaches down to what carries it
    stays = isinstance(method, Default) and height > 0.05
    up = height if stays else 0.0
    for name, level in (("0000", up), ("0001", 0.75 + up), ("0002", 0.75 + 2 * up), ("0003", up), ("0004", -up)):
        assert boxes[name][0, 2] == pytest.approx(level, abs=2e-4), name
    for name, level in (("0000", 0.0), ("0001", 0.75 + up), ("0002", 0.75 + up), ("0003", 0.0), ("0004", 0.0)):
        assert collider_bounds(outcome, scene)[name][0, 2] == pytest.approx(level, abs=2e-4), name
    gaps = {row.instance_id: row.gap_m for row in outcome.rows["supports"]}
    assert [gaps[name] for name in sorted(gaps)] == pytest.approx([height, 0.0, height, height, -height], abs=1e-6)
    assert all(row.displacement_m == 0.0 for row in outcome.rows["placements"])
    assert all(row.is_stable_1cm for row in outcome.rows["certificates"])


def test_a_chair_under_a_table_stays_under_it() -> None:
    scene = Scene()
    scene.add(TABLE, np.eye(4), "table")
    scene.add(CHAIR, yaw_pose(np.pi / 2, [0.1, -0.25, 0.01]), "chair")
    scene.add(CHAIR, yaw_pose(-np.pi / 2, [-0.1, 0.21, 0.0]), "chair")  # its back is in the table's edge
    outcome = scene.run()
    boxes = bounds(outcome, scene)
    (summary,) = outcome.rows["optimizations"]
    assert summary.loss_final == 0.0
    for row in outcome.rows["placements"]:
        assert row.displacement_m < 0.02
        assert row.remains is None
    for name in ("0001", "0002"):
        under = np.minimum(boxes[name][1], boxes["0000"][1]) - np.maximum(boxes[name][0], boxes["0000"][0])
        assert under.min() > 0.1, "still within the table's box"
        assert {r.instance_id: r.relation for r in outcome.rows["supports"]}[name] == "floor"


def test_what_reaches_through_a_wall_ends_there_and_what_lies_outside_is_pulled_in_with_all_it_carries() -> None:
    scene = Scene()
    scene.add(block(1.2, 0.8, 0.7), yaw_pose(0.3, [1.7, 0.0, 0.0]), "chest")
    scene.add(block(0.5, 0.5, 0.9), translation([-0.5, -2.4, 0.0]), "cabinet")
    scene.add(block(0.1, 0.1, 0.1), translation([-0.5, -2.3, 0.9]), "mug")
    scene.add(block(0.4, 0.4, 0.4), translation([-1.0, 1.83, 0.0]), "box")
    outcome = scene.run()
    ends, before, after = collider_bounds(outcome, scene), poses_of(outcome, "proposed"), poses_of(outcome)
    for name, box in ends.items():
        assert (box[:, :2] > -2.0 - 1e-6).all(), name
        assert (box[:, :2] < 2.0 + 1e-6).all(), name
    ways = {name: after[name][:3, 3] - before[name][:3, 3] for name in after}
    first = bounds(outcome, scene, "proposed")
    assert np.hypot(*ways["0000"][:2]) < 0.02, "half of it is in the room: it stays, and ends at the wall"
    assert ways["0001"][:2] == pytest.approx([0.0, -2.0 - first["0001"][0, 1]], abs=1e-6), "most of it lay outside"
    assert ways["0002"][:2] == pytest.approx(ways["0001"][:2], abs=1e-9), "the mug came along"
    assert ways["0003"][:2] == pytest.approx([0.0, 2.0 - first["0003"][1, 1]], abs=1e-6), "nobody sees three centimeters"
    assert all(row.remains is None for row in outcome.rows["placements"])
    assert {s.instance_id for s in outcome.rows["optimization_steps"] if s.outcome == "pulled_in"} == {"0001", "0003"}


@pytest.mark.parametrize("off", [-0.05, 0.04], ids=["before", "in"])
def test_a_worktop_stays_at_its_wall_when_its_cabinet_is_hung(off: float) -> None:
    """Before the wall or into it: a hanging cabinet moves alone, under a fastened worktop with its sink."""
    scene = Scene()
    scene.add(block(0.55, 1.2, 0.56), translation([1.725 + off, 0.0, 0.3]), "kitchen cabinet")
    scene.add(block(0.6, 1.3, 0.04), translation([1.7, 0.0, 0.86]), "kitchen counter")
    scene.add(block(0.3, 0.4, 0.15), translation([1.7, 0.0, 0.9]), "sink")
    outcome = scene.run()
    before, after = poses_of(outcome, "proposed"), poses_of(outcome)
    ways = {name: after[name][:3, 3] - before[name][:3, 3] for name in after}
    assert ways["0000"] == pytest.approx([-off, 0.0, 0.0], abs=1e-7), "the cabinet's back is on the wall"
    assert ways["0001"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert ways["0002"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert all(row.remains is None for row in outcome.rows["placements"])


@pytest.mark.whole
@METHODS
def test_what_is_carried_moves_along(method: Released | Default) -> None:
    """Replaying the carriers' own moves alone takes what they carry with them, rigidly."""
    outcome = crowded_scene().run(method)
    rows = outcome.rows["placements"], outcome.rows["supports"]
    parents = {row.instance_id: row.parent_id for row in rows[1] if row.parent_id is not None}
    steps = [step for step in outcome.rows["optimization_steps"] if step.instance_id not in parents]
    before, after = poses_of(outcome, "proposed"), replayed_poses(*rows, steps)
    assert any(not np.array_equal(before[parent], after[parent]) for parent in parents.values())
    for child, parent in parents.items():
        relative = [np.linalg.inv(poses[parent]) @ poses[child] for poses in (before, after)]
        assert np.allclose(*relative, atol=1e-9)


@pytest.mark.whole
@pytest.mark.parametrize("seed", range(2))
def test_generated_furniture_comes_to_rest_without_collisions(seed: int) -> None:
    """A desk with objects on it, chairs and cabinets, scanned a few centimetres off."""
    rng = np.random.default_rng(seed)
    scene = Scene(((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)))
    desk = generate("desk", (0.7, 1.4, 0.75), rng)
    scene.add(desk.parts, yaw_pose(0.0, [-2.0, 0.0, 0.02]), "desk", known=desk.pieces)
    for category, y in (("monitor", 0.1), ("mug", -0.5), ("keyboard", 0.6)):
        model = generate(category, None, rng)
        pose = yaw_pose(rng.uniform(-0.2, 0.2), [-2.0, y, 0.75 + rng.uniform(-0.04, 0.06)])
        scene.add(model.parts, pose, category, known=model.pieces)
    for category in ("chair", "cabinet", "bookshelf", "sofa", "stool", "bed", "nightstand"):
        model = generate(category, None, rng)
        pose = yaw_pose(rng.uniform(-3, 3), [*rng.uniform(-1.5, 1.5, 2), rng.uniform(-0.05, 0.05)])
        scene.add(model.parts, pose, category, known=model.pieces)
    outcome = scene.run(seed=seed)
    relations = {row.instance_id: (row.relation, row.parent_id) for row in outcome.rows["supports"]}
    assert all(relations[f"{i:04d}"] == ("on", "0000") for i in (1, 2, 3)), relations
    assert all(relations[f"{i:04d}"][0] in ("floor", "on") for i in range(4, 11)), relations
    (summary,) = outcome.rows["optimizations"]
    assert max(row.penetration_m for row in outcome.rows["contacts"] if row.phase == "proposed") > 0.1
    assert (summary.loss_final, summary.deep_pairs) == (0.0, 0)
    boxes = bounds(outcome, scene)
    for name in ("0001", "0002", "0003"):
        assert (boxes[name][0, :2] + boxes[name][1, :2] >= 2 * boxes["0000"][0, :2]).all()
        assert (boxes[name][0, :2] + boxes[name][1, :2] <= 2 * boxes["0000"][1, :2]).all()
        assert boxes[name][0, 2] == pytest.approx(boxes["0000"][1, 2], abs=0.03)


# steps, contacts, bytes


@pytest.mark.slow
@pytest.mark.whole
@METHODS
@pytest.mark.parametrize("seed", range(3))
def test_replaying_the_steps_gives_the_optimized_poses_bit_for_bit(method: Released | Default, seed: int) -> None:
    outcome = crowded_scene().run(method, seed)
    assert {"start", "rested", "kept"} <= {row.outcome for row in outcome.rows["optimization_steps"]}
    tables = ("placements", "supports", "optimization_steps")
    kept = [arrow_to_rows(rows_to_arrow(outcome.rows[table], RECORDS[table]), RECORDS[table]) for table in tables]
    for given in ([outcome.rows[table] for table in tables], kept, [rows[::-1] for rows in kept]):
        poses = replayed_poses(*given)
        for row in given[0]:
            assert np.array_equal(poses[row.instance_id], matrix(row.optimized_pose))
    moved_by_steps = {row.instance_id for row in kept[2] if row.outcome in APPLIED}
    for row in kept[0]:
        way = matrix(row.optimized_pose)[:3, 3] - matrix(row.proposed_pose)[:3, 3]
        assert row.displacement_m == pytest.approx(np.hypot(*way[:2]), abs=1e-12)
        assert row.lift_m == pytest.approx(way[2], abs=1e-12)
        assert not way.any() or moved_by_steps, row
    # every step counts: without the last one that moved something, something stands elsewhere
    last = max(row.step for row in kept[2] if row.outcome in APPLIED)
    fewer = replayed_poses(kept[0], kept[1], [row for row in kept[2] if row.step != last])
    assert any(not np.array_equal(fewer[row.instance_id], matrix(row.optimized_pose)) for row in kept[0])


@pytest.mark.whole
@METHODS
def test_contacts_are_the_penetrations_of_the_meshes_before_and_after(method: Released | Default) -> None:
    """Pieces made anew from the GLBs, put where the rows say; depths from Minkowski differences."""
    scene = room_scene()
    scene.add(TABLE, yaw_pose(0.1, [0.6, 0.3, 0.0]), "table")
    scene.add(block(0.4, 0.3, 0.5), yaw_pose(0.5, [1.9, -1.0, -0.01]), "box")
    outcome = scene.run(method)
    room = {name: [mesh.vertices] for name, mesh in room_shell(scene.shells[0]) if name != "floor"}
    for phase in ("proposed", "optimized"):
        objects = {name: [hull.vertices for hull in hulls] for name, hulls in hulls_of(outcome, scene, phase).items()}
        corners = {name: np.concatenate(clouds) for name, clouds in objects.items()}
        expected: dict[tuple[str, str], tuple[float, float]] = {}
        names = sorted(objects)
        for i, a in enumerate(names):
            for b in [*names[i + 1 :], *room]:
                others = objects.get(b) or room[b]
                depth = max(penetration_depth(p, q) for p in objects[a] for q in others)
                sides = np.zeros(3)
                if b in objects:
                    sides = np.minimum(corners[a].max(0), corners[b].max(0)) - np.maximum(corners[a].min(0), corners[b].min(0))
                if depth > TOUCH_M or (sides > TOUCH_M).all():
                    expected[a, b] = depth, float(sides.prod()) if (sides > TOUCH_M).all() else 0.0
            if -corners[a][:, 2].min() > TOUCH_M:
                expected[a, "floor"] = float(-corners[a][:, 2].min()), 0.0
        found = {(c.instance_a, c.body_b): c for c in outcome.rows["contacts"] if c.phase == phase}
        # what only touches may be a hair's breadth on either side
        for pair in set(found) ^ set(expected):
            depth, volume = (found[pair].penetration_m, found[pair].box_overlap_m3) if pair in found else expected[pair]
            assert depth < 2 * TOUCH_M, pair
            assert volume < 4 * 2 * TOUCH_M, pair
        for pair in set(found) & set(expected):
            assert found[pair].penetration_m == pytest.approx(expected[pair][0], abs=2 * TOUCH_M), pair
            assert found[pair].box_overlap_m3 == pytest.approx(expected[pair][1], abs=1e-5), pair
        assert max(c.penetration_m for c in found.values()) > 0.1 or phase == "optimized"


def on_two_processes(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(function, items))


@pytest.mark.whole
@METHODS
def test_the_same_scene_gives_the_same_rows_in_any_order_and_in_any_process(method: Released | Default) -> None:
    first = crowded_scene().run(method, 1)
    spread = on_two_processes if isinstance(method, Default) else in_turn
    second = crowded_scene().reversed().run(method, 1, spread)
    assert first.rows == second.rows
    assert first.degradations == second.degradations
    for table, record in RECORDS.items():
        assert rows_to_arrow(first.rows[table], record).equals(rows_to_arrow(second.rows[table], record))
    assert crowded_scene().run(method, 2).rows["optimization_steps"] != first.rows["optimization_steps"]


def test_step_zero_of_the_paper_is_the_state_at_rest() -> None:
    outcome = room_scene().run(Released(max_steps=0))
    steps = outcome.rows["optimization_steps"]
    assert (steps[0].step, steps[0].outcome, steps[0].instance_id) == (0, "start", None)
    assert {step.outcome for step in steps[1:]} == {"rested"}
    assert {step.loss for step in steps} == {steps[0].loss}
    assert steps[0].loss == room_scene().run(Released()).rows["optimization_steps"][0].loss > 0
    assert outcome.rows["optimizations"][0].ended == "out_of_moves"


@METHODS
def test_nothing_gives_way_to_a_rug_or_to_what_it_stands_in(method: Released | Default) -> None:
    scene = Scene()
    scene.add(block(1.5, 1.0, 0.02), np.eye(4), "rug")
    scene.add(block(0.4, 0.4, 0.5), translation([0.85, 0.0, 0.0]), "stool")  # a quarter of it on the rug
    scene.add(SHELF, translation([-1.5, 0.0, 0.0]), "shelf")
    scene.add(block(0.1, 0.2, 0.2), translation([-1.5, 0.1, 0.52]), "book")
    outcome = scene.run(method)
    assert {step.loss for step in outcome.rows["optimization_steps"]} == {0.0}
    assert all(row.displacement_m < 0.01 for row in outcome.rows["placements"])
    boxes = {(c.instance_a, c.body_b) for c in outcome.rows["contacts"] if c.box_overlap_m3 > 0 and c.phase == "proposed"}
    assert boxes == {("0000", "0001"), ("0002", "0003")}
