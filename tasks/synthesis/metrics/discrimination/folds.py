"""Which classifier judges which layouts, whatever it looks at, and layouts that any has to tell from true ones."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from tasks.selection.metrics.bootstrap import ConfidenceInterval, interval
from tasks.synthesis.layout import Array, Layout
from tasks.synthesis.metrics.boxes import overhangs

FOLDS = 5
"""Classifiers that are trained; each judges the fifth of the layouts that it did not see."""

Judge = Callable[[NDArray[np.int64], NDArray[np.bool_], int], Array]
"""Trains a classifier and judges by it: answers, shape (n,), which layouts are held out, shape (n,), and a seed give 1 for each of the
held-out ones that is judged rightly, else 0."""


def accuracy(truth: Sequence[Layout], drawn: Sequence[Layout], seed: int, judge: Callable[[Sequence[Layout]], Judge]) -> ConfidenceInterval:
    """Share of layouts that classifiers which saw others put on the right side, with its interval of 95 %.

    Equally many of both sides are judged, each once. Layouts on the same large object are judged by the same classifier, so that it
    cannot know from the one what the other is. NaN where a side has fewer than `FOLDS` layouts.

    judge: From all layouts of both sides, true ones first, what trains and judges.
    """
    count = min(len(truth), len(drawn))
    if count < FOLDS:
        return ConfidenceInterval(math.nan, math.nan, math.nan, 0)
    rng = np.random.default_rng([seed, 2])
    chosen = [[side[at] for at in sorted(rng.permutation(len(side))[:count].tolist())] for side in (truth, drawn)]
    layouts = [*chosen[0], *chosen[1]]
    answers = np.repeat([0, 1], count)
    trained, keys = judge(layouts), [repr(layout.large) for layout in layouts]
    folds = _folds(keys, seed)
    hits = np.full(len(layouts), math.nan)
    for fold in range(FOLDS):
        held = folds == fold
        if held.any() and not held.all():
            hits[held] = trained(answers, held, seed * FOLDS + fold)
    return interval(hits, keys, seed)


def shuffled(layouts: Sequence[Layout], seed: int) -> list[Layout]:
    """Layouts whose objects stand anywhere: footprints inside of the large object's box as far as they fit, at their own heights and
    turns. What tells true ones from drawn ones has to tell these from true ones, or it tells nothing."""
    rng = np.random.default_rng([seed, 3])
    made = []
    for layout in layouts:
        centers = layout.centers.copy()
        room = np.maximum(-(overhangs(layout) - np.abs(layout.centers[:, :2])), 0.0)
        centers[:, :2] = rng.uniform(-1.0, 1.0, size=(len(layout), 2)) * room
        made.append(dataclasses.replace(layout, centers=centers))
    return made


def _folds(keys: Sequence[str], seed: int) -> NDArray[np.int64]:
    """Which classifier judges each layout, shape (n,): equally many large objects each, by chance."""
    names = sorted(set(keys), key=lambda key: hashlib.sha256(f"{seed}|{key}".encode()).digest())
    place = {name: at % FOLDS for at, name in enumerate(names)}
    return np.array([place[key] for key in keys], dtype=np.int64)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Torch with draws by a seed and one thread, so that sums are in the same order however many there are; as it was afterwards."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(threads)
