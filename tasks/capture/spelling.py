"""Labels with a slip of the hand: `hcair`, `kitchen cabnet`."""

from __future__ import annotations

from collections.abc import Callable, Container
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spellchecker import SpellChecker

LEAST_LETTERS = 4
"""Shorter words are one slip away from too many others."""

SHORT_LETTERS = 2
"""Shorter words are none, whatever else speaks for them."""


def respelled(text: str, known: Container[str]) -> str | None:
    """The known text, lower case with single spaces, that a text becomes when one of its words is put right; None where none is.

    One letter too many, too few, wrong, or in the place of its neighbor. A word that English has is no slip if it stands alone, however
    near to a known one: a house is no mouse. Beside another it is, if both are known together then: an office chari is a chair. Of
    several the most usual word wins.
    """
    is_phrase = " " in text
    right = slips(text, known, lambda word: is_phrase or not is_english(word))
    return right[0] if right else None


def slips(
    text: str, known: Container[str], may_be: Callable[[str], bool] = lambda word: True, least_letters: int = LEAST_LETTERS
) -> list[str]:
    """The known texts that a text becomes when one of its words that may be a slip is put right, the most usual first."""
    words = text.split()
    right = []
    for at, word in enumerate(words):
        if len(word) < least_letters or not word.isalpha() or not may_be(word):
            continue
        for other in _english().edit_distance_1(word):
            whole = " ".join([*words[:at], other, *words[at + 1 :]])
            if whole in known:
                right.append((-_english().word_usage_frequency(other), whole))
    return [whole for _, whole in sorted(right)]


def is_english(word: str) -> bool:
    """Whether English has a word, lower case."""
    return word in _english()


@cache
def _english() -> SpellChecker:
    from spellchecker import SpellChecker

    return SpellChecker(language="en", distance=1)
