"""How far layouts are from each other, how varied they are, and whether they repeat what was learned from."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.synthesis.layout import Large, Layout

Array = NDArray[np.float64]

UNMATCHED_M = 0.5
"""What an object counts that the other layout has no counterpart of, and the most that a pair counts."""

COPY_M = 0.01
"""Nearer than this to a layout that was learned from is a copy of it."""

MOST_PAIRS = 4000
"""Pairs of layouts that variety is taken over; more would change its third digit."""

_ROUNDING = 1e-12


@dataclasses.dataclass(frozen=True)
class NearestFigures:
    """Mean distance to the nearest layout that was learned from [m]: of drawn layouts, of held-out true ones, and their ratio; far below
    1 the drawn ones repeat what was learned. copies, true_copies: Shares nearer than 1 cm to one of them."""

    drawn_m: float
    truth_m: float
    ratio: float
    copies: float
    true_copies: float


def layout_distance(a: Layout, b: Layout) -> float:
    """How far two layouts are apart [m], symmetric, 0 for equal ones, at most `UNMATCHED_M`.

    Objects of the same category are paired so that the distances of their middles, each at most `UNMATCHED_M`, sum to the least; objects
    without counterpart count `UNMATCHED_M`. The sum is divided by the number of objects of the larger layout.
    """
    return _Prepared(a).distance(_Prepared(b))


def nearest_distances(layouts: Sequence[Layout], among: Sequence[Layout]) -> Array:
    """Distance of each layout to the nearest of others on the same category of large object [m], shape (n,); `UNMATCHED_M` without any."""
    by_large: dict[str, list[_Prepared]] = defaultdict(list)
    for layout in among:
        by_large[layout.large.category].append(_Prepared(layout))
    indexed = {category: _Among(prepared) for category, prepared in by_large.items()}
    matches = np.full(len(layouts), UNMATCHED_M)
    for at, layout in enumerate(layouts):
        if layout.large.category in indexed:
            matches[at] = indexed[layout.large.category].nearest(_Prepared(layout))
    return matches


def nearest_figures(drawn: Sequence[Layout], truth: Sequence[Layout], learned: Sequence[Layout]) -> NearestFigures:
    """Whether drawn layouts repeat what was learned from. truth: Layouts that were held out; they tell how near a new one is."""
    own, held = nearest_distances(drawn, learned), nearest_distances(truth, learned)
    drawn_m, truth_m = (float(values.mean()) if len(values) else math.nan for values in (own, held))
    copies, true_copies = (float((values < COPY_M).mean()) if len(values) else math.nan for values in (own, held))
    return NearestFigures(drawn_m, truth_m, drawn_m / truth_m if truth_m else math.nan, copies, true_copies)


def like(large: Large) -> Hashable:
    """What large objects have in common among which variety is taken: category and kind of room."""
    return large.category, large.room_type


def variety(layouts: Sequence[Layout], seed: int, same: Sequence[Hashable] | None = None) -> float:
    """Mean distance of two layouts of large objects of one kind [m]; NaN where no two are of one kind.

    same: What kind each layout is of, shape (n,), such as the number of its large object; None for `like`. Every pair counts as much as
    every other; of more than `MOST_PAIRS`, so many are drawn.
    """
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for at, layout in enumerate(layouts):
        groups[like(layout.large) if same is None else same[at]].append(at)
    members = [np.array(group) for group in groups.values() if len(group) > 1]
    if not members:
        return math.nan
    pairs = np.concatenate([np.column_stack([part[i] for i in np.triu_indices(len(part), 1)]) for part in members])
    if len(pairs) > MOST_PAIRS:
        pairs = pairs[np.random.default_rng([seed, 1]).choice(len(pairs), MOST_PAIRS, replace=False)]
    prepared = {at: _Prepared(layouts[at]) for at in np.unique(pairs).tolist()}
    return float(np.mean([prepared[a].distance(prepared[b]) for a, b in pairs.tolist()]))


class _Prepared:
    """A layout's middles by category."""

    def __init__(self, layout: Layout) -> None:
        names = np.array(layout.categories)
        self.size = len(layout)
        self.points: Mapping[str, Array] = {name: layout.centers[names == name] for name in dict.fromkeys(layout.categories)}

    def distance(self, other: _Prepared) -> float:
        """See `layout_distance`."""
        most = max(self.size, other.size)
        if not most:
            return 0.0
        total, paired = 0.0, 0
        for name, points in self.points.items():
            if name in other.points:
                cost, count = _matched(points, other.points[name])
                total, paired = total + cost, paired + count
        return (total + UNMATCHED_M * (most - paired)) / most


class _Among:
    """Layouts of which the nearest is asked for, their middles by category in arrays, so that few have to be paired one by one."""

    def __init__(self, prepared: Sequence[_Prepared]) -> None:
        self.prepared = prepared
        self.sizes = np.array([item.size for item in prepared])
        names = sorted({name for item in prepared for name in item.points})
        self.counts = {name: np.array([len(item.points.get(name, ())) for item in prepared]) for name in names}
        self.points: dict[str, Array] = {}
        for name, counts in self.counts.items():
            points = np.full((len(prepared), counts.max(), 3), np.inf)
            for at in np.flatnonzero(counts).tolist():
                points[at, : counts[at]] = prepared[at].points[name]
            self.points[name] = points

    def nearest(self, item: _Prepared) -> float:
        """Distance to the nearest of the layouts [m]; those go first that cannot be far."""
        least, best = self.least(item), np.inf
        for at in np.argsort(least, kind="stable").tolist():
            if least[at] >= best:
                break
            best = min(best, item.distance(self.prepared[at]))
        return float(best)

    def least(self, item: _Prepared) -> Array:
        """What the distances are at least [m], shape (n,), were no object in the way of another's nearest counterpart."""
        most = np.maximum(self.sizes, item.size)
        total = UNMATCHED_M * most.astype(np.float64)
        for name, points in item.points.items():
            if name in self.points:
                squares = ((points[None, :, None] - self.points[name][:, None]) ** 2).sum(axis=3)
                nearest = np.sort(np.minimum(np.sqrt(squares.min(axis=2)), UNMATCHED_M), axis=1)  # of each object of `one`
                pairs = np.minimum(self.counts[name], len(points))
                paired = np.where(np.arange(len(points)) < pairs[:, None], nearest, 0.0)
                total += paired.sum(axis=1) - UNMATCHED_M * pairs
        return np.asarray(total / np.maximum(most, 1)) - _ROUNDING


def _matched(a: Array, b: Array) -> tuple[float, int]:
    """Least sum of distances of points paired one to one, each at most `UNMATCHED_M` [m], and how many; shapes (n, 3), (m, 3)."""
    from scipy.optimize import linear_sum_assignment

    costs = np.minimum(np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=2)), UNMATCHED_M)
    if 1 in costs.shape:
        return float(costs.min()), 1
    rows, columns = linear_sum_assignment(costs)
    return float(costs[rows, columns].sum()), len(rows)
