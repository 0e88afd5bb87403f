"""Tipping: what cannot stand turns until it rests on a face, what would fall over stays; and turns in traces."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from tasks.geometry.mass import mass_properties
from tasks.geometry.pieces import Hull, PieceConfig, convex_hull
from tasks.geometry.transforms import rotation_of, rotation_vector, translation, yaw_pose
from tasks.optimization.contacts import penetrations
from tasks.optimization.search.trace import Move, moved_poses
from tasks.optimization.shapes import Shapes, Stand, compiled, shapes_of, stand_of
from tasks.optimization.solids import ConvexParts
from tasks.optimization.support.tipping import SUNK_M, Tip, free_turn, tip, turn_along
from tasks.optimization.support.tipping import compiled as tipping_kernels
from tests.tasks.optimization.interiors import block, hull, world_vertices

Array = np.ndarray
seeds = st.integers(0, 10**6)
CONFIG = PieceConfig()
MOST = 0.45


def set_down(pieces: list[Hull], rotation: Array, below: list[ConvexParts] | None = None) -> tuple[Shapes, Stand]:
    """A body as it is turned, lowered onto the floor, or onto the bodies after it."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[2, 3] = 3.0
    others = below or []
    shapes = shapes_of([ConvexParts("thing", tuple(pieces)), *others], np.array([pose, *[np.eye(4)] * len(others)]))
    stand = stand_of(shapes, np.array([pose[:3, 3], *[np.zeros(3)] * len(others)]))
    among = np.arange(len(others) + 1) > 0
    gap, _ = compiled()["least_gap"](shapes, stand, 0, among, 0.01)
    stand.place[0, 2] -= min(gap, stand.low[0, 2])
    compiled()["bound"](shapes, stand, 0)
    return shapes, stand


def tipped(
    pieces: list[Hull], rotation: Array, most: float = MOST, below: list[ConvexParts] | None = None
) -> tuple[Tip | None, Shapes, Stand, Array]:
    """What tipping makes of a body, and its center of mass in the world frame [m] in the end."""
    shapes, stand = set_down(pieces, rotation, below)
    center = rotation @ mass_properties(pieces).center
    made = tip(shapes, stand, 0, center, np.arange(len(stand.low)) > 0, most)
    turn = np.eye(3) if made is None else made.rotation
    return made, shapes, stand, turn @ center + stand.place[0]


def base_of(vertices: Array, near: float = 1e-3) -> Array:
    """Lowest points in plan, shape (n, 2) [m]."""
    return vertices[vertices[:, 2] < vertices[:, 2].min() + near, :2]


def margin(points: Array, center: Array) -> float:
    """How far a point in plan lies inside the convex hull of others [m]; negative outside."""
    equations = ConvexHull(points).equations
    return -float((equations[:, :2] @ center[:2] + equations[:, 2]).max())


def about(axis: tuple[float, float, float], angle: float) -> Array:
    return Rotation.from_rotvec(np.array(axis) / np.linalg.norm(axis) * angle).as_matrix()


def prism(sides: int, length: float = 0.3, radius: float = 0.1) -> Hull:
    """A prism whose axis is x; at no turn it stands on an edge."""
    angles = 2 * np.pi * np.arange(sides) / sides - np.pi / 2
    ring = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return convex_hull(np.concatenate([np.column_stack([np.full(sides, x), ring]) for x in (0.0, length)]), CONFIG)


@pytest.mark.parametrize("off", [0.0, 1e-4, 0.1, -0.3, 0.5])
@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_a_hexagonal_prism_on_an_edge_tips_onto_a_face(off: float, yaw: float) -> None:
    """By the 30 degrees, less what it is off already, to the side to which it leans."""
    made, shapes, stand, center = tipped([prism(6)], about((0, 0, 1), yaw) @ about((1, 0, 0), off), most=0.6)
    assert made is not None
    vertices = world_vertices(shapes, stand, 0)
    lowest = np.sort(vertices[:, 2])[:4]
    assert np.ptp(lowest) < 1e-3
    assert abs(lowest[0]) < 1e-3
    turn = float(np.linalg.norm(rotation_vector(made.rotation)))
    assert turn == pytest.approx(np.pi / 6 - abs(off), abs=0.01)  # flat to 1 mm
    assert margin(base_of(vertices), center) > 0.04
    # rigid: distances to the place are what they were
    assert vertices == pytest.approx(prism(6).vertices @ (made.rotation @ about((0, 0, 1), yaw) @ about((1, 0, 0), off)).T + stand.place[0])


