"""Masks of a frame held against the true ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.small_objects.lifting import FrameMasks

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

LEAST_IOU, EXACT_IOU = 0.5, 0.75
"""Overlaps in pixels from which on a mask is an object's, and from which on it is so closely."""

DRAWS = 2000
"""Of frames with repetition, for an interval."""


@dataclasses.dataclass(frozen=True)
class FrameTruth:
    """What a frame shows. masks: Shape (n, h, w). words: Of each. counted: Which have to be found, shape (n,); who finds another one makes
    no error. care: Pixels that count, shape (h, w). group: Frames of one scene are no independent evidence."""

    masks: Bools
    words: tuple[str, ...]
    counted: Bools
    care: Bools
    group: str


@dataclasses.dataclass(frozen=True)
class FrameScore:
    """Of one frame. true: Objects that have to be found. seen: Masks, but for those of other objects. matched, exact: Pairs of the two that
    overlap by `LEAST_IOU` and by `EXACT_IOU`. named: Matched pairs of one word."""

    group: str
    true: int
    seen: int
    matched: int
    exact: int
    named: int


def score(truth: FrameTruth, seen: FrameMasks) -> FrameScore:
    """Masks of a frame held against the truth, each one in one pair at most."""
    from scipy.optimize import linear_sum_assignment

    overlap = overlaps(truth.masks & truth.care, seen.masks & truth.care)
    pairs = []
    for least in (LEAST_IOU, EXACT_IOU):
        rows, columns = linear_sum_assignment(np.where(overlap >= least, overlap, 0.0), maximize=True)
        near = [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if overlap[i, j] >= least and truth.counted[i]]
        pairs.append(near)
    best = overlap.argmax(axis=0) if overlap.size else np.zeros(0, dtype=np.int64)
    spare = [not truth.counted[i] and overlap[i, j] > 0 for j, i in enumerate(best)]
    named = sum(truth.words[i] == seen.labels[j] for i, j in pairs[0])
    return FrameScore(truth.group, int(truth.counted.sum()), len(seen.masks) - int(sum(spare)), len(pairs[0]), len(pairs[1]), named)


def overlaps(true: Bools, seen: Bools) -> Array:
    """Intersection over union of masks, shapes (n, h, w) and (m, h, w); shape (n, m)."""
    if not len(true) or not len(seen):
        return np.zeros((len(true), len(seen)))
    a, b = (masks.reshape(len(masks), -1).astype(np.float32) for masks in (true, seen))
    shared = a @ b.T
    return np.asarray(shared / np.maximum(a.sum(axis=1)[:, None] + b.sum(axis=1)[None] - shared, 1), dtype=np.float64)


def harmonic(scores: Sequence[FrameScore], exact: bool = False) -> float:
    """F1 over frames: of all objects and masks together."""
    return _f1(_table(scores, exact).sum(axis=0))


def precision_recall(scores: Sequence[FrameScore], exact: bool = False) -> tuple[float, float]:
    """Shares of masks that are an object's, and of objects that have a mask."""
    matched, true, seen = _table(scores, exact).sum(axis=0)
    return float(matched / max(seen, 1)), float(matched / max(true, 1))


def lead(first: Sequence[FrameScore], second: Sequence[FrameScore], seed: int) -> tuple[float, float, float]:
    """F1 of the first less that of the second on the same frames, and the ends of its interval of 95 %: groups of frames are drawn with
    repetition, for both at once."""
    groups = sorted({each.group for each in first})
    sums = [[_table([each for each in scores if each.group == group]).sum(axis=0) for group in groups] for scores in (first, second)]
    tables = np.array(sums)
    drawn = np.random.default_rng(seed).integers(len(groups), size=(DRAWS, len(groups)))
    leads = [_f1(tables[0][rows].sum(axis=0)) - _f1(tables[1][rows].sum(axis=0)) for rows in drawn]
    low, high = np.quantile(leads, [0.025, 0.975])
    return harmonic(first) - harmonic(second), float(low), float(high)


def _table(scores: Sequence[FrameScore], exact: bool = False) -> NDArray[np.int64]:
    """Matched, true and seen, shape (frames, 3)."""
    return np.array([(each.exact if exact else each.matched, each.true, each.seen) for each in scores], dtype=np.int64).reshape(-1, 3)


def _f1(sums: NDArray[np.int64]) -> float:
    matched, true, seen = sums
    return float(2 * matched / max(true + seen, 1))
