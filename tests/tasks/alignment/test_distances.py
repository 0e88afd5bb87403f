"""Distances, colors and the score: equal to independent implementations, within their bounds."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.alignment import AlignmentConfig, Distances, Fit, Sample, make_target, measure
from tasks.alignment.distances import coarse_distances, disc_distances, nearest_indices, nearest_turn
from tasks.alignment.samples import turned
from tasks.captions.colors import lab
from tasks.geometry.meshes import sample_surface, surface_of
from tasks.selection import ScoreConfig, score_of
from tasks.selection.coloring import HUE_BINS, HUE_REACH, LIGHTNESS_BINS, color_histogram, color_similarity


@given(seed=st.integers(0, 2**32 - 1), k=st.integers(1, 60), m=st.integers(1, 300), decimals=st.integers(0, 9), flat=st.booleans())
@settings(max_examples=60, deadline=None)
def test_samples_that_are_not_looked_at_are_not_the_nearest(seed: int, k: int, m: int, decimals: int, flat: bool) -> None:
    rng = np.random.default_rng(seed)
    points, samples = rng.normal(size=(k, 3)), np.round(rng.normal(size=(m, 3)), decimals)  # with ties, and many at one place
    samples *= [1.0, 1.0, 0.0 if flat else 1.0]
    away = samples[None] - points[:, None]
    square = away[..., 0] * away[..., 0] + away[..., 1] * away[..., 1] + away[..., 2] * away[..., 2]
    index, distance = nearest_indices(points, samples)
    assert np.array_equal(index, square.argmin(axis=1)), "of equal ones the first"
    assert np.array_equal(distance, np.sqrt(square.min(axis=1)))
    normals = rng.normal(size=(m, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    radius = float(rng.uniform(0.0, 0.5))
    off = (away * normals).sum(axis=2)
    over = np.maximum(np.sqrt(np.maximum(square - off * off, 0.0)) - radius, 0.0)
    assert np.allclose(disc_distances(points, samples, normals, radius), np.sqrt(off * off + over * over).min(axis=1), atol=1e-9)


@given(seed=st.integers(0, 2**32 - 1), k=st.integers(1, 60), m=st.integers(1, 300), decimals=st.integers(1, 9), reach=st.floats(0.0, 0.3))
@settings(max_examples=60, deadline=None)
def test_the_turn_is_that_of_the_nearest_pairs_whatever_order_was_known(seed: int, k: int, m: int, decimals: int, reach: float) -> None:
    """Surfaces that move by much, by little and not at all, with ties and many samples at one place."""
    rng = np.random.default_rng(seed)
    points, placed = np.round(rng.normal(size=(k, 3)), decimals), np.round(rng.normal(size=(m, 3)), decimals)
    keep, ranks = int(rng.integers(1, k + 1)), np.arange(k)
    for _ in range(4):
        index, distance = nearest_indices(points, placed)
        used = np.argsort(distance, kind="stable")
        to, source = points[used[:keep], :2], placed[index[used[:keep]], :2]
        a, b = source - source.mean(axis=0), to - to.mean(axis=0)
        across, along, middle, goal = nearest_turn(points, placed, keep, ranks)
        assert (across, along) == pytest.approx(((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()), abs=1e-9)
        assert np.allclose(middle, source.mean(axis=0), atol=1e-12)
        assert np.allclose(goal, to.mean(axis=0), atol=1e-12)
        assert np.array_equal(ranks, used)
        angle, shift = reach * rng.normal() * rng.integers(0, 2), reach * rng.normal(size=3) * rng.integers(0, 2)
        placed = placed @ turned(angle).T + shift * [1.0, 1.0, 0.0]


@given(seed=st.integers(0, 2**32 - 1), k=st.integers(2, 60), m=st.integers(1, 300), share=st.floats(0.1, 1.0))
@settings(max_examples=40, deadline=None)
def test_measures_are_those_of_numpy(seed: int, k: int, m: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    config = AlignmentConfig(seen_share=share)
    target = make_target(rng.normal(size=(k, 3)), np.zeros((k, 3), dtype=np.uint8), np.array([2.0, 2.0, 2.0]), config, rng)
    normals = rng.normal(size=(m, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    asset = Sample(rng.normal(size=(m, 3)), normals, np.zeros((m, 3), dtype=np.uint8), np.ones(3), 6.0)
    fit = Fit(float(rng.uniform(-4, 4)), rng.normal(size=3), rng.uniform(0.5, 2.0, 3))
    threshold, limit = 0.3, config.truncation * target.diagonal
    placed, tilted, radius = asset.placed(fit)
    assert np.allclose(np.linalg.norm(tilted, axis=1), 1.0)
    points, turned_normals, radii = asset.placed_all([fit, fit])
    assert np.array_equal(points[1], placed)
    assert np.array_equal(turned_normals[1], tilted)
    assert radii.tolist() == [radius, radius]
    scan = disc_distances(target.points, placed, tilted, radius)
    back = np.maximum(nearest_indices(placed, target.points)[1] - target.spacing, 0.0)
    weights = target.weights(placed, tilted, config)
    order = np.argsort(np.minimum(back, limit), kind="stable")
    reached = np.cumsum(weights[order])
    seen = order[: int((reached < share * reached[-1]).sum()) + 1]
    made = measure(target, asset, fit, threshold, config)
    assert made.scan == pytest.approx(np.minimum(scan, limit).mean(), rel=1e-12)
    assert made.asset == pytest.approx((np.minimum(back, limit) * weights)[seen].sum() / weights[seen].sum(), rel=1e-12)
    assert made.chamfer == pytest.approx(0.5 * (scan.mean() + back.mean()), rel=1e-12)
    assert made.coverage == (scan <= threshold).mean()


def test_compiled_distances_equal_an_independent_implementation() -> None:
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(6)
    points, samples = rng.random((70, 3)), rng.random((90, 3))
    index, distance = nearest_indices(points, samples)
    expected, at = cKDTree(samples).query(points)
    assert np.allclose(distance, expected, atol=1e-12)
    assert (index == at).all()
    out, back = coarse_distances(points, np.stack([samples, samples + 1.0]))
    assert np.allclose(out[0], expected)
    assert np.allclose(back[1], cKDTree(points).query(samples + 1.0)[0])


def test_disc_distance_is_the_distance_to_the_surface() -> None:
    """Discs spread over a plane and a box stand for them: far fewer samples than nearest points would need."""
    rng = np.random.default_rng(7)
    mesh = trimesh.creation.box((1.0, 1.0, 1.0)).subdivide()
    mesh.visual.vertex_colors = [200, 200, 200, 255]
    surface = surface_of([mesh])
    centers, _, normals = sample_surface(surface, 800, rng)
    points = sample_surface(surface, 300, rng)[0] + rng.normal(0, 0.02, (300, 3))
    found = disc_distances(points, centers, normals, float(np.sqrt(6.0 / (np.pi * 800))))
    exact = trimesh.proximity.closest_point_naive(mesh, points)[1]
    nearest = nearest_indices(points, centers)[1]
    assert np.abs(found - exact).mean() < 0.015
    assert (found <= nearest + 1e-12).all()
    assert np.abs(found - exact).mean() < 0.5 * np.abs(nearest - exact).mean()


@given(st.lists(st.tuples(*[st.integers(0, 255)] * 3), min_size=1, max_size=30))
@settings(max_examples=40, deadline=None)
def test_colors_are_shared_between_neighboring_bins(colors: list[tuple[int, int, int]]) -> None:
    """By distance along each axis: the mean over the histogram is that of the colors, as far as bins reach."""
    rgb = np.array(colors, dtype=np.uint8)
    shares = color_histogram(rgb).reshape(LIGHTNESS_BINS, HUE_BINS, HUE_BINS)
    values = lab(rgb)
    light = np.clip(values[:, 0] / 100.0, 0, 1).mean() * (LIGHTNESS_BINS - 1)
    hues = (np.clip((values[:, 1:] + HUE_REACH) / (2 * HUE_REACH), 0, 1) * (HUE_BINS - 1)).mean(axis=0)
    means = [float((shares.sum(axis=tuple({0, 1, 2} - {axis})) * np.arange(shares.shape[axis])).sum()) for axis in range(3)]
    assert means == pytest.approx([light, *hues], abs=1e-9)
    assert (shares > 0).sum() <= 8 * len({tuple(color) for color in colors})


@given(
    st.lists(st.tuples(*[st.integers(0, 255)] * 3), min_size=1, max_size=30),
    st.lists(st.tuples(*[st.integers(0, 255)] * 3), min_size=1, max_size=30),
)
@settings(max_examples=40, deadline=None)
def test_color_similarity_is_a_similarity(first: list[tuple[int, int, int]], second: list[tuple[int, int, int]]) -> None:
    a, b = (color_histogram(np.array(colors, dtype=np.uint8)) for colors in (first, second))
    assert a.sum() == pytest.approx(1.0)
    assert color_similarity(a, a) == pytest.approx(1.0, abs=1e-6)
    assert color_similarity(a, b) == pytest.approx(color_similarity(b, a), abs=1e-9)
    assert 0.0 <= color_similarity(a, b) <= 1.0


def test_closeness_is_told_no_finer_than_the_scan_is() -> None:
    """A mug's falloff of 4 % is 6 mm; points 3 cm apart cannot tell so much."""
    config, off = ScoreConfig(), Distances(0.01, 0.01, 0.01, 1.0)
    mug, coarse = (score_of(off, 1, 1, 0.15, config, 0.0, resolution) for resolution in (0.0, 0.03))
    assert mug < coarse < 1.0
    assert score_of(off, 1, 1, 2.0, config, 0.0, 0.03) == score_of(off, 1, 1, 2.0, config)


def test_the_score_is_a_weighted_sum_that_grows_with_every_term() -> None:
    config = ScoreConfig()
    weights = [config.coverage, config.scan_closeness, config.asset_closeness, config.box_iou, config.color]
    assert sum(weights) == pytest.approx(1.0)
    best = score_of(Distances(0.0, 0.0, 0.0, 1.0), 1.0, 1.0, 1.0, config)
    assert best == pytest.approx(1.0)
    worse = [
        score_of(Distances(0.1, 0, 0.1, 1), 1, 1, 1, config), score_of(Distances(0, 0.1, 0.1, 1), 1, 1, 1, config),
        score_of(Distances(0, 0, 0, 0.5), 1, 1, 1, config), score_of(Distances(0, 0, 0, 1), 0.5, 1, 1, config),
        score_of(Distances(0, 0, 0, 1), 1, 0.5, 1, config), score_of(Distances(0, 0, 0, 1), 1, 1, 1, config, foreign=0.2),
    ]  # fmt: skip
    assert all(0 <= value < best for value in worse)
