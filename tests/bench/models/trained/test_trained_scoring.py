"""Masks of frames held against the truth."""

from __future__ import annotations

import numpy as np
import pytest

from bench.models.trained.scoring import FrameScore, FrameTruth, harmonic, lead, overlaps, precision_recall, score
from tasks.capture.small_objects.lifting import FrameMasks


def masks(*spans: tuple[int, int]) -> np.ndarray:
    made = np.zeros((len(spans), 4, 40), dtype=bool)
    for mask, (start, end) in zip(made, spans, strict=True):
        mask[:, start:end] = True
    return made


def found(*spans: tuple[int, int], words: tuple[str, ...] = ()) -> FrameMasks:
    return FrameMasks(masks(*spans), words or ("",) * len(spans), np.ones(len(spans)))


TRUTH = FrameTruth(
    masks((0, 10), (10, 20), (20, 24)), ("mug", "book", "pen"), np.array([True, True, False]), np.ones((4, 40), dtype=bool), "a"
)


def test_exact_masks_are_all_right() -> None:
    exact = score(TRUTH, found((0, 10), (10, 20), (20, 24), words=("mug", "book", "pen")))
    assert exact == FrameScore("a", 2, 2, 2, 2, 2)
    assert precision_recall([exact]) == (1.0, 1.0)
    assert harmonic([exact], exact=True) == 1.0


def test_what_need_not_be_found_is_no_error_and_what_is_nowhere_is_one() -> None:
    assert score(TRUTH, found((0, 10), (20, 24))) == FrameScore("a", 2, 1, 1, 1, 0)
    assert score(TRUTH, found((0, 10), (30, 36))) == FrameScore("a", 2, 2, 1, 1, 0)
    assert score(TRUTH, found()) == FrameScore("a", 2, 0, 0, 0, 0)


def test_a_mask_is_of_one_object_and_closely_from_three_quarters_on() -> None:
    # one mask over both: half of each
    assert score(TRUTH, found((0, 20))).matched == 1
    assert score(TRUTH, found((0, 6), words=("cup",))) == FrameScore("a", 2, 1, 1, 0, 0)
    assert score(TRUTH, found((0, 8), words=("mug",))) == FrameScore("a", 2, 1, 1, 1, 1)


def test_overlaps_are_counted_pixels() -> None:
    rng = np.random.default_rng(0)
    true, seen = rng.random((3, 9, 11)) < 0.5, rng.random((4, 9, 11)) < 0.4
    expected = [[(a & b).sum() / (a | b).sum() for b in seen] for a in true]
    assert np.allclose(overlaps(true, seen), expected)
    assert overlaps(true, seen[:0]).shape == (3, 0)


def test_a_lead_is_of_the_same_frames() -> None:
    good = [FrameScore(str(i), 10, 10, 8, 6, 0) for i in range(12)]
    poor = [FrameScore(str(i), 10, 12, 4 + i % 2, 2, 0) for i in range(12)]
    assert lead(good, good, 0) == (0.0, 0.0, 0.0)
    value, low, high = lead(good, poor, 0)
    assert value == pytest.approx(0.8 - 2 * 54 / (120 + 144))
    assert 0 < low < value < high
    assert lead(good, poor, 0) == (value, low, high)
    assert lead(poor, good, 0)[0] == pytest.approx(-value)
