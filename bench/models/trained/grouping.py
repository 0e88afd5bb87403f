"""Objects from pairs of pixels that are likely one: patches of pixels that surely are, joined while the mean over their pairs says so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]
Logits = NDArray[np.float32]

PAIRS = ((0, 1), (1, 0), (0, 3), (3, 0), (3, 3), (3, -3), (0, 9), (9, 0), (9, 9), (9, -9), (0, 22), (22, 0))
"""Steps in rows and columns from a pixel to the one that it is paired with [px]: near ones say where an object ends, far ones whether what
an edge of depth divides is one."""

LEAST_PIXELS = 30
"""Of an object."""

_SURE, _FAR_SURE = 1.5, 2.5
"""Logits from which on neighbors, and pixels three apart, are one patch."""

_LEAST_PATCH = 6
_LEAST_PAIRS = 2
_MOST_LOGIT = 6.0
_ROUNDS = 20


def halves(step: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of an image that give pixels and those that are a step further."""
    down, right = step
    rows = (slice(None, -down or None), slice(down, None))
    left = (slice(max(0, -right), -max(0, right) or None), slice(max(0, right), -max(0, -right) or None))
    return (rows[0], left[0]), (rows[1], left[1])


def objects_of_pairs(logits: Logits, is_object: Bools, least: int = LEAST_PIXELS) -> Indices:
    """Object of each pixel, shape (h, w), -1 for none. logits: That pairs are one object, shape (pairs, h, w), see `PAIRS`, each at its
    first pixel. is_object: Pixels of objects."""
    shape = is_object.shape
    pairs = _pairs(logits, is_object)
    patch = _patches(pairs, is_object)
    if patch.max(initial=-1) < 0:
        return np.full(shape, -1, dtype=np.int64)
    group = _joined(pairs, patch)
    return _sizable(np.where(patch >= 0, group[patch], -1), least).reshape(shape)


def _pairs(logits: Logits, is_object: Bools) -> list[tuple[Indices, Indices, NDArray[np.float64]]]:
    """Of each step the pixels, those that they are paired with, and logits."""
    index = np.arange(is_object.size).reshape(is_object.shape)
    made = []
    for place, step in enumerate(PAIRS):
        here, there = halves(step)
        both = is_object[here] & is_object[there]
        likely = np.clip(logits[place][here][both].astype(np.float64), -_MOST_LOGIT, _MOST_LOGIT)
        made.append((index[here][both], index[there][both], likely))
    return made


def _patches(pairs: list[tuple[Indices, Indices, NDArray[np.float64]]], is_object: Bools) -> Indices:
    """Patch of each pixel, shape (h * w,), -1 for none: pixels that near pairs surely join, and those that are likeliest theirs."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = [], []
    for place, (here, there, likely) in enumerate(pairs[:4]):
        sure = likely > (_SURE if place < 2 else _FAR_SURE)
        first.append(here[sure])
        second.append(there[sure])
    ends = (np.concatenate(first), np.concatenate(second))
    graph = coo_array((np.ones(len(ends[0]), dtype=np.int8), ends), shape=(is_object.size, is_object.size))
    component = connected_components(graph, directed=False)[1]
    patch = _sizable(np.where(is_object.ravel(), component, -1), _LEAST_PATCH)
    source = np.concatenate([np.concatenate([here, there]) for here, there, _ in pairs[:4]])
    target = np.concatenate([np.concatenate([there, here]) for here, there, _ in pairs[:4]])
    likely = np.concatenate([np.concatenate([each, each]) for *_, each in pairs[:4]])
    for _ in range(_ROUNDS):
        reached = np.flatnonzero((likely > 0) & (patch[source] >= 0) & (patch[target] < 0))
        if not len(reached):
            break
        order = reached[np.lexsort((patch[source[reached]], -likely[reached], target[reached]))]
        own, nearest = np.unique(target[order], return_index=True)
        patch[own] = patch[source[order[nearest]]]
    return patch


def _joined(pairs: list[tuple[Indices, Indices, NDArray[np.float64]]], patch: Indices) -> Indices:
    """Group of each patch: the two whose pairs are likeliest one are joined, as long as they are likelier one than not."""
    count = int(patch.max()) + 1
    total, number = np.zeros((count, count)), np.zeros((count, count))
    for here, there, likely in pairs:
        across = (patch[here] >= 0) & (patch[there] >= 0) & (patch[here] != patch[there])
        ends = (patch[here[across]], patch[there[across]])
        np.add.at(total, ends, likely[across])
        np.add.at(number, ends, 1)
    total, number, group = total + total.T, number + number.T, np.arange(count)
    mean = np.where(number >= _LEAST_PAIRS, total / np.maximum(number, 1), -np.inf)
    while True:
        a, b = divmod(int(mean.argmax()), count)
        if mean[a, b] <= 0:
            return group
        for table in (total, number):
            table[a] += table[b]
            table[:, a] += table[:, b]
            table[b], table[:, b], table[a, a] = 0, 0, 0
        group[group == b] = a
        mean[b], mean[:, b] = -np.inf, -np.inf
        mean[a] = mean[:, a] = np.where(number[a] >= _LEAST_PAIRS, total[a] / np.maximum(number[a], 1), -np.inf)


def _sizable(label: Indices, least: int) -> Indices:
    """Labels numbered from 0, without those of too few; -1 is none."""
    named, dense, sizes = np.unique(label, return_inverse=True, return_counts=True)
    kept = (named >= 0) & (sizes >= least)
    return np.asarray(np.where(kept, np.cumsum(kept) - 1, -1)[dense], dtype=np.int64)
