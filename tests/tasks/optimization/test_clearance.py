"""Neighbors keep two millimeters clear of each other, at no cost: nothing is lost, deeper, or moved that had no need."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.transforms import yaw_pose
from tasks.optimization.clearance import CLEAR_M, keep_clear
from tasks.optimization.contacts import Colliders
from tasks.optimization.default import Default
from tasks.optimization.interior import Interior
from tasks.optimization.search.trace import Move, moved_poses
from tasks.optimization.support.resting import lost_supports
from tests.tasks.optimization.interiors import Object, block, interior_of

SLOP = Default().slop_m
SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))


def cleared(interior: Interior) -> tuple[list[tuple[str, Move]], np.ndarray]:
    """The moves, and the poses after them."""
    moves = keep_clear(interior, interior.poses, SLOP)
    parents = {name: carrier.parent_id for name, carrier in zip(interior.names, interior.carriers, strict=True)}
    moved = moved_poses(dict(zip(interior.names, interior.poses, strict=True)), parents, moves)
    return moves, np.array([moved[name] for name in interior.names])


def depth(interior: Interior, poses: np.ndarray) -> float:
    return max((p.depth_m for p in Colliders(interior.solids, interior.shell).penetrations(poses)), default=0.0)


@given(gap=st.floats(0.0, 0.0017), yaw=st.floats(-3.0, 3.0))
@settings(max_examples=25, deadline=None)
def test_the_smaller_of_two_steps_aside_once(gap: float, yaw: float) -> None:
    turn = yaw_pose(yaw)
    monitor: Object = ("monitor", [block((0.2, 0.6, 0.4))], turn @ yaw_pose(0.0, [0.0, 0.0, 0.7]))
    candle: Object = ("candle", [block((0.06, 0.06, 0.1))], turn @ yaw_pose(0.0, [0.13 + gap, 0.0, 0.7]))
    interior = interior_of([("desk", [block((1.2, 0.8, 0.7))], turn), monitor, candle])
    moves, poses = cleared(interior)
    assert [name for name, _ in moves] == ["0002"]
    way = np.linalg.inv(turn[:3, :3]) @ (poses[2][:3, 3] - interior.poses[2][:3, 3])
    assert gap + way[0] >= 0.7 * CLEAR_M  # the way may be askew by half of the angle between two directions
    assert np.linalg.norm(way) <= 1.5 * CLEAR_M + 1e-12
    assert way[2] == 0.0
    assert depth(interior, poses) <= SLOP
    assert lost_supports(interior, poses) == lost_supports(interior, interior.poses)
    np.testing.assert_array_equal(poses[:2], interior.poses[:2])


def test_from_a_corner_it_goes_along_both_sides() -> None:
    """And with all that it carries; a second time there is nothing to do."""
    side: Object = ("cabinet", [block((0.6, 1.2, 0.9))], yaw_pose(0.0, [0.6, 0.0, 0.0]))
    back: Object = ("cabinet", [block((1.2, 0.6, 0.9))], yaw_pose(0.0, [-0.3, 0.9, 0.0]))
    table: Object = ("table", [block((0.5, 0.5, 0.7))], yaw_pose(0.0, [0.05, 0.35, 0.0]))
    box: Object = ("box", [block((0.1, 0.1, 0.1))], yaw_pose(0.0, [0.05, 0.35, 0.7]))
    interior = interior_of([side, back, table, box])
    moves, poses = cleared(interior)
    assert [name for name, _ in moves if name in ("0002", "0003")] == ["0002"]
    way = poses[2, :3, 3] - interior.poses[2, :3, 3]
    assert (way[:2] <= -CLEAR_M).all()
    np.testing.assert_allclose(poses[3, :3, 3] - interior.poses[3, :3, 3], way, atol=1e-12)
    assert depth(interior, poses) <= SLOP
    assert keep_clear(interior, poses, SLOP) == []


def test_nobody_goes_below_the_edge_of_something() -> None:
    """A candle that touches a monitor's foot, its top right below the screen on one side, goes to the other side."""
    monitor: Object = (
        "monitor", [block((0.2, 0.2, 0.1)), block((0.1, 0.5, 0.3)).apply_translation([0.0, 0.0, 0.1])], yaw_pose(0.0, [0.0, 0.0, 0.7])
    )  # fmt: skip
    candle: Object = ("candle", [block((0.06, 0.06, 0.09999))], yaw_pose(0.0, [-0.0801, 0.13, 0.7]))
    interior = interior_of([("desk", [block((1.2, 0.8, 0.7))], yaw_pose(0.0)), monitor, candle])
    moves, poses = cleared(interior)
    assert [name for name, _ in moves] == ["0002"]
    assert poses[2][1, 3] > 0.13 + 0.7 * CLEAR_M
    assert poses[2][0, 3] + 0.03 <= -0.05


