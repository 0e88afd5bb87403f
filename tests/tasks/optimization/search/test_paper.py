"""Algorithm 1 of the supplementary: IoU of all pairs, sweeps in order, heights, bounds, and an independent replay of its losses."""

from __future__ import annotations

import itertools
from collections import defaultdict

import numpy as np
import pytest

from schemas.optimization import APPLIED, OptimizationStep
from tasks.geometry.pieces import PieceConfig
from tasks.geometry.transforms import yaw_pose
from tasks.optimization import Paper, SupportConfig, paper
from tasks.optimization.interior import furnish
from tasks.optimization.proposals import propose
from tests.tasks.optimization.scenes import SQUARE, Scene, block, bounds, crowded_scene, room_scene


def iou_sum(boxes: dict[str, np.ndarray]) -> float:
    """Sum of IoU over all pairs of boxes (equation A1), summed plainly."""
    total = 0.0
    for a, b in itertools.combinations(boxes.values(), 2):
        sides = np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])
        shared = float(np.prod(sides)) if (sides > 1e-6).all() else 0.0
        total += shared / (float(np.prod(a[1] - a[0])) + float(np.prod(b[1] - b[0])) - shared)
    return total


def searched(steps: list[OptimizationStep]) -> list[OptimizationStep]:
    return [step for step in steps if step.outcome in ("kept", "reverted", "left_room")]


def cup_between_a_wide_and_a_small_box() -> Scene:
    """Boxes whose overlap volume and IoU disagree on the way out for the middle one."""
    scene = Scene(((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)))
    scene.add(block(2.0, 1.0, 0.8), yaw_pose(0.0, [0.0, 0.0, 0.0]), "desk")
    scene.add(block(0.2, 0.2, 0.2), yaw_pose(0.0, [1.05, 0.0, 0.0]), "box")
    scene.add(block(0.2, 0.2, 0.2), yaw_pose(0.0, [1.2, 0.0, 0.0]), "box")
    return scene


def test_the_loss_is_a_sum_of_iou() -> None:
    outcome = cup_between_a_wide_and_a_small_box().run(Paper(max_sweeps=0))
    (summary,) = outcome.rows["optimizations"]
    assert summary.loss_start == pytest.approx(0.002 / (1.6 + 0.008 - 0.002) + 0.002 / (0.016 - 0.002))


def test_iou_keeps_a_move_that_leaves_the_overlap_volume_as_it_is() -> None:
    """The middle box moves into the wide one: the volume stays 0.004 m3, and IoU falls from 0.144 to 0.002."""
    scene = cup_between_a_wide_and_a_small_box()
    placed = (scene.assets, scene.blobs, None, SupportConfig(), PieceConfig(), defaultdict(dict))
    proposals, _ = propose(scene.instances, scene.selections, [], scene.assets)
    interior, _ = furnish(proposals, *placed)
    boxes = np.array([[obj.low, obj.high] for obj in interior.objects])
    search = paper._Search(interior, boxes, None)
    assert search.loss == pytest.approx(0.144, abs=1e-3)
    loss, outcome = search._try(interior.names.index("0001"), np.array([-1, 0, 0]), 0.05)
    assert (loss, outcome) == (pytest.approx(0.004 / 1.604), "kept")