@pytest.mark.parametrize("seed", range(8))
def test_a_ball_of_triangles_comes_to_rest_on_one(seed: int) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.2)
    ball = convex_hull(np.asarray(mesh.vertices), CONFIG)
    made, shapes, stand, center = tipped([ball], Rotation.random(rng=np.random.default_rng(seed)).as_matrix(), most=0.6)
    assert made is not None
    vertices = world_vertices(shapes, stand, 0)
    assert len(base_of(vertices)) >= 3
    assert abs(vertices[:, 2].min()) < 1e-3
    assert margin(base_of(vertices), center) > -1e-3


@given(seeds)
@example(131072)  # a last turn of less than a tenth of a degree brings the second corner down
@settings(max_examples=25, deadline=None)
def test_whatever_leans_a_little_rests_flat_after(seed: int) -> None:
    """Boxes that were scanned a few degrees off lie on their face again, over which their mass is."""
    rng = np.random.default_rng(seed)
    box = hull(block(rng.uniform(0.15, 0.4, 3)))
    lean = about((np.cos(seed), np.sin(seed), 0.0), rng.uniform(0.0, 0.2))
    made, shapes, stand, center = tipped([box], about((0, 0, 1), rng.uniform(-3, 3)) @ lean)
    assert made is not None
    vertices = world_vertices(shapes, stand, 0)
    assert np.ptp(np.sort(vertices[:, 2])[:4]) < 1e-3
    assert abs(vertices[:, 2].min()) < 1e-3
    assert margin(base_of(vertices), center) > 0.05
    assert made.rotation @ made.rotation.T == pytest.approx(np.eye(3), abs=1e-12)


def test_what_would_tip_farther_stays_bit_for_bit() -> None:
    box = hull(block((0.3, 0.3, 0.3)))
    rotation = about((1, 0, 0), np.radians(40))
    shapes, stand = set_down([box], rotation)
    before = [a.copy() for a in (*shapes, *stand)]
    assert tip(shapes, stand, 0, rotation @ np.array([0.0, 0.0, 0.15]), np.zeros(1, dtype=np.bool_), MOST) is None
    assert all(np.array_equal(a, b) for a, b in zip((*shapes, *stand), before, strict=True))
    assert tipped([box], rotation, most=0.75)[0] is not None


@pytest.mark.parametrize("past", [-0.02, -0.005, 0.005, 0.05])
def test_a_box_stays_on_a_ledge_only_with_its_mass_over_it(past: float) -> None:
    table = ConvexParts("table", (hull(block((1.0, 1.0, 0.7))),))
    box = hull(block((0.2, 0.1, 0.2))).transformed(translation([0.5 + past, 0.0, 0.0]))
    made, _, stand, _ = tipped([box], np.eye(3), below=[table])
    assert stand.low[0, 2] == pytest.approx(0.7, abs=1e-9)
    assert (made is None) == (past > 0)
    if made is not None:
        assert np.array_equal(made.rotation, np.eye(3))
        assert np.abs(made.shift).max() < 1e-9


def test_a_board_tips_until_its_end_is_on_the_floor() -> None:
    """A board across a low beam, its mass beside it: the closed form is the right triangle under it."""
    height, reach = 0.06, 0.5
    beam = ConvexParts("beam", (hull(block((0.1, 1.0, height))).transformed(translation([-0.05, 0.0, 0.0])),))
    board = hull(block((0.8, 0.2, 0.02))).transformed(translation([0.1, 0.0, 0.0]))
    made, shapes, stand, center = tipped([board], np.eye(3), below=[beam])
    assert made is not None
    # the underside runs from the beam's edge at (0, 0.06) to the floor, 0.5 m along the board
    assert np.linalg.norm(rotation_vector(made.rotation)) == pytest.approx(np.arcsin(height / reach), abs=2e-3)
    vertices = world_vertices(shapes, stand, 0)
    assert abs(vertices[:, 2].min()) < 1e-3
    found = penetrations([ConvexParts("board", (Hull(vertices, board.faces),)), beam], np.tile(np.eye(4), (2, 1, 1)))
    assert max((p.depth_m for p in found), default=0.0) < 1e-3
    assert 0.0 < center[0] < vertices[:, 0].max()


