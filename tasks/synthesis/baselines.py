"""What learned layouts are held against: independent draws, and the layout that was learned from whose large object is most alike."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Hashable, Sequence

import numpy as np

from tasks.synthesis.layout import Array, Large, Layout


class IndependentDraws:
    """Layouts whose objects know nothing of each other.

    How many of a category there are is drawn from the counts in learned layouts of the same kind of large object and room; sizes from the
    category's mean and spread; place, relative to the large object's sides, height above its top and turn each from all that the category
    had on that kind of large object, one apart from the other.
    """

    def __init__(self, learned: Sequence[Layout]) -> None:
        if not learned:
            raise ValueError("baselines need at least one layout")
        self._counts: dict[Hashable, list[dict[str, int]]] = defaultdict(list)
        self._boxes: dict[Hashable, list[Array]] = defaultdict(list)
        for layout in learned:
            counts = {name: layout.categories.count(name) for name in dict.fromkeys(layout.categories)}
            rows = _relative(layout)
            for key in _keys(layout.large):
                self._counts[key].append(counts)
                for name, row in zip(layout.categories, rows, strict=True):
                    self._boxes[key, name].append(row)

    def draw(self, larges: Sequence[Large], seed: int) -> list[Layout]:
        """A layout on each of some large objects; the same seed gives the same ones, whatever else is drawn."""
        return [self._drawn(large, np.random.default_rng([seed, at])) for at, large in enumerate(larges)]

    def _drawn(self, large: Large, rng: np.random.Generator) -> Layout:
        key = next(key for key in _keys(large) if key in self._counts)
        learned = self._counts[key]
        names: list[str] = []
        for name in sorted({name for counts in learned for name in counts}):
            names += [name] * learned[rng.integers(len(learned))].get(name, 0)
        rows = np.array([self._box(np.array(self._boxes[key, name]), rng) for name in names]).reshape(len(names), 7)
        depth, width, height = large.size
        sizes = rows[:, 3:6]
        centers = rows[:, :3] * np.array([depth, width, 1.0]) + np.column_stack([np.zeros((len(names), 2)), height + 0.5 * sizes[:, 2]])
        return Layout(large, tuple(names), centers, sizes, rows[:, 6])

    @staticmethod
    def _box(rows: Array, rng: np.random.Generator) -> Array:
        """A box whose columns are drawn apart, shape (7,). rows: Of the category, shape (n, 7)."""
        row = rows[rng.integers(len(rows), size=7), np.arange(7)]
        sizes = np.log(rows[:, 3:6])
        row[3:6] = np.exp(sizes.mean(axis=0) + sizes.std(axis=0) * rng.normal(size=3))
        return np.asarray(row)


class NearestScene:
    """The learned layout whose large object is nearest in size, of the same category and kind of room where there is one, as it is."""

    def __init__(self, learned: Sequence[Layout]) -> None:
        if not learned:
            raise ValueError("baselines need at least one layout")
        self._learned: dict[Hashable, list[Layout]] = defaultdict(list)
        for layout in learned:
            for key in _keys(layout.large):
                self._learned[key].append(layout)

    def draw(self, larges: Sequence[Large], seed: int = 0) -> list[Layout]:
        """A layout on each of some large objects. seed: Which one is taken of equally near ones."""
        return [self._nearest(large, seed) for large in larges]

    def _nearest(self, large: Large, seed: int) -> Layout:
        learned = next(self._learned[key] for key in _keys(large) if key in self._learned)
        sizes = np.log(np.array([layout.large.size for layout in learned]))
        distances = np.abs(sizes - np.log(large.size)).sum(axis=1)
        nearest = np.flatnonzero(distances == distances.min())
        text = f"{seed}|{large}|nearest scene"
        rng = np.random.default_rng(list(hashlib.sha256(text.encode()).digest()))
        matches = learned[int(nearest[rng.integers(len(nearest))])]
        return Layout(large, matches.categories, matches.centers, matches.sizes, matches.yaws)


def _keys(large: Large) -> tuple[Hashable, ...]:
    """What a large object is looked up by: category and kind of room, then category alone, then nothing."""
    return (large.category, large.room_type), (large.category,), ()


def _relative(layout: Layout) -> Array:
    """Objects, shape (n, 7): middle over depth and width of the large object, bottom above its top [m], size [m], yaw [rad]."""
    depth, width, height = layout.large.size
    bottoms = layout.centers[:, 2] - 0.5 * layout.sizes[:, 2] - height
    return np.column_stack([layout.centers[:, 0] / depth, layout.centers[:, 1] / width, bottoms, layout.sizes, layout.yaws])
