"""Which assets of a library come nearest to an instance: by category words, extents, shape and color."""

from __future__ import annotations

from collections.abc import Sequence

from tasks.candidates.descriptors import Descriptor, extents_similarity, shape_similarity, similarity
from tasks.candidates.library import LibraryEntry
from tasks.captions.physics import known_name, table

CATEGORY_WEIGHT = 0.45
"""A wrong category is the one error that everybody sees; it outweighs shape and color together."""

EXTENTS_WEIGHT = 0.25
"""Selection may scale within narrow limits only, so the size has to be nearly right before."""

SHAPE_WEIGHT = 0.2
"""Partial scans blur shape histograms: two scans of one chair differ by 0.1 to 0.2, chair and stool by 0.3."""

COLOR_WEIGHT = 0.1
"""Least: light changes color, and a material can be recolored where a shape cannot be reshaped."""

MIN_SCORE = 0.4
"""Below this neither the category nor size, shape and color together fit: a mug is not stood in for by a bed."""

MIN_UNNAMED_SCORE = 0.62
"""The same where nobody knows what the instance is, of size, shape and color alone: nearly all of 39 models reach it that were scanned
from three sides with noise, and less than a quarter of what comes next (tests/tasks/test_retrieval.py)."""

_CATCH_ALL = frozenset({"", "otherprop", "otherfurniture", "otherstructure", "unlabeled"})


def category_similarity(first: str, other: str) -> float:
    """1 for the same object under any of its names, 0.8 for the same head noun, 0.5 for the same NYU40 class, else shared words."""
    a, b = first.lower().split(), other.lower().split()
    name_a, name_b = known_name(first), known_name(other)
    if first.lower() == other.lower() or (name_a is not None and name_a == name_b):
        return 1.0
    if a and b and a[-1] == b[-1]:
        return 0.8
    if name_a and name_b:
        classes = table()[name_a].nyu40, table()[name_b].nyu40
        if classes[0] == classes[1] and classes[0] not in _CATCH_ALL:
            return 0.5
    return 0.5 * len(set(a) & set(b)) / max(len(set(a) | set(b)), 1)


def score(category: str, descriptor: Descriptor, entry: LibraryEntry) -> float:
    """How well an entry fits an instance, 0..1."""
    return (
        CATEGORY_WEIGHT * category_similarity(category, entry.category)
        + EXTENTS_WEIGHT * extents_similarity(descriptor.extents, entry.descriptor.extents)
        + SHAPE_WEIGHT * shape_similarity(descriptor, entry.descriptor)
        + COLOR_WEIGHT * similarity(descriptor.colors, entry.descriptor.colors)
    )


def retrieve(category: str, descriptor: Descriptor, entries: Sequence[LibraryEntry], count: int) -> list[tuple[float, LibraryEntry]]:
    """The `count` entries that fit best, best first, none below `MIN_SCORE`; ties by file name.

    What has no known category, nor a word in common with any entry's, is compared by size, shape and color alone, none below
    `MIN_UNNAMED_SCORE`.
    """
    scored = [(score(category, descriptor, entry), entry) for entry in entries]
    least = MIN_SCORE
    if known_name(category) is None and not any(category_similarity(category, entry.category) > 0.0 for entry in entries):
        scored, least = [(value / (1.0 - CATEGORY_WEIGHT), entry) for value, entry in scored], MIN_UNNAMED_SCORE
    fitting = [pair for pair in scored if pair[0] >= least]
    return sorted(fitting, key=lambda pair: (-pair[0], pair[1].file))[:count]
