"""Categories of models: what the name of a file tells, and how alike two of them are."""

from __future__ import annotations

import re

from tasks.captions.physics import known_name, table

_CATCH_ALL = frozenset({"", "otherprop", "otherfurniture", "otherstructure", "unlabeled"})


def category_of(stem: str) -> str:
    """Category that a file's name tells: `aws_ChairA_01` is a chair. Words are split at case, digits and signs."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", stem)
    kept = [word.lower() for word in words if len(word) > 1] or [stem.lower()]
    for end in range(len(kept), 0, -1):
        name = known_name(" ".join(kept[:end]))
        if name:
            return name
    return " ".join(kept)


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
