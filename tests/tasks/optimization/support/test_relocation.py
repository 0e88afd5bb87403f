"""The last resort: what is still in something else is put at the nearest place that is free, and what made it necessary."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.optimization import APPLIED
from tasks.geometry.transforms import matrix, translation, yaw_pose
from tasks.optimization import Default, replayed_poses
from tasks.optimization.colliders.seams import SUNK_M
from tasks.optimization.contacts import Colliders
from tasks.optimization.default import arrangement_of
from tasks.optimization.interior import Interior
from tasks.optimization.support.relocation import LastResort, last_resort, moves_of, relocate
from tasks.optimization.support.resting import DEEP_M, Settling, let_down, lost_supports
from tasks.optimization.support.supports import SupportConfig
from tasks.stage import Outcome
from tests.tasks.optimization.interiors import Object, block, bodies_of, interior_of, poses_after
from tests.tasks.optimization.scenes import SHELF, Scene, bounds, collider_bounds, poses_of, remains
from tests.tasks.optimization.support.test_resting import SQUARE, TOP, box, shelf, table

Array = np.ndarray
SLOP, MOST = 0.0002, 0.45


def put_apart(objects: list[Object], polygon: tuple[tuple[float, float], ...] | None = SQUARE) -> tuple[Interior, LastResort, Array]:
    """Objects as proposed, without any other step before: the last resort, and the poses that it leads to."""
    interior = interior_of(objects, polygon)
    shapes, stand = bodies_of(interior)
    room = arrangement_of(interior, interior.solids, shapes, stand, SupportConfig())
    made = last_resort(interior, interior.solids, room, stand, Settling([], set(), {}, []), SLOP, MOST)
    return interior, made, poses_after(interior, [(i, move) for i, move, _ in made.moves])


def deep(interior: Interior, poses: Array, within: float = DEEP_M) -> list[tuple[str, str]]:
    """Pairs of objects deeper in each other, or in the floor, than that [m]."""
    return [(p.a, p.b) for p in Colliders(interior.solids).penetrations(poses) if p.depth_m > within]


def follows(outcome: Outcome) -> None:
    """The steps lead to the optimized poses, bit for bit."""
    poses = replayed_poses(*(outcome.rows[table] for table in ("placements", "supports", "optimization_steps")))
    for row in outcome.rows["placements"]:
        assert np.array_equal(poses[row.instance_id], matrix(row.optimized_pose))


# what made it necessary


@pytest.mark.parametrize("raised", [0.0, 0.04, 0.095])
@pytest.mark.parametrize("wall", [0.004, 0.01, 0.05])
def test_a_bin_with_a_thin_bottom_comes_down_onto_a_rug_and_not_through_it(raised: float, wall: float) -> None:
    """However thin its bottom is, compared to the rug's 12 mm."""
    scene = Scene()
    rug = scene.add([block((1.5, 2.2, 0.012))], np.eye(4), "rug")
    sides = [
        block((w, d, 0.3), (x, y, wall))
        for w, d, x, y in ((0.4, 0.02, 0, 0.24), (0.4, 0.02, 0, -0.24), (0.02, 0.5, 0.19, 0), (0.02, 0.5, -0.19, 0))
    ]
    parts = [block((0.4, 0.5, wall)), *sides]
    bin_ = scene.add(parts, translation([0.5, 1.25, raised]), "storage bin", known=parts)  # less than half of it on the rug
    outcome = scene.run()
    assert not [c for c in outcome.rows["contacts"] if c.phase == "optimized" and c.penetration_m > 0.001]
    assert remains(outcome) == {rug: None, bin_: None}
    assert 0.0 <= bounds(outcome, scene)[bin_][0, 2] <= 0.012
    assert bounds(outcome, scene)[bin_][1, 2] > 0.3 + wall + 0.005, "one side of it stands on the rug"
    assert all(row.is_stable_1cm for row in outcome.rows["certificates"])
    assert not [step for step in outcome.rows["optimization_steps"] if step.outcome == "relocated"]


@pytest.mark.whole
@given(sunk=st.floats(0.0, 0.1), bottom=st.floats(0.03, 0.09), y=st.floats(-0.25, 0.25), gap=st.floats(-0.005, 0.005))
@settings(max_examples=20, deadline=None)
def test_what_stands_in_a_sunk_shelf_comes_up_with_it(sunk: float, bottom: float, y: float, gap: float) -> None:
    """Even where it is at the floor's height before the shelf is raised. A shelf that sank deeper stays, and ends at the floor."""
    boards = [block((0.3, 0.8, 0.02), (0.0, 0.0, z)) for z in (bottom - 0.02, 0.6, 1.28)]
    parts = [*boards, *(block((0.3, 0.02, 1.3), (0.0, side, 0.0)) for side in (-0.41, 0.41))]
    scene = Scene()
    case = scene.add(parts, translation([0.0, 0.0, -sunk]), "bookshelf", known=parts)
    book = scene.add([block((0.16, 0.2, 0.03))], translation([0.0, y, bottom - sunk + gap]), "book")
    outcome = scene.run()
    supports = {row.instance_id: row for row in outcome.rows["supports"]}
    assert (supports[book].relation, supports[book].parent_id) == ("inside", case)
    boxes = bounds(outcome, scene)
    level = -sunk if sunk > SUNK_M else 0.0
    assert boxes[case][0, 2] == pytest.approx(level, abs=2e-4)
    assert collider_bounds(outcome, scene)[case][0, 2] == pytest.approx(0.0, abs=2e-4)
    assert boxes[book][0, 2] == pytest.approx(max(bottom + level, 0.0), abs=2e-4)
    is_board_gone = bottom + level < 0.003  # below the floor: the book stands on that, in the shelf
    assert set(remains(outcome).values()) <= {None, *(["what carried it carries it no more"] if is_board_gone else [])}


