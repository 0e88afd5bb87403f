"""What a classifier of pictures from above tells apart."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.synthesis.metrics.discrimination import FOLDS, PictureClassifier, picture_accuracy, shuffled
from tests.tasks.synthesis.layouts import desks, layout_of


@pytest.mark.whole
def test_pictures_of_shuffled_layouts_are_told_from_true_ones_and_true_ones_from_nothing() -> None:
    true, others = desks(120, 0), desks(120, 1)
    settings = PictureClassifier(epochs=7, batch=32)
    telling = picture_accuracy(others, shuffled(true, 0), 0, settings)
    assert telling.value > 0.8
    assert telling.low < telling.value < telling.high
    assert telling.examples == 240
    alike = picture_accuracy(true, others, 0, settings)
    assert alike.low - 0.05 < 0.5 < alike.high + 0.05  # one interval of 95 % in twenty leaves out what it is of


@pytest.mark.whole
def test_pictures_of_few_or_no_objects_and_a_seed_give_the_same_again() -> None:
    true, others = [layout_of(), *desks(10, 0)], [*desks(10, 1), layout_of()]
    quick = PictureClassifier(epochs=2, batch=8)
    first = picture_accuracy(true, others, 3, quick)
    assert first == picture_accuracy(true, others, 3, quick)
    assert first.examples == 22
    assert np.isnan(picture_accuracy(true[: FOLDS - 1], others, 0).value)
    assert picture_accuracy(true[: FOLDS - 1], others, 0).examples == 0
