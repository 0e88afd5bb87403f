"""Flat arrays of convex pieces: faces against qhull, gaps against linear programs, depths against the exact ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from tasks.furniture import generate
from tasks.geometry.pieces import Hull, PieceConfig, convex_hull, pieces
from tasks.geometry.transforms import translation, yaw_pose
from tasks.optimization.contacts import penetrations
from tasks.optimization.shapes import Shapes, Stand, compiled, shapes_of, stand_of
from tasks.optimization.solids import ConvexParts
from tests.tasks.optimization.interiors import block, hull, turned, world_vertices

Array = np.ndarray
seeds = st.integers(0, 10**6)
CONFIG = PieceConfig()
HIGH = np.array([0.0, 0.0, 10.0])
"""Above the floor, which the exact depths know of and the pairs do not."""


def cloud(rng: np.random.Generator, most: int = 40) -> Hull:
    return convex_hull(rng.normal(size=(int(rng.integers(4, most)), 3)) * rng.uniform(0.1, 1.0, 3) * 0.3, CONFIG)


def box(rng: np.random.Generator) -> Hull:
    return hull(block(rng.uniform(0.05, 0.6, 3)))


def two(a: Hull, b: Hull, rng: np.random.Generator, reach: float = 0.35) -> tuple[Shapes, Stand]:
    """Two bodies of a piece each, turned and moved at random."""
    shapes = shapes_of([ConvexParts("0000", (a,)), ConvexParts("0001", (b,))], np.tile(np.eye(4), (2, 1, 1)))
    return shapes, turned(shapes, HIGH + rng.uniform(-reach, reach, (2, 3)), rng.uniform(-np.pi, np.pi, 2))


def moved(shapes: Shapes, stand: Stand, yaw: float, shift: Array) -> Stand:
    """Everything turned about the world's upright axis and moved."""
    c, s = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    angles = np.arctan2(stand.turn[:, 1], stand.turn[:, 0]) + yaw
    return turned(shapes, stand.place @ rotation.T + shift, angles)


def exact(shapes: Shapes, stand: Stand) -> float:
    """Exact depth of two bodies of a piece each [m]."""
    solids = [ConvexParts(f"{i:04d}", (convex_hull(world_vertices(shapes, stand, i), CONFIG),)) for i in range(2)]
    found = penetrations(solids, np.tile(np.eye(4), (2, 1, 1)))
    return max((p.depth_m for p in found if p.b != "floor"), default=0.0)


def depth(shapes: Shapes, stand: Stand, slop: float = 0.0, a: int = 0, b: int = 1) -> tuple[float, float]:
    total, deepest = compiled()["pair_depth"](shapes, stand, a, b, slop)
    return float(total), float(deepest)


def gap_by_program(a: Array, b: Array) -> float:
    """Least z_a - z_b of points of two hulls, vertices (n, 3) and (m, 3), on one upright line [m]; infinite without any."""
    n, m = len(a), len(b)
    equal = np.zeros((4, n + m))
    equal[:2, :n], equal[:2, n:] = a[:, :2].T, -b[:, :2].T
    equal[2, :n] = equal[3, n:] = 1.0
    found = linprog(np.concatenate([a[:, 2], -b[:, 2]]), A_eq=equal, b_eq=[0.0, 0.0, 1.0, 1.0], method="highs")
    return float(found.fun) if found.success else np.inf


def separation_by_program(a: Array, b: Array) -> float:
    """Half the width of a slab between two hulls, by a normal of at most unit entries [m]; zero when none separates them."""
    ones = np.ones((len(a) + len(b), 1))
    sides = np.concatenate([np.column_stack([a, -ones[: len(a)]]), np.column_stack([-b, ones[: len(b)]])])
    rows = np.column_stack([sides, ones])
    bounds = [(-1.0, 1.0)] * 3 + [(None, None), (0.0, None)]
    found = linprog([0.0, 0.0, 0.0, 0.0, -1.0], A_ub=rows, b_ub=np.zeros(len(rows)), bounds=bounds, method="highs")
    assert found.success
    return float(found.x[4])