@pytest.mark.parametrize("inward", [0.001, 0.01, 0.03])
def test_what_is_right_below_an_edge_comes_out(inward: float) -> None:
    """A monitor that gives way by rounding would pinch it."""
    monitor: Object = (
        "monitor", [block((0.2, 0.2, 0.1)), block((0.2, 0.6, 0.3)).apply_translation([0.0, 0.0, 0.1])], yaw_pose(0.0, [0.0, 0.0, 0.7])
    )  # fmt: skip
    candle: Object = ("candle", [block((0.06, 0.06, 0.09999))], yaw_pose(0.0, [0.13 - inward, 0.2, 0.7]))
    interior = interior_of([("desk", [block((1.2, 0.8, 0.7))], yaw_pose(0.0)), monitor, candle])
    moves, poses = cleared(interior)
    assert [name for name, _ in moves] == ["0002"]
    assert poses[2][0, 3] - 0.03 >= 0.1 + CLEAR_M - 1e-9
    assert np.linalg.norm(poses[2][:3, 3] - interior.poses[2][:3, 3]) <= 0.04 + 1e-12
    assert depth(interior, poses) <= SLOP


def test_furniture_stays_at_its_wall() -> None:
    bed: Object = ("bed", [block((1.6, 1.4, 0.5))], yaw_pose(0.0, [1.2, 0.0, 0.0]))
    interior = interior_of([bed], SQUARE)
    assert keep_clear(interior, interior.poses, SLOP) == []


CABINET: Object = ("cabinet", [block((0.5, 0.5, 0.9))], yaw_pose(0.0))
APART: list[Object] = [("cabinet", [block((0.5, 0.5, 0.9))], yaw_pose(0.0, [x, 0.0, 0.0])) for x in (-0.5 - CLEAR_M, 0.0, 0.5 + CLEAR_M)]
ON_IT: Object = ("box", [block((0.1, 0.1, 0.1))], yaw_pose(0.0, [0.0, 0.0, 0.9]))
LEANING: Object = ("book", [block((0.02, 0.2, 0.3))], yaw_pose(0.0, [0.26, 0.0, 0.0]))


@pytest.mark.parametrize("objects", [APART, [CABINET, ON_IT], [CABINET, LEANING]], ids=["clear", "on it", "leans"])
def test_nobody_goes_without_need(objects: list[Object]) -> None:
    interior = interior_of(objects)
    assert keep_clear(interior, interior.poses, SLOP) == []


def test_who_is_wedged_stays_to_the_bit() -> None:
    walls: list[Object] = [("cabinet", [block((1.0, 0.6, 0.9))], yaw_pose(0.0, [x, 0.0, 0.0])) for x in (-1.0005, 1.0005)]
    box: Object = ("box", [block((1.0, 0.3, 0.3))], yaw_pose(0.0))
    fixed = interior_of([*walls, box])
    moves, poses = cleared(fixed)
    assert depth(fixed, poses) <= SLOP
    assert "0002" not in dict(moves)


def test_what_carries_it_has_a_back_that_nobody_goes_into() -> None:
    """A box at the back of a bench, before it something that touches it: it has no room, and a book holder beside it gives way along."""
    bench: Object = ("bench", [block((0.6, 1.4, 0.4)), block((0.1, 1.4, 0.4), (0.25, 0.0, 0.4))], yaw_pose(0.0))
    box: Object = ("box", [block((0.1, 0.1, 0.1))], yaw_pose(0.0, [0.15, 0.0, 0.4]))
    front: Object = ("vase", [block((0.2, 0.2, 0.2))], yaw_pose(0.0, [0.0, 0.0, 0.4]))
    interior = interior_of([bench, box, front])
    before = depth(interior, interior.poses)
    moves, poses = cleared(interior)
    assert moves
    assert depth(interior, poses) <= max(before, SLOP) + 1e-5
    assert (poses[1:, 0, 3] <= interior.poses[1:, 0, 3] + 1e-12).all()


@pytest.mark.parametrize("gap", [0.0, 0.001])
def test_nobody_goes_into_a_rug(gap: float) -> None:
    rug: Object = ("rug", [block((1.0, 1.0, 0.012))], yaw_pose(0.0, [0.5505, 0.0, 0.0]))
    box: Object = ("box", [block((0.1, 0.1, 0.1))], yaw_pose(0.0))
    cabinet: Object = ("cabinet", [block((0.5, 0.5, 0.9))], yaw_pose(0.0, [-0.3 - gap, 0.0, 0.0]))
    interior = interior_of([rug, box, cabinet])
    moves, poses = cleared(interior)
    assert depth(interior, poses) <= max(depth(interior, interior.poses), SLOP) + 1e-5
    assert "0000" not in dict(moves)


def test_who_stands_at_a_wall_goes_along_it() -> None:
    stand: Object = ("nightstand", [block((0.4, 0.4, 0.5))], yaw_pose(0.0, [1.8, -0.9, 0.0]))
    bed: Object = ("bed", [block((1.6, 1.4, 0.5))], yaw_pose(0.0, [1.2, 0.0, 0.0]))
    interior = interior_of([stand, bed], SQUARE)
    interior = dataclasses.replace(interior, fixed=np.zeros(2, dtype=np.bool_))
    moves, poses = cleared(interior)
    assert [name for name, _ in moves] == ["0000"]
    assert poses[0][0, 3] == pytest.approx(1.8, abs=1e-12)
    assert poses[0][1, 3] <= -0.9 - CLEAR_M + 1e-12


