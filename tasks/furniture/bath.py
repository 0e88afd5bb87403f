"""Bathrooms and what is fixed to a house: pipes, radiators, doors, windows, boards. Fronts at +x, walls at -x."""

from __future__ import annotations

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import FABRICS, LINENS, METALS, PAINTS, WHITES, WOODS, Color, shade
from tasks.furniture.solids import band, bar, cylinder, ellipsoid, rounded_square, square, sweep, turned_body, vessel

SKY: Color = (186, 208, 222)
"""What one sees through a window."""


@category("toilet", (0.68, 0.38, 0.76), "toilet seat", "urinal")
def toilet(d: Draft) -> None:
    """A bowl on a foot, a seat, a lid that stands or lies, and a cistern."""
    color = d.main(WHITES)
    seat, tank = 0.53 * d.Z, 0.28 * d.X
    middle = -d.hx + tank + 0.5 * (d.X - tank)
    r = 0.5 * (d.X - tank) + 0.03
    stretch = d.hy / r
    bowl = [(0.55 * r, 0), (0.52 * r, 0.15 * d.Z), (0.75 * r, 0.35 * d.Z), (0.98 * r, seat)]
    d.add("bowl", color, vessel(bowl, 0.16 * r, 0.3 * d.Z, stretch=stretch).at(middle - 0.03, 0, 0))
    d.add("seat", shade(color, 0.97), band([(r, seat), (r, seat + 0.03 * d.Z)], 0.28 * r, stretch=stretch).at(middle - 0.03, 0, 0))
    d.cushion("cistern", color, (-d.hx, -d.hx + tank), (-d.hy, d.hy), (0.46 * d.Z, 0.96 * d.Z), 0.02)
    d.cushion("cistern lid", color, (-d.hx, -d.hx + 1.06 * tank), (-d.hy, d.hy), (0.95 * d.Z, d.Z), 0.01)
    d.box("foot", color, (-d.hx, middle), (-0.4 * d.hy, 0.4 * d.hy), (0, 0.48 * d.Z))
    lid = turned_body([(0.95 * r, 0), (0.95 * r, 0.03)], stretch=stretch).turned("y", -1.45)
    if d.one_of("lid up", "lid down") == "lid up":
        d.add("lid", color, lid.moved(_squash(0.8)).at(-d.hx + 1.25 * tank, 0, seat + 0.85 * r * 0.8))
    else:
        d.add("lid", color, turned_body([(0.98 * r, 0), (0.96 * r, 0.025)], stretch=stretch).at(middle - 0.03, 0, seat + 0.03 * d.Z))