# faces


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_faces_are_those_of_qhull_and_obey_euler(seed: int) -> None:
    rng = np.random.default_rng(seed)
    piece = cloud(rng) if seed % 2 else box(rng)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    shapes = shapes_of([ConvexParts("0000", (piece,))], pose[None])
    planes = np.column_stack([shapes.normals, -shapes.offsets])
    expected = ConvexHull(piece.vertices @ pose[:3, :3].T).equations
    distance = np.abs(planes[:, None] - expected[None]).max(axis=2)
    assert distance.min(axis=1).max() < 1e-7
    assert distance.min(axis=0).max() < 1e-7
    assert np.linalg.norm(shapes.normals, axis=1) == pytest.approx(np.ones(len(planes)), abs=1e-12)
    # no point is outside, every plane carries a face, and vertices, edges, faces make one closed polyhedron
    levels = shapes.vertices @ shapes.normals.T - shapes.offsets
    assert levels.max() <= 1e-12
    assert ((levels > -1e-9).sum(axis=0) >= 3).all()
    assert len(piece.vertices) - len(shapes.edges) + len(planes) == 2


@pytest.mark.parametrize("sides", [3, 4, 6, 24])
def test_triangles_of_one_plane_are_one_face(sides: int) -> None:
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    piece = convex_hull(np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (0.0, 0.7)]), CONFIG)
    shapes = shapes_of([ConvexParts("0000", (piece, piece))], np.eye(4)[None])
    assert np.diff(shapes.first_plane).tolist() == [sides + 2] * 2
    assert np.diff(shapes.first_edge).tolist() == [3 * sides] * 2


# gaps


def check_gap(shapes: Shapes, stand: Stand, p: int = 0, q: int = 1) -> bool:
    """Whether an upright line meets both pieces; what the gap is then, is what the linear programs say."""
    corners = []
    for body, piece in ((0, p), (1, q)):
        local = shapes.vertices[shapes.first_vertex[piece] : shapes.first_vertex[piece + 1]]
        c, s = stand.turn[body]
        corners.append(local @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + stand.place[body])
    lower, higher = compiled()["piece_gap"](shapes, stand, 0, 1, p, q)
    swapped = compiled()["piece_gap"](shapes, stand, 1, 0, q, p)
    expected = gap_by_program(*corners), gap_by_program(corners[1], corners[0])
    if np.isinf(expected[0]) or np.isinf(lower):  # the programs know a line that just touches to 1e-7 only
        assert np.isinf(lower) == np.isinf(expected[0]) or abs(separation_by_program(corners[0], corners[1])) < 1e-6
        return False
    assert (lower, higher) == pytest.approx(expected, abs=1e-6)
    assert swapped == pytest.approx((higher, lower), abs=1e-9)
    return True


@given(seeds)
@settings(max_examples=120, deadline=None)
def test_gaps_are_those_of_linear_programs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes, stand = two(cloud(rng), cloud(rng) if seed % 3 else box(rng), rng)
    check_gap(shapes, stand)


def test_gaps_of_furniture_are_those_of_linear_programs() -> None:
    rng = np.random.default_rng(3)
    met = 0
    for above, below in (("mug", "chair"), ("plant", "table"), ("lamp", "desk")):
        solids = []
        for name in (above, below):
            model = generate(name, None, rng)
            solids.append(ConvexParts(name, pieces(model.parts, model.pieces, CONFIG).hulls))
        shapes = shapes_of(solids, np.tile(np.eye(4), (2, 1, 1)))
        stand = turned(shapes, np.array([[*rng.uniform(-0.2, 0.2, 2), 1.0], [0.0, 0.0, 0.0]]), rng.uniform(-3, 3, 2))
        for p in range(shapes.first_piece[1])[:8]:
            for q in range(shapes.first_piece[1], shapes.first_piece[2])[:16]:
                met += check_gap(shapes, stand, p, q)
    assert met > 10


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_an_object_that_is_lowered_by_its_gap_touches(seed: int) -> None:
    """A hair above, the two are apart; a hair below, they overlap."""
    rng = np.random.default_rng(seed)
    shapes, stand = two(cloud(rng), cloud(rng), rng, 0.1)
    stand.place[0, 2] += 2.0
    compiled()["bound"](shapes, stand, 0)
    gap = compiled()["body_gap"](shapes, stand, 0, 1, 0.05, np.inf)
    assume(np.isfinite(gap))
    for hair, overlaps in ((1e-5, False), (-1e-3, True)):
        near = stand_of(shapes, stand.place - [[0.0, 0.0, gap - hair], [0.0, 0.0, 0.0]])
        near.turn[:] = stand.turn
        for body in range(2):
            compiled()["bound"](shapes, near, body)
        apart = separation_by_program(world_vertices(shapes, near, 0), world_vertices(shapes, near, 1))
        assert apart < 1e-7 if overlaps else apart > 0.0


