"""Words for merged categories: what a box of a category is, by its size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from tasks.furniture import CATEGORIES, canonical_category, typical_extents
from tasks.micro_scenes.categories import Categories, read_categories
from tasks.mounting import mounting

ALIKE = 0.5
"""Words whose usual extents are as near to a box as the nearest, give or take this (sum over sides of the logarithm's difference)."""

THIN_M = 0.02
"""Sides that are thinner are of one size [m]: a tablet is no less a tablet for being 8 mm thick instead of 6."""

_ELSEWHERE = ("let_in", "wall", "ceiling", "covering")
"""Kinds of mounting of what never stands on furniture."""


def word_for(category: str, size: Sequence[float], rng: np.random.Generator) -> str:
    """A word that the table of categories merges into `category` and whose usual extents are about `size` [m], shape (3,).

    Where the furniture generator draws nothing of the category, the category's own name.
    """
    words = words_of(category)
    if not words:
        return category.replace("_", " ")
    usual = np.log(np.maximum([typical_extents(word) for word in words], THIN_M))
    away = np.abs(usual - np.log(np.maximum(size, THIN_M))).sum(axis=1)
    near = np.flatnonzero(away <= away.min() + ALIKE)
    return words[int(near[rng.integers(len(near))])]


def words_of(category: str) -> tuple[str, ...]:
    """Words that the furniture generator draws and the table merges into a category, in alphabetical order."""
    return _words().get(category, ())


@cache
def _words() -> Mapping[str, tuple[str, ...]]:
    table = read_categories()
    matches: dict[str, set[str]] = {}
    for word in {*CATEGORIES, *(known for word in table.words if (known := canonical_category(word)) is not None)}:
        if mounting(word).kind not in _ELSEWHERE:
            matches.setdefault(table.merged(word), set()).add(word)
    return {category: tuple(sorted(words)) for category, words in matches.items()}


def large_of(word: str, table: Categories | None = None) -> str | None:
    """The category of a large object that a word names; None for what is no large object."""
    table = table or read_categories()
    category = table.merged(word)
    is_named = category != "object" or word.strip().lower() == "object"
    return category if is_named and table.is_large(category) else None
