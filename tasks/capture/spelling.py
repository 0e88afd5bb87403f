"""Labels with a slip of the hand: `hcair`, `kitchen cabnet`."""

from __future__ import annotations

from collections.abc import Callable, Container
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spellchecker import SpellChecker

LEAST_LETTERS = 4
"""Shorter words are one slip away from too many others."""


def respelled(text: str, known: Container[str]) -> str | None:
    """The known text, lower case with single spaces, that a text becomes when one of its words is put right; None where none is.

    One letter too many, too few, wrong, or in the place of its neighbor. Words that English has are no slips, however near to a known
    one: a house is no mouse. Of several the most usual word wins.
    """
    right = slips(text, known, lambda word: word not in _english())
    return right[0] if right else None


def slips(text: str, known: Container[str], may_be: Callable[[str], bool] = lambda word: True) -> list[str]:
    """The known texts that a text becomes when one of its words that may be a slip is put right, the most usual first."""
    words = text.split()
    right = []
    for at, word in enumerate(words):
        if len(word) < LEAST_LETTERS or not word.isalpha() or not may_be(word):
            continue
        for other in _english().edit_distance_1(word):
            whole = " ".join([*words[:at], other, *words[at + 1 :]])
            if whole in known:
                right.append((-_english().word_usage_frequency(other), whole))
    return [whole for _, whole in sorted(right)]


@cache
def _english() -> SpellChecker:
    from spellchecker import SpellChecker

    return SpellChecker(language="en", distance=1)