def test_what_leans_against_a_wall_leans_on() -> None:
    wall = ConvexParts("wall", (hull(block((0.2, 2.0, 2.0))).transformed(translation([0.1 + 0.3, 0.0, 0.0])),))
    board = hull(block((0.03, 0.4, 1.0)))
    rotation = about((0, 1, 0), 0.15)
    shapes, stand = set_down([board], rotation, [wall])
    stand.place[0, 0] += 0.3 - stand.high[0, 0]
    compiled()["bound"](shapes, stand, 0)
    made = tip(shapes, stand, 0, rotation @ np.array([0.0, 0.0, 0.5]), np.array([False, True]), MOST)
    assert made is not None
    # it may slide by a centimeter, no more, and leans on
    assert np.linalg.norm(rotation_vector(made.rotation)) < 0.02
    assert np.hypot(*made.shift[:2]) < 0.03
    assert stand.high[0, 0] == pytest.approx(0.3, abs=1e-3)
    assert stand.low[0, 2] == pytest.approx(0.0, abs=1e-3)


def test_what_a_tipped_object_carries_turns_with_it() -> None:
    rng = np.random.default_rng(4)
    poses = np.array([yaw_pose(0.3, [0.1, 0.2, 1.0]), yaw_pose(-0.4, [0.15, 0.25, 1.2])])
    solids = [ConvexParts(f"{i:04d}", (hull(block(rng.uniform(0.1, 0.3, 3))),)) for i in range(2)]
    shapes = shapes_of(solids, poses)
    stand = stand_of(shapes, poses[:, :3, 3])
    stand.turn[:] = [np.cos(0.5), np.sin(0.5)]
    for body in range(2):
        compiled()["bound"](shapes, stand, body)
    before = [world_vertices(shapes, stand, i) for i in range(2)]
    made, origin = Tip(about((1, 2, 0), 0.2), np.array([0.01, 0.02, -0.03])), stand.place[0].copy()
    for body in range(2):
        turn_along(shapes, stand, body, made, origin)
        expected = (before[body] - origin) @ made.rotation.T + origin + made.shift
        assert world_vertices(shapes, stand, body) == pytest.approx(expected, abs=1e-12)
        assert stand.low[body] == pytest.approx(expected.min(axis=0), abs=1e-12)
        first, last = shapes.first_plane[body], shapes.first_plane[body + 1]
        local = shapes.vertices[shapes.first_vertex[body] : shapes.first_vertex[body + 1]]
        assert (local @ shapes.normals[first:last].T).max(axis=0) == pytest.approx(shapes.offsets[first:last], abs=1e-12)


# turns and moves as traces have them

vectors = st.tuples(*[st.floats(-1.7, 1.7)] * 3)


@given(vectors)
@settings(max_examples=200, deadline=None)
def test_rotation_vectors_go_there_and_back(turn: tuple[float, float, float]) -> None:
    rotation = rotation_of(turn)
    assert rotation == pytest.approx(Rotation.from_rotvec(turn).as_matrix(), abs=1e-12)
    if np.linalg.norm(turn) < np.pi - 1e-3:
        assert rotation_of(rotation_vector(rotation)) == pytest.approx(rotation, abs=1e-9)
        assert rotation_vector(rotation) == pytest.approx(turn, abs=1e-8)


def scene(seed: int) -> tuple[dict[str, Array], dict[str, str | None], list[tuple[str, Move]]]:
    """Objects, some on others, and moves of them."""
    rng = np.random.default_rng(seed)
    names = [f"{i:04d}" for i in range(7)]
    parents = {name: (names[int(rng.integers(0, i))] if i and rng.random() < 0.5 else None) for i, name in enumerate(names)}
    poses = {}
    for name in names:
        poses[name] = translation(rng.uniform(-2, 2, 3))
        poses[name][:3, :3] = Rotation.random(rng=rng).as_matrix()
    moves = [(str(rng.choice(names)), tuple((rng.uniform(-0.5, 0.5, 6) * (rng.random(6) < 0.7)).tolist())) for _ in range(12)]
    return poses, parents, moves  # type: ignore[return-value]


