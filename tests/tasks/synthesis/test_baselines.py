"""What learned layouts are held against: marginals that are kept, relations that are not, and layouts that come back as they are."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.synthesis.baselines import IndependentDraws, NearestScene
from tasks.synthesis.layout import Large
from tasks.synthesis.metrics.boxes import box_figures
from tasks.synthesis.metrics.distributions import category_kl
from tests.tasks.synthesis.layouts import desks, layout_of


def test_independent_draws_keep_each_category_and_lose_what_is_beside_what() -> None:
    learned = desks(400, 0)
    drawn = IndependentDraws(learned).draw([layout.large for layout in desks(400, 1)], 0)
    assert category_kl(learned, drawn) < 0.005
    assert np.mean([len(layout) for layout in drawn]) == pytest.approx(np.mean([len(layout) for layout in learned]), rel=0.05)
    figures = box_figures(drawn)
    assert figures.floats == 0.0
    heights = [
        (row[2] - 0.5 * size[2] - layout.large.size[2]) for layout in drawn for row, size in zip(layout.centers, layout.sizes, strict=True)
    ]
    assert np.allclose(heights, 0.0)

    def places(layouts: list) -> np.ndarray:
        pairs = [(one.centers[one.categories.index("monitor"), 1], one.centers[one.categories.index("keyboard"), 1]) for one in layouts]
        return np.array(pairs)

    before, after = places(learned), places(drawn)
    assert after.std(axis=0) == pytest.approx(before.std(axis=0), rel=0.15)
    assert np.corrcoef(before.T)[0, 1] > 0.99
    assert abs(np.corrcoef(after.T)[0, 1]) < 0.3


def test_the_same_seed_draws_the_same_whatever_else_is_drawn() -> None:
    draws, larges = IndependentDraws(desks(50, 0)), [layout.large for layout in desks(5, 1)]
    some, fewer, other = draws.draw(larges, 7), draws.draw(larges[:2], 7), draws.draw(larges, 8)
    assert [one.categories for one in some[:2]] == [one.categories for one in fewer]
    assert all(np.array_equal(a.centers, b.centers) for a, b in zip(some, fewer, strict=False))
    assert any(len(a) != len(b) or not np.allclose(a.centers, b.centers) for a, b in zip(some, other, strict=True))


def test_a_kind_of_room_counts_where_it_was_seen() -> None:
    size = (0.6, 1.2, 0.7)
    mug, book = ("mug", (0.0, 0.0, 0.75), (0.1, 0.1, 0.1), 0.0), ("book", (0.0, 0.0, 0.72), (0.2, 0.2, 0.04), 0.0)
    learned = [layout_of(mug, large=Large("desk", size, "office")), layout_of(book, large=Large("desk", size, "kitchen"))] * 5
    asked = [Large("desk", size, "office"), Large("desk", size, "kitchen"), Large("bed", size, "bedroom")]
    for baseline in (IndependentDraws(learned), NearestScene(learned)):
        office, kitchen, unseen = baseline.draw(asked, 0)
        assert (office.categories, kitchen.categories) == (("mug",), ("book",))
        assert set(unseen.categories) <= {"mug", "book"}
    with pytest.raises(ValueError, match="at least one"):
        IndependentDraws([])


def test_the_nearest_scene_comes_back_as_it_is_on_the_object_that_was_asked_for() -> None:
    learned = desks(50, 0)
    asked = [Large("desk", tuple(1.001 * side for side in layout.large.size), layout.large.room_type) for layout in learned]  # type: ignore[arg-type]
    for before, large, after in zip(learned, asked, NearestScene(learned).draw(asked), strict=True):
        assert after.large == large
        assert after.categories == before.categories
        assert np.array_equal(after.centers, before.centers)
