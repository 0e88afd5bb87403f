"""CIEDE2000 against published pairs, and structural similarity against its definition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra import numpy as arrays

from tasks.captions.colors import lab
from tasks.fidelity.colors import ciede2000, gray, structural_similarity

# Sharma, Wu, Dalal 2005, table 1: two CIELAB colors and their difference
PUBLISHED = """
50.0000 2.6772 -79.7751 50.0000 0.0000 -82.7485 2.0425
50.0000 3.1571 -77.2803 50.0000 0.0000 -82.7485 2.8615
50.0000 2.8361 -74.0200 50.0000 0.0000 -82.7485 3.4412
50.0000 -1.3802 -84.2814 50.0000 0.0000 -82.7485 1.0000
50.0000 -1.1848 -84.8006 50.0000 0.0000 -82.7485 1.0000
50.0000 -0.9009 -85.5211 50.0000 0.0000 -82.7485 1.0000
50.0000 0.0000 0.0000 50.0000 -1.0000 2.0000 2.3669
50.0000 -1.0000 2.0000 50.0000 0.0000 0.0000 2.3669
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0009 7.1792
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0010 7.1792
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0011 7.2195
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0012 7.2195
50.0000 -0.0010 2.4900 50.0000 0.0009 -2.4900 4.8045
50.0000 -0.0010 2.4900 50.0000 0.0010 -2.4900 4.8045
50.0000 -0.0010 2.4900 50.0000 0.0011 -2.4900 4.7461
50.0000 2.5000 0.0000 50.0000 0.0000 -2.5000 4.3065
50.0000 2.5000 0.0000 73.0000 25.0000 -18.0000 27.1492
50.0000 2.5000 0.0000 61.0000 -5.0000 29.0000 22.8977
50.0000 2.5000 0.0000 56.0000 -27.0000 -3.0000 31.9030
50.0000 2.5000 0.0000 58.0000 24.0000 15.0000 19.4535
50.0000 2.5000 0.0000 50.0000 3.1736 0.5854 1.0000
50.0000 2.5000 0.0000 50.0000 3.2972 0.0000 1.0000
50.0000 2.5000 0.0000 50.0000 1.8634 0.5757 1.0000
50.0000 2.5000 0.0000 50.0000 3.2592 0.3350 1.0000
60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
63.0109 -31.0961 -5.8663 62.8187 -29.7946 -4.0864 1.2630
61.2901 3.7196 -5.3901 61.4292 2.2480 -4.9620 1.8731
35.0831 -44.1164 3.7933 35.0232 -40.0716 1.5901 1.8645
22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
36.4612 47.8580 18.3852 36.2715 50.5065 21.2231 1.4146
90.8027 -2.0831 1.4410 91.1528 -1.6435 0.0447 1.4441
90.9257 -0.5406 -0.9208 88.6381 -0.8985 -0.7239 1.5381
6.7747 -0.2908 -2.4247 5.8714 -0.0985 -2.2286 0.6377
2.0776 0.0795 -1.1350 0.9033 -0.0636 -0.5514 0.9082
"""
PAIRS = np.array([[float(word) for word in line.split()] for line in PUBLISHED.strip().splitlines()])

COLORS = arrays.arrays(np.uint8, (6, 3))


def test_differences_are_those_that_were_published() -> None:
    assert len(PAIRS) == 34
    assert np.abs(ciede2000(PAIRS[:, :3], PAIRS[:, 3:6]) - PAIRS[:, 6]).max() < 0.5e-4
    assert np.abs(ciede2000(PAIRS[:, 3:6], PAIRS[:, :3]) - PAIRS[:, 6]).max() < 0.5e-4


@given(COLORS, COLORS)
def test_a_difference_is_symmetric_and_nothing_between_equal_colors(first: np.ndarray, second: np.ndarray) -> None:
    a, b = lab(first), lab(second)
    assert ciede2000(a, b) == pytest.approx(ciede2000(b, a), abs=1e-9)
    assert (ciede2000(a, a) == 0).all()
    assert (ciede2000(a, b)[(first != second).any(axis=1)] > 0).all()


def by_definition(a: np.ndarray, b: np.ndarray, seen: np.ndarray, row: int, column: int) -> float:
    """SSIM around one pixel, window by window, of the pixels that are seen."""
    step = np.arange(-5, 6)
    bell = np.exp(-(step**2) / (2 * 1.5**2))
    total, sums = 0.0, np.zeros(5)
    for i, down in zip(step, bell, strict=True):
        for j, across in zip(step, bell, strict=True):
            r, c = row + i, column + j
            if 0 <= r < a.shape[0] and 0 <= c < a.shape[1] and seen[r, c]:
                x, y = a[r, c], b[r, c]
                total += down * across
                sums += down * across * np.array([x, y, x * x, y * y, x * y])
    mx, my, xx, yy, xy = sums / total
    c1, c2 = 2.55**2, 7.65**2
    return float((2 * mx * my + c1) * (2 * (xy - mx * my) + c2) / ((mx**2 + my**2 + c1) * (xx - mx**2 + yy - my**2 + c2)))


def test_structural_similarity_is_its_definition() -> None:
    rng = np.random.default_rng(3)
    a = rng.uniform(0, 255, (17, 23))
    b = np.clip(a + rng.normal(0, 40, a.shape), 0, 255)
    for seen in (np.ones(a.shape, dtype=bool), rng.random(a.shape) < 0.7):
        similar = structural_similarity(a, b, seen)
        for row, column in np.argwhere(seen)[::7]:
            assert similar[row, column] == pytest.approx(by_definition(a, b, seen, row, column), abs=1e-9)


@given(arrays.arrays(np.uint8, (14, 15, 3)), arrays.arrays(bool, (14, 15)))
def test_equal_pictures_are_as_similar_as_can_be(picture: np.ndarray, seen: np.ndarray) -> None:
    values = gray(picture)
    assert structural_similarity(values, values, seen)[seen] == pytest.approx(1.0, abs=1e-9)
    other = structural_similarity(values, 255 - values, seen)[seen]
    assert (np.abs(other) <= 1 + 1e-9).all()


def test_what_is_not_seen_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 255, (2, 20, 20))
    seen = rng.random(a.shape) < 0.6
    changed = np.where(seen, a, 255 - a)
    assert structural_similarity(a, b, seen)[seen] == pytest.approx(structural_similarity(changed, b, seen)[seen], abs=1e-9)