def root(name: str, parents: dict[str, str | None]) -> str:
    above = parents[name]
    return name if above is None else root(above, parents)


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_moves_are_rigid_and_groups_that_move_apart_do_not_touch_each_other(seed: int) -> None:
    poses, parents, moves = scene(seed)
    found = moved_poses(poses, parents, moves)
    # every move once more, as matrices: about the object's own origin, with all that it carries
    expected = {name: pose.copy() for name, pose in poses.items()}
    for name, (dx, dy, dz, *turn) in moves:
        about_own = translation(expected[name][:3, 3])
        step = np.eye(4)
        step[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        whole = translation([dx, dy, dz]) @ about_own @ step @ np.linalg.inv(about_own)
        for other in poses:
            above: str | None = other
            while above is not None and above != name:
                above = parents[above]
            if above == name:
                expected[other] = whole @ expected[other]
    for name in poses:
        assert found[name] == pytest.approx(expected[name], abs=1e-9)
    # moves of different groups commute, bit for bit: sorted by group they lead to the same
    again = moved_poses(poses, parents, sorted(moves, key=lambda move: root(move[0], parents)))
    assert all(np.array_equal(found[name], again[name]) for name in poses)


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_what_moves_together_keeps_its_relative_poses(seed: int) -> None:
    poses, parents, moves = scene(seed)
    whole = [(name, move) for name, move in moves if parents[name] is None]
    found = moved_poses(poses, parents, whole)
    for name in poses:
        first = root(name, parents)
        assert np.linalg.inv(found[first]) @ found[name] == pytest.approx(np.linalg.inv(poses[first]) @ poses[name], abs=1e-9)
        if first not in {n for n, _ in whole}:
            assert np.array_equal(found[name], poses[name])


@settings(max_examples=60, deadline=None)
@given(seed=seeds, least=st.sampled_from([0.0, 3e-5, 1e-3, 0.02]), bodies=st.integers(0, 5))
def test_what_sinks_is_what_has_a_gap_that_deep(seed: int, least: float, bodies: int) -> None:
    """Among heaps of blocks, some of them in two pieces, one on, in or beside the other."""
    rng = np.random.default_rng(seed)

    def thing(name: str) -> ConvexParts:
        sizes, places = rng.uniform(0.05, 0.3, (2, 3)), rng.uniform(-0.1, 0.1, (2, 3))
        return ConvexParts(name, tuple(block(tuple(sizes[i]), tuple(places[i])) for i in range(rng.integers(1, 3))))

    heap = [thing(str(i)) for i in range(bodies + 1)]
    poses = np.array([np.eye(4)] * (bodies + 1))
    poses[:, :3, :3] = [Rotation.from_euler("zx", (turn, lean)).as_matrix() for turn, lean in rng.normal(0.0, 0.2, (bodies + 1, 2))]
    poses[:, :3, 3] = np.array([0.0, 0.0, 0.3]) + rng.uniform(-0.2, 0.2, (bodies + 1, 3))
    shapes = shapes_of(heap, poses)
    stand = stand_of(shapes, poses[:, :3, 3])
    among = rng.random(bodies + 1) < 0.8
    gap, _ = compiled()["least_gap"](shapes, stand, 0, among, SUNK_M)
    assert tipping_kernels()["sinks"](shapes, stand, 0, among, SUNK_M, least) == (gap < -least)


@settings(max_examples=20, deadline=None)
@given(seed=seeds, least=st.sampled_from([0.002, 0.01, 0.1, 1.0]))
def test_an_angle_that_is_not_asked_for_is_only_known_to_be_less(seed: int, least: float) -> None:
    rng = np.random.default_rng(seed)
    wall = ConvexParts("wall", (block((0.02, 1.0, 1.0), (rng.uniform(0.1, 0.25), 0.0, 0.0)),))
    shapes, stand = set_down([block((0.2, 0.2, 0.2))], about((0, 0, 1), rng.uniform(0, 1)), [wall])
    asked = shapes, stand, 0, np.array([False, True]), np.array([0.1, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), 0.6
    exact, rough = free_turn(*asked), free_turn(*asked, least)
    assert rough == exact or max(rough, exact) <= least
