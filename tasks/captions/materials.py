"""What an object is made of: the category's prior weighed with its colors and its texture."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from tasks.captions.colors import ColorNames
from tasks.captions.physics import PhysicsRow, materials

ROUGHNESS_WIDTH = 0.5
"""Spread of lightness variation among objects of one material: wide, because light and sensor add to it."""

OTHER_COLOR = 0.35
"""Likelihood of a color that a material is not known for, against 1 for its usual colors: paint and dye exist."""

MIN_PROBABILITY = 0.15
"""Materials less likely than this are not named."""

_USUAL: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "wood": frozenset({"brown", "dark brown", "beige", "orange", "cream", "olive"}),
        "metal": frozenset({"gray", "light gray", "dark gray", "black"}),
        "plastic": frozenset({"white", "black", "red", "blue", "green", "yellow", "orange", "light gray", "turquoise", "gray"}),
        "glass": frozenset({"light gray", "gray", "turquoise", "light blue", "dark gray"}),
        "ceramic": frozenset({"white", "cream", "light gray", "blue", "teal", "light blue"}),
        "leather": frozenset({"black", "dark brown", "brown", "dark red"}),
        "paper": frozenset({"white", "cream", "light gray", "beige", "red", "blue", "dark red", "navy"}),
        "cardboard": frozenset({"beige", "brown"}),
        "stone": frozenset({"gray", "light gray", "dark gray", "beige"}),
        "concrete": frozenset({"gray", "light gray"}),
        "rubber": frozenset({"black", "dark gray", "blue", "turquoise", "red", "orange"}),
        "wicker": frozenset({"beige", "brown", "dark brown"}),
        "foliage": frozenset({"green", "dark green", "olive"}),
        "cork": frozenset({"brown", "beige", "orange"}),
        "wax": frozenset({"white", "cream", "red"}),
    }
)
# Fabric is in no row: it is dyed in any color, so color says nothing about it.
_ANY_COLOR = 0.6


def rank_materials(row: PhysicsRow, names: ColorNames, roughness: float) -> list[tuple[str, float]]:
    """Materials of an object with their probabilities, most likely first (Bayes; ties in the order of the table).

    row: Prior of the category. names: Its color words and shares. roughness: Variation of lightness, 0..1.
    """
    scores = []
    for material, prior in row.materials:
        usual = _USUAL.get(material)
        color = _ANY_COLOR if usual is None else OTHER_COLOR
        if usual is not None:
            color += (1 - OTHER_COLOR) * sum(share for word, share in zip(names.words, names.shares, strict=True) if word in usual)
        texture = np.exp(-(((roughness - materials()[material].roughness) / ROUGHNESS_WIDTH) ** 2))
        scores.append((material, prior * (color if names.words else 1.0) * float(texture)))
    total = sum(score for _, score in scores)
    return sorted(((material, score / total) for material, score in scores), key=lambda pair: -pair[1])


def likely_materials(ranked: list[tuple[str, float]]) -> tuple[str, ...]:
    """Names of the materials worth telling, most likely first; at least one, at most three."""
    return tuple(material for index, (material, p) in enumerate(ranked[:3]) if index == 0 or p >= MIN_PROBABILITY)
