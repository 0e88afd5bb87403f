"""Laying down: what a nudge throws over lies before, what withstands it stays as it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.geometry.mass import mass_properties
from tasks.geometry.pieces import Hull
from tasks.geometry.transforms import yaw_pose
from tasks.optimization.certificates import CertificateConfig, certify
from tasks.optimization.solids import ConvexParts, RigidBody
from tasks.optimization.support.laying import GRAVITY_M_S2, lay_down
from tasks.optimization.support.resting import let_down
from tasks.optimization.support.tipping import Tip
from tests.tasks.optimization.interiors import block, bodies_of, hull, interior_of, world_vertices
from tests.tasks.optimization.support.test_tipping import prism, set_down

NUDGE = 0.05


def board(*size: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Hull:
    return hull(block(size, at))


def laid(pieces: list[Hull], rotation: np.ndarray, below: list[ConvexParts] | None = None) -> tuple[Tip | None, np.ndarray]:
    """What laying down makes of a body, and its vertices in the world in the end [m]."""
    shapes, stand = set_down(pieces, rotation, below)
    center = rotation @ mass_properties(pieces).center
    made = lay_down(shapes, stand, 0, center, np.arange(len(stand.low)) > 0, NUDGE)
    return made, world_vertices(shapes, stand, 0)


@pytest.mark.whole
@given(width=st.floats(0.002, 0.1), height=st.floats(0.05, 1.5), yaw=st.floats(-3.0, 3.0))
def test_a_board_on_its_edge_stands_exactly_where_a_nudge_cannot_throw_it_over(width: float, height: float, yaw: float) -> None:
    reach = NUDGE * np.sqrt(0.5 * height / GRAVITY_M_S2)
    if abs(0.5 * width - reach) < 1e-5:
        return
    made, vertices = laid([board(0.4, width, height)], yaw_pose(yaw)[:3, :3])
    assert (made is not None) == (0.5 * width < reach)
    assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-3)
    assert vertices[:, 2].max() == pytest.approx(height if made is None else width, abs=1e-3)
    if made is not None:
        np.testing.assert_allclose(made.rotation.T @ made.rotation, np.eye(3), atol=1e-9)


@pytest.mark.whole
@given(width=st.floats(0.004, 0.06), height=st.floats(0.1, 0.6))
def test_what_is_laid_down_is_what_the_certificate_sees_fall(width: float, height: float) -> None:
    reach = NUDGE * np.sqrt(0.5 * height / GRAVITY_M_S2)
    if 0.6 * reach < 0.5 * width < 1.3 * reach:
        return  # a push at its foot turns it less than one at its center, which the reach is for
    body = RigidBody(ConvexParts("0001", (board(0.4, width, height),)), 1.0, 0.5, (), False)
    (row,) = certify([body], np.eye(4)[None], (), CertificateConfig(mujoco_defaults=False))
    made, _ = laid([board(0.4, width, height)], np.eye(3))
    assert row.is_stable_1cm
    assert row.is_stable_nudged == (made is None)


def test_what_rolls_is_left_as_it_is() -> None:
    roller = prism(32, radius=0.02)
    before = set_down([roller], np.eye(3))
    made, vertices = laid([roller], np.eye(3))
    assert made is None
    np.testing.assert_array_equal(vertices, world_vertices(*before, 0))


def test_it_falls_to_the_other_side_where_it_would_only_lean() -> None:
    beside = ConvexParts("beside", (board(1.0, 0.3, 0.1, at=(0.0, 0.16, 0.0)),))  # 5 mm beside it, a third as high
    made, vertices = laid([board(0.4, 0.01, 0.3)], np.eye(3), [beside])
    assert made is not None
    assert vertices[:, 2].max() == pytest.approx(0.01, abs=1e-3)
    assert vertices[:, 1].max() < 0.01


def test_letting_down_lays_a_board_and_leaves_it_there() -> None:
    thin = ("box", [block((0.3, 0.004, 0.3))], yaw_pose(0.3, [0.0, 0.0, 0.0]))
    interior = interior_of([thin])
    shapes, stand = bodies_of(interior)
    assert not let_down(interior, shapes, stand, 0.45).laid
    made = let_down(interior, shapes, stand, 0.45, NUDGE)
    assert len(made.laid) == 1
    assert not let_down(interior, shapes, stand, 0.45, NUDGE).moves, "what lies, lies"


def test_what_would_fall_is_laid_down_unless_it_is_furniture() -> None:
    for height, is_laid in ((0.5, True), (0.9, False)):
        leaning = yaw_pose(0.0)
        c, s = np.cos(0.35), np.sin(0.35)
        leaning[1:3, 1:3] = [[c, -s], [s, c]]
        interior = interior_of([("box", [block((0.3, 0.1, height))], leaning)])
        shapes, stand = bodies_of(interior)
        made = let_down(interior, shapes, stand, 0.45, NUDGE)
        assert bool(made.laid) == is_laid
        assert made.toppling == ([] if is_laid else [0])


def test_what_carries_something_is_not_laid_down() -> None:
    thin = ("shelf", [block((0.3, 0.004, 0.3))], yaw_pose(0.0))
    on_top = ("box", [block((0.02, 0.004, 0.02))], yaw_pose(0.0, [0.0, 0.0, 0.3]))
    interior = interior_of([thin, on_top])
    carried = dataclasses.replace(interior.carriers[1], relation="on", parent_id=interior.names[0])
    interior = dataclasses.replace(interior, parent=np.array([-1, 0]), carriers=(interior.carriers[0], carried))
    shapes, stand = bodies_of(interior)
    made = let_down(interior, shapes, stand, 0.45, NUDGE, rounds=1)
    assert 0 not in {made.moves[at][0] for at in made.laid}


def test_what_was_laid_down_is_balanced_where_it_lies() -> None:
    lollipop = [block((0.012, 0.012, 0.3)), block((0.2, 0.012, 0.2), (0.0, 0.0, 0.3))]
    interior = interior_of([("sign", lollipop, yaw_pose(0.7))])
    shapes, stand = bodies_of(interior)
    made = let_down(interior, shapes, stand, 0.45, NUDGE)
    assert len(made.laid) == 1
    assert made.toppling == []
    low = stand.low.copy()
    again = let_down(interior, shapes, stand, 0.45, NUDGE)
    assert not again.moves
    assert not again.toppling
    np.testing.assert_array_equal(stand.low, low)
