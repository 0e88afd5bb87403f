"""Vertical placement: objects come down onto what carries them, exactly, are drawn back from edges, and stay out of each other."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks.furniture import generate
from tasks.geometry.mass import mass_properties
from tasks.geometry.transforms import rotation_vector, translation, yaw_pose
from tasks.optimization.contacts import Colliders
from tasks.optimization.default import Default, resolve
from tasks.optimization.interior import Interior
from tasks.optimization.search.trace import Move
from tasks.optimization.shapes import Shapes, Stand
from tasks.optimization.support.balance import balance, draw_back
from tasks.optimization.support.resting import ROUNDING_M, Settling, center_of_mass, gap_to_carrier, let_down, put_to_rest, shift
from tasks.optimization.support.supports import SupportConfig
from tests.tasks.optimization.interiors import Object, block, bodies_of, interior_of, poses_after, world_vertices

Array = np.ndarray
seeds = st.integers(0, 10**6)
MOST = 0.45
SQUARE = ((-2, -2), (2, -2), (2, 2), (-2, 2))
TOP = 0.75


def table(x: float = 0.0, y: float = 0.0) -> Object:
    legs = [block((0.06, 0.06, TOP - 0.04), (a, b, 0.0)) for a in (-0.55, 0.55) for b in (-0.35, 0.35)]
    return "table", [block((1.2, 0.8, 0.04), (0.0, 0.0, TOP - 0.04)), *legs], translation([x, y, 0.0])


BOARDS = (0.02, 0.42, 0.82, 1.22)


def shelf() -> Object:
    sides = [block((0.3, 0.02, 1.3), (0.0, y, 0.0)) for y in (-0.41, 0.41)]
    return "shelf", [*(block((0.3, 0.8, 0.02), (0.0, 0.0, z - 0.02)) for z in BOARDS), *sides], translation([0.0, 0.0, 0.0])


def box(size: Sequence[float], x: float, y: float, z: float, yaw: float = 0.0, category: str = "box") -> Object:
    return category, [block(size)], yaw_pose(yaw, [x, y, z])


def lifted(interior: Interior, moves: Sequence[tuple[int, float]]) -> Array:
    return poses_after(interior, [(i, (0.0, 0.0, dz, 0.0, 0.0, 0.0)) for i, dz in moves])


def settled(interior: Interior, shapes: Shapes, stand: Stand, most: float = MOST) -> tuple[Settling, list[tuple[int, Move]]]:
    """What letting objects down does, and the same as moves of a trace."""
    made = let_down(interior, shapes, stand, most)
    return made, [(i, (*map(float, shift), *rotation_vector(rotation))) for i, shift, rotation in made.moves]


def check_same(interior: Interior, shapes: Shapes, stand: Stand, poses: Array) -> None:
    """The trace leads to where the bodies are."""
    for i, solid in enumerate(interior.solids):
        corners = np.concatenate([hull.vertices for hull in solid.placed(poses[i])])
        assert world_vertices(shapes, stand, i) == pytest.approx(corners, abs=5.0 * ROUNDING_M)


def deepest(interior: Interior, poses: Array) -> float:
    """Deepest exact penetration of objects in each other and in the floor [m]."""
    return max((p.depth_m for p in Colliders(interior.solids).penetrations(poses)), default=0.0)


def is_touching(interior: Interior, poses: Array, obj: int, within: float = 1e-3) -> bool:
    """Whether an object that is lowered by so much is in something else, or in the floor, deeper than before."""
    lowered = poses.copy()
    lowered[obj, 2, 3] -= within
    solids = Colliders(interior.solids)
    name = interior.names[obj]
    before, after = ({(p.a, p.b): p.depth_m for p in solids.penetrations(some) if name in (p.a, p.b)} for some in (poses, lowered))
    return any(depth > before.get(pair, 0.0) + 1e-6 for pair, depth in after.items())


# onto the carrier


@given(st.floats(-0.06, 0.09), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2), st.floats(-3, 3))
@settings(max_examples=25, deadline=None)
def test_a_box_comes_down_onto_its_table_and_not_through_it(gap: float, x: float, y: float, yaw: float) -> None:
    interior = interior_of([table(), box((0.2, 0.15, 0.1), x, y, TOP + gap, yaw)])
    assert interior.parent.tolist() == [-1, 0]
    shapes, stand = bodies_of(interior)
    poses = lifted(interior, put_to_rest(interior, shapes, stand))
    exact = 1e-9 if abs(gap) > 2 * ROUNDING_M else ROUNDING_M  # what is off by rounding is left alone
    assert stand.low[1, 2] == pytest.approx(stand.high[0, 2], abs=exact)
    assert stand.low[0, 2] == pytest.approx(0.0, abs=1e-9)
    assert deepest(interior, poses) < exact
    assert is_touching(interior, poses, 1, 1e-5)
    check_same(interior, shapes, stand, poses)
    assert gap_to_carrier(interior, shapes, stand, 1)[0] == pytest.approx(0.0, abs=exact)
    again = interior_again(interior, poses)
    assert not let_down(again, *bodies_of(again), MOST).moves  # what rests, rests


def interior_again(interior: Interior, poses: Array) -> Interior:
    return dataclasses.replace(interior, poses=poses)


@pytest.mark.parametrize("board", [0, 1, 2])
@pytest.mark.parametrize("gap", [-0.04, -0.003, 0.0, 0.06])
def test_a_book_comes_to_rest_on_the_board_of_its_compartment(board: int, gap: float) -> None:
    interior = interior_of([shelf(), box((0.15, 0.05, 0.22), 0.02, 0.1, BOARDS[board] + gap, 0.2, "book")])
    assert interior.parent.tolist() == [-1, 0]
    shapes, stand = bodies_of(interior)
    poses = lifted(interior, put_to_rest(interior, shapes, stand))
    assert stand.low[1, 2] == pytest.approx(BOARDS[board], abs=1e-7)  # boards are float32 in the file
    assert deepest(interior, poses) < 1e-7
    made, moves = settled(interior, shapes, stand)
    assert not made.hanging
    assert not made.toppling
    assert stand.low[1, 2] == pytest.approx(BOARDS[board], abs=1e-7)
    check_same(interior, shapes, stand, poses_after(interior_again(interior, poses), moves))


def test_generated_objects_rest_on_generated_tables() -> None:
    """Many pieces, round tops, cups with feet: exact contact all the same."""
    for seed, (below, above) in enumerate((("table", "mug"), ("desk", "lamp"), ("cabinet", "plant"), ("table", "bottle"))):
        rng = np.random.default_rng(seed)
        first, second = generate(below, None, rng), generate(above, None, rng)
        top = max(part.bounds[1, 2] for part in first.parts)
        obj = (above, second.pieces, yaw_pose(rng.uniform(-3, 3), [0.05, 0.02, top + 0.03]))
        interior = interior_of([(below, first.pieces, np.eye(4)), obj])
        child = interior.names.index("0001")
        assert interior.parent[child] >= 0
        shapes, stand = bodies_of(interior)
        poses = lifted(interior, put_to_rest(interior, shapes, stand))
        assert gap_to_carrier(interior, shapes, stand, child)[0] == pytest.approx(0.0, abs=1e-9)
        assert deepest(interior, poses) < 1e-7
        assert is_touching(interior, poses, child)


def test_what_is_carried_comes_down_with_its_carrier() -> None:
    objects = [
        ("table", table()[1], translation([0, 0, 0.06])),
        box((0.4, 0.3, 0.1), 0, 0, TOP + 0.08),
        box((0.2, 0.2, 0.2), 0, 0, TOP + 0.17),
    ]
    interior = interior_of(objects)
    assert interior.parent.tolist() == [-1, 0, 1]
    shapes, stand = bodies_of(interior)
    poses = lifted(interior, put_to_rest(interior, shapes, stand))
    assert stand.low[:, 2] == pytest.approx([0.0, TOP, TOP + 0.1], abs=1e-7)
    check_same(interior, shapes, stand, poses)


# balance


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_the_margin_is_the_distance_to_the_hull(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, center = rng.normal(size=(int(rng.integers(3, 20)), 2)), rng.normal(size=2)
    hull = shapely.MultiPoint(points).convex_hull
    away = shapely.Point(center).distance(hull.exterior)
    margin, inward = balance(points, center)
    assert margin == pytest.approx(away if hull.covers(shapely.Point(center)) else -away, abs=1e-9)
    assert np.linalg.norm(inward) == pytest.approx(1.0, abs=1e-9)
    moved, _ = balance(points, center + 1e-4 * inward)
    assert moved > margin + 0.5e-4 or margin > 0.99 * max(balance(points, p)[0] for p in rng.normal(size=(500, 2)))


@pytest.mark.parametrize("past", [-0.03, -0.005, 0.0, 0.004, 0.02])
@pytest.mark.parametrize("yaw", [0.0, 0.8])
def test_what_stands_at_an_edge_is_drawn_back_from_it(past: float, yaw: float) -> None:
    interior = interior_of([table(), box((0.2, 0.14, 0.1), 0.6 + past, 0.1, TOP, yaw)])
    assert interior.parent.tolist() == [-1, 0]
    shapes, stand = bodies_of(interior)
    put_to_rest(interior, shapes, stand)
    before = stand.place[1].copy()
    moves = draw_back(interior, shapes, stand)
    inside = 0.6 - stand.place[1, 0]
    if past < -0.015 - 1e-6:
        assert not moves
        assert np.array_equal(before, stand.place[1])
    else:
        assert [i for i, _ in moves] == [1]
        assert 0.015 - 1e-6 <= inside <= 0.03
        assert moves[0][1] == pytest.approx(tuple((stand.place[1] - before)[:2]), abs=1e-12)
    made, _ = settled(interior, shapes, stand)
    assert not made.toppling
    assert not made.hanging
    assert all(np.array_equal(rotation, np.eye(3)) for _, _, rotation in made.moves)
    assert stand.low[1, 2] == pytest.approx(TOP, abs=1e-7)


def test_nothing_is_drawn_across_its_carrier_to_a_bump() -> None:
    """A platform with one corner 2 cm higher: an armchair in its middle touches nothing else, and stays in its middle."""
    platform = ("platform", [block((2.0, 1.4, 0.2)), block((0.2, 0.2, 0.02), (0.85, 0.55, 0.2))], translation([0.0, 0.0, 0.0]))
    interior = interior_of([platform, box((1.9, 1.2, 0.7), 0.0, 0.0, 0.22, category="armchair")])
    shapes, stand = bodies_of(interior)
    before = stand.place.copy()
    put_to_rest(interior, shapes, stand)
    assert draw_back(interior, shapes, stand) == []
    assert np.array_equal(stand.place[:, :2], before[:, :2])


def test_what_is_not_drawn_back_would_fall_and_is_said_to() -> None:
    interior = interior_of([table(), box((0.2, 0.14, 0.1), 0.61, 0.1, TOP)])
    shapes, stand = bodies_of(interior)
    before = world_vertices(shapes, stand, 1)
    made, moves = settled(interior, shapes, stand)
    assert made.toppling == [1]
    assert world_vertices(shapes, stand, 1) == pytest.approx(before, abs=1e-7)
    check_same(interior, shapes, stand, poses_after(interior, moves))


def test_a_box_on_its_edge_stays_and_is_said_to_topple() -> None:
    pose = translation([0.0, 0.0, 0.0])
    pose[:3, :3] = Rotation.from_rotvec([np.radians(40), 0, 0]).as_matrix()
    interior = interior_of([("box", [block((0.4, 0.4, 0.4))], pose)])
    shapes, stand = bodies_of(interior)
    put_to_rest(interior, shapes, stand)
    made, moves = settled(interior, shapes, stand)
    assert made.toppling == [0]
    assert all(np.array_equal(rotation, np.eye(3)) for _, _, rotation in made.moves)
    assert stand.low[0, 2] == pytest.approx(0.0, abs=1e-9)
    assert poses_after(interior, moves)[0, :3, :3] == pytest.approx(pose[:3, :3], abs=1e-12)


def test_a_box_that_leans_a_little_is_set_flat_with_what_it_carries() -> None:
    lean = np.eye(4)
    lean[:3, :3] = Rotation.from_rotvec([0.06, 0.03, 0.0]).as_matrix()
    upper = lean @ translation([0.02, 0.03, 0.3])
    interior = interior_of([("cabinet", [block((0.5, 0.4, 0.3))], lean), ("box", [block((0.2, 0.2, 0.1))], upper)])
    assert interior.parent.tolist() == [-1, 0]
    shapes, stand = bodies_of(interior)
    rests = [(i, (0.0, 0.0, dz, 0.0, 0.0, 0.0)) for i, dz in put_to_rest(interior, shapes, stand)]
    made, moves = settled(interior, shapes, stand)
    assert not made.toppling
    poses = poses_after(interior, [*rests, *moves])
    check_same(interior, shapes, stand, poses)
    assert poses[:, 2, 2] == pytest.approx([1.0, 1.0], abs=1e-4)
    assert stand.low[:, 2] == pytest.approx([0.0, 0.3], abs=2e-3)
    assert deepest(interior, poses) < 1e-3
    assert np.linalg.inv(poses[0]) @ poses[1] == pytest.approx(np.linalg.inv(lean) @ upper, abs=0.02)


def test_a_stack_that_leans_stands_as_long_as_each_is_over_the_one_below() -> None:
    for step, stands in ((0.04, True), (0.09, True), (0.12, False)):  # of boxes 20 cm wide
        interior = interior_of([box((0.2, 0.2, 0.2), step * i, 0.0, 0.2 * i) for i in range(4)])
        assert interior.parent.tolist() == [-1, 0, 1, 2]
        shapes, stand = bodies_of(interior)
        made, _ = settled(interior, shapes, stand)
        assert bool(made.toppling) != stands
        if stands:
            assert stand.low[:, 2] == pytest.approx(0.2 * np.arange(4), abs=1e-6)
            assert all(np.array_equal(rotation, np.eye(3)) for _, _, rotation in made.moves)


def test_what_lost_its_carrier_hangs_and_is_said_to() -> None:
    interior = interior_of([table(), box((0.2, 0.2, 0.1), 0.0, 0.0, TOP)])
    shapes, stand = bodies_of(interior)
    stand.place[1, 0] += 1.5  # as a chain would never
    shift(shapes, stand, [1], (0.0, 0.0, 0.0))
    made, _ = settled(interior, shapes, stand)
    assert made.hanging == {1: pytest.approx(TOP, abs=1e-6)}


# piles


def pile(seed: int, count: int) -> list[Object]:
    """Boxes turned about the upright axis, each a little over the highest below it, none in another."""
    rng = np.random.default_rng(seed)
    objects: list[Object] = []
    blocks: list[tuple[Array, float, float]] = []
    for _ in range(count):
        size = rng.uniform(0.08, 0.35, 3)
        x, y, yaw = *rng.uniform(-0.3, 0.3, 2), rng.uniform(-3, 3)
        half = 0.5 * float(np.hypot(size[0], size[1]))
        low = 0.0
        for other, radius, top in blocks:
            if np.hypot(*(other - (x, y))) < half + radius:
                low = max(low, top)
        low += rng.uniform(0.0, 0.05)
        blocks.append((np.array([x, y]), half, low + size[2]))
        objects.append(box(size.tolist(), x, y, low, yaw))
    return objects


@pytest.mark.whole
@given(seeds)
@example(16942)  # a box is put elsewhere as a last resort, and what leaned on it cannot stand any more
@settings(max_examples=30, deadline=None)
def test_piles_of_boxes_come_to_rest(seed: int) -> None:
    """Nothing is in anything deeper than 1 mm, and all that stands touches something within 1 mm."""
    interior = interior_of(pile(seed, 6), SQUARE)
    method = Default(chains=2, max_moves=6000)
    made = resolve(
        interior, method, SupportConfig(), lambda *words: np.random.default_rng([seed, words[-1]]), lambda f, jobs: [f(job) for job in jobs]
    )
    index = {name: i for i, name in enumerate(interior.names)}
    poses = poses_after(interior, [(index[step.name], step.move) for step in made.steps])
    tipped = {step.name for step in made.steps if step.outcome == "tipped"}
    if made.final == 0.0 and not tipped & {
        carrier.parent_id for carrier in interior.carriers
    }:  # what is carried may be turned into a neighbor
        assert deepest(interior, poses) < 1e-3
    for i, carrier in enumerate(interior.carriers):
        assert carrier.relation == "none" or interior.names[i] in made.problems or is_touching(interior, poses, i)
    assert poses[:, 2, 2].min() > np.cos(method.most_tilt_radians) - 1e-9
    if tipped:
        return
    # where nothing leaned, everything has its mass over what it stands on: let down once more, it stays
    again = interior_again(interior, poses)
    calm = let_down(again, *bodies_of(again), method.most_tilt_radians)
    said = {index[name] for name in made.problems}
    assert set(calm.toppling) | set(calm.hanging) <= said
    for i, move, rotation in calm.moves:
        assert i in said or (np.abs(move).max() < 1e-3 and np.abs(rotation - np.eye(3)).max() < 5e-3)


def test_what_comes_to_stand_on_a_neighbor_is_held_up_while_its_carrier_goes_down() -> None:
    """A plank on a high box that is let down by 3 cm meets a lower box after 1 cm."""
    high, low = box((0.4, 0.4, 0.5), 0.0, 0.0, 0.03), box((0.1, 0.4, 0.52), 0.3, 0.0, 0.0)
    plank, cup = box((0.75, 0.3, 0.02), 0.1, 0.0, 0.53), box((0.05, 0.05, 0.1), 0.1, 0.0, 0.55, category="mug")
    interior = interior_of([high, low, plank, cup])
    names = {name: i for i, name in enumerate(interior.names)}
    assert [interior.carriers[names[n]].parent_id for n in ("0002", "0003")] == ["0000", "0002"]
    shapes, stand = bodies_of(interior)
    made, moves = settled(interior, shapes, stand)
    poses = poses_after(interior, moves)
    check_same(interior, shapes, stand, poses)
    assert not made.hanging
    assert stand.low[names["0000"], 2] == pytest.approx(0.0, abs=1e-6)
    assert deepest(interior, poses) < 1e-3
    assert stand.high[names["0002"], 2] > 0.53  # it leans from the one to the other
    assert all(is_touching(interior, poses, i) for i in range(4))


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_the_same_pile_comes_to_rest_the_same_way_every_time(seed: int) -> None:
    objects = pile(seed, 4)
    first, again = interior_of(objects), interior_of(objects)
    made = [let_down(one, *bodies_of(one), MOST) for one in (first, again)]
    assert [(i, a.tobytes(), b.tobytes()) for i, a, b in made[0].moves] == [(i, a.tobytes(), b.tobytes()) for i, a, b in made[1].moves]


def test_centers_of_mass_are_those_of_the_pieces() -> None:
    cone = trimesh.creation.cone(0.2, 0.6, sections=16)
    pose = yaw_pose(0.7, [0.3, 0.4, 0.0])
    interior = interior_of([("cone", [cone], pose)])
    expected = pose[:3, :3] @ mass_properties(interior.solids[0].hulls).center
    assert center_of_mass(interior, 0) == pytest.approx(expected, abs=1e-12)
    assert expected[2] == pytest.approx(0.15, abs=1e-3)
