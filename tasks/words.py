"""Names of people's folders as words that tables, paths, addresses and simulators all take: ASCII letters, digits, `_`, `.`, `-`."""

from __future__ import annotations

import hashlib
import re
import unicodedata

MAX_WORD_LETTERS = 96
"""A dataset, a scan and an ending (`.scene_instance.json`) make one file name, and file systems take 255 bytes."""

MAX_STEM_LETTERS = 64
"""Letters that stay of a name before its digits. Another script may need four Latin letters for one of its own."""

_RESERVED = re.compile(r"(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?", re.IGNORECASE | re.ASCII)
"""Names of devices: Windows opens no file that is called so, whatever its ending."""


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
    in which file systems differ, does not matter. A long name, a name that ends with a dot, and a name that Windows reserves
    end in such digits, too.
    """
    word = _letters(text) or "scan"
    is_portable = len(word) <= MAX_WORD_LETTERS and not word.endswith(".") and not _RESERVED.fullmatch(word)
    return word if text.isascii() and is_portable else marked_word(text, unicodedata.normalize("NFC", text))


def marked_word(text: str, identity: str) -> str:
    """A name as one word that ends in eight digits of another text, such as the path of what bears the name."""
    stem = _letters(text)[:MAX_STEM_LETTERS].rstrip("_.-") or "scan"
    stem = f"scan_{stem}" if _RESERVED.fullmatch(stem) else stem
    return f"{stem}-{hashlib.sha256(identity.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def _letters(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", latin(text)).lstrip("_.-")
