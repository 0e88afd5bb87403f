"""Objects out of pairs: exact pairs give exact objects."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.models.trained.grouping import LEAST_PIXELS, PAIRS, halves, objects_of_pairs


def cells(seed: int, count: int, shape: tuple[int, int] = (48, 64)) -> np.ndarray:
    """Convex regions, some of which are nobody's (-1), shape (h, w)."""
    rng = np.random.default_rng(seed)
    middles = rng.uniform(0, 1, (count, 2)) * shape
    rows, columns = np.indices(shape)
    nearest = ((rows[..., None] - middles[:, 0]) ** 2 + (columns[..., None] - middles[:, 1]) ** 2).argmin(axis=-1)
    sizes = np.bincount(nearest.ravel(), minlength=count)
    return np.where((nearest % 3 == 0) | (sizes < 2 * LEAST_PIXELS)[nearest], -1, nearest)


def exact(owner: np.ndarray) -> np.ndarray:
    """Logits of pairs, by rolling the image."""
    logits = np.full((len(PAIRS), *owner.shape), -4.0, dtype=np.float32)
    for place, (down, right) in enumerate(PAIRS):
        there = np.roll(owner, (-down, -right), (0, 1))
        logits[place][(owner == there) & (owner >= 0)] = 4.0
    return logits


@given(st.integers(0, 10_000), st.integers(2, 14))
def test_exact_pairs_give_exact_objects(seed: int, count: int) -> None:
    owner = cells(seed, count)
    found = objects_of_pairs(exact(owner), owner >= 0)
    for number in range(found.max() + 1):
        assert len(np.unique(owner[found == number])) == 1
    for number in np.unique(owner[owner >= 0]):
        assert (found[owner == number] >= 0).mean() > 0.9  # but for corners that no pair of neighbors reaches
        assert len(np.unique(found[(owner == number) & (found >= 0)])) == 1
    assert (found[owner < 0] == -1).all()


def test_pairs_are_of_pixels_and_those_a_step_further() -> None:
    index = np.arange(48 * 64).reshape(48, 64)
    for down, right in PAIRS:
        here, there = halves((down, right))
        assert index[here].shape == (48 - down, 64 - abs(right))
        assert (index[there] - index[here] == 64 * down + right).all()


def test_what_an_edge_of_depth_divides_is_one_by_far_pairs_and_two_without() -> None:
    owner = np.full((40, 80), -1)
    owner[10:30, 10:30] = owner[10:30, 34:60] = 0
    logits = exact(owner)
    assert len(np.unique(objects_of_pairs(logits, owner >= 0))) == 2
    logits[6:] = -4.0
    assert len(np.unique(objects_of_pairs(logits, owner >= 0))) == 3


def test_nothing_is_of_nothing() -> None:
    logits = np.zeros((len(PAIRS), 20, 30), dtype=np.float32)
    assert (objects_of_pairs(logits, np.zeros((20, 30), dtype=bool)) == -1).all()
    few = np.zeros((20, 30), dtype=bool)
    few[3, 4] = few[9, 9] = True
    assert (objects_of_pairs(logits, few) == -1).all()
