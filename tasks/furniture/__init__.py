"""Furniture and household objects drawn from parameters: every model comes with its own convex pieces.

>>> model = generate("chair", (0.5, 0.45, 0.9), numpy.random.default_rng(0))

The same generator state, category, extents and color give the same model.
"""

from __future__ import annotations

import numpy as np

from tasks.furniture import (
    appliances,
    bath,
    beds,
    decor,
    electronics,
    fallback,
    lighting,
    seating,
    storage,
    tables,
    tableware,
)
from tasks.furniture.drafting import ALIASES, REGISTRY, Draft, Extents, FurnitureModel
from tasks.furniture.halves import Half, TemplateWithheld, has_single_template
from tasks.furniture.palette import Color

FAMILIES = (seating, tables, storage, beds, lighting, tableware, electronics, appliances, bath, decor)
"""Modules that draw, each a family."""

CATEGORIES: tuple[str, ...] = tuple(sorted(REGISTRY))
"""Categories that are drawn under their own name."""

MINIMUM_M = 1e-3
"""Thinnest extent that is drawn: thinner parts would not survive float32."""

MAXIMUM_M = 20.0
"""Longest extent that is drawn: more is no furniture."""

MAX_DRAWINGS = 8
"""Drawings of a category before it counts as one with a single template: some have variants in a part of their drawings only."""

__all__ = ["CATEGORIES", "FAMILIES", "FurnitureModel", "canonical_category", "generate", "is_known", "typical_extents"]


def canonical_category(category: str) -> str | None:
    """The category that is drawn for a word: itself, what it is another word for, its singular; None for an unknown one."""
    word = " ".join(category.lower().replace("_", " ").replace("-", " ").split())
    for form in (word, word.removesuffix("s"), word.removesuffix("es")):
        if form in REGISTRY:
            return form
        if form in ALIASES:
            return ALIASES[form]
    return None


def is_known(category: str) -> bool:
    """Whether a category has a drawing of its own; others are drawn as a plain body of their silhouette."""
    return canonical_category(category) is not None


def typical_extents(category: str) -> Extents:
    """Usual extents of a category along its own axes [m], shape (3,): depth (x), width (y), height (z)."""
    known = canonical_category(category)
    return REGISTRY[known].extents if known else (0.4, 0.4, 0.4)


def generate(
    category: str, extents: Extents | None, rng: np.random.Generator, color: Color | None = None, half: Half = "all",
    has_plain_front: bool = False,
) -> FurnitureModel:  # fmt: skip
    """A model of a category whose bounds equal `extents` [m], shape (3,); usual ones, a little varied, when None.

    `color`: RGB 0..255 of its main surface; by chance when None. `half`: templates to draw from; an unknown category has a plain body
    in either half. `has_plain_front`: draws one panel instead of a front's drawers and doors.

    Raises:
        ValueError: an extent is not finite, or below a millimetre, or above 20 m.
        TemplateWithheld: the category has a single template, which is not in the half.
    """
    if extents is None:
        x, y, z = (float(v) for v in np.array(typical_extents(category)) * rng.uniform(0.93, 1.07, 3))
    else:
        x, y, z = (float(v) for v in extents)
    if not (np.isfinite([x, y, z]).all() and min(x, y, z) >= MINIMUM_M and max(x, y, z) <= MAXIMUM_M):
        raise ValueError(f"extents of a {category!r} must be {MINIMUM_M} to {MAXIMUM_M} m, are {(x, y, z)}")
    known = canonical_category(category)
    if known is None:
        draft = Draft(category, (x, y, z), rng, color)
        fallback.draw(draft)
    else:
        for _ in range(MAX_DRAWINGS):
            draft = Draft(category, REGISTRY[known].drawn_extents((x, y, z)), rng, color, half, has_plain_front)
            REGISTRY[known].draw(draft)
            if draft.has_variants or has_single_template(half, known):
                break
        else:
            raise TemplateWithheld(f"the only template of a {known} is not among those {half}")
    return draft.model((x, y, z))