@pytest.mark.whole
@pytest.mark.parametrize("seed", range(3))
def test_every_loss_follows_from_the_boxes_and_sweeps_go_by_id(seed: int) -> None:
    scene = crowded_scene()
    outcome = scene.run(Paper(max_sweeps=40), seed)
    boxes = bounds(outcome, scene, "proposed")
    parents = {row.instance_id: row.parent_id for row in outcome.rows["supports"]}
    steps = outcome.rows["optimization_steps"]

    def moved(step: OptimizationStep) -> dict[str, np.ndarray]:
        group, way = {step.instance_id}, np.array([step.dx_m, step.dy_m, step.dz_m])
        while more := {name for name, parent in parents.items() if parent in group} - group:
            group |= more
        return {name: box + way if name in group else box for name, box in boxes.items()}

    best = None
    for step in steps[1:]:
        if step.outcome == "rested":
            boxes = moved(step)
            continue
        best = iou_sum(boxes) if best is None else best
        after = iou_sum(moved(step))
        if step.outcome == "left_room":
            assert step.loss == pytest.approx(best)
            continue
        assert step.loss == pytest.approx(after, abs=1e-9)
        assert (step.outcome == "kept") == (after < best - 1e-12)
        if step.outcome == "kept":
            boxes, best = moved(step), after
        assert step.smallest_loss == pytest.approx(best, abs=1e-9)
    order = sorted(boxes)
    visits = [step.instance_id for step in searched(steps)]
    assert visits == [order[k % len(order)] for k in range(len(visits))], "sweeps visit all objects in the order of their ids"
    final = bounds(outcome, scene)
    for name, box in boxes.items():
        assert box == pytest.approx(final[name], abs=1e-9)
    assert outcome.rows["optimizations"][0].loss_final < outcome.rows["optimizations"][0].loss_start


def test_max_sweeps_counts_sweeps_and_movements_are_steps_along_one_axis() -> None:
    outcome = crowded_scene().run(Paper(max_sweeps=2))
    (summary,) = outcome.rows["optimizations"]
    assert summary.moves == 2 * summary.object_count
    for step in searched(outcome.rows["optimization_steps"]):
        way = np.abs([step.dx_m, step.dy_m, step.dz_m])
        assert sorted(way) == pytest.approx([0.0, 0.0, 0.05])


@pytest.mark.whole
def test_heights_move_as_well_within_the_room() -> None:
    """Two boards fill the floor of a closet: only upwards can they part."""
    scene = Scene(((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)))
    scene.add(block(1.0, 1.0, 0.3), yaw_pose(0.0, [0.0, 0.0, 0.0]), "cabinet")
    scene.add(block(0.98, 0.98, 0.3), yaw_pose(0.0, [0.0, 0.0, 0.1]), "cabinet")
    outcome = scene.run(Paper(), 1)
    (summary,) = outcome.rows["optimizations"]
    kept = [step for step in outcome.rows["optimization_steps"] if step.outcome in APPLIED]
    assert any(step.dz_m > 0 for step in kept)
    assert summary.loss_final == 0.0
    assert all(box[0, 2] >= -1e-9 for box in bounds(outcome, scene).values())


@pytest.mark.whole
def test_nothing_leaves_the_room() -> None:
    scene = Scene(SQUARE)
    for k in range(6):
        scene.add(block(0.9, 0.9, 0.9), yaw_pose(0.0, [1.5 - 0.1 * k, 1.5, 0.0]), "cabinet")
    outcome = scene.run(Paper(max_sweeps=200))
    for box in bounds(outcome, scene).values():
        assert (box[0] >= [-2 - 1e-6, -2 - 1e-6, -1e-6]).all()
        assert (box[1] <= [2 + 1e-6, 2 + 1e-6, 2.5 + 1e-6]).all()
    assert {"kept", "left_room"} <= {step.outcome for step in outcome.rows["optimization_steps"]}


def test_a_scene_without_overlaps_has_nothing_to_do() -> None:
    scene = Scene()
    scene.add(block(0.5, 0.5, 0.5), yaw_pose(0.0, [0.0, 0.0, 0.0]), "cabinet")
    (summary,) = scene.run(Paper()).rows["optimizations"]
    assert (summary.ended, summary.moves) == ("nothing_to_do", 0)


@pytest.mark.whole
def test_the_same_seed_gives_the_same_steps() -> None:
    first, second = (room_scene().run(Paper(max_sweeps=20), 4).rows["optimization_steps"] for _ in range(2))
    assert first == second
