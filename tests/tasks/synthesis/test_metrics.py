"""Figures of layouts against independent computations: shares, boxes, distances, features."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
import scipy.linalg
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import entropy

from tasks.synthesis.layout import Array, Large, Layout
from tasks.synthesis.metrics.boxes import box_figures, colliding, depths, floating, off_edge
from tasks.synthesis.metrics.distances import UNMATCHED_M, layout_distance, nearest_distances, nearest_figures, variety
from tasks.synthesis.metrics.distributions import category_kl, category_shares, distinct_share, presence_shares, total_variation
from tasks.synthesis.metrics.renders import fid, frechet_distance, kid
from tasks.synthesis.pictures import footprint
from tests.tasks.synthesis.layouts import desks, layout_of

DESK = Large("desk", (1.0, 2.0, 0.7), "office")


@st.composite
def layouts(draw: st.DrawFn) -> Layout:
    count = draw(st.integers(0, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    sizes = rng.uniform(0.02, 0.5, (count, 3))
    centers = np.column_stack([rng.uniform(-0.6, 0.6, count), rng.uniform(-1.1, 1.1, count), rng.uniform(0.6, 1.0, count)])
    names = tuple(rng.choice(["book", "mug", "lamp"], count).tolist())
    return Layout(DESK, names, centers, sizes, rng.uniform(-math.pi, math.pi, count))


@given(layouts())
@settings(max_examples=60, deadline=None)
def test_depth_is_the_shortest_move_after_which_boxes_share_nothing(layout: Layout) -> None:
    found = depths(layout)
    assert np.allclose(found, found.T)
    rings = [shapely.Polygon(footprint(layout, at)) for at in range(len(layout))]
    for a, b in itertools.permutations(range(len(layout)), 2):
        low = [layout.centers[at, 2] - 0.5 * layout.sizes[at, 2] for at in (a, b)]
        high = [layout.centers[at, 2] + 0.5 * layout.sizes[at, 2] for at in (a, b)]
        height = min(high[0] - low[1], high[1] - low[0])
        difference = shapely.MultiPoint([p - q for p in footprint(layout, a) for q in footprint(layout, b)]).convex_hull
        origin = shapely.Point(0.0, 0.0)
        plane = difference.boundary.distance(origin)
        if difference.contains(origin) and height > 0:
            assert found[a, b] == pytest.approx(min(plane, height), abs=1e-9)
            assert rings[a].intersection(rings[b]).area > 0
        else:
            assert found[a, b] <= 1e-9


@given(layouts(), st.floats(-math.pi, math.pi))
@settings(max_examples=30, deadline=None)
def test_what_collides_does_so_however_the_whole_is_turned_and_moved(layout: Layout, turn: float) -> None:
    cos, sin = math.cos(turn), math.sin(turn)
    moved = layout.centers @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + np.array([0.3, -0.7, 0.1])
    assert np.allclose(depths(layout), depths(dataclasses.replace(layout, centers=moved, yaws=layout.yaws + turn)), atol=1e-9)


def test_a_pile_rests_and_what_is_sunk_into_another_collides() -> None:
    book = (0.2, 0.3, 0.04)
    pile = layout_of(*[("book", (0.0, 0.0, 0.72 + 0.04 * at - 0.001 * at), book, 0.1 * at) for at in range(3)])
    sunk = layout_of(("book", (0.0, 0.0, 0.72), book, 0.0), ("mug", (0.0, 0.0, 0.75), (0.1, 0.1, 0.08), 0.0))
    beside = layout_of(("book", (0.0, 0.0, 0.72), book, 0.0), ("book", (0.196, 0.0, 0.72), book, 0.0))
    touching = layout_of(
        ("book", (0.0, 0.0, 0.72), book, 0.0), ("book", (0.19, 0.0, 0.72), book, 0.0), ("mug", (0.4, 0.9, 0.75), (0.1,) * 3, 0)
    )
    assert [flags.tolist() for flags in colliding([pile, sunk, layout_of(), beside, touching])] == [
        [False] * 3, [True, True], [], [False, False], [True, True, False],
    ]  # fmt: skip
    figures = box_figures([pile, sunk, layout_of(), beside, touching])
    assert (figures.layouts, figures.objects) == (5, 10)
    assert (figures.collides, figures.layouts_collide) == (0.4, 0.4)


@given(layouts())
@settings(max_examples=60, deadline=None)
def test_off_the_edge_is_whose_corners_are_outside(layout: Layout) -> None:
    over = [bool((np.abs(footprint(layout, at)) > np.array([0.505, 1.005])).any()) for at in range(len(layout))]
    assert off_edge([layout])[0].tolist() == over


def test_what_stands_on_nothing_floats_and_nothing_does_on_a_bed() -> None:
    mug, book = (0.1, 0.1, 0.1), (0.3, 0.3, 0.05)
    objects = [
        ("book", (0.0, 0.0, 0.725), book, 0.0),  # on the desk
        ("mug", (0.05, 0.0, 0.808), mug, 0.5),  # on the book, 8 mm above it
        ("mug", (0.0, 0.6, 0.80), mug, 0.0),  # as high, and beside the book
        ("mug", (0.4, -0.6, 0.68), mug, 0.0),  # sunk into the desk
        ("mug", (0.0, -0.6, 0.908), mug, 0.0),  # as high as a mug on the mug, and not over it
    ]
    assert floating([layout_of(*objects, large=DESK), layout_of(), layout_of(*objects, large=Large("bed", DESK.size))])[0].tolist() == [
        False, False, True, True, True,
    ]  # fmt: skip
    assert not floating([layout_of(*objects, large=Large("bed", DESK.size))])[0].any()
    figures = box_figures([layout_of(*objects, large=DESK), layout_of(("book", (0.4, 0.0, 0.725), book, 0.0), large=DESK)])
    assert (figures.floats, figures.off_edge, figures.off_support) == (0.5, 1 / 6, 4 / 6)
    assert figures.layouts_off_support == 1.0


def test_rule_made_desks_neither_collide_nor_float() -> None:
    figures = box_figures(desks(200, 0))
    assert (figures.collides, figures.off_support) == (0.0, 0.0)
    assert math.isnan(box_figures([]).collides)


def test_shares_and_divergences() -> None:
    truth, drawn = desks(300, 0), desks(300, 1)
    p, q = category_shares(truth), category_shares(drawn)
    assert sum(p.values()) == pytest.approx(1.0)
    names = sorted({*p, *q})
    assert category_kl(truth, drawn) == pytest.approx(entropy([p[n] for n in names], [q[n] for n in names]), abs=1e-4)
    assert category_kl(truth, truth) == 0.0
    without = [layout_of(("book", (0, 0, 0.72), (0.1, 0.1, 0.04), 0.0))]
    missing = {name: share for name, share in p.items() if name != "book"}
    by_hand = sum(s * math.log((s + 1e-6) / 1e-6) for s in missing.values()) + p["book"] * math.log((p["book"] + 1e-6) / (1 + 1e-6))
    assert category_kl(truth, without) == pytest.approx(by_hand)
    assert math.isnan(category_kl(truth, [layout_of()]))
    assert total_variation(p, q) == pytest.approx(0.5 * np.abs([p[n] - q[n] for n in names]).sum())
    assert total_variation({"a": 1.0}, {"b": 0.5, "c": 0.5}) == 1.0
    assert presence_shares(truth)["monitor"] == 1.0
    assert distinct_share([layout_of(), layout_of(), truth[0], truth[0]]) == 0.5


def by_trying(a: Layout, b: Layout) -> float:
    """The distance of two layouts by trying all ways of pairing."""
    if len(a) > len(b):
        return by_trying(b, a)
    if not len(b):
        return 0.0
    best = math.inf
    for chosen in itertools.permutations(range(len(b)), len(a)):
        cost = UNMATCHED_M * (len(b) - len(a))
        for i, j in enumerate(chosen):
            apart = float(np.linalg.norm(a.centers[i] - b.centers[j]))
            cost += min(apart, UNMATCHED_M) if a.categories[i] == b.categories[j] else UNMATCHED_M
        best = min(best, cost)
    return best / len(b)


@given(layouts(), layouts())
@settings(max_examples=40, deadline=None)
def test_the_distance_of_layouts_is_that_of_the_best_pairing(a: Layout, b: Layout) -> None:
    assert layout_distance(a, b) == pytest.approx(by_trying(a, b))
    assert layout_distance(b, a) == pytest.approx(layout_distance(a, b))
    assert layout_distance(a, a) == pytest.approx(0.0)


@given(st.lists(layouts(), min_size=1, max_size=6), st.lists(layouts(), min_size=1, max_size=12))
@settings(max_examples=40, deadline=None)
def test_the_nearest_layout_is_the_least_of_all_distances(some: list[Layout], among: list[Layout]) -> None:
    assert nearest_distances(some, among) == pytest.approx([min(layout_distance(a, b) for b in among) for a in some])


def test_what_repeats_the_training_layouts_is_found_out() -> None:
    learned, held, fresh = desks(200, 0), desks(100, 1), desks(100, 2)
    assert nearest_figures(fresh, held, learned).ratio == pytest.approx(1.0, abs=0.25)
    repeated = nearest_figures(learned[:100], held, learned)
    assert (repeated.drawn_m, repeated.copies, repeated.ratio) == (0.0, 1.0, 0.0)
    bed = dataclasses.replace(held[0], large=Large("bed", held[0].large.size))
    assert nearest_distances([bed], learned) == [UNMATCHED_M]


def test_variety_is_the_mean_over_pairs_on_the_same_kind() -> None:
    some = desks(12, 0)
    kinds = [0, 1, 2] * 4
    pairs = [layout_distance(some[a], some[b]) for a, b in itertools.combinations(range(12), 2) if kinds[a] == kinds[b]]
    assert variety(some, 0, kinds) == pytest.approx(np.mean(pairs))
    assert variety([some[0]] * 5, 0) == pytest.approx(0.0)
    assert math.isnan(variety(some[:1], 0))
    assert variety(desks(300, 0), 0) == pytest.approx(variety(desks(300, 0), 1), rel=0.1)


def slow_kid(x: Array, y: Array) -> float:
    """The definition, pair by pair."""

    def kernel(a: Array, b: Array) -> float:
        return float((sum(p * q for p, q in zip(a, b, strict=True)) / len(a) + 1) ** 3)

    n, m = len(x), len(y)
    first = sum(kernel(x[i], x[j]) for i in range(n) for j in range(n) if i != j) / (n * (n - 1))
    second = sum(kernel(y[i], y[j]) for i in range(m) for j in range(m) if i != j) / (m * (m - 1))
    return first + second - 2 * sum(kernel(a, b) for a in x for b in y) / (n * m)


def test_kid_is_its_definition_and_unbiased() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(7, 4)), rng.normal(1.0, 2.0, size=(9, 4))
    assert kid(x, y) == pytest.approx(slow_kid(x, y))
    same = [kid(rng.normal(size=(20, 4)), rng.normal(size=(20, 4))) for _ in range(400)]
    assert abs(np.mean(same)) < 4 * np.std(same) / 20
    assert min(same) < 0 < max(same)


@given(st.integers(0, 2**32), st.integers(1, 6), st.integers(2, 12))
@settings(max_examples=30, deadline=None)
def test_fid_is_the_distance_with_the_root_of_the_product(seed: int, width: int, rows: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(rows + width, width)), rng.normal(0.5, 1.5, size=(rows + width, width))
    a, b = np.atleast_2d(np.cov(x, rowvar=False)), np.atleast_2d(np.cov(y, rowvar=False))
    root = np.real(scipy.linalg.sqrtm(a @ b))
    expected = ((x.mean(0) - y.mean(0)) ** 2).sum() + np.trace(a + b - 2 * root)
    assert fid(x, y) == pytest.approx(expected, rel=1e-5, abs=1e-6)
    assert fid(x, x) == pytest.approx(0.0, abs=1e-7)


def test_fid_in_closed_forms() -> None:
    scales, others = np.array([1.0, 2.0, 0.0]), np.array([4.0, 1.0, 9.0])
    expected = 14.0 + ((np.sqrt(scales) - np.sqrt(others)) ** 2).sum()
    assert frechet_distance([0, 0, 0], np.diag(scales), [1, 2, 3], np.diag(others)) == pytest.approx(expected)
    rng = np.random.default_rng(0)
    few = rng.normal(size=(5, 40))  # covariances of rank 4
    assert fid(few, few + 1.0) == pytest.approx(40.0, rel=1e-6)
