"""What a model says of an object, read: appearance and physical attributes (supplementary, Tables A1 and A2; specs F.1, F.2)."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from tasks.calls.replies import UnreadableReply, number_in, table_of, word_in
from tasks.captions.colors import WORDS
from tasks.captions.physics import implausible, materials

APPEARANCE: dict[str, Any] = {
    "type": "object",
    "properties": {
        "category": {"type": "string"},
        "colors": {"type": "array", "items": {"type": "string"}},
        "materials": {"type": "array", "items": {"type": "string"}},
        "texture": {"type": "string"},
        "shape": {"type": "string"},
        "sentence": {"type": "string"},
    },
    "required": ["category", "colors", "materials", "texture", "shape", "sentence"],
    "additionalProperties": False,
}
"""JSON schema of a reply about appearance."""

PHYSICS: dict[str, Any] = {
    "type": "object",
    "properties": {
        "physics_attributes": {
            "type": "object",
            "properties": {
                "category": {"type": "string", "enum": ["Rigid Body", "Cloth", "Soft Body"]},
                "mass": {"type": "number"},
                "friction": {"type": "number"},
                "bounciness": {"type": "integer", "enum": [0, 1]},
            },
            "required": ["category", "mass", "friction", "bounciness"],
            "additionalProperties": False,
        }
    },
    "required": ["physics_attributes"],
    "additionalProperties": False,
}
"""JSON schema of a reply about physical attributes."""

MOST_WORDS, MOST_LETTERS = 3, 300
"""Colors and materials that are asked for, and letters of a sentence: a longer one is no sentence."""

LIGHTEST_KG, HEAVIEST_KG = 0.001, 2000.0
"""A sheet of paper, and a grand piano with all that stands on it."""

UNITS: Mapping[str, float] = MappingProxyType({"kg": 1.0, "kilogram": 1.0, "kilograms": 1.0, "g": 0.001, "gram": 0.001, "grams": 0.001})

_BODIES = ("rigid", "cloth", "soft")
_COLORS = {
    "grey": "gray", "crimson": "dark red", "maroon": "dark red", "tan": "beige", "ivory": "cream", "gold": "yellow", "violet": "purple",
    "silver": "light gray", "cyan": "turquoise", "lavender": "purple", "rose": "pink", "khaki": "olive", "charcoal": "dark gray",
}  # fmt: skip
_MATERIALS = {
    "wooden": "wood", "metallic": "metal", "steel": "metal", "iron": "metal", "aluminum": "metal", "cloth": "fabric", "textile": "fabric",
    "cotton": "fabric", "wool": "fabric", "porcelain": "ceramic", "marble": "stone", "rattan": "wicker", "plant": "foliage",
    "leaves": "foliage", "particleboard": "wood", "plywood": "wood", "mdf": "wood",
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Appearance:
    """What an object looks like. colors, materials: Of the project's words, most of it first; what it has no word for is left out."""

    category: str
    colors: tuple[str, ...]
    materials: tuple[str, ...]
    sentence: str


@dataclasses.dataclass(frozen=True)
class PhysicalAttributes:
    """How an object behaves. body_type: rigid, cloth or soft. friction: Coefficient of dry friction, at rest and moving."""

    body_type: str
    mass_kg: float
    friction: float
    is_bouncy: bool


def appearance_of(reply: str) -> Appearance:
    """What a reply says of an appearance.

    Raises:
        UnreadableReply: it does not say all that was asked for.
    """
    fields = _lowered(table_of(reply, '{"category": "chair", "colors": ["brown"], ...}', is_alone=True))
    sentence = word_in(_needed(fields, "sentence"), "sentence")
    if len(sentence) > MOST_LETTERS:
        raise UnreadableReply(f"sentence must have {MOST_LETTERS} letters at most")
    return Appearance(
        category=word_in(_needed(fields, "category"), "category").lower()[:60],
        colors=_known(_words(fields, "colors"), WORDS, _COLORS),
        materials=_known(_words(fields, "materials"), tuple(materials()), _MATERIALS),
        sentence=sentence[0].upper() + sentence[1:],
    )


def attributes_of(reply: str, size: Sequence[float], *, most_friction: float = 1.0) -> PhysicalAttributes:
    """What a reply says of physical attributes, held against the object's box [m]. most_friction: 1; above it where the prompt has more.

    Raises:
        UnreadableReply: it does not say all that was asked for, or what no object of that size is.
    """
    table = _lowered(table_of(reply, '{"physics_attributes": {"category": "Rigid Body", ...}}', is_alone=True))
    fields = table.get("physics_attributes", table)
    if isinstance(fields, list) and len(fields) == 1:
        fields = fields[0]
    if not isinstance(fields, dict):
        raise UnreadableReply("physics_attributes must be an object")
    fields = _lowered(fields)
    word = re.sub(r"[\s_-]*(body|object)$", "", word_in(_needed(fields, "category"), "category").lower())
    if word not in _BODIES:
        raise UnreadableReply('category must be "Rigid Body", "Cloth" or "Soft Body"')
    mass = number_in(_needed(fields, "mass"), "mass", UNITS)
    friction = number_in(_needed(fields, "friction"), "friction", {})
    bounciness = _needed(fields, "bounciness")
    bounce = float(bounciness) if isinstance(bounciness, bool) else number_in(bounciness, "bounciness", {})
    if not LIGHTEST_KG <= mass <= HEAVIEST_KG:
        raise UnreadableReply(f"mass must be between {LIGHTEST_KG:g} and {HEAVIEST_KG:g} kg, is {mass:g}")
    if not 0.0 <= friction <= most_friction:
        raise UnreadableReply(f"friction must be between 0 and {most_friction:g}, is {friction:g}")
    if bounce not in (0.0, 1.0):
        raise UnreadableReply("bounciness must be 0 or 1")
    doubt = implausible(word, mass, bounce, size)
    if doubt:
        raise UnreadableReply(f"that cannot be: {doubt}")
    return PhysicalAttributes(word, mass, friction, bounce == 1.0)


def _lowered(table: Mapping[str, Any]) -> dict[str, Any]:
    lowered = {str(key).strip().lower().replace(" ", "_"): value for key, value in table.items()}
    if len(lowered) < len(table):
        raise UnreadableReply("a field is there twice")
    return lowered


def _needed(fields: Mapping[str, Any], name: str) -> Any:
    if fields.get(name) is None:
        raise UnreadableReply(f"{name} is missing")
    return fields[name]


def _words(fields: Mapping[str, Any], name: str) -> list[str]:
    value = _needed(fields, name)
    words = value if isinstance(value, list) else re.split(r",|\band\b", value) if isinstance(value, str) else None
    made = [word_in(word, name).lower() for word in words or ()]
    if not made or len(made) > 10 or not all(re.fullmatch(r"[\w /&'().-]+", word) for word in made):
        raise UnreadableReply(f"{name} must be a list of one to {MOST_WORDS} words")
    return made


def _known(given: Sequence[str], words: Sequence[str], synonyms: Mapping[str, str]) -> tuple[str, ...]:
    """The project's words for what is given, at most `MOST_WORDS`: the same, one that is meant, else what its last words are."""
    names: dict[str, None] = {}
    for text in given:
        parts = [synonyms.get(part, part) for part in text.replace("-", " ").split()]
        tails = (" ".join(parts[start:]) for start in range(len(parts)))
        name = next((synonyms.get(tail, tail) for tail in tails if synonyms.get(tail, tail) in words), None)
        if name is not None:
            names[name] = None
    return tuple(names)[:MOST_WORDS]
