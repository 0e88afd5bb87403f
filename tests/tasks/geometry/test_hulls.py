"""Convex hulls within what engines take."""

from __future__ import annotations

from collections import Counter

import networkx as nx
import numpy as np
import pytest
import trimesh
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks.geometry.hulls import COPLANAR, REDUCED, Complexity, Hull, balanced, complexity, deviation, hull_of, is_within, reduced
from tasks.geometry.transforms import rotation_of


def prism(sides: int, radius: float = 0.3, height: float = 0.5) -> Hull:
    angle = np.arange(sides) * (2 * np.pi / sides)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return hull_of(np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (0.0, height)]))


@pytest.mark.parametrize(
    ("hull", "counted"),
    [
        (hull_of(np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], dtype=float)), Complexity(8, 6, 4, 3)),
        (prism(24), Complexity(48, 26, 24, 3)),
        (prism(3), Complexity(6, 5, 4, 3)),
        (hull_of(np.asarray(trimesh.creation.icosphere(subdivisions=0).vertices)), Complexity(12, 20, 3, 5)),
        (hull_of(np.asarray(trimesh.creation.cone(0.3, 0.5, sections=20).vertices)), Complexity(21, 21, 20, 20)),
    ],
)
def test_polygons_are_counted_once_triangles_in_one_plane_are_one(hull: Hull, counted: Complexity) -> None:
    assert complexity(hull) == counted
    turned = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    moved = Hull(np.float32(hull.vertices @ turned + 5.0).astype(np.float64), hull.faces)
    assert complexity(moved) == counted, "in single precision, turned and far from the origin, as files have it"


def test_a_cylinder_of_24_sides_stays_as_it_is_though_it_has_92_triangles() -> None:
    hull = prism(24)
    assert len(hull.faces) == 92
    assert reduced(hull) is hull
    fewer = reduced(hull, Complexity(34, 64, 31, 31))  # 64 triangles at most
    assert deviation(fewer, hull.vertices) > 0.01, "a centimeter would be lost to a limit on triangles"


def clouds(seed: int, count: int, size: tuple[float, float, float], kind: str) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    if kind == "ball":
        points /= np.linalg.norm(points, axis=1)[:, None]
    if kind == "disc":  # stands on a round foot of many corners
        angle = np.arange(count) * (2 * np.pi / count)
        ring = np.column_stack([np.cos(angle), np.sin(angle)])
        points = np.concatenate(
            [np.column_stack([ring, np.zeros(count)]), np.column_stack([0.7 * ring, np.ones(count)]), 0.5 + 0.1 * points]
        )
    return points * size


sizes = st.floats(0.05, 2.0)


def counted_slowly(hull: Hull, coplanar: float) -> Complexity:
    """What engines count, by a graph of triangles whose distances from each other's planes are small."""
    corners = hull.vertices[hull.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(lengths, 1e-300)[:, None]
    tolerance = coplanar * np.linalg.norm(np.ptp(hull.vertices, axis=0))
    beside: dict[frozenset[int], list[int]] = {}
    for index, face in enumerate(hull.faces.tolist()):
        for k in range(3):
            beside.setdefault(frozenset((face[k], face[(k + 1) % 3])), []).append(index)
    graph = nx.Graph()
    graph.add_nodes_from(range(len(hull.faces)))
    for a, b in beside.values():
        apart = max(np.abs((corners[y] - corners[x][0]) @ normals[x]).max() for x, y in ((a, b), (b, a)))
        if apart <= tolerance or min(lengths[a], lengths[b]) <= tolerance**2:
            graph.add_edge(a, b)
    polygons = [set(hull.faces[sorted(part)].ravel().tolist()) for part in nx.connected_components(graph)]
    meeting = Counter(vertex for polygon in polygons for vertex in polygon)
    return Complexity(len(hull.vertices), len(polygons), max(map(len, polygons)), max(meeting.values()))


@pytest.mark.whole
@given(
    st.integers(0, 10_000), st.integers(4, 120), st.tuples(sizes, sizes, sizes), st.sampled_from(["cloud", "ball", "disc"]),
    st.sampled_from([COPLANAR / 8, COPLANAR, 8 * COPLANAR, 0.01, 0.2]),
)  # fmt: skip
def test_what_engines_count_is_what_a_graph_of_triangles_has(
    seed: int, count: int, size: tuple[float, float, float], kind: str, coplanar: float
) -> None:
    hull = hull_of(clouds(seed, count, size, kind))
    assert complexity(hull, coplanar) == counted_slowly(hull, coplanar)


@given(st.integers(0, 10_000), st.integers(4, 60), st.tuples(sizes, sizes, sizes), st.sampled_from(["cloud", "ball", "disc"]))
def test_triangles_of_a_hull_look_outwards(seed: int, count: int, size: tuple[float, float, float], kind: str) -> None:
    points = clouds(seed, count, size, kind)
    hull = hull_of(points)
    mesh = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert hull.volume > 0
    assert set(map(tuple, hull.vertices.tolist())) <= set(map(tuple, points.tolist())), "corners are points, to the bit"
    assert deviation(hull, points) <= 1e-9 * max(size)


@pytest.mark.whole
@given(st.integers(0, 10_000), st.integers(8, 200), st.tuples(sizes, sizes, sizes), st.sampled_from(["cloud", "ball", "disc"]))
def test_reduced_hulls_keep_the_limits_the_box_and_what_they_stand_on(
    seed: int, count: int, size: tuple[float, float, float], kind: str
) -> None:
    whole = hull_of(clouds(seed, count, size, kind))
    hull = reduced(whole)
    assert is_within(hull, REDUCED)
    assert all(mine <= most for mine, most in zip(complexity(hull), REDUCED, strict=True))
    mesh = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    diagonal = float(np.linalg.norm(size))
    assert deviation(whole, hull.vertices) <= 1e-9 * diagonal, "inside what it stands for"
    for both in (np.min, np.max):
        np.testing.assert_array_equal(both(hull.vertices, axis=0), both(whole.vertices, axis=0))
    foot, own = (h.vertices[h.vertices[:, 2] == h.vertices[:, 2].min(), :2] for h in (whole, hull))
    np.testing.assert_array_equal([own.min(axis=0), own.max(axis=0)], [foot.min(axis=0), foot.max(axis=0)])
    grown = balanced(hull, whole)
    assert is_within(grown, REDUCED)
    for both in (np.min, np.max):
        np.testing.assert_allclose(both(grown.vertices, axis=0), both(whole.vertices, axis=0), atol=1e-12)
    assert deviation(grown, whole.vertices) <= deviation(hull, whole.vertices) + 1e-9


def test_vertices_where_most_is_lost_come_first() -> None:
    ball = hull_of(np.asarray(trimesh.creation.icosphere(subdivisions=3, radius=0.1).vertices))
    assert not is_within(ball)
    hull = reduced(ball)
    index = np.arange(64 - 6) + 0.5
    height, turn = 1 - 2 * index / 58, np.pi * (1 + 5**0.5) * index
    radius = np.sqrt(1 - height**2)
    spread = np.concatenate([np.eye(3), -np.eye(3), np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])])
    fixed = hull_of(ball.vertices[np.unique((ball.vertices @ spread[: len(hull.vertices)].T).argmax(axis=0))])
    assert deviation(hull, ball.vertices) < deviation(fixed, ball.vertices)
    assert deviation(hull, ball.vertices) < 0.013


