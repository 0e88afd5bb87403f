"""One sentence about an object: color, material, category, and what stands out of its shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tasks.captions.physics import materials

SECOND_COLOR_FROM = 0.2
"""Share of the points from which a second color is told."""

TALL_BACK_M = 0.95
"""Height of a seat with a tall back: shoulders of a seated adult begin at about 0.95 m above the floor (seat 0.45 + 0.5)."""

_SEATS = frozenset({"chair", "office chair", "armchair", "sofa chair", "dining chair", "sofa", "couch", "rocking chair"})
_TOPS = frozenset({"table", "dining table", "desk", "coffee table", "side table", "end table", "console table", "conference table"})
_PHRASES = {
    "flat": "thin and flat", "panel": "upright and thin", "tall": "tall and narrow", "long": "long and slender",
    "low": "low and wide", "compact": "about as wide as high", "wide": "wider than deep",
}  # fmt: skip

SHAPES: tuple[str, ...] = tuple(_PHRASES)
"""Every word that `shape_word` can answer."""


def shape_word(size: ArrayLike) -> str:
    """Shape from the proportions of a box of `size` along x, y, z [m], shape (3,)."""
    x, y, z = np.maximum(np.asarray(size, dtype=np.float64), 1e-3)
    long, short = max(x, y), min(x, y)
    if z < 0.12 * short or (z < 0.2 * long and z < 0.25 * short):
        return "flat"
    if short < 0.2 * min(long, z):
        return "panel"
    if z > 1.8 * long:
        return "tall"
    if long > 3.0 * max(short, z):
        return "long"
    if z < 0.45 * short:
        return "low"
    return "wide" if long > 1.6 * short else "compact"


def compose(category: str, colors: Sequence[str], shares: Sequence[float], material: str, shape: str, size: ArrayLike) -> str:
    """The sentence. `colors` with their `shares`, most frequent first; `material` a name of the material table."""
    words = [colors[0]] if colors else []
    adjective = materials()[material].adjective
    if adjective not in category:
        words.append(adjective)
    words.append(category)
    body = " ".join(words)
    if category.endswith("s") and not category.endswith(("ss", "us", "is")):
        subject = body[0].upper() + body[1:]
    else:
        subject = f"{'An' if body[:1] in ('a', 'e', 'i', 'o', 'u') else 'A'} {body}"
    details = [_detail(category, shape, np.asarray(size, dtype=np.float64))]
    if len(colors) > 1 and shares[1] >= SECOND_COLOR_FROM:
        details.append(f"partly {colors[1]}")
    return f"{subject}{details[0]}" + (f", {details[1]}." if len(details) > 1 else ".")


def _detail(category: str, shape: str, size: np.ndarray) -> str:
    """What stands out of the shape, from the box alone."""
    if category in _SEATS:
        return f" with a {'tall' if size[2] >= TALL_BACK_M else 'low'} back"
    if category in _TOPS:
        long, short = max(size[:2]), max(min(size[:2]), 1e-3)
        return " with a long top" if long > 1.6 * short else " with a compact top"
    return f", {_PHRASES[shape]}"
