"""Tables and counters. The front is +x: the side where one sits at a desk."""

from __future__ import annotations

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import METALS, PAINTS, WOODS, Color, shade
from tasks.furniture.solids import bar, turned_body, wedge

STONES: tuple[Color, ...] = ((198, 196, 190), (84, 84, 86), (226, 222, 214), (150, 146, 140))
"""Counter tops."""


@category("table", (0.8, 1.3, 0.75), "dining table", "kitchen table", "folding table", "conference table", "dinner table")
def table(d: Draft) -> None:
    """A top on four legs, on two trestles, or round on one foot."""
    wood = d.main(WOODS)
    round_one = 0.8 < d.X / d.Y < 1.25 and d.chance(0.5)
    if round_one:
        d.variant = "round"
        _pedestal(d, wood)
        return
    kind = d.one_of("four-legged", "trestle", "framed")
    top = min(0.04, 0.1 * d.Z)
    d.box("top", wood, (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - top, d.Z))
    if kind == "trestle":
        for s in (-1, 1):
            y = s * (d.hy - 0.1 * d.Y)
            for t in (-1, 1):
                d.add("legs", wood, bar((t * 0.85 * d.hx, y, 0.01), (t * 0.2 * d.hx, y, d.Z - top), 0.07, 0.05))
            d.box("legs", wood, (-0.6 * d.hx, 0.6 * d.hx), (y - 0.03, y + 0.03), (d.Z - top - 0.06, d.Z - top))
        d.box("legs", wood, (-0.025, 0.025), (-0.55 * d.hy, 0.55 * d.hy), (0.5 * d.Z, 0.5 * d.Z + 0.08))
        return
    _legs(d, wood if kind == "four-legged" else d.pick(METALS[1:3]), top, 0.065 if kind == "four-legged" else 0.045)


@category("desk", (0.7, 1.4, 0.74), "computer desk", "office desk", "reading desk", "writing desk", "workbench", "school desk")
def desk(d: Draft) -> None:
    """A top with a drawer pedestal, panel sides, or a metal frame."""
    kind = d.one_of("pedestal", "panel", "framed")
    wood = d.main(WOODS + PAINTS[:2])
    top = min(0.03, 0.08 * d.Z)
    d.box("top", wood, (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - top, d.Z))
    if kind == "framed":
        _legs(d, d.pick(METALS[1:3]), top, 0.045)
        d.box("back panel", shade(wood, 0.92), (-d.hx + 0.05, -d.hx + 0.065), (-d.hy + 0.06, d.hy - 0.06), (0.55 * d.Z, d.Z - top))
        return
    side = min(0.025, 0.05 * d.Y)
    inset = 0.02
    d.box("sides", wood, (-d.hx + inset, d.hx - inset), (-d.hy + inset, -d.hy + inset + side), (0, d.Z - top))
    d.box("sides", wood, (-d.hx + inset, d.hx - inset), (d.hy - inset - side, d.hy - inset), (0, d.Z - top))
    d.box("back panel", shade(wood, 0.94), (-d.hx + inset, -d.hx + inset + 0.015), (-d.hy + inset, d.hy - inset), (0.4 * d.Z, d.Z - top))
    if kind == "pedestal":
        width = min(0.42, 0.32 * d.Y)
        y0 = d.hy - inset - width
        d.box("pedestal", shade(wood, 0.97), (-d.hx + inset, d.hx - 0.05), (y0, d.hy - inset), (0.06 * d.Z, d.Z - top))
        high = (0.9 * d.Z - top) / 3
        for i in range(3):
            z = 0.08 * d.Z + i * high
            d.box("drawers", shade(wood, 1.05), (d.hx - 0.05, d.hx - 0.03), (y0 + 0.01, d.hy - inset - 0.01), (z, z + high - 0.012))
            middle = 0.5 * (y0 + d.hy - inset)
            d.box(
                "handles",
                d.pick(METALS),
                (d.hx - 0.03, d.hx - 0.012),
                (middle - 0.05, middle + 0.05),
                (z + 0.55 * high, z + 0.55 * high + 0.012),
            )


@category("coffee table", (0.6, 1.1, 0.42))
def coffee_table(d: Draft) -> None:
    """Low: with a shelf below, on slanted legs, or a round top."""
    wood = d.main(WOODS + STONES[:1])
    if 0.8 < d.X / d.Y < 1.25 and d.chance(0.6):
        d.variant = "round"
        _pedestal(d, wood)
        return
    kind = d.one_of("shelved", "slanted", "block")
    top = min(0.045, 0.14 * d.Z)
    d.cushion("top", wood, (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - top, d.Z), 0.008)
    if kind == "slanted":
        for x, y in d.corners(0.04):
            d.leg("legs", shade(wood, 0.85), (x, y), (0.8 * x, 0.88 * y), (0, d.Z - top), 0.05, 0.6)
    elif kind == "block":
        for s in (-1, 1):
            y0, y1 = sorted((s * 0.92 * d.hy, s * (0.92 * d.hy - 0.06)))
            d.box("legs", shade(wood, 0.92), (-0.9 * d.hx, 0.9 * d.hx), (y0, y1), (0, d.Z - top))
    else:
        for x, y in d.corners(0.045):
            d.leg("legs", wood, (x, y), (x, y), (0, d.Z - top), 0.05)
        d.box("shelf", shade(wood, 0.95), (-d.hx + 0.04, d.hx - 0.04), (-d.hy + 0.04, d.hy - 0.04), (0.3 * d.Z, 0.3 * d.Z + 0.02))