@given(st.integers(0, 10_000), st.integers(3, 12), st.floats(1e-12, 1e-7))
def test_hulls_with_corners_that_hardly_differ_are_closed_and_wound_alike(seed: int, count: int, apart: float) -> None:
    rng = np.random.default_rng(seed)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 0.1)], dtype=float)
    along = corners[rng.integers(0, 8, count)] * rng.uniform(0, 1, (count, 1)) + corners[0]
    hull = hull_of(np.concatenate([corners, along + rng.normal(0, apart, along.shape)]))
    mesh = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert hull.volume == pytest.approx(0.1, abs=1e-5)


@pytest.mark.whole
@given(sides=st.integers(20, 64), scale=st.floats(0.5, 2.0), tilt=st.floats(-3.0, 3.0), height=st.floats(0.01, 1.0))
def test_reduced_hulls_stay_within_limits_when_they_are_scaled_and_written(sides: int, scale: float, tilt: float, height: float) -> None:
    angles = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(sides)])
    points = (np.concatenate([0.3 * ring, 0.2 * ring + [0.0, 0.0, height]]) @ rotation_of([tilt, 0.3, 0.1]).T).astype(np.float32)
    hull = reduced(hull_of(points.astype(np.float64)))
    written = (hull.vertices * [scale, 1.0, 1.0 / scale]).astype(np.float32).astype(np.float64)
    assert is_within(hull_of(written))


stretches = st.tuples(*[st.floats(0.5, 2.0)] * 3)


@given(sides=st.integers(20, 64), exponent=st.floats(-7.5, -4.0), stretch=stretches)
@example(sides=34, exponent=-5.54, stretch=(1.29, 1.55, 1.0))
@example(sides=27, exponent=-7.0, stretch=(0.5, 0.5, 1.0))
def test_a_disc_whose_rim_is_nearly_even_stays_within_limits_when_it_is_scaled(
    sides: int, exponent: float, stretch: tuple[float, float, float]
) -> None:
    """Sides that are one polygon at one scale are several at another: the limits hold for both."""
    step = 10.0**exponent
    angles = 2.0 * np.pi * np.arange(sides) / sides
    rim = np.column_stack([0.06 * np.cos(angles), 0.06 * np.sin(angles), np.where(np.arange(sides) % 3, 0.0, step)])
    hull = reduced(hull_of(np.concatenate([rim, rim * [1.16, 1.16, -1.0] + [0.0, 0.0, 0.0057]])))
    assert is_within(hull_of((hull.vertices * stretch).astype(np.float32).astype(np.float64)))


@pytest.mark.parametrize(
    ("hull", "place", "decimals"),
    [
        (prism(24, 0.6, 0.03), 0.0, 6),
        (prism(24, 0.2, 0.3), 0.0, 6),
        (prism(20, 0.02, 0.45), 0.0, 6),
        (prism(24, 0.0075, 0.015), 0.8, None),
    ],
    ids=["table top", "shade", "leg", "knob"],
)
def test_flat_sides_stay_flat_in_the_decimals_of_files(hull: Hull, place: float, decimals: int | None) -> None:
    """Tilted, as OBJ writes them with six decimals and GLB in single precision off the middle: nothing is taken from them."""
    points = hull.vertices @ Rotation.from_euler("xy", [0.2, 0.1]).as_matrix().T + [place, 0.5 * place, place]
    written = hull_of(np.round(points, decimals) if decimals else points.astype(np.float32).astype(np.float64))
    assert reduced(written) is written


@pytest.mark.parametrize("seed", range(20))
def test_a_disc_with_a_pointed_rim_is_reduced_however_it_lies(seed: int) -> None:
    angles = 2.0 * np.pi * np.arange(48) / 48
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(48)])
    disc = np.concatenate([0.3 * ring, 0.29 * ring + [0.0, 0.0, 0.005], 0.29 * ring - [0.0, 0.0, 0.005]])
    points = disc @ Rotation.random(rng=np.random.default_rng(seed)).as_matrix().T
    assert is_within(reduced(hull_of(points)), REDUCED)
