"""Physical attributes by category: mass through density and solid volume, friction, restitution, kind of body.

The table is `physics.csv`, one row per category, then one per NYU40 class (`nyu40:<class>`), then two generic rows;
`materials.csv` holds densities and frictions of materials. Every row names its sources.
"""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

_FOLDER = Path(__file__).parent

SMALL_M = 0.4
"""Longest side up to which an unknown object counts as household goods, not furniture: it fits in one hand's reach."""

MIN_SIDE_M = 0.004
"""Boxes of flat objects (posters, rugs) come out of a scan with no thickness; 4 mm is the thinnest of them."""

_ALIASES: dict[str, str] = {
    "couch": "sofa", "television": "tv", "night stand": "nightstand", "bedside table": "nightstand", "bookcase": "bookshelf",
    "shelves": "shelf", "trash bin": "trash can", "garbage bin": "trash can", "waste bin": "trash can", "bin": "trash can",
    "wastebasket": "trash can", "fridge": "refrigerator", "refridgerator": "refrigerator", "floor mat": "mat", "carpet": "rug",
    "potted plant": "plant", "houseplant": "plant", "plant pot": "flower pot", "computer": "computer tower", "screen": "monitor",
    "computer monitor": "monitor", "phone": "telephone", "smartphone": "cell phone", "books": "book", "stack of books": "book stack",
    "books stack": "book stack", "drawer": "dresser", "drawers": "dresser", "chest of drawers": "dresser", "washer": "washing machine",
    "dryer": "clothes dryer", "basin": "sink", "bath": "bathtub", "tub": "bathtub", "painting": "picture", "photo": "picture frame",
    "tea cup": "cup", "coffee cup": "cup", "teapot": "kettle", "sideboard": "cabinet", "cupboard": "cabinet", "media console": "tv stand",
    "tv cabinet": "tv stand", "lounge chair": "armchair", "swivel chair": "office chair", "footstool": "ottoman", "footrest": "ottoman",
    "quilt": "blanket", "comforter": "blanket", "duvet": "blanket", "drape": "curtain", "drapes": "curtain", "cooker": "stove",
    "stuffed toy": "stuffed animal", "plush": "stuffed animal", "teddy bear": "stuffed animal", "handbag": "hand bag", "purse": "hand bag",
    "wall clock": "clock", "alarm clock": "clock", "pendant lamp": "ceiling lamp", "standing lamp": "floor lamp", "cardboard box": "box",
    "notebook": "book", "pc": "computer tower", "dining chair": "chair", "pouf": "ottoman",
    "luggage": "suitcase", "hamper": "laundry hamper", "coat": "jacket", "binder": "folder", "shirt": "clothes", "bathrobe": "clothes",
    "recliner": "armchair", "loveseat": "sofa", "trolley": "cart", "remote control": "remote", "column": "pillar", "handrail": "rail",
    "heating": "radiator", "shelf unit": "shelf",
}  # fmt: skip

FILL: Mapping[str, float] = MappingProxyType({"furniture": 0.1, "soft": 0.3, "small": 0.5})
"""Share of the box that is material in the plausibility check: open frames, stuffed objects, small solid objects."""

PLAUSIBLE_DENSITY: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"rigid": (20.0, 3000.0), "cloth": (5.0, 400.0), "soft": (5.0, 400.0)}
)
"""Bounds of mass / (box volume x fill) [kg/m3] outside of which an answer is doubted."""

BOUNCY_FROM, BOUNCY_MASS_KG = 0.5, 5.0
"""An object heavier than 5 kg that gives back more than half of its speed is doubted: such objects are balls, and balls are light."""


@dataclasses.dataclass(frozen=True)
class Material:
    """A row of `materials.csv`. density_min_kg_m3, density_max_kg_m3: What the material is found at, without hollows and
    stuffing. roughness: Typical variation of lightness as `tasks.captions.colors.roughness` measures it."""

    name: str
    adjective: str
    density_kg_m3: float
    density_min_kg_m3: float
    density_max_kg_m3: float
    friction: float
    restitution: float
    roughness: float
    source: str


@dataclasses.dataclass(frozen=True)
class PhysicsRow:
    """A row of `physics.csv`. materials: Material and prior probability, most likely first."""

    name: str
    nyu40: str
    materials: tuple[tuple[str, float], ...]
    density_kg_m3: float
    solid_fraction: float
    friction: float
    restitution: float
    body_type: str
    mass_min_kg: float
    mass_max_kg: float
    source: str


@dataclasses.dataclass(frozen=True)
class Mass:
    """Mass of an object. problem: Why the product of density, solid fraction and volume was not taken as it is, or None."""

    mass_kg: float
    density_kg_m3: float
    solid_fraction: float
    problem: str | None


