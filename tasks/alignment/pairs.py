"""Points of a scan and the samples of a surface that are nearest to them, kept up while the surface is turned and shifted, compiled.

A pair stays while no other sample can have come nearer: what is known of how far the others were is less by what samples have moved.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.alignment import distances
from tasks.alignment.distances import blocked, pairwise_sum, search
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

_SLACK = 1e-9  # bounds are this much looser than the numbers: rounding keeps no pair


class Pairs:
    """Nearest samples of points, shape (k, 3) [m], of which those `keep` count that are nearest."""

    def __init__(self, points: Array, keep: int) -> None:
        self._points, self._keep = np.ascontiguousarray(points), keep
        self._index, self._ranks = np.zeros(len(points), dtype=np.int64), np.arange(len(points))
        self._distance, self._beyond = np.zeros((2, len(points)))
        self._placed: Array | None = None
        self._order = np.zeros(0, dtype=np.int64)

    def turn(self, placed: Array) -> tuple[float, float, Array, Array]:
        """How the points that count must be met by samples, shape (m, 3) and each time the same ones: sums over the pairs, about their
        middles in plan, of the sine and of the cosine of the turn between them, times both lengths [m2], and the middles of these samples
        and points, both shape (2,) [m]."""
        placed = np.ascontiguousarray(placed)
        kernels, is_first = _compiled(), self._placed is None
        if self._placed is None:
            self._order, self._placed = distances.compiled()["curve"](placed), placed
        kernels["_paired"](
            self._points, placed, self._placed, self._order, is_first, self._index, self._distance, self._beyond, self._ranks
        )
        self._placed = placed
        across, along, source, to = kernels["_turned"](self._points, placed, self._index, self._ranks[: self._keep])
        return float(across), float(along), source, to


@cache
def _compiled() -> Kernels:
    return compile_kernels(_ranked, _paired, _turned, known=distances.compiled())


def _ranked(distance: Array, ranks: NDArray[np.int64]) -> None:
    """Put points into the order of their distances, of equal ones the first: from an order that is nearly so, or anew."""
    left = 4 * len(ranks)
    for i in range(1, len(ranks)):
        point, at = ranks[i], i
        while at > 0:
            other = ranks[at - 1]
            if distance[other] < distance[point] or (distance[other] == distance[point] and other < point):
                break
            ranks[at] = other
            at -= 1
        ranks[at] = point
        left -= i - at
        if left < 0:
            ranks[:] = np.argsort(distance, kind="mergesort")
            return


def _paired(
    points: Array, placed: Array, before: Array, order: NDArray[np.int64], is_first: bool, index: NDArray[np.int64], distance: Array,
    beyond: Array, ranks: NDArray[np.int64],
) -> None:  # fmt: skip
    """Nearest samples, how far they are, and how far all others are at least; the order of points by their distance."""
    columns, spheres, groups = blocked(placed, order)
    middle, moved = np.empty(groups.shape[1]), 0.0
    for j in range(len(placed)):
        p, q, r = placed[j, 0] - before[j, 0], placed[j, 1] - before[j, 1], placed[j, 2] - before[j, 2]
        moved = max(moved, p * p + q * q + r * r)
    moved = np.sqrt(moved) * (1 + _SLACK)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not is_first:
            j, others = index[i], beyond[i] - moved
            p, q, r = placed[j, 0] - x, placed[j, 1] - y, placed[j, 2] - z
            d = p * p + q * q + r * r
            if others > 0.0 and d < others * others * (1 - _SLACK):
                distance[i], beyond[i] = np.sqrt(d), others
                continue
        at, best, second = search(order, columns, spheres, groups, middle, x, y, z, True)
        index[i], distance[i], beyond[i] = at, np.sqrt(best), np.sqrt(second) * (1 - _SLACK)
    _ranked(distance, ranks)


def _turned(points: Array, placed: Array, index: NDArray[np.int64], used: NDArray[np.int64]) -> tuple[float, float, Array, Array]:
    count = len(used)
    source, to = np.zeros(2), np.zeros(2)
    for i in used:
        for a in range(2):
            source[a] += placed[index[i], a]
            to[a] += points[i, a]
    source, to = source / count, to / count
    across, along = np.empty(count), np.empty(2 * count)
    for n in range(count):
        i, j = used[n], index[used[n]]
        x, y = placed[j, 0] - source[0], placed[j, 1] - source[1]
        u, v = points[i, 0] - to[0], points[i, 1] - to[1]
        across[n] = x * v - y * u
        along[2 * n], along[2 * n + 1] = x * u, y * v
    return pairwise_sum(across), pairwise_sum(along), source, to
