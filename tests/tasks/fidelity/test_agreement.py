"""Accuracy, completeness and F-score of surfaces for which theory says what they are."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.fidelity.agreement import THRESHOLDS_M, SurfaceSamples, distances, f_score, joined, sampled, share, shares_within
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import surface_area
from tests.tasks.geometry.test_proximity import brute

SEEDS = st.integers(0, 2**32 - 1)


def surface(mesh: trimesh.Trimesh) -> Surface:
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    return Surface(vertices, np.asarray(mesh.faces, dtype=np.int64), np.zeros((len(vertices), 3), np.uint8))


def square(side: float, offset: tuple[float, float, float] = (0, 0, 0)) -> Surface:
    corners = side * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float) + offset
    return Surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros((4, 3), np.uint8))


def soup(rng: np.random.Generator, count: int) -> Surface:
    """Triangles anywhere within a metre."""
    corners = rng.uniform(-0.5, 0.5, (count, 1, 3)) + 0.2 * rng.normal(size=(count, 3, 3))
    return Surface(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), np.zeros((3 * count, 3), np.uint8))


def slack(p: float, n: int) -> float:
    """Five standard errors of a share of independent points; points spread evenly err less."""
    return 5 * float(np.sqrt(max(p * (1 - p), 0.0) / n)) + 2 / n


@settings(deadline=None)
@given(SEEDS, st.integers(1, 40))
def test_a_surface_agrees_with_itself(seed: int, count: int) -> None:
    one = soup(np.random.default_rng(seed), count)
    points = sampled(one, 500, 100, 1000, np.random.default_rng(seed))
    within = shares_within(points.areas, distances(points.points, one))
    assert within == pytest.approx((1.0, 1.0, 1.0), abs=1e-12)
    assert [f_score(a, a) for a in within] == pytest.approx([1.0, 1.0, 1.0])
    assert points.area == pytest.approx(surface_area(one.vertices, one.faces))


@settings(deadline=None)
@given(SEEDS, st.floats(0.3, 3.0), st.floats(0.0, 0.2))
def test_a_square_moved_within_its_plane_agrees_but_for_a_strip(seed: int, side: float, shift: float) -> None:
    points = sampled(square(side), 1, 2000, 2000, np.random.default_rng(seed))
    within = shares_within(points.areas, distances(points.points, square(side, (shift, 0, 0))))
    for threshold, value in zip(THRESHOLDS_M, within, strict=True):
        strip = max(shift - threshold, 0.0) / side
        assert value == pytest.approx(1 - strip, abs=slack(strip, 2000))


@given(SEEDS, st.sampled_from([0.0, 0.0199, 0.02, 0.0201, 0.03, 0.05, 0.07, 0.1, 0.2]))
def test_a_square_moved_off_its_plane_agrees_wholly_or_not_at_all(seed: int, shift: float) -> None:
    points = sampled(square(1.0), 1, 300, 300, np.random.default_rng(seed))
    within = shares_within(points.areas, distances(points.points, square(1.0, (0, 0, shift))))
    assert within == tuple(pytest.approx(float(shift <= threshold)) for threshold in THRESHOLDS_M)


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.integers(1, 30), st.integers(1, 30))
def test_distances_are_those_of_brute_force_and_shares_rise_with_them(seed: int, first: int, second: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = soup(rng, first), soup(rng, second)
    points = sampled(one, 200, 50, 100, rng)
    distance = distances(points.points, other)
    slow = brute(other.vertices, other.faces, points.points)
    assert distance == pytest.approx(slow, abs=1e-9)
    within = shares_within(points.areas, distance)
    assert list(within) == sorted(within)  # type: ignore[type-var]
    assert within == tuple(pytest.approx(points.areas[slow <= t].sum() / points.area) for t in THRESHOLDS_M)


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.floats(0.01, 0.08))
def test_shares_hardly_hang_on_how_many_samples_there_are(seed: int, shift: float) -> None:
    rng = np.random.default_rng(seed)
    one, other = (
        surface(trimesh.creation.box((0.5, 0.4, 0.3))),
        surface(trimesh.creation.box((0.5, 0.4, 0.3)).apply_translation([shift] * 3)),
    )
    found = []
    for count in (500, 8000):
        points = sampled(one, 1, count, count, rng)
        found.append(shares_within(points.areas, distances(points.points, other)))
    for few, many in zip(*found, strict=True):
        assert few == pytest.approx(many, abs=slack(0.5, 500) + slack(0.5, 8000))


@given(st.floats(0, 1), st.floats(0, 1))
def test_an_f_score_lies_between_its_two_and_nearer_the_smaller(accuracy: float, completeness: float) -> None:
    score = f_score(accuracy, completeness)
    assert score is not None
    low, high = sorted([accuracy, completeness])
    assert low - 1e-12 <= score <= (low + high) / 2 + 1e-12
    assert score == f_score(completeness, accuracy)


def test_what_is_missing_stays_missing() -> None:
    assert f_score(None, 1.0) is None
    assert f_score(1.0, None) is None
    assert f_score(0.0, 0.0) == 0.0
    assert share(np.zeros(0), np.zeros(0, dtype=bool)) is None
    nothing = Surface(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3), np.uint8))
    assert distances(np.zeros((2, 3)), nothing).tolist() == [np.inf, np.inf]
    assert len(sampled(nothing, 100, 5, 10, np.random.default_rng(0)).points) == 0
    assert (
        len(sampled(Surface(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros((3, 3), np.uint8)), 1, 5, 9, np.random.default_rng(0)).points)
        == 0
    )


def test_pooled_samples_weigh_by_area_however_many_stand_for_it() -> None:
    pool = joined([SurfaceSamples(np.zeros((4, 3)), np.full(4, 0.25)), SurfaceSamples(np.ones((1, 3)), np.full(1, 3.0))])
    assert share(pool.areas, np.array([True] * 4 + [False])) == pytest.approx(0.25)