def test_what_stands_on_the_floor_beside_a_sunk_shelf_stays_there() -> None:
    scene = Scene()
    scene.add(SHELF, translation([0.0, 0.0, -0.08]), "bookshelf")
    book = scene.add([block((0.16, 0.2, 0.03))], translation([0.4, 0.0, -0.01]), "book")
    outcome = scene.run()
    assert {row.instance_id: row.relation for row in outcome.rows["supports"]}[book] == "floor"
    assert bounds(outcome, scene)[book][0, 2] == pytest.approx(0.0, abs=2e-4)


# the last resort


def test_the_smaller_of_two_goes_the_shortest_way_with_all_it_carries() -> None:
    interior, made, poses = put_apart([table(), box((0.5, 0.5, 1.0), 0.7, 0.0, 0.0), box((0.1, 0.1, 0.1), 0.75, 0.1, 1.0, category="mug")])
    assert interior.parent.tolist() == [-1, -1, 1]
    moved = [(i, outcome) for i, _, outcome in made.moves]
    assert (1, "relocated") in moved
    assert {i for i, _ in moved} == {1}
    assert not deep(interior, poses, 1e-3)
    way = poses[1, :3, 3] - interior.poses[1, :3, 3]
    assert np.hypot(*way[:2]) == pytest.approx(0.15, abs=0.02), "out of the table's edge at 0.6 m, in steps of 2 cm"
    assert poses[2, :3, 3] - interior.poses[2, :3, 3] == pytest.approx(way, abs=1e-9), "the mug comes along"
    assert made.reasons == {1: f"moved by {np.hypot(*way[:2]):.2f} m: no room for it where it was"}


def test_what_is_fixed_stays_and_the_larger_goes() -> None:
    interior, made, poses = put_apart([box((0.4, 0.4, 0.4), 0.0, 0.0, 0.0, category="toilet"), box((0.9, 0.9, 0.9), 0.4, 0.0, 0.0)])
    assert interior.fixed.tolist() == [True, False]
    assert np.array_equal(poses[0], interior.poses[0])
    assert list(made.reasons) == [1]
    assert not deep(interior, poses)


def test_an_object_stays_on_its_table_while_there_is_room() -> None:
    interior, made, poses = put_apart([table(), box((0.3, 0.3, 0.3), 0.0, 0.0, TOP), box((0.1, 0.1, 0.1), 0.05, 0.0, TOP)])
    assert interior.parent.tolist() == [-1, 0, 0]
    assert list(made.reasons) == [2]
    assert "onto the floor" not in made.reasons[2]
    assert poses[2, 2, 3] == pytest.approx(TOP, abs=1e-3)
    assert not deep(interior, poses, 1e-3)
    assert not lost_supports(interior, poses)


def test_a_book_stays_in_its_compartment() -> None:
    interior, made, poses = put_apart([shelf(), box((0.2, 0.3, 0.2), 0.0, 0.0, 0.42), box((0.15, 0.1, 0.15), 0.0, 0.05, 0.42)])
    assert interior.parent.tolist() == [-1, 0, 0]
    assert list(made.reasons) == [2]
    assert poses[2, 2, 3] == pytest.approx(0.42, abs=1e-3), "not on the board above, nor on the floor"
    assert not deep(interior, poses, 1e-3)


def test_what_fits_nowhere_on_its_carrier_goes_to_the_floor_and_that_is_known() -> None:
    interior, made, poses = put_apart([table(), box((1.2, 0.8, 0.3), 0.0, 0.0, TOP), box((0.2, 0.2, 0.1), 0.1, 0.0, TOP)])
    assert interior.parent.tolist() == [-1, 0, 0]
    assert list(made.reasons) == [2]
    assert "onto the floor: no room for it where it was" in made.reasons[2]
    assert poses[2, 2, 3] == pytest.approx(0.0, abs=1e-3)
    assert not deep(interior, poses, 1e-3)
    assert lost_supports(interior, poses) == {"0002"}