@category("side table", (0.45, 0.45, 0.55), "end table", "console table", "telephone table", "round table")
def side_table(d: Draft) -> None:
    """Small: round on one foot, or square on four legs with a shelf."""
    wood = d.main(WOODS + PAINTS[:3])
    if d.one_of("round", "square") == "round" and 0.75 < d.X / d.Y < 1.33:
        _pedestal(d, wood)
        return
    top = min(0.025, 0.08 * d.Z)
    d.box("top", wood, (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - top, d.Z))
    for x, y in d.corners(0.025):
        d.leg("legs", wood, (x, y), (x, y), (0, d.Z - top), 0.035, 0.7)
    d.box("shelf", shade(wood, 0.95), (-d.hx + 0.02, d.hx - 0.02), (-d.hy + 0.02, d.hy - 0.02), (0.32 * d.Z, 0.32 * d.Z + 0.015))


@category("kitchen counter", (0.62, 1.8, 0.9), "counter", "kitchen island", "bar", "sideboard counter")
def counter(d: Draft) -> None:
    """A run of base cupboards under a stone or wooden top."""
    paint, stone = d.main(PAINTS + WOODS[3:5]), d.pick(STONES)
    top, plinth = min(0.04, 0.1 * d.Z), 0.1 * d.Z
    d.box("plinth", (50, 50, 52), (-d.hx, d.hx - 0.06), (-d.hy + 0.01, d.hy - 0.01), (0, plinth))
    d.box("body", paint, (-d.hx, d.hx - 0.04), (-d.hy, d.hy), (plinth, d.Z - top))
    d.box("top", stone, (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - top, d.Z))
    count = max(1, round(d.Y / 0.6))
    width = d.Y / count
    for i in range(count):
        y0, y1 = -d.hy + i * width + 0.004, -d.hy + (i + 1) * width - 0.004
        drawer = d.Z - top - 0.2 * d.Z
        for z0, z1 in ((plinth + 0.004, drawer - 0.004), (drawer, d.Z - top - 0.004)):
            d.box("doors", shade(paint, 1.04), (d.hx - 0.04, d.hx - 0.022), (y0, y1), (z0, z1))
            d.box("handles", d.pick(METALS), (d.hx - 0.022, d.hx - 0.008), (y0 + 0.3 * width, y1 - 0.3 * width), (z1 - 0.05, z1 - 0.038))


def _legs(d: Draft, color: Color, top: float, side: float) -> None:
    """Four straight legs and an apron under a top of that thickness."""
    side = min(side, 0.2 * min(d.X, d.Y))
    for x, y in d.corners(0.5 * side + 0.01):
        d.leg("legs", color, (x, y), (x, y), (0, d.Z - top), side, 0.75)
    low, high = d.Z - top - min(0.08, 0.12 * d.Z), d.Z - top
    x, y, thin = d.hx - 0.5 * side - 0.01, d.hy - 0.5 * side - 0.01, 0.22 * side
    for s in (-1, 1):
        d.box("apron", color, (-x, x), (s * y - thin, s * y + thin), (low, high))
        d.box("apron", color, (s * x - thin, s * x + thin), (-y, y), (low, high))


def _pedestal(d: Draft, color: Color) -> None:
    """A round top on one foot."""
    top, stretch = min(0.035, 0.08 * d.Z), d.Y / d.X
    d.add("top", color, turned_body([(d.hx, d.Z - top), (d.hx, d.Z)], stretch=stretch))
    r = 0.12 * min(d.hx, d.hy) + 0.01
    d.add("foot", shade(color, 0.9), turned_body([(1.3 * r, 0.03), (r, 0.2 * d.Z), (0.9 * r, 0.7 * d.Z), (1.6 * r, d.Z - top)]))
    if d.chance(0.5):
        plate = [(0.62 * d.hx, 0), (0.62 * d.hx, 0.02), (1.2 * r, 0.05)]
        d.add("foot", shade(color, 0.9), turned_body(plate, stretch=min(stretch, 1.2)))
        return
    for i in range(4):
        angle = np.pi / 4 + i * np.pi / 2
        tip = 0.7 * min(d.hx, d.hy)
        start, end = (0.5 * r * np.cos(angle), 0.5 * r * np.sin(angle), 0.12 * d.Z), (tip * np.cos(angle), tip * np.sin(angle), 0.025)
        d.add("foot", shade(color, 0.9), bar(start, end, 0.06, 0.05))
    d.add("foot", shade(color, 0.9), wedge(((-r, r), (-r, r)), ((-r, r), (-r, r)), (0.0, 0.15 * d.Z)))
