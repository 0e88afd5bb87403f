"""Texts as hashed tokens: whole words and their letters in threes, so that an unknown word is near those that are written alike."""

from __future__ import annotations

import re
import zlib

import numpy as np
from numpy.typing import NDArray

_WORD = re.compile(r"[^\W_]+")


def tokens_of(text: str, buckets: int, count: int) -> NDArray[np.int64]:
    """Tokens of a text, shape (count,), from 1 to `buckets`, then 0: word after word with its threes of letters, the rest cut off.

    The same on every machine, whatever the seed of Python's own hashes.
    """
    tokens: list[int] = []
    for word in _WORD.findall(text.lower()):
        framed = f"<{word}>"
        pieces = [framed, *(framed[i : i + 3] for i in range(len(framed) - 2))] if len(framed) > 3 else [framed]
        tokens += [zlib.crc32(piece.encode()) % buckets + 1 for piece in pieces]
    row = np.zeros(count, dtype=np.int64)
    row[: min(len(tokens), count)] = tokens[:count]
    return row


def described(category: str, caption: str | None) -> str:
    """What a model reads of an object: its category, then its caption where there is one."""
    return category if not caption else f"{category}. {caption}"
