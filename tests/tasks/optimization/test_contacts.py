"""Contacts: penetration depths against every axis tried one by one, closed forms, and what must not change them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks.furniture import generate
from tasks.geometry.pieces import Hull, PieceConfig, convex_hull, pieces
from tasks.geometry.transforms import translation, yaw_pose
from tasks.optimization.contacts import Colliders, Penetration, penetrations
from tasks.optimization.solids import ConvexParts, shell_solids
from tests.replicas import room_of

Array = np.ndarray
seeds = st.integers(0, 10**6)
CONFIG = PieceConfig()
ROOM = room_of()


def box(size: tuple[float, float, float], at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Hull:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return convex_hull(corners * size + at, CONFIG)


def cloud(rng: np.random.Generator, reach: float = 0.3) -> Hull:
    return convex_hull(rng.normal(size=(int(rng.integers(4, 50)), 3)) * rng.uniform(0.1, 1.0, 3) * reach, CONFIG)


def rigid(rng: np.random.Generator, reach: float, height: float = 10.0) -> Array:
    pose = translation([*rng.uniform(-reach, reach, 2), height + rng.uniform(-reach, reach)])
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    return pose


def exact_depth(a: Hull, b: Hull) -> float:
    """Least overlap of two hulls' shadows over all face normals of both and all cross products of their edges, both ways [m]."""
    axes = []
    for hull in (a, b):
        corners = hull.vertices[hull.faces]
        axes.append(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    first, second = (np.concatenate([h.vertices[h.faces[:, k]] - h.vertices[h.faces[:, k - 1]] for k in range(3)]) for h in (a, b))
    lengths = np.linalg.norm(first, axis=1)[:, None] * np.linalg.norm(second, axis=1)[None]
    crosses = np.cross(first[:, None], second[None])
    axes.append(crosses[np.linalg.norm(crosses, axis=2) > 1e-9 * lengths])
    directions = np.concatenate(axes)
    norms = np.linalg.norm(directions, axis=1)
    directions = directions[norms > 1e-14] / norms[norms > 1e-14][:, None]
    one, other = a.vertices @ directions.T, b.vertices @ directions.T
    return float(np.minimum(one.max(0) - other.min(0), other.max(0) - one.min(0)).min())


def of_two(a: Hull, b: Hull, pose_a: Array | None = None, pose_b: Array | None = None) -> Penetration | None:
    """What is found of two single pieces, by default high above the floor."""
    high = translation([0.0, 0.0, 10.0])
    poses = np.array([high if pose is None else pose for pose in (pose_a, pose_b)])
    found = [c for c in penetrations([ConvexParts("0000", (a,)), ConvexParts("0001", (b,))], poses) if c.b != "floor"]
    assert len(found) <= 1
    return found[0] if found else None


def depth_of(found: Penetration | None) -> float:
    return found.depth_m if found else 0.0


@given(seeds)
@settings(max_examples=150, deadline=None)
def test_depths_equal_those_of_all_axes_tried_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = cloud(rng), cloud(rng)
    poses = [rigid(rng, 0.25), rigid(rng, 0.25)]
    expected = exact_depth(a.transformed(poses[0]), b.transformed(poses[1]))
    found = of_two(a, b, *poses)
    assert depth_of(found) == pytest.approx(max(expected, 0.0), abs=2e-6 if expected < 2e-6 else 1e-11)
    if found:  # the direction parts them, and a hair less does not
        assert np.linalg.norm(found.direction) == pytest.approx(1.0)
        for share, sign in ((1.0 + 1e-9, -1), (1.0 - 1e-6, 1)):
            moved = translation(np.array(found.direction) * found.depth_m * share) @ poses[0]
            assert sign * exact_depth(a.transformed(moved), b.transformed(poses[1])) > -1e-9


@given(seeds)
@settings(max_examples=150, deadline=None)
def test_boxes_on_a_grid_have_the_closed_form(seed: int) -> None:
    """Faces that touch, edges that coincide, boxes within boxes, equal boxes: all that is degenerate."""
    rng = np.random.default_rng(seed)
    sizes, centers = rng.integers(1, 6, (2, 3)) * 0.1, rng.integers(-4, 5, (2, 3)) * 0.05
    apart = sizes.sum(axis=0) / 2 - np.abs(centers[0] - centers[1])
    found = of_two(*(box(tuple(s)) for s in sizes), *(translation([*c[:2], c[2] + 10]) for c in centers))
    assert depth_of(found) == pytest.approx(max(float(apart.min()), 0.0), abs=1e-12)
    assert (found is None) == (apart.min() < 1e-9)


@given(seeds, st.floats(1e-9, 1e-2))
@settings(max_examples=100, deadline=None)
def test_what_rests_on_a_board_is_as_deep_as_it_sinks(seed: int, sink: float) -> None:
    """Flat on flat, turned about the upright axis, a board thinner or thicker than what stands on it."""
    rng = np.random.default_rng(seed)
    board, obj = box((1.2, 0.8, float(rng.choice([0.03, 0.5])))), box(tuple(rng.uniform(0.05, 0.3, 3)))
    at = [*rng.uniform(-0.3, 0.3, 2), 10 + board.vertices[:, 2].max() + obj.vertices[:, 2].max() - sink]
    found = of_two(board, obj, None, yaw_pose(rng.uniform(-3, 3), at))
    # What is no deeper than what counts as touching may be found or not, and is as deep as it sinks where it is.
    assert found is not None or sink <= 2.1e-6
    if found:
        assert found.depth_m == pytest.approx(sink, abs=1e-12)
        assert found.direction == pytest.approx((0.0, 0.0, -1.0), abs=1e-12)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (0.3, 0.1, 0.0), (0.0, 0.0, -0.85)])
