"""Pictures of layouts from above: where what is seen, and what hides what."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tasks.micro_scenes.categories import read_categories
from tasks.synthesis.layout import Large
from tasks.synthesis.pictures import BACKGROUND, LARGE, color_of, figure_of, from_above, palette
from tests.tasks.synthesis.layouts import desks, layout_of


def test_every_category_has_a_color_of_its_own() -> None:
    colors = palette()
    assert list(colors) == list(read_categories().names)
    assert len({*colors.values(), BACKGROUND, LARGE}) == len(colors) + 2
    assert color_of("no such thing") == colors["object"]


def test_up_is_the_front_left_is_plus_y_and_the_higher_top_is_seen() -> None:
    table = Large("table", (1.0, 1.0, 0.7))
    layout = layout_of(
        ("mug", (0.4, 0.4, 0.75), (0.2, 0.1, 0.1), 0.0),
        ("lamp", (-0.3, -0.3, 0.9), (0.1, 0.1, 0.4), 0.0),
        ("book", (-0.3, -0.3, 0.72), (0.3, 0.3, 0.04), 0.0),
        large=table,
    )
    image = from_above(layout, 120, 1.2)
    expected = np.empty((120, 120, 3), dtype=np.uint8)
    expected[:] = BACKGROUND
    expected[10:110, 10:110] = LARGE
    expected[10:30, 15:25] = color_of("mug")
    expected[75:105, 75:105] = color_of("book")
    expected[85:95, 85:95] = color_of("lamp")
    assert np.array_equal(image, expected)


def test_areas_are_those_of_turned_boxes_and_the_order_of_objects_is_not_seen() -> None:
    layout = layout_of(("book", (0.1, -0.2, 0.72), (0.3, 0.2, 0.04), 0.6), ("mug", (0.1, -0.2, 0.9), (0.1, 0.1, 0.1), 0.2))
    image = from_above(layout, 400, 2.0)
    seen = {name: (image == color_of(name)).all(axis=2).mean() * 4.0 for name in layout.categories}
    assert seen["mug"] == pytest.approx(0.01, rel=0.02)
    assert seen["book"] == pytest.approx(0.05, rel=0.02)
    back = dataclasses.replace(
        layout, categories=layout.categories[::-1], centers=layout.centers[::-1], sizes=layout.sizes[::-1], yaws=layout.yaws[::-1]
    )
    assert np.array_equal(from_above(back, 400, 2.0), image)
    around = dataclasses.replace(layout, yaws=layout.yaws + 2 * np.pi)
    assert np.array_equal(from_above(around, 400, 2.0), image)


@pytest.mark.whole
def test_a_figure_names_its_rows_and_what_is_seen() -> None:
    some = desks(6, 0)
    figure = figure_of([("office", some), ("bedroom", some[:3])], "desks")
    texts = {text.get_text() for ax in figure.axes for text in (ax.title, ax._left_title, *ax.texts)}  # type: ignore[attr-defined]
    assert {"office", "bedroom", "monitor"} <= texts
    assert len(figure.axes) == 2
    (first, _) = figure.axes
    assert len(first.patches) == sum(len(layout) + 1 for layout in some)
    labels = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    assert labels == {name.replace("_", " ") for layout in some for name in layout.categories}
    figure.canvas.draw()
    with pytest.raises(ValueError, match="at least one"):
        figure_of([], "nothing")
