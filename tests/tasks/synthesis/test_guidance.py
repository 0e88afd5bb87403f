"""Guidance: slopes are slopes, faults go, and what has none stays as it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.synthesis.rooms import micro_scene_rows
from tasks.synthesis.inference.guidance import MARGIN_M, Guidance, boxes_of, contacts_of, cost, gradient, guided, settled, sound
from tasks.synthesis.layout import Large, Layout, layouts_of
from tasks.synthesis.metrics.boxes import box_figures, depths, overhangs
from tasks.synthesis.model.encoding import BOX, Heights, encoding_of
from tests.tasks.synthesis.layouts import layout_of

TRUTH = layouts_of(*micro_scene_rows(40, 5))


def disturbed(layouts, spread: float, seed: int = 0):
    rng = np.random.default_rng(seed)
    return [
        dataclasses.replace(
            layout,
            centers=layout.centers + rng.normal(0.0, spread, (len(layout), 3)) * (1.0, 1.0, 0.3),
            yaws=layout.yaws + rng.normal(0.0, spread, len(layout)),
        )
        for layout in layouts
    ]


def crowd(seed: int):
    """Anything anywhere about a table, in any turn."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 9))
    sizes = rng.uniform(0.01, 0.4, (count, 3))
    centers = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)), 0.7 + rng.uniform(-0.2, 0.5, count)])
    return Layout(Large(str(rng.choice(["desk", "bed"])), (0.8, 0.9, 0.7)), ("mug",) * count, centers, sizes, rng.uniform(-7, 7, count))


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_the_gradient_is_that_of_finite_differences(seed: int) -> None:
    boxes = boxes_of([crowd(seed), crowd(seed + 1)])
    contacts = contacts_of(boxes)
    by_center, by_yaw = gradient(boxes, contacts)
    numbers = np.column_stack([boxes.centers, boxes.yaws])
    step = 1e-7
    for row in range(len(numbers)):
        for column, slope in enumerate((*by_center[row], by_yaw[row])):
            ends = []
            for sign in (-1.0, 1.0):
                moved = numbers.copy()
                moved[row, column] += sign * step
                ends.append(cost(boxes.at(moved[:, :3], moved[:, 3]), contacts).sum())
            assert slope == pytest.approx((ends[1] - ends[0]) / (2 * step), abs=2e-6)


def test_layouts_without_fault_stay_as_they_are() -> None:
    assert cost(boxes_of(TRUTH), contacts_of(boxes_of(TRUTH))).max() < 1e-12
    for before, after in zip(TRUTH, settled(TRUTH, Guidance()), strict=True):
        np.testing.assert_allclose(after.centers, before.centers, atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * after.yaws), np.exp(1j * before.yaws), atol=1e-9)


@pytest.mark.parametrize(("spread", "before", "after"), [(0.02, 0.07, 0.0), (0.1, 0.2, 0.01)])
def test_faults_go_and_little_else_changes(spread: float, before: float, after: float) -> None:
    drawn = disturbed(TRUTH, spread)
    made = settled(drawn, Guidance())
    assert box_figures(drawn).collides > before
    assert box_figures(made).collides <= after
    assert box_figures(made).off_support <= after
    for one, other in zip(drawn, made, strict=True):
        assert one.categories == other.categories
        np.testing.assert_array_equal(one.sizes, other.sizes)
    shifts = [np.abs(one.centers - other.centers)[:, :2].max(axis=1) for one, other in zip(drawn, made, strict=True)]
    assert np.median(np.concatenate(shifts)) < spread


def test_what_becomes_of_a_layout_does_not_depend_on_others() -> None:
    drawn = disturbed(TRUTH[:30], 0.05)
    together = settled(drawn, Guidance())
    for number in (0, 3, 17):
        (alone,) = settled(drawn[number : number + 1], Guidance())
        np.testing.assert_array_equal(alone.centers, together[number].centers)
        np.testing.assert_array_equal(alone.yaws, together[number].yaws)


def test_boxes_part_by_what_they_are_in_each_other_and_turned_ones_that_do_not_meet_stay() -> None:
    inside = layout_of(("mug", (0.0, 0.0, 0.75), (0.1, 0.1, 0.1), 0.0), ("mug", (0.0, 0.07, 0.75), (0.1, 0.1, 0.1), 0.0))
    (made,) = settled([inside], Guidance())
    np.testing.assert_allclose(made.centers[:, 1], [-0.016, 0.086], atol=2e-4)
    assert -depths(made)[0, 1] == pytest.approx(MARGIN_M, abs=1e-3)
    # long boxes side by side, turned by 45 degrees: the boxes around them overlap by far
    beside = layout_of(("book", (0.0, 0.0, 0.72), (0.4, 0.05, 0.04), 0.8), ("book", (0.08, -0.08, 0.72), (0.4, 0.05, 0.04), 0.8))
    (kept,) = settled([beside], Guidance())
    np.testing.assert_array_equal(kept.centers[:, :2], beside.centers[:, :2])