def _squash(factor: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[2, 2] = factor
    return matrix


@category("sink", (0.45, 0.55, 0.85), "wash basin", "bathroom sink", "kitchen sink", "basin", free=True)
def sink(d: Draft) -> None:
    """A basin with a tap: on a pedestal, on a cupboard, or, when flat, let into a counter."""
    color = d.main(WHITES + METALS[:1])
    r, stretch, tap = d.hx, d.Y / d.X, min(0.14, 0.3 * d.Z)
    rim = d.Z - tap
    deep = min(0.17, 0.95 * rim)
    if rim > 0.4:
        if d.one_of("pedestal", "vanity") == "pedestal":
            d.add("pedestal", color, turned_body([(0.5 * r, 0), (0.36 * r, 0.2 * rim), (0.42 * r, rim - 0.6 * deep)]).at(-0.3 * r, 0, 0))
        else:
            wood = d.pick(WOODS + PAINTS)
            d.box("vanity", wood, (-d.hx, 0.9 * d.hx), (-0.94 * d.hy, 0.94 * d.hy), (0, rim - deep))
            for s in (-1, 1):
                y0, y1 = sorted((s * 0.01, s * 0.92 * d.hy))
                d.box("doors", shade(wood, 1.06), (0.9 * d.hx, 0.96 * d.hx), (y0, y1), (0.08 * rim, rim - deep - 0.01))
    else:
        d.variant = "inset"
    basin = [(0.7 * r, rim - deep), (0.95 * r, rim - 0.2 * deep), (r, rim)]
    d.add("basin", color, vessel(basin, 0.14 * r, 0.12 * deep, rounded_square(0.45, 3), stretch, 16))
    x = -0.86 * d.hx
    path = [(x, 0, rim - 0.01), (x, 0, rim + 0.9 * tap), (x + 0.3 * d.hx, 0, rim + 0.95 * tap), (x + 0.55 * d.hx, 0, rim + 0.6 * tap)]
    d.add("tap", d.pick(METALS[:1] + METALS[3:]), sweep(path, 0.022, 0.022, 8, up=(0, 1, 0)))
    d.add("tap", METALS[3], cylinder(0.016, (rim - 0.01, rim + 0.4 * tap), 10).at(x, 0.09, 0))


@category("bathtub", (0.75, 1.65, 0.56), "tub", "bath tub")
def bathtub(d: Draft) -> None:
    """A tub with a rim, in an apron or on its own."""
    color = d.main(WHITES)
    r, stretch = d.hx, d.Y / d.X
    top = 0.86 * d.Z
    if d.one_of("apron", "free") == "apron":
        d.add(
            "tub",
            color,
            vessel(
                [(0.97 * r, 0), (0.97 * r, 0.9 * top), (r, 0.9 * top), (r, top)],
                0.1 * d.X,
                0.12 * d.Z,
                rounded_square(0.12, 2),
                stretch,
                12,
            ),
        )
    else:
        d.add(
            "tub",
            color,
            vessel([(0.7 * r, 0), (0.9 * r, 0.4 * top), (r, top)], 0.07 * d.X, 0.14 * d.Z, rounded_square(0.8, 5), stretch, 16),
        )
    y = -0.93 * d.hy
    d.add("tap", METALS[3], sweep([(0, y, top - 0.02), (0, y, d.Z - 0.02), (0, y + 0.14, d.Z - 0.012)], 0.024, 0.024, 8, up=(1, 0, 0)))


@category("shower", (0.9, 0.9, 2.05), "shower cabin", "shower stall")
def shower(d: Draft) -> None:
    """A tray with glass sides in a frame, and a shower head on a rail."""
    metal = d.main(METALS)
    d.add("tray", WHITES[0], vessel([(d.hx, 0), (d.hx, 0.06 * d.Z)], 0.05, 0.025 * d.Z, square(), d.Y / d.X, 4))
    for x, y in d.corners(0.015):
        d.leg("frame", metal, (x, y), (x, y), (0.05 * d.Z, d.Z), 0.03)
    for s in (-1, 1):
        y0, y1 = sorted((s * d.hy, s * (d.hy - 0.008)))
        d.box("glass", (206, 222, 226), (-d.hx + 0.02, d.hx - 0.02), (y0, y1), (0.06 * d.Z, 0.97 * d.Z))
        d.box("frame", metal, (-d.hx, d.hx), (min(s * d.hy, s * (d.hy - 0.03)), max(s * d.hy, s * (d.hy - 0.03))), (d.Z - 0.03, d.Z))
    d.box("glass", (206, 222, 226), (-d.hx, -d.hx + 0.008), (-d.hy, d.hy), (0.06 * d.Z, 0.97 * d.Z))
    d.add("rail", metal, bar((-0.9 * d.hx, 0, 0.5 * d.Z), (-0.9 * d.hx, 0, 0.93 * d.Z), 0.02, 0.02, 8))
    d.add("rail", metal, bar((-0.9 * d.hx, 0, 0.92 * d.Z), (-0.5 * d.hx, 0, 0.95 * d.Z), 0.02, 0.02, 8))
    d.add("head", metal, turned_body([(0.1, 0), (0.1, 0.015), (0.03, 0.04)]).at(-0.48 * d.hx, 0, 0.93 * d.Z))


@category("toilet paper", (0.11, 0.11, 0.1), "paper towel roll", "toilet paper roll", "paper roll")
def toilet_paper(d: Draft) -> None:
    """A roll with a core."""
    d.add("roll", d.main(WHITES), band([(d.hx, 0), (d.hx, d.Z)], 0.6 * d.hx, stretch=d.Y / d.X))
    d.add("core", (170, 140, 110), band([(0.42 * d.hx, 0.0), (0.42 * d.hx, d.Z)], 0.03 * d.hx, stretch=d.Y / d.X))


@category("soap dispenser", (0.08, 0.08, 0.18), "soap bottle", "hand soap")
def soap_dispenser(d: Draft) -> None:
    """A short bottle with a pump."""
    color = d.main(((220, 224, 222), (120, 160, 170), (200, 150, 130), (60, 62, 66)))
    r, stretch = d.hx, d.Y / d.X
    d.add("bottle", color, turned_body([(0.95 * r, 0), (r, 0.05 * d.Z), (r, 0.6 * d.Z), (0.35 * r, 0.7 * d.Z)], stretch=stretch))
    d.add("pump", METALS[0], cylinder(0.2 * r, (0.68 * d.Z, 0.95 * d.Z), 10))
    d.box("pump", METALS[0], (-0.3 * r, 0.95 * r), (-0.2 * r, 0.2 * r), (0.92 * d.Z, d.Z))


@category("towel", (0.06, 0.45, 0.65), "hand towel", "bath towel", "towels", free=True)
def towel(d: Draft) -> None:
    """A cloth over a rail; a flat one is folded."""
    color = d.main(LINENS + FABRICS)
    if 0.5 * min(d.X, d.Y) > d.Z:
        layers = 3
        for i in range(layers):
            z = d.Z * i / layers
            inset = 0.02 * min(d.X, d.Y) * (i % 2)
            d.cushion("folds", color, (-d.hx + inset, d.hx), (-d.hy + inset, d.hy - inset), (z, z + d.Z / layers), 0.48 * d.Z / layers)
        return
    d.variant = "hanging"
    d.cushion("cloth", color, (0, d.hx), (-0.94 * d.hy, 0.94 * d.hy), (0, d.Z), 0.3 * d.hx)
    d.cushion("cloth", color, (-d.hx, 0), (-0.94 * d.hy, 0.94 * d.hy), (0.25 * d.Z, d.Z), 0.3 * d.hx)
    d.cushion("stripe", shade(color, 0.75), (0, d.hx * 1.01), (-0.94 * d.hy, 0.94 * d.hy), (0.1 * d.Z, 0.14 * d.Z), 0.2 * d.hx)
    d.add("rail", METALS[0], bar((0, -d.hy, 0.97 * d.Z), (0, d.hy, 0.97 * d.Z), 0.5 * d.hx, 0.5 * d.hx, 8))


@category("radiator", (0.12, 0.9, 0.6))
def radiator(d: Draft) -> None:
    """Columns side by side between two pipes."""
    color = d.main(WHITES)
    count = max(4, round(d.Y / 0.075))
    wide = d.Y / count
    for i in range(count):
        y = -d.hy + (i + 0.5) * wide
        d.cushion("columns", color, (-d.hx, d.hx), (y - 0.36 * wide, y + 0.36 * wide), (0.04 * d.Z, d.Z), 0.3 * wide)
    for z in (0.14, 0.88):
        d.add("pipes", color, bar((0, -d.hy, z * d.Z), (0, d.hy, z * d.Z), 0.5 * d.hx, 0.5 * d.hx, 8))
    for s in (-1, 1):
        d.box("feet", color, (-0.5 * d.hx, 0.5 * d.hx), (s * 0.8 * d.hy - 0.015, s * 0.8 * d.hy + 0.015), (0, 0.1 * d.Z))


@category("door", (0.05, 0.9, 2.05), "closet door", "cabinet door", "doors", "bathroom door")
def door(d: Draft) -> None:
    """A leaf with panels and a lever on either side."""
    color = d.main(WHITES + WOODS)
    leaf = 0.4 * d.X
    d.box("leaf", color, (-0.5 * leaf, 0.5 * leaf), (-d.hy, d.hy), (0, d.Z))
    if d.one_of("panelled", "plain") == "panelled":
        for z0, z1 in ((0.08, 0.42), (0.5, 0.93)):
            for s in (-1, 1):
                y0, y1 = sorted((s * 0.12 * d.hy, s * 0.8 * d.hy))
                d.box("panels", shade(color, 0.93), (-0.6 * leaf, 0.6 * leaf), (y0, y1), (z0 * d.Z, z1 * d.Z))
    for s in (-1, 1):
        x0, x1 = sorted((s * 0.4 * leaf, s * 0.9 * d.hx))
        d.box("levers", METALS[0], (x0, x1), (0.8 * d.hy, 0.86 * d.hy), (0.485 * d.Z, 0.5 * d.Z))
        x0, x1 = sorted((s * 0.75 * d.hx, s * d.hx))
        d.box("levers", METALS[0], (x0, x1), (0.58 * d.hy, 0.86 * d.hy), (0.485 * d.Z, 0.5 * d.Z))


@category("window", (0.12, 1.2, 1.2), "windows", "window frame")
def window(d: Draft) -> None:
    """A frame, one or two sashes with light panes, and a sill."""
    color = d.main(WHITES + WOODS[:2])
    edge = min(0.06, 0.1 * d.Y, 0.1 * d.Z)
    front = 0.3 * d.hx
    d.box("frame", color, (-d.hx, front), (-d.hy, -d.hy + edge), (0, d.Z))
    d.box("frame", color, (-d.hx, front), (d.hy - edge, d.hy), (0, d.Z))
    d.box("frame", color, (-d.hx, front), (-d.hy + edge, d.hy - edge), (d.Z - edge, d.Z))
    d.box("frame", color, (-d.hx, d.hx), (-d.hy, d.hy), (0, 0.6 * edge))
    d.box("panes", SKY, (-0.5 * d.hx, -0.3 * d.hx), (-d.hy + edge, d.hy - edge), (0.6 * edge, d.Z - edge))
    if d.Y > 0.8:
        d.box("frame", color, (-0.8 * d.hx, front), (-0.5 * edge, 0.5 * edge), (0.6 * edge, d.Z - edge))
    if d.one_of("cross", "plain") == "cross":
        d.box("frame", color, (-0.7 * d.hx, 0.8 * front), (-d.hy + edge, d.hy - edge), (0.6 * d.Z, 0.6 * d.Z + 0.5 * edge))


@category("whiteboard", (0.06, 1.4, 0.95), "white board", "blackboard", "bulletin board", "board", "chalkboard")
def whiteboard(d: Draft) -> None:
    """A white board in a metal frame with a pen tray and some writing; black or cork when the word says so."""
    dark, cork = "black" in d.category or "chalk" in d.category, "bulletin" in d.category
    face = d.main(((44, 58, 52),) if dark else ((190, 150, 104),) if cork else ((246, 247, 248),))
    edge, front = min(0.025, 0.06 * d.Z), -0.3 * d.hx
    d.box("board", face, (-d.hx, front), (-d.hy + edge, d.hy - edge), (edge, d.Z - edge))
    for side in ((-d.hy, -d.hy + edge), (d.hy - edge, d.hy)):
        d.box("frame", METALS[0], (-d.hx, front + 0.004), side, (0, d.Z))
    for rail in ((0, edge), (d.Z - edge, d.Z)):
        d.box("frame", METALS[0], (-d.hx, front + 0.004), (-d.hy + edge, d.hy - edge), rail)
    d.box("tray", METALS[1], (-d.hx, d.hx), (-0.4 * d.hy, 0.4 * d.hy), (-0.01, 0.012))
    ink = (236, 236, 230) if dark else d.pick(((40, 70, 150), (170, 50, 50), (40, 44, 48)))
    for i in range(4):
        y0, z = -0.75 * d.hy, (0.8 - 0.12 * i) * d.Z
        d.box("writing", ink, (front - 0.002, front + 0.001), (y0, y0 + d.between(0.4, 1.0) * d.hy), (z, z + 0.012 * d.Z))
    d.box("writing", ink, (front - 0.002, front + 0.001), (0.35 * d.hy, 0.7 * d.hy), (0.35 * d.Z, 0.36 * d.Z))
    d.box("writing", ink, (front - 0.002, front + 0.001), (0.5 * d.hy, 0.512 * d.hy), (0.25 * d.Z, 0.5 * d.Z))


@category("blinds", (0.06, 1.1, 1.2), "window blinds", "shades")
def blinds(d: Draft) -> None:
    """Slats hanging under a rail."""
    color = d.main(WHITES + WOODS[3:5])
    d.box("rail", shade(color, 0.94), (-d.hx, d.hx), (-d.hy, d.hy), (0.96 * d.Z, d.Z))
    count = max(6, min(24, round(d.Z / 0.05)))
    for i in range(count):
        z = 0.95 * d.Z * (i + 0.5) / count
        d.add("slats", color, bar((-0.7 * d.hx, 0, z - 0.4 * d.Z / count), (0.7 * d.hx, 0, z + 0.4 * d.Z / count), 1.98 * d.hy, 0.003))
    d.box("rail", shade(color, 0.94), (-0.6 * d.hx, 0.6 * d.hx), (-d.hy, d.hy), (0, 0.015 * d.Z))
    for s in (-1, 1):
        d.box("cords", (210, 210, 204), (-0.004, 0.004), (s * 0.7 * d.hy - 0.004, s * 0.7 * d.hy + 0.004), (0.01, 0.97 * d.Z))


@category("shower curtain", (0.14, 1.4, 1.8))
def shower_curtain(d: Draft) -> None:
    """A light curtain in waves on a rod."""
    _waves(d, d.main(WHITES + LINENS), 10)


@category("curtain", (0.14, 1.0, 2.2), "curtains", "drapes")
def curtain(d: Draft) -> None:
    """A heavy curtain in waves on a rod."""
    _waves(d, d.main(LINENS + FABRICS), max(4, round(d.Y / 0.13)))


def _waves(d: Draft, color: Color, folds: int) -> None:
    steps = 8 * folds + 1
    y = np.linspace(-0.97 * d.hy, 0.97 * d.hy, steps)
    wave = 0.8 * d.hx * np.sin(np.linspace(0, 2 * np.pi * folds, steps))
    high = 0.97 * d.Z
    path = np.column_stack([wave, y, np.full(steps, 0.5 * high)])
    d.add("cloth", color, sweep(path, min(0.012, 0.2 * d.X), high, 4, run=2))
    d.add("rod", (70, 66, 62), bar((0, -d.hy, 0.98 * d.Z), (0, d.hy, 0.98 * d.Z), 0.02, 0.02, 8))
    for s in (-1, 1):
        d.add("rod", (70, 66, 62), ellipsoid((0, s * 0.98 * d.hy, 0.98 * d.Z), (0.02, 0.02 * d.hy, 0.018), 8, 6))
