"""Names of people's folders as words that tables, paths, addresses and simulators all take: ASCII letters, digits, `_`, `.`, `-`."""

from __future__ import annotations

import hashlib
import re
import unicodedata

_LONGEST = 64
"""Letters of a word that is made of another script; Chinese takes some four for one, and file systems 255 bytes."""


def latin(text: str) -> str:
    """A text in Latin letters without marks, as it is read aloud; characters that have no reading are left out."""
    if text.isascii():
        return text
    from text_unidecode import unidecode

    return str(unidecode(unicodedata.normalize("NFC", text)))


def plain_word(text: str) -> str:
    """A name as one word that begins with a letter or digit; `scan` where nothing of it is left.

    ASCII stays as it is, with `_` for other characters. A name in other letters is written in Latin ones and ends in eight
    digits of its own, so that different names stay different: `会议室` is `Hui_Yi_Shi-423bba6b`. How its letters are composed,
    in which file systems differ, does not matter.
    """
    word = re.sub(r"[^A-Za-z0-9_.-]+", "_", latin(text)).lstrip("_.-")
    if text.isascii():
        return word or "scan"
    mark = hashlib.sha256(unicodedata.normalize("NFC", text).encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return f"{word[:_LONGEST].rstrip('_.-') or 'scan'}-{mark}"
