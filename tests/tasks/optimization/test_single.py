"""One object put to rest while the others are held."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.pieces import PieceConfig
from tasks.geometry.transforms import is_rigid, yaw_pose
from tasks.optimization import Default
from tasks.optimization.contacts import FLOOR, Colliders
from tasks.optimization.interior import Interior, furnish
from tasks.optimization.proposals import propose
from tasks.optimization.single import Rested, hold_others, rest_alone
from tasks.optimization.support.supports import SupportConfig
from tasks.stage import Context
from tests.tasks.optimization.scenes import DEEP_M, TABLE, Scene, block

SUPPORTS = SupportConfig()


def interior_of(scene: Scene) -> Interior:
    proposals, _ = propose(scene.instances, scene.selections, (), set(scene.assets))
    context = Context("demo/room_a", "optimization", 0, scene.blobs)
    interior, notes = furnish(proposals, scene.assets, scene.blobs, scene.shells[0], SUPPORTS, PieceConfig(), context.caches)
    assert notes == []
    return interior


def rested(interior: Interior, name: str) -> Rested:
    return rest_alone(interior, name, Default(), SUPPORTS, Context("demo/room_a", "optimization", 0, {}).rng)


def depth_after(interior: Interior, name: str, pose: np.ndarray) -> float:
    """How deep an object is in anything but the floor [m], once it stands at a pose."""
    poses = interior.poses.copy()
    poses[interior.names.index(name)] = pose
    pairs = Colliders(interior.solids, interior.shell).penetrations(poses)
    return max((pair.depth_m for pair in pairs if name in (pair.a, pair.b) and FLOOR not in (pair.a, pair.b)), default=0.0)


@given(
    x=st.floats(-1.6, 1.6), y=st.floats(-1.6, 1.6), yaw=st.floats(-np.pi, np.pi), rise=st.floats(-0.04, 0.1), is_high=st.booleans(),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_an_object_comes_to_rest_and_out_of_what_does_not_move(x: float, y: float, yaw: float, rise: float, is_high: bool) -> None:
    scene = Scene()
    scene.add(TABLE, np.eye(4), "table")
    scene.add(block(0.4, 0.4, 0.4), yaw_pose(0.3, (1.2, 1.2, 0.0)), "box")
    name = scene.add(block(0.3, 0.2, 0.25), yaw_pose(yaw, (x, y, rise + (0.75 if is_high else 0.0))), "box")
    interior = interior_of(scene)
    before = interior.poses.copy()
    made = rested(interior, name)
    assert np.array_equal(interior.poses, before), "nothing but the answer"
    assert is_rigid(made.pose)
    assert made.problem or depth_after(interior, name, made.pose) <= DEEP_M
    parts = interior.solids[interior.names.index(name)].placed(made.pose)
    bottom = min(float(hull.vertices[:, 2].min()) for hull in parts)
    assert bottom > -1e-4
    if not made.problem and not {"tipped", "laid_down"} & set(made.outcomes):
        assert min(abs(bottom - height) for height in (0.0, 0.4, 0.75)) < 0.001, "on the floor, the block or the table"
    assert np.array_equal(rested(interior, name).pose, made.pose), "the same every time"


def test_what_rests_in_nothing_stays_where_it_is() -> None:
    scene = Scene()
    scene.add(TABLE, np.eye(4), "table")
    name = scene.add(block(0.3, 0.2, 0.25), yaw_pose(0.4, (0.1, 0.1, 0.75)), "box")
    interior = interior_of(scene)
    made = rested(interior, name)
    assert made.problem == ""
    assert made.pose == pytest.approx(interior.poses[interior.names.index(name)], abs=1e-6)


def test_what_an_object_carries_does_not_hold_it_back() -> None:
    """A table that hovers with a box on it comes down; one on which it was set too deep is not lifted by it."""
    scene = Scene()
    table = scene.add(TABLE, yaw_pose(0.0, (0.0, 0.0, 0.08)), "table")
    box = scene.add(block(0.3, 0.2, 0.25), yaw_pose(0.4, (0.1, 0.1, 0.82)), "box")
    interior = interior_of(scene)
    assert interior.carriers[interior.names.index(box)].parent_id == table
    assert box not in hold_others(interior, table).names
    made = rested(interior, table)
    assert made.pose[:3, 3] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_an_object_beyond_a_wall_is_pulled_in_and_what_is_wedged_says_so() -> None:
    scene = Scene()
    name = scene.add(block(0.4, 0.4, 0.4), yaw_pose(0.0, (1.95, 0.0, 0.0)), "box")
    made = rested(interior_of(scene), name)
    assert made.pose[:3, 3] == pytest.approx([1.8, 0.0, 0.0], abs=1e-3)
    assert "pulled_in" in made.outcomes
    tight = Scene(((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)))
    tight.add(block(0.6, 1.0, 0.4), yaw_pose(0.0, (-0.2, 0.0, 0.0)), "box")
    name = tight.add(block(0.6, 1.0, 0.4), yaw_pose(0.0, (0.2, 0.0, 0.0)), "box")
    interior = interior_of(tight)
    made = rested(interior, name)
    assert made.problem or depth_after(interior, name, made.pose) <= DEEP_M


def test_who_is_not_there_cannot_be_put_to_rest() -> None:
    scene = Scene()
    scene.add(TABLE, np.eye(4), "table")
    with pytest.raises(KeyError):
        rested(interior_of(scene), "0099")