def test_what_fits_nowhere_stays_and_is_reported() -> None:
    small = tuple((0.25 * x, 0.25 * y) for x, y in SQUARE)
    interior, made, poses = put_apart([box((0.9, 0.9, 0.5), 0.0, 0.0, 0.0), box((0.8, 0.8, 0.5), 0.05, 0.0, 0.0)], small)
    assert not made.moves
    assert not made.reasons
    assert np.array_equal(poses, interior.poses)
    assert deep(interior, poses)


def test_objects_that_are_only_just_apart_or_touch_are_left_alone() -> None:
    interior, made, poses = put_apart([table(), box((0.3, 0.3, 0.3), 0.0, 0.0, TOP), box((0.5, 0.5, 0.5), 0.849, 0.0, 0.0)])
    assert not made.moves
    assert np.array_equal(poses, interior.poses)


@st.composite
def crowds(draw: st.DrawFn) -> list[Object]:
    """Boxes on the floor and on a table, any of them in any other."""
    place = st.floats(-1.2, 1.2)
    objects = [table(draw(place), draw(place))]
    for _ in range(draw(st.integers(1, 5))):
        size = [draw(st.floats(0.1, 0.6)) for _ in range(3)]
        objects.append(box(size, draw(place), draw(place), draw(st.sampled_from([0.0, TOP])), draw(st.floats(-3, 3))))
    return objects


@given(crowds())
@settings(max_examples=25, deadline=None)
def test_a_crowd_with_room_around_it_is_taken_apart(objects: list[Object]) -> None:
    """No pair deeper than 2 mm is left of objects that nothing carries into each other, nothing leaves the room, and what had
    no part in it stays where it was; the same again gives the same."""
    interior = interior_of(objects, SQUARE)
    shapes, stand = bodies_of(interior)
    settled = moves_of(let_down(interior, shapes, stand, MOST))
    room = arrangement_of(interior, interior.solids, shapes, stand, SupportConfig())
    made = relocate(interior, interior.solids, room, stand, SLOP, MOST)
    moves = [(i, move) for i, move, _ in settled]
    before = poses_after(interior, moves)
    for one in made:
        moves.append((one.obj, (*map(float, one.shift), 0.0, 0.0, 0.0)))
        assert one.on_floor <= (interior.parent[one.obj] >= 0)
    tipped = any(np.abs(one.rotation - np.eye(3)).max() > 0 for one in made)
    after = poses_after(interior, moves)
    names = {interior.names[one.obj] for one in made}
    wrong = {name for pair in deep(interior, before) for name in pair}
    assert names <= wrong
    moved = {j for one in made for j in interior.groups()[one.obj]}
    for i in set(range(len(objects))) - moved:
        assert np.array_equal(after[i], before[i])
    if tipped:
        return
    groups = interior.groups()
    index = {name: i for i, name in enumerate(interior.names)}
    for a, b in deep(interior, after):
        assert b != "floor"
        assert index[b] in groups[index[a]] or index[a] in groups[index[b]], "only what one carries moves along with it"
    for i in moved:
        corners = np.concatenate([hull.vertices for hull in interior.solids[i].placed(after[i])])
        assert np.abs(corners[:, :2]).max() <= 2.0 + 1e-6
    again_shapes, again = bodies_of(interior)
    let_down(interior, again_shapes, again, MOST)
    room = arrangement_of(interior, interior.solids, again_shapes, again, SupportConfig())
    for one, other in zip(made, relocate(interior, interior.solids, room, again, SLOP, MOST), strict=True):
        assert one.obj == other.obj
        assert np.array_equal(one.shift, other.shift)


# in the stage


def test_a_move_of_the_last_resort_is_told_and_can_be_replayed() -> None:
    """Chains that are given two moves leave two boxes in each other."""
    scene = Scene()
    large = scene.add([block((0.9, 0.9, 0.5))], np.eye(4), "cabinet")
    small = scene.add([block((0.72, 0.72, 0.5))], yaw_pose(0.1, [0.0, 0.01, 0.0]), "box")
    on_it = scene.add([block((0.1, 0.1, 0.1))], translation([0.1, 0.2, 0.5]), "mug")
    outcome = scene.run(Default(max_moves=2, chains=1, most_way_m=10.0))
    (summary,) = outcome.rows["optimizations"]
    assert summary.deep_pairs == 0
    assert (summary.ended, summary.loss_final) == ("zero_loss", 0.0)
    assert "relocated" in APPLIED
    assert [step.instance_id for step in outcome.rows["optimization_steps"] if step.outcome == "relocated"] == [small]
    told = remains(outcome)
    way = (poses_of(outcome)[small] - poses_of(outcome, "proposed")[small])[:2, 3]
    assert (told[large], told[on_it]) == (None, None)
    said = float((told[small] or "").removeprefix("moved by ").removesuffix(" m: no room for it where it was"))
    assert math.hypot(*way) == pytest.approx(said, abs=0.1), "the chain's two moves come before"
    assert f"{small}: {told[small]}" in outcome.degradations
    follows(outcome)
    assert scene.run(Default(max_moves=2, chains=1)).rows == outcome.rows