@cache
def materials() -> Mapping[str, Material]:
    """Materials by name."""
    with open(_FOLDER / "materials.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    numbers = ("density_kg_m3", "density_min_kg_m3", "density_max_kg_m3", "friction", "restitution", "roughness")
    return MappingProxyType(
        {
            r["material"]: Material(name=r["material"], adjective=r["adjective"], source=r["source"], **{n: float(r[n]) for n in numbers})
            for r in rows
        }
    )


@cache
def table() -> Mapping[str, PhysicsRow]:
    """Rows of the category table by name."""
    with open(_FOLDER / "physics.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return MappingProxyType({r["name"]: _physics_row(r) for r in rows})


def _physics_row(text: Mapping[str, str]) -> PhysicsRow:
    """A row of the table from its text."""
    return PhysicsRow(
        name=text["name"],
        nyu40=text["nyu40"],
        materials=tuple((part.split(":")[0], float(part.split(":")[1])) for part in text["materials"].split("|")),
        density_kg_m3=float(text["density_kg_m3"]),
        solid_fraction=float(text["solid_fraction"]),
        friction=float(text["friction"]),
        restitution=float(text["restitution"]),
        body_type=text["body_type"],
        mass_min_kg=float(text["mass_min_kg"]),
        mass_max_kg=float(text["mass_max_kg"]),
        source=text["source"],
    )


def known_name(category: str) -> str | None:
    """The table's name for a category: itself, an alias, its singular, else the same of its last words; None if unknown."""
    words = category.lower().replace("_", " ").replace("-", " ").split()
    for start in range(len(words)):
        tail = " ".join(words[start:])
        for form in (tail, tail[:-1] if tail.endswith("s") else tail, tail[:-2] if tail.endswith("es") else tail):
            name = _ALIASES.get(form, form)
            if name in table():
                return name
    return None


def attributes(category: str, nyu40_label: str, size: ArrayLike) -> PhysicsRow:
    """The row for an object: its category, else its NYU40 class, else generic by its longest side. `size` [m], shape (3,)."""
    name = known_name(category)
    if name is None and nyu40_label not in ("unlabeled", "otherprop"):
        name = f"nyu40:{nyu40_label}" if f"nyu40:{nyu40_label}" in table() else None
    if name is None:
        small = float(np.max(np.asarray(size))) <= SMALL_M
        name = "generic:small" if small else ("nyu40:otherprop" if nyu40_label == "otherprop" else "generic:large")
    return table()[name]


def mass(row: PhysicsRow, material: str, size: ArrayLike) -> Mass:
    """Mass of an object of box `size` [m], shape (3,), that is made of `material`.

    The row's solid fraction is for its first material. Another material keeps the row's mass per volume of box: a
    metal chair has thinner legs than a wooden one. A mass outside the category's range is replaced by the bound and
    the problem is told.
    """
    volume = float(np.prod(np.maximum(np.asarray(size, dtype=np.float64), MIN_SIDE_M)))
    density = materials()[material].density_kg_m3
    fraction = float(np.clip(row.solid_fraction * row.density_kg_m3 / density, 0.001, 1.0))
    value = density * fraction * volume
    bounded = float(np.clip(value, row.mass_min_kg, row.mass_max_kg))
    problem = None
    if bounded != value:
        which = "below" if value < row.mass_min_kg else "above"
        bounds = f"{row.mass_min_kg:g} to {row.mass_max_kg:g} kg"
        problem = f"mass {value:.3g} kg from density and volume is {which} the range of {row.name} ({bounds}); {bounded:g} kg taken"
    return Mass(bounded, density, fraction, problem)


def implausible(body_type: str, mass_kg: float, restitution: float, size: ArrayLike) -> str | None:
    """Why physical attributes are doubtful, or None. `size` of the box [m], shape (3,).

    For answers that no row of the object's own category backs; such a row has a range of its own, which is stricter.
    """
    sides = np.maximum(np.asarray(size, dtype=np.float64), MIN_SIDE_M)
    fill = FILL["soft"] if body_type != "rigid" else FILL["small"] if sides.max() <= SMALL_M else FILL["furniture"]
    density = mass_kg / (float(np.prod(sides)) * fill)
    low, high = PLAUSIBLE_DENSITY[body_type]
    if not low <= density <= high:
        return f"{mass_kg:.3g} kg means {density:.3g} kg/m3 of material, outside {low:g} to {high:g} for a {body_type} body"
    if restitution > BOUNCY_FROM and mass_kg > BOUNCY_MASS_KG:
        return f"restitution {restitution:g} with {mass_kg:.3g} kg"
    return None
