"""Fitted kitchens: base cabinets under one worktop, a sink let into it, appliances in and on it, cabinets on the wall above.

A run of units stands along a wall, from left to right as one looks at it. Lengths in metres.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from tasks.furniture import generate
from tasks.furniture.drafting import Draft, Extents, FurnitureModel
from tasks.furniture.dwellings.corners import ordered
from tasks.furniture.palette import DARKS, METALS, PAINTS, WHITES, WOODS, Color, shade

UNIT_M = 0.6
"""Width of a unit: the grid that kitchens are built to."""

BASE_M = (0.56, 0.86)
"""Depth and height of a base cabinet."""

TOP_M = (0.62, 0.04)
"""Depth and thickness of the worktop."""

UPPER_M = (0.34, 0.66)
"""Depth and height of a cabinet on the wall."""

UPPER_LOW_M = 1.46
"""Height of the lower edge of the cabinets on the wall."""

SLIT_M = 0.002
"""Between neighbors."""

STONES: tuple[Color, ...] = ((92, 92, 96), (190, 184, 174), (54, 54, 58), (150, 118, 84), (214, 210, 202))


@dataclasses.dataclass(frozen=True)
class Unit:
    """A part of a fitted kitchen. at: its middle along the run, off: of its back from the wall, low: its bottom [m]. carrier: name
    of the kind of unit below it, or `floor`, `wall`."""

    model: FurnitureModel
    extents: Extents
    at: float
    off: float
    low: float
    carrier: str
    is_fitted: bool = True


def kitchen(length: float, height: float, has_window: bool, rng: np.random.Generator) -> list[Unit]:
    """The units of a run of `length` [m] in a room of a height [m]; without cabinets above where there is a window."""
    count = int(length / UNIT_M)
    has_fridge = count >= 4
    paint = (PAINTS + WOODS[3:5])[int(rng.integers(len(PAINTS) + 2))]
    kinds = _order(count - has_fridge, rng)
    units, at = [], 0.5 * (length - count * UNIT_M)
    if has_fridge:
        size = (0.62, UNIT_M - 0.02, float(rng.uniform(1.6, 1.9)))
        units.append(Unit(generate("refrigerator", size, rng), size, at + 0.5 * UNIT_M, 0.01, 0.0, "floor", False))
        at += UNIT_M
    first = at
    for kind in kinds:
        units.append(_base(kind, at + 0.5 * UNIT_M, paint, rng))
        at += UNIT_M
    top_low, run = BASE_M[1] + 0.001, at - first
    sink, hob = (first + (kinds.index(kind) + 0.5) * UNIT_M for kind in ("sink", "oven"))
    hole = (0.4, 0.46)
    model, size = _worktop(run - SLIT_M, sink - first - 0.5 * run, hole, rng)
    units.append(Unit(model, size, first + 0.5 * run, 0.005, top_low, "kitchen cabinet"))
    units.append(_sink(sink, top_low + TOP_M[1], hole, rng))
    units.append(_hob(hob, top_low + TOP_M[1], rng))
    if not has_window:
        units += _uppers(first, kinds, paint, height, rng)
    return units


def _order(count: int, rng: np.random.Generator) -> list[str]:
    """Kinds of base units: a sink and an oven always, not side by side where there is room; a dishwasher beside the sink."""
    kinds = ["doors" if rng.random() < 0.6 else "drawers" for _ in range(count)]
    sink, oven = (0, count - 1) if count < 4 else (int(rng.integers(0, count - 2)), 0)
    if count >= 4:
        oven = int(rng.integers(sink + 2, count))
        if sink > 0:
            kinds[sink - 1] = "dishwasher"
    kinds[sink], kinds[oven] = "sink", "oven"
    return kinds


def _base(kind: str, at: float, paint: Color, rng: np.random.Generator) -> Unit:
    size = (BASE_M[0], UNIT_M - SLIT_M, BASE_M[1])
    if kind in ("oven", "dishwasher"):
        return Unit(generate(kind, size, rng), size, at, 0.005, 0.0, "floor")
    d = Draft("kitchen cabinet", size, rng, paint)
    d.variant = f"base {kind}"
    color, metal = d.main((paint,)), d.pick(METALS)
    d.box("plinth", (56, 56, 58), (-d.hx, d.hx - 0.06), (-d.hy, d.hy), (0, 0.1))
    face = d.hx - 0.03
    if kind == "sink":  # open at the top: the bowl hangs in it
        d.box("body", color, (-d.hx, face), (-d.hy, d.hy), (0.1, 0.6))
        for s in (-1, 1):
            d.box("body", color, (-d.hx, face), ordered(s * d.hy, s * (d.hy - 0.018)), (0.6, d.Z))
        d.box("body", color, (face - 0.018, face), (-d.hy + 0.018, d.hy - 0.018), (0.6, d.Z))
    else:
        d.box("body", color, (-d.hx, face), (-d.hy, d.hy), (0.1, d.Z))
    rows = [(0.104, 0.36), (0.364, 0.6), (0.604, d.Z - 0.004)] if kind == "drawers" else [(0.104, d.Z - 0.004)]
    for low, high in rows:
        d.box("fronts", shade(color, 1.05), (face, d.hx - 0.012), (-d.hy + 0.002, d.hy - 0.002), (low, high))
        d.box("handles", metal, (d.hx - 0.012, d.hx), (-0.1, 0.1), (high - 0.05, high - 0.038))
    return Unit(d.model(size), size, at, 0.005, 0.0, "floor")


def _worktop(length: float, sink: float, hole: tuple[float, float], rng: np.random.Generator) -> tuple[FurnitureModel, Extents]:
    """One slab with a hole for the sink, `sink` from its middle along the run."""
    size = (TOP_M[0], length, TOP_M[1])
    d = Draft("kitchen counter", size, rng, None)
    d.variant = "worktop"
    stone, z = d.main(STONES), (0.0, d.Z)
    # as one looks at the run from the room, its start is at +y of a model whose back is at the wall
    y, hx, hy = -sink, 0.5 * hole[0], 0.5 * hole[1]
    d.box("top", stone, (-d.hx, -hx), (-d.hy, d.hy), z)
    d.box("top", stone, (hx, d.hx), (-d.hy, d.hy), z)
    d.box("top", stone, (-hx, hx), (-d.hy, y - hy), z)
    d.box("top", stone, (-hx, hx), (y + hy, d.hy), z)
    return d.model(size), size


def _sink(at: float, top: float, hole: tuple[float, float], rng: np.random.Generator) -> Unit:
    """A bowl of steel that hangs by its rim, with a tap."""
    deep, tap, rim = 0.16, 0.24, 0.006
    size = (hole[0] + 0.06, hole[1] + 0.06, deep + rim + tap)
    d = Draft("sink", size, rng, None)
    d.variant = "let in"
    steel = d.main(METALS[:1] + WHITES[:1])
    x, y, w = 0.5 * hole[0] - 0.004, 0.5 * hole[1] - 0.004, 0.008
    level = deep + rim
    d.box("bowl", steel, (-x, x), (-y, y), (0, w))
    for s in (-1, 1):
        d.box("bowl", steel, ordered(s * x, s * (x - w)), (-y, y), (w, deep))
        d.box("bowl", steel, (-x + w, x - w), ordered(s * y, s * (y - w)), (w, deep))
        d.box("rim", steel, ordered(s * (x - w), s * d.hx), (-d.hy, d.hy), (deep, level))
        d.box("rim", steel, (-x + w, x - w), ordered(s * (y - w), s * d.hy), (deep, level))
    d.box("tap", METALS[3], (-d.hx + 0.005, -d.hx + 0.03), (-0.0125, 0.0125), (level, d.Z - 0.02))
    d.box("tap", METALS[3], (-d.hx + 0.005, -d.hx + 0.17), (-0.0125, 0.0125), (d.Z - 0.02, d.Z))
    return Unit(d.model(size), size, at, 0.005 + 0.5 * (TOP_M[0] - size[0]), top - deep, "kitchen counter")


def _hob(at: float, top: float, rng: np.random.Generator) -> Unit:
    size = (0.5, UNIT_M - 0.04, 0.012)
    d = Draft("stove", size, rng, None)
    d.variant = "hob"
    black = d.main(DARKS)
    d.box("glass", black, (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z))
    return Unit(d.model(size), size, at, 0.005 + 0.5 * (TOP_M[0] - size[0]), top, "kitchen counter")


def _uppers(first: float, kinds: list[str], paint: Color, height: float, rng: np.random.Generator) -> list[Unit]:
    """A cabinet above every unit but the oven, which has a hood."""
    tall = min(UPPER_M[1], height - UPPER_LOW_M - 0.05)
    units = []
    for k, kind in enumerate(kinds):
        at = first + (k + 0.5) * UNIT_M
        if kind == "oven":
            size = (0.45, UNIT_M - 2 * SLIT_M, min(0.6, height - 1.56 - 0.03))
            units.append(Unit(generate("range hood", size, rng), size, at, 0.002, 1.56, "wall"))
            continue
        size = (UPPER_M[0], UNIT_M - SLIT_M, tall)
        units.append(Unit(generate("kitchen cabinet", size, rng, paint), size, at, 0.002, UPPER_LOW_M, "wall"))
    return units
