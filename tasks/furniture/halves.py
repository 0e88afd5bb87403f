"""Halves of the generator's templates: one furnishes wild rooms, the other may stand in for what was scanned there.

A template is a variant of a category, or a category that is always drawn in the same way.
"""

from __future__ import annotations

import zlib
from typing import Literal

Half = Literal["all", "offered", "withheld"]
"""Templates to draw from: all of them, those that candidates may use in wild rooms, or those that furnish wild rooms."""


class TemplateWithheld(ValueError):
    """The category has a single template, and it belongs to the other half."""


def variants_in(half: Half, variants: tuple[str, ...]) -> tuple[str, ...]:
    """Variants of one half; they take turns, so that each half has one of any two. A single variant belongs to both."""
    if half == "all" or len(variants) == 1:
        return variants
    return variants[0::2] if half == "offered" else variants[1::2]


def has_single_template(half: Half, category: str) -> bool:
    """True if the only template of a category belongs to a half. A hash of its name decides, so that new categories move no other."""
    return half == "all" or (zlib.crc32(category.encode()) % 2 == 1) == (half == "withheld")