# depths


@given(seeds)
@settings(max_examples=120, deadline=None)
def test_turned_boxes_have_the_exact_depth_and_are_apart_when_a_plane_separates_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes, stand = two(box(rng), box(rng), rng)
    expected, (total, deepest) = exact(shapes, stand), depth(shapes, stand)
    assert total == deepest == pytest.approx(expected, abs=1e-6 if expected < 2e-6 else 1e-11)
    apart = separation_by_program(world_vertices(shapes, stand, 0), world_vertices(shapes, stand, 1))
    assume(apart > 1e-6 or expected > 1e-6)
    assert (total == 0.0) == (apart > 1e-6)
    assert depth(shapes, stand, 0.01)[0] == pytest.approx(max(expected - 0.01, 0.0), abs=1e-9)


@given(seeds)
@settings(max_examples=100, deadline=None)
def test_depths_are_never_below_the_exact_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes, stand = two(cloud(rng), cloud(rng), rng, 0.25)
    found = depth(shapes, stand)[1]
    assert found >= exact(shapes, stand) - 1e-9
    # and never more than along the axes: what it says parts two pieces
    boxes = (stand.high - stand.low[::-1]).min()
    assert found <= max(float(boxes), 0.0) + 1e-12


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_depths_are_symmetric_and_do_not_depend_on_where_a_room_lies(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes, stand = two(cloud(rng), cloud(rng), rng, 0.2)
    expected, gap = depth(shapes, stand), compiled()["piece_gap"](shapes, stand, 0, 1, 0, 1)
    assert depth(shapes, stand, 0.0, 1, 0) == pytest.approx(expected, abs=1e-12)
    for quarter in range(4):
        other = moved(shapes, stand, quarter * np.pi / 2, rng.uniform(-20, 20, 3))
        assert depth(shapes, other) == pytest.approx(expected, abs=1e-9)
        if np.isfinite(gap[0]):
            assert compiled()["piece_gap"](shapes, other, 0, 1, 0, 1) == pytest.approx(gap, abs=1e-7)
    shapes, stand = two(box(rng), box(rng), rng, 0.2)
    other = moved(shapes, stand, rng.uniform(-3, 3), rng.uniform(-20, 20, 3))
    assert depth(shapes, other) == pytest.approx(depth(shapes, stand), abs=1e-9)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_depths_of_many_pieces_are_the_sum_over_their_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = [[box(rng).transformed(translation(rng.uniform(-0.3, 0.3, 3))) for _ in range(3)] for _ in range(2)]
    poses = np.array([yaw_pose(rng.uniform(-3, 3), HIGH) for _ in range(2)])
    shapes = shapes_of([ConvexParts(f"{i:04d}", tuple(some)) for i, some in enumerate(parts)], poses)
    slop = 0.002
    depths = []
    for a in parts[0]:
        for b in parts[1]:
            found = penetrations([ConvexParts("0000", (a,)), ConvexParts("0001", (b,))], poses)
            depths.append(max((p.depth_m for p in found if p.b != "floor"), default=0.0))
    deep = [d for d in depths if d > slop]
    found = depth(shapes, stand_of(shapes, poses[:, :3, 3]), slop)
    assert found == pytest.approx((sum(d - slop for d in deep), max(deep, default=0.0)), abs=1e-9)