def test_a_box_inside_another_is_as_deep_as_the_nearest_face_is_away(at: tuple[float, float, float]) -> None:
    found = of_two(box((2.0, 2.0, 2.0)), box((0.2, 0.2, 0.2), at))
    assert depth_of(found) == pytest.approx(1.1 - max(abs(v) for v in at), abs=1e-12)


def test_what_touches_or_is_apart_is_not_in_each_other() -> None:
    a = box((1.0, 1.0, 1.0))
    for at in ((1.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1.0, 0.5, 0.3), (1.001, 0.0, 0.0), (0.0, 0.0, 5.0)):
        assert of_two(a, box((1.0, 1.0, 1.0), at)) is None
    turned = translation([0.0, 0.0, 10.0]) @ yaw_pose(np.pi / 4, [0.5 + np.sqrt(0.5) + 1e-3, 0.0, 0.0])  # boxes of the boxes overlap
    assert of_two(a, box((1.0, 1.0, 1.0)), None, turned) is None


def scene(seed: int, count: int = 6) -> tuple[list[ConvexParts], Array]:
    rng = np.random.default_rng(seed)
    solids = [ConvexParts(f"{i:04d}", tuple(cloud(rng) for _ in range(int(rng.integers(1, 4))))) for i in range(count)]
    return solids, np.array([rigid(rng, 0.4) for _ in range(count)])


def table(found: list[Penetration]) -> dict[tuple[str, str], float]:
    return {(c.a, c.b): c.depth_m for c in found}


@pytest.mark.whole
@given(seeds)
@settings(max_examples=30, deadline=None)
def test_the_deepest_pair_of_pieces_counts(seed: int) -> None:
    solids, poses = scene(seed)
    expected = {}
    for i, a in enumerate(solids):
        for j in range(i + 1, len(solids)):
            deep = max(exact_depth(p, q) for p in a.placed(poses[i]) for q in solids[j].placed(poses[j]))
            if deep > 2e-6:
                expected[a.name, solids[j].name] = deep
    found = {pair: depth for pair, depth in table(penetrations(solids, poses)).items() if depth > 2e-6}
    assert found == pytest.approx(expected, abs=1e-11)


@given(seeds, st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(0, 50)))
@settings(max_examples=30, deadline=None)
def test_moving_everything_changes_nothing(seed: int, shift: tuple[float, float, float]) -> None:
    solids, poses = scene(seed)
    moved = translation(shift) @ yaw_pose(shift[0], [0.0, 0.0, 0.0]) @ poses
    one, other = table(penetrations(solids, poses)), table(penetrations(solids, moved))
    for pair in one.keys() | other.keys():
        assert one.get(pair, 1e-6) == pytest.approx(other.get(pair, 1e-6), abs=1e-11)


