"""Slight overlaps are parted by level shifts that cost nobody anything."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.transforms import yaw_pose
from tasks.optimization.contacts import Colliders
from tasks.optimization.default import Default
from tasks.optimization.interior import Interior
from tasks.optimization.parting import part_slight
from tasks.optimization.search.trace import Move, moved_poses
from tasks.optimization.support.resting import DEEP_M, lost_supports
from tests.tasks.optimization.interiors import Object, block, interior_of

SLOP = Default().slop_m
DESK: Object = ("desk", [block((1.2, 0.8, 0.7))], yaw_pose(0.0))
SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))


def parted(interior: Interior) -> tuple[list[tuple[str, Move]], np.ndarray]:
    """The moves that part an interior where its objects are, and the poses after them."""
    met = Colliders(interior.solids, interior.shell).penetrations(interior.poses)
    moves = part_slight(interior, interior.poses, met, {}, SLOP)
    parents = {name: carrier.parent_id for name, carrier in zip(interior.names, interior.carriers, strict=True)}
    moved = moved_poses(dict(zip(interior.names, interior.poses, strict=True)), parents, moves)
    return moves, np.array([moved[name] for name in interior.names])


def depth(interior: Interior, poses: np.ndarray) -> float:
    return max((p.depth_m for p in Colliders(interior.solids, interior.shell).penetrations(poses)), default=0.0)


@given(st.floats(2e-5, 0.0019), st.floats(-3.0, 3.0))
@settings(max_examples=25, deadline=None)
def test_a_candle_leaves_the_monitor_that_it_is_in(deep: float, yaw: float) -> None:
    """The smaller one goes, no farther than it is deep, and level; on a desk turned as one likes."""
    turn = yaw_pose(yaw)
    monitor: Object = ("monitor", [block((0.2, 0.6, 0.4))], turn @ yaw_pose(0.0, [0.0, 0.0, 0.7]))
    candle: Object = ("candle", [block((0.06, 0.06, 0.1))], turn @ yaw_pose(0.0, [0.13 - deep, 0.0, 0.7]))
    interior = interior_of([("desk", DESK[1], turn), monitor, candle])
    assert depth(interior, interior.poses) == pytest.approx(deep, abs=1e-6)
    moves, poses = parted(interior)
    assert [name for name, _ in moves] == ["0002"]
    assert depth(interior, poses) <= SLOP
    assert np.linalg.norm(poses[2][:3, 3] - interior.poses[2][:3, 3]) == pytest.approx(deep, abs=1e-6)
    assert poses[2][2, 3] == interior.poses[2][2, 3]
    np.testing.assert_array_equal(poses[:2], interior.poses[:2])
    assert lost_supports(interior, poses) == lost_supports(interior, interior.poses)


def test_a_bed_leaves_the_wall_with_what_lies_on_it() -> None:
    bed: Object = ("bed", [block((1.6, 1.4, 0.5))], yaw_pose(0.0, [1.2006, 0.0, 0.0]))
    pillow: Object = ("box", [block((0.3, 0.3, 0.1))], yaw_pose(0.0, [1.2, 0.0, 0.5]))
    interior = interior_of([bed, pillow], SQUARE)
    moves, poses = parted(interior)
    assert [name for name, _ in moves] == ["0000"]
    assert depth(interior, poses) <= SLOP < depth(interior, interior.poses)
    np.testing.assert_allclose(poses[:, :3, 3] - interior.poses[:, :3, 3], [[-0.0006, 0.0, 0.0]] * 2, atol=1e-6)


def test_what_has_no_room_stays_to_the_bit() -> None:
    """Between two that touch it, or deeper than is slight, nothing is shifted; nor where nothing overlaps."""
    left, right = (("cabinet", [block((0.5, 0.5, 0.9))], yaw_pose(0.0, [x, 0.0, 0.0])) for x in (-0.5, 0.5))
    walls = (("cabinet", [block((1.25, 0.5, 0.9))], yaw_pose(0.0, [x, 1.0, 0.0])) for x in (-1.375, 1.375))
    wedged: Object = ("box", [block((1.502, 0.3, 0.3))], yaw_pose(0.0, [0.0, 1.0, 0.0]))
    deep: Object = ("box", [block((0.2, 0.2, 0.2))], yaw_pose(0.0, [0.25 - 0.1 - DEEP_M, 0.0, 0.0]))
    for objects in ([*walls, wedged], [left, right, deep], [left, right]):
        interior = interior_of(objects, SQUARE)
        moves, poses = parted(interior)
        assert moves == []
        assert poses.tobytes() == interior.poses.tobytes()


def test_what_is_carried_goes_along() -> None:
    """A stand and a box on it, both slightly in a cabinet: the stand is the smallest that one shift of helps both."""
    stand: Object = ("table", [block((0.4, 0.4, 0.4))], yaw_pose(0.0, [-0.2, 0.0, 0.0]))
    small: Object = ("box", [block((0.1, 0.1, 0.1))], yaw_pose(0.0, [-0.35, 0.0, 0.4]))
    large: Object = ("cabinet", [block((0.5, 0.5, 0.9))], yaw_pose(0.0, [-0.6495, 0.0, 0.0]))
    interior = interior_of([stand, small, large])
    moves, poses = parted(interior)
    assert [name for name, _ in moves] == ["0000"]
    assert depth(interior, poses) <= SLOP
    assert lost_supports(interior, poses) == set()
    way = dict(zip(interior.names, (poses - interior.poses)[:, 0, 3].tolist(), strict=True))
    assert way == pytest.approx({"0000": 0.0005, "0001": 0.0005, "0002": 0.0}, abs=1e-6)