def test_bottoms_go_to_the_nearest_level_and_stacks_stay_stacks() -> None:
    book, mug = ("book", (0.0, 0.0, 0.73), (0.3, 0.2, 0.04), 0.0), ("mug", (0.02, 0.0, 0.83), (0.08, 0.08, 0.1), 0.0)
    (made,) = settled([layout_of(book, mug)], Guidance())
    np.testing.assert_allclose(made.centers, [[0.0, 0.0, 0.72], [0.02, 0.0, 0.79]], atol=1e-4)
    sunk = layout_of(("mug", (0.0, 0.0, 0.6), (0.08, 0.08, 0.1), 0.0))
    assert settled([sunk], Guidance())[0].centers[0, 2] == pytest.approx(0.75, abs=1e-4)
    in_shelf = dataclasses.replace(sunk, large=Large("shelf", (1.0, 2.0, 0.7)))
    np.testing.assert_array_equal(settled([in_shelf], Guidance())[0].centers, in_shelf.centers)


def test_what_reaches_over_the_edge_comes_back_onto_it() -> None:
    layout = layout_of(("book", (0.45, -1.2, 0.72), (0.3, 0.2, 0.04), 0.5))
    (made,) = settled([layout], Guidance())
    assert box_figures([made]).off_support == 0.0
    assert made.centers[0, 0] < 0.45


def test_what_objects_keep_free_lies_between_them_and_before_edges() -> None:
    pair = layout_of(("mug", (0.0, 0.0, 0.75), (0.1, 0.1, 0.1), 0.0), ("mug", (0.0, 0.07, 0.75), (0.1, 0.1, 0.1), 0.0))
    (made,) = settled([pair], Guidance(), [np.array([0.01, 0.02])])
    assert -depths(made)[0, 1] == pytest.approx(0.03, abs=1e-3)
    at_edge = layout_of(("mug", (0.45, 0.0, 0.75), (0.1, 0.1, 0.1), 0.0))
    (made,) = settled([at_edge], Guidance(), [np.array([0.01])])
    assert overhangs(made).max() == pytest.approx(-0.02, abs=1e-3)
    free = Guidance(free_m=(0.003, 0.008)).free(np.random.default_rng(0), (500,))
    assert 0.003 <= free.min() < 0.0032
    assert 0.0078 < free.max() <= 0.008
    first, second = np.random.default_rng(7), np.random.default_rng(7)
    Guidance().free(first, (3,))
    np.testing.assert_array_equal(first.random(4), second.random(4))


def test_sound_layouts_have_nothing_that_collides_or_is_off_its_support() -> None:
    assert all(sound(TRUTH))
    inside = layout_of(("mug", (0.0, 0.0, 0.75), (0.1, 0.1, 0.1), 0.0), ("mug", (0.0, 0.07, 0.75), (0.1, 0.1, 0.1), 0.0))
    over, above = (layout_of(("mug", middle, (0.1, 0.1, 0.1), 0.0)) for middle in ((0.5, 0.0, 0.75), (0.0, 0.0, 0.9)))
    assert sound([inside, TRUTH[0], over, above]) == [False, True, False, False]


@pytest.mark.parametrize("heights", ["middles", "bottoms"])
def test_denoised_vectors_change_in_middles_and_turns_of_objects_alone(heights: Heights) -> None:
    encoding = encoding_of(TRUTH, heights=heights)
    drawn = [layout for layout in disturbed(TRUTH, 0.1) if len(layout) < 12][:6]
    vectors = np.array([encoding.vectors(layout, 13) for layout in drawn])
    larges = {row: layout.large for row, layout in enumerate(drawn) if row != 2}
    made = guided(vectors, larges, encoding, Guidance(inner=20), np.full((len(drawn), 12), 0.5 * MARGIN_M))
    changed = made != vectors
    assert not changed[:, 0].any()
    assert not changed[..., 3:6].any()
    assert not changed[..., BOX:].any()
    assert not changed[2].any()
    assert not changed[vectors[..., -1] > 0].any()
    np.testing.assert_allclose(np.hypot(made[..., 6], made[..., 7]), np.hypot(vectors[..., 6], vectors[..., 7]), atol=1e-6)
    after = [encoding.layout(rows, layout.large) for rows, layout in zip(made, drawn, strict=True)]
    kept = [row for row in larges if len(drawn[row])]
    costs = [cost(boxes_of(part), contacts_of(boxes_of(part)))[kept] for part in (drawn, after)]
    assert (costs[1] <= costs[0]).all()
    assert costs[1].sum() < 0.05 * costs[0].sum()