@given(seeds, st.randoms(use_true_random=False))
@settings(max_examples=30, deadline=None)
def test_the_order_changes_nothing(seed: int, random: object) -> None:
    solids, poses = scene(seed)
    order = list(range(len(solids)))
    random.shuffle(order)  # type: ignore[attr-defined]
    one = {frozenset(pair): depth for pair, depth in table(penetrations(solids, poses)).items()}
    shuffled = [dataclasses.replace(solids[i], hulls=solids[i].hulls[::-1]) for i in order]
    other = {frozenset(pair): depth for pair, depth in table(penetrations(shuffled, poses[order])).items()}
    for pair in one.keys() | other.keys():
        assert one.get(pair, 1e-6) == pytest.approx(other.get(pair, 1e-6), abs=1e-11)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_the_same_colliders_give_the_same_at_every_pose(seed: int) -> None:
    solids, poses = scene(seed)
    shell = shell_solids(ROOM)
    prepared = Colliders(solids, shell)
    for height in (-10.0, -10.3, 0.0, -10.0):
        moved = translation([0.0, 0.0, height]) @ poses
        assert prepared.penetrations(moved) == penetrations(solids, moved, shell)


def test_the_floor_and_the_walls_are_met_too() -> None:
    cube = ConvexParts("0000", (box((0.4, 0.4, 0.4), (0.0, 0.0, 0.2)),))
    shell = shell_solids(ROOM)
    inner = np.array(ROOM.floor_polygon).mean(axis=0)
    assert penetrations([cube], [translation([*inner, 0.0])], shell) == []
    sunk = penetrations([cube], [translation([*inner, -0.07])], shell)
    assert [(c.a, c.b, c.index_a, c.index_b) for c in sunk] == [("0000", "floor", 0, 1 + len(shell))]
    assert sunk[0].depth_m == pytest.approx(0.07, abs=1e-12)
    assert sunk[0].direction == (0.0, 0.0, 1.0)
    for k, wall in enumerate(shell):
        if wall.name.startswith("wall"):
            center = wall.hulls[0].vertices.mean(axis=0)
            found = penetrations([cube], [translation([center[0], center[1], 0.5])], shell)
            hit = next(c for c in found if c.b == wall.name)
            assert hit.index_b == 1 + k
            expected = exact_depth(cube.placed(translation([center[0], center[1], 0.5]))[0], wall.hulls[0])
            assert hit.depth_m == pytest.approx(expected, abs=1e-11)
    assert penetrations([], np.zeros((0, 4, 4)), shell) == []


@pytest.mark.slow
@pytest.mark.whole
def test_real_furniture_is_as_deep_as_all_axes_say() -> None:
    rng = np.random.default_rng(4)
    solids = []
    for i, category in enumerate(("chair", "table", "bookshelf", "sofa", "mug", "stool")):
        model = generate(category, None, rng)
        solids.append(ConvexParts(f"{i:04d}", pieces(model.parts, model.pieces, CONFIG).hulls))
    poses = np.array([yaw_pose(rng.uniform(-3, 3), [*rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.05, 0.05)]) for _ in solids])
    poses[4, 2, 3] = 0.4
    found = table(penetrations(solids, poses))
    assert len(found) > 10
    for i, a in enumerate(solids):
        lowest = min(h.vertices[:, 2].min() for h in a.placed(poses[i]))
        assert found.get((a.name, "floor"), 0.0) == pytest.approx(max(-lowest, 0.0), abs=2e-6)
        for j in range(i + 1, len(solids)):
            deep = max(exact_depth(p, q) for p in a.placed(poses[i]) for q in solids[j].placed(poses[j]))
            assert found.get((a.name, solids[j].name), 0.0) == pytest.approx(max(deep, 0.0), abs=2e-6 if deep < 2e-6 else 1e-11)


def test_a_pose_that_is_none_is_refused() -> None:
    solids, poses = scene(0)
    poses[2, 0, 3] = np.nan
    with pytest.raises(ValueError, match=r"^pose of 0002: must be finite"):
        penetrations(solids, poses)