def test_what_is_fixed_stays() -> None:
    box: Object = ("box", [block((0.1, 0.1, 0.1))], yaw_pose(0.0))
    cabinet: Object = ("cabinet", [block((0.5, 0.5, 0.9))], yaw_pose(0.0, [-0.3, 0.0, 0.0]))
    interior = interior_of([box, cabinet])
    for fixed in ((True, True), (True, False), (False, True)):
        moves, _ = cleared(dataclasses.replace(interior, fixed=np.array(fixed)))
        assert [name for name, _ in moves] == [name for name, is_fixed in zip(interior.names, fixed, strict=True) if not is_fixed]


def test_nobody_walks_out_from_under_what_lies_on_it() -> None:
    """A board on two boxes, its middle over neither, beside a third that touches the second."""
    boxes: list[Object] = [("box", [block((0.3, 0.3, 0.4))], yaw_pose(0.0, [x, 0.0, 0.0])) for x in (-0.5, 0.5, 0.8)]
    board: Object = ("board", [block((1.06, 0.3, 0.04))], yaw_pose(0.0, [-0.15, 0.0, 0.4]))
    interior = interior_of([*boxes, board])
    _, poses = cleared(interior)
    assert np.abs(poses[:, :2, 3] - interior.poses[:, :2, 3]).max() <= 0.003 + 1e-12


def test_nobody_stands_beyond_the_edge_of_what_carries_it() -> None:
    """A candle below the edge of a monitor, at the edge of the desk: it comes out along the desk, or not at all."""
    monitor: Object = (
        "monitor", [block((0.2, 0.2, 0.1)), block((0.2, 0.6, 0.3)).apply_translation([0.0, 0.0, 0.1])], yaw_pose(0.0, [0.47, 0.0, 0.7])
    )  # fmt: skip
    candle: Object = ("candle", [block((0.06, 0.06, 0.09999))], yaw_pose(0.0, [0.565, 0.15, 0.7]))
    desk: Object = ("desk", [block((1.2, 0.8, 0.7))], yaw_pose(0.0))
    interior = interior_of([desk, monitor, candle])
    _, poses = cleared(interior)
    assert poses[2][0, 3] + 0.03 <= 0.6 + 0.003


@given(seed=st.integers(0, 400))
@settings(max_examples=40, deadline=None)
def test_no_pair_gets_deeper(seed: int) -> None:
    """Whatever overlaps already."""
    rng = np.random.default_rng(seed)
    objects: list[Object] = [
        ("box", [block(rng.uniform(0.1, 0.4, 3))], yaw_pose(float(rng.uniform(-3, 3)), [*rng.uniform(-0.4, 0.4, 2), 0.0])) for _ in range(6)
    ]
    interior = interior_of(objects)
    _, poses = cleared(interior)
    before, after = (
        {(p.a, p.b): p.depth_m for p in Colliders(interior.solids, interior.shell).penetrations(where)} for where in (interior.poses, poses)
    )
    for pair, deep in after.items():
        assert deep <= max(before.get(pair, 0.0), SLOP) + 5e-5


@pytest.mark.parametrize("relation", ["wall", "on"])
def test_what_is_below_something_that_does_not_need_it_comes_out_too(relation: str) -> None:
    """A screen begins above the candle, and its wall holds it; or it is off its desk, propped up by the candle."""
    screen: Object = ("monitor", [block((0.2, 0.6, 0.3))], yaw_pose(0.0, [0.0, 0.0, 0.8]))
    candle: Object = ("candle", [block((0.06, 0.06, 0.09999))], yaw_pose(0.0, [0.12, 0.2, 0.7]))
    interior = interior_of([("desk", [block((1.2, 0.8, 0.7))], yaw_pose(0.0)), screen, candle])
    carriers = tuple(
        dataclasses.replace(carrier, relation=relation) if name == "0001" else carrier
        for name, carrier in zip(interior.names, interior.carriers, strict=True)
    )
    moves, poses = cleared(dataclasses.replace(interior, carriers=carriers))
    assert [name for name, _ in moves] == ["0002"]
    assert poses[2][0, 3] - 0.03 >= 0.1


def test_who_cannot_come_out_from_below_stays() -> None:
    """Under the middle of a screen, at its foot: a step aside, of either, would leave it pinched, and no longer held."""
    monitor: Object = (
        "monitor", [block((0.2, 0.2, 0.1)), block((0.6, 0.6, 0.3)).apply_translation([0.0, 0.0, 0.1])], yaw_pose(0.0, [0.0, 0.0, 0.7])
    )  # fmt: skip
    candle: Object = ("candle", [block((0.06, 0.06, 0.09999))], yaw_pose(0.0, [0.13, 0.0, 0.7]))
    interior = interior_of([("desk", [block((1.2, 0.8, 0.7))], yaw_pose(0.0)), monitor, candle])
    assert keep_clear(interior, interior.poses, SLOP) == []
