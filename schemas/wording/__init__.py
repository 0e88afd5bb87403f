"""Words of messages: counts with their noun, and what somebody may have meant who mistyped a name."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterable

from schemas.text import SHOWN

_MOST_COMPARED = 10_000
"""Names that a mistyped one is held against: half a second's worth."""


def counted(count: int, single: str, several: str = "") -> str:
    """A count and what is counted: ``1 scene``, ``2 scenes``."""
    return f"{count} {noun(count, single, several)}"


def noun(count: int, single: str, several: str = "") -> str:
    """What is counted, for so many: `single`, or `several`, which is `single` and an s where nothing is said."""
    return single if count == 1 else several or f"{single}s"


def meant(word: str, known: Iterable[str]) -> str:
    """``did you mean scene0000_00? ``, where one of the known names is near to a word; else nothing."""
    names = {name.lower(): name for name in itertools.islice(known, _MOST_COMPARED)}
    close = difflib.get_close_matches(word[:SHOWN].lower(), names, n=1)
    return f"did you mean {names[close[0]]}? " if close else ""
