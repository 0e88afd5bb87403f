"""Figures of UV layouts: closed forms, an exact rasterizer, and what must not change them."""

from __future__ import annotations

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks.texturing.charts import chart_figures, charts_of
from tasks.texturing.texels import coverage_of, texels_of

Array = np.ndarray

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
QUAD = np.array([[0, 1, 2], [0, 2, 3]])


def cube(corner: list[tuple[float, float]], side: float) -> tuple[Array, Array, Array]:
    """A unit cube as six quads with vertices of their own; each face a square of a side in the texture, not mirrored."""
    vertices, faces, uv = [], [], []
    for face, (u, v) in enumerate(corner):
        axis, up = divmod(face, 2)
        at = np.insert(SQUARE, axis, float(up), axis=1)
        if np.cross(at[1] - at[0], at[2] - at[0])[axis] * (2 * up - 1) < 0:
            at = at[[0, 3, 2, 1]]
        faces.append(QUAD + 4 * face)
        vertices.append(at)
        uv.append(SQUARE * side + [u, v])
    return np.concatenate(vertices), np.concatenate(faces), np.concatenate(uv)


def grid(columns: int, rows: int) -> tuple[Array, Array]:
    """Places of a grid over the unit square, shape (n, 2), and its triangles."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    quad = np.stack([first, first + 1, first + columns + 2, first + columns + 1], axis=1)
    return np.column_stack([u.ravel(), v.ravel()]), np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])


def test_a_cube_of_six_squares() -> None:
    figures = chart_figures(*cube([(x / 3 + 0.01, y / 3 + 0.01) for x in range(3) for y in range(2)], 0.25))
    assert (figures.charts, figures.faces) == (6, 12)
    assert (figures.stretch_l2, figures.stretch_linf) == pytest.approx((1.0, 1.0))
    assert figures.angle_distortion == pytest.approx(0.0, abs=1e-7)
    assert figures.coverage == pytest.approx(6 / 16, abs=1e-3)
    assert (figures.overlap, figures.flipped, figures.mirrored, figures.outside, figures.degenerate, figures.collapsed) == (0,) * 6
    assert figures.seam_ratio == pytest.approx(12 / np.sqrt(3))


def test_all_faces_of_a_cube_on_one_square_overlap() -> None:
    figures = chart_figures(*cube([(0.25, 0.25)] * 6, 0.5))
    assert figures.overlap > 0.99  # all but the centers on the diagonals that all share
    assert figures.coverage == pytest.approx(0.25, abs=2e-3)


def test_a_cylinder_unrolls_without_stretch() -> None:
    sides, height = 24, 0.7
    uv, faces = grid(sides, 5)
    angle = 2 * np.pi * uv[:, 0]
    vertices = np.column_stack([np.cos(angle), np.sin(angle), height * uv[:, 1]])
    around = sides * 2 * np.sin(np.pi / sides)
    figures = chart_figures(vertices, faces, uv * np.array([1.0, height / around]))
    assert figures.charts == 1
    assert (figures.stretch_l2, figures.stretch_linf) == pytest.approx((1.0, 1.0))
    assert figures.seam_ratio == pytest.approx(height / np.sqrt(8 + height**2))
    assert figures.coverage == pytest.approx(height / around, abs=2e-3)
    assert figures.overlap == 0


def test_a_sphere_by_longitude_and_latitude() -> None:
    """Singular values are 2 pi cos(latitude) and pi: their mean square over the sphere is 11 pi^2 / 6, the largest 2 pi."""
    uv, faces = grid(120, 60)
    east, north = 2 * np.pi * uv[:, 0], np.pi * (uv[:, 1] - 0.5)
    vertices = np.column_stack([np.cos(north) * np.cos(east), np.cos(north) * np.sin(east), np.sin(north)])
    figures = chart_figures(vertices, faces, uv)
    assert figures.stretch_l2 == pytest.approx(np.sqrt(11 * np.pi / 24), rel=0.01)
    assert figures.stretch_linf == pytest.approx(np.sqrt(np.pi), rel=0.01)
    assert (figures.charts, figures.degenerate, figures.flipped) == (1, 2 * 120, 0)
    chord = 2 * np.sin(np.pi / 120)  # a meridian has 60; at the poles, every triangle is cut from its neighbors
    assert figures.seam_ratio == pytest.approx((60 + 2 * 120) * chord / np.sqrt(12), rel=1e-3)


@given(ratio=st.floats(0.1, 10), turn=st.floats(-4, 4))
@settings(max_examples=30, deadline=None)
def test_stretching_one_way(ratio: float, turn: float) -> None:
    uv, faces = grid(3, 3)
    rotation = Rotation.from_rotvec([0.3, turn, -1.0]).as_matrix()
    vertices = np.column_stack([uv * [ratio, 1.0], np.zeros(len(uv))]) @ rotation.T
    figures = chart_figures(vertices, faces, 0.5 * uv + 0.2, 64)
    assert figures.stretch_l2 == pytest.approx(np.sqrt((ratio + 1 / ratio) / 2))
    assert figures.stretch_linf == pytest.approx(np.sqrt(max(ratio, 1 / ratio)))
    legs = np.arctan2(ratio, 1.0)
    assert figures.angle_distortion == pytest.approx(2 * abs(legs - np.pi / 4) / 3, abs=1e-9)


random_layout = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed))


@given(rng=random_layout, scale=st.floats(0.01, 100))
@settings(max_examples=40, deadline=None)
def test_figures_do_not_hang_on_place_size_or_order(rng: np.random.Generator, scale: float) -> None:
    uv, faces = grid(4, 3)
    uv = 0.1 + 0.8 * uv + rng.uniform(-0.02, 0.02, uv.shape)
    vertices = np.column_stack([uv, rng.uniform(-0.2, 0.2, len(uv))])
    figures = chart_figures(vertices, faces, uv, 64)
    assert 1.0 <= figures.stretch_l2 <= figures.stretch_linf
    pose = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    moved = chart_figures(scale * (vertices @ pose.T + rng.normal(size=3)), faces, uv, 64)
    shuffled, order = rng.permutation(len(uv)), rng.permutation(len(faces))
    named = np.argsort(shuffled)[np.roll(faces[order], 1, axis=1)]
    other = chart_figures(vertices[shuffled], named, uv[shuffled], 64)
    for same in (moved, other):
        for field in dataclasses.fields(figures):
            assert getattr(same, field.name) == pytest.approx(getattr(figures, field.name), rel=1e-6, abs=1e-6), field.name


@given(rng=random_layout)
@settings(max_examples=40, deadline=None)
def test_charts_are_those_of_a_flood(rng: np.random.Generator) -> None:
    places, faces = grid(6, 5)
    vertices = np.column_stack([places, np.zeros(len(places))])
    island = rng.integers(0, 4, len(faces))
    corners = faces.ravel()
    uv = places[corners] + np.repeat(island, 3)[:, None] * 2.0
    split = np.arange(len(corners)).reshape(-1, 3)
    left, count, expected = set(range(len(faces))), 0, np.full(len(faces), -1)
    while left:
        front = [min(left)]
        while front:
            face = front.pop()
            left.discard(face)
            expected[face] = count
            front += [k for k in left if island[k] == island[face] and len(set(faces[k]) & set(faces[face])) == 2]
        count += 1
    found = charts_of(vertices[corners], split, uv)
    assert found.tolist() == expected.tolist()
    assert chart_figures(vertices[corners], split, uv, 16).charts == count


def test_mirrored_charts_and_folded_triangles() -> None:
    vertices, faces, uv = cube([(x / 3 + 0.01, y / 3 + 0.01) for x in range(3) for y in range(2)], 0.25)
    mirrored = uv.copy()
    mirrored[:4] = mirrored[:4] * [-1.0, 1.0] + [0.27, 0.0]
    figures = chart_figures(vertices, faces, mirrored)
    assert (figures.mirrored, figures.flipped) == (1, 0)
    flat, triangles = grid(4, 4)
    folded = flat.copy()
    folded[12] = [0.9, 0.5]  # the middle one, pulled over its neighbor
    figures = chart_figures(np.column_stack([flat, np.zeros(25)]), triangles, folded)
    assert figures.flipped > 0
    assert figures.mirrored == 0
    assert figures.overlap > 0


def test_what_lies_outside_or_has_no_area_is_counted() -> None:
    uv, faces = grid(2, 2)
    vertices = np.column_stack([uv, np.zeros(9)])
    assert chart_figures(vertices, faces, uv + np.array([0.25, 0.0])).outside == 4
    assert chart_figures(vertices, faces, uv).outside == 0
    assert chart_figures(vertices, np.vstack([faces, [[0, 1, 2]], [[4, 4, 5]]]), uv).degenerate == 2
    collapsed = uv.copy()
    collapsed[1] = collapsed[0]
    assert chart_figures(vertices, faces, collapsed).collapsed == 1
    assert np.isfinite(chart_figures(vertices, faces, collapsed).stretch_linf)


@pytest.mark.parametrize("change", ["shape", "index", "nan", "point"])
def test_layouts_that_make_no_sense_are_refused(change: str) -> None:
    uv, faces = grid(2, 2)
    vertices = np.column_stack([uv, np.zeros(9)])
    if change == "shape":
        uv = uv[:-1]
    elif change == "index":
        faces = faces + 1
    elif change == "nan":
        uv[3, 1] = np.nan
    else:
        uv = np.zeros_like(uv)
    with pytest.raises(ValueError, match=r"^(uv|faces): "):
        chart_figures(vertices, faces, uv)


coarse = st.integers(-16, 80).map(lambda value: Fraction(value, 64))


@given(corners=st.lists(st.tuples(coarse, coarse), min_size=3, max_size=12), order=st.randoms(use_true_random=False))
@settings(max_examples=25, deadline=None)
def test_coverage_is_that_of_exact_arithmetic(corners: list[tuple[Fraction, Fraction]], order: object) -> None:
    """Corners lie on a grid of quarters of a texel, so that a center lies on an edge or clearly off it."""
    side = 16
    triangles = [[order.randrange(len(corners)) for _ in range(3)] for _ in range(4)]  # type: ignore[attr-defined]
    owner, depth = np.full((side, side), -1), np.zeros((side, side), dtype=int)
    for face in reversed(range(4)):
        a, b, c = (corners[k] for k in triangles[face])
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if not area:
            continue
        for row in range(side):
            for column in range(side):
                p = (Fraction(2 * column + 1, 2 * side), 1 - Fraction(2 * row + 1, 2 * side))
                edges = [
                    ((v[0] - u[0]) * (p[1] - u[1]) - (v[1] - u[1]) * (p[0] - u[0])) * (1 if area > 0 else -1)
                    for u, v in ((a, b), (b, c), (c, a))
                ]
                owner[row, column] = face if min(edges) >= 0 else owner[row, column]
                depth[row, column] += min(edges) > 0
    found = coverage_of(np.array(corners, dtype=float), np.array(triangles), (side, side))
    assert (found.owner == owner).all()
    assert (found.depth == depth).all()


def test_shared_edges_leave_no_gap_and_count_once() -> None:
    """A fan whose edges run through centers of texels, in single precision."""
    uv, faces = grid(7, 5)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    places = ((uv - 0.5) @ turn.T * 0.6 + 0.5).astype(np.float32).astype(np.float64)
    raster = coverage_of(places, faces, (257, 257))
    assert raster.depth.max() == 1
    x, y = np.meshgrid((np.arange(257) + 0.5) / 257 - 0.5, 0.5 - (np.arange(257) + 0.5) / 257)
    inside = np.abs(np.stack([x, y], axis=-1) @ turn).max(axis=2)
    assert (raster.owner[inside < 0.2999] >= 0).all()
    assert (raster.owner[inside > 0.3001] < 0).all()


@given(rng=random_layout)
@settings(max_examples=25, deadline=None)
def test_weights_of_texels_give_their_centers(rng: np.random.Generator) -> None:
    uv, faces = grid(5, 4)
    uv = uv * 0.8 + 0.1 + rng.uniform(-0.02, 0.02, uv.shape)
    height, width = 48, 96
    texels = texels_of(uv, faces, (height, width))
    places = np.einsum("tc,tck->tk", texels.weights, uv[faces[texels.face]])
    expected = np.column_stack([(texels.column + 0.5) / width, 1 - (texels.row + 0.5) / height])
    assert np.abs(places - expected).max() < 1e-6
    assert texels.weights.min() >= 0
