"""Kitchen and household machines. Their doors are at the front, +x."""

from __future__ import annotations

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import DARKS, METALS, PLASTICS, WHITES, Color, shade
from tasks.furniture.solids import band, bar, circle, cylinder, sweep, turned_body, vessel, wedge

GLASS_DARK: Color = (36, 40, 46)
"""The window of an oven."""


@category("refrigerator", (0.66, 0.65, 1.75), "fridge", "mini fridge", "freezer")
def refrigerator(d: Draft) -> None:
    """A tall body with a large and a small door, or two side by side."""
    color = d.main(WHITES + METALS[:1] + METALS[3:])
    face = d.hx - min(0.09, 0.14 * d.X)
    d.box("body", shade(color, 0.92), (-d.hx, face), (-d.hy, d.hy), (0.03 * d.Z, d.Z))
    d.box("plinth", (50, 50, 52), (-d.hx, face - 0.02), (-d.hy + 0.01, d.hy - 0.01), (0, 0.03 * d.Z))
    door = d.hx - min(0.035, 0.06 * d.X)
    grip = d.pick(METALS)
    if d.one_of("two doors", "side by side") == "two doors":
        split = (0.66 if d.chance(0.5) else 0.4) * d.Z
        doors = [((-d.hy, d.hy), (0.04 * d.Z, split - 0.004)), ((-d.hy, d.hy), (split + 0.004, d.Z))]
    else:
        doors = [((-d.hy, -0.004), (0.04 * d.Z, d.Z)), ((0.004, d.hy), (0.04 * d.Z, d.Z))]
    for index, (y, z) in enumerate(doors):
        d.cushion("doors", color, (face + 0.004, door), y, z, 0.012)
        edge = y[0] + 0.05 if y[0] > -0.01 or (len(doors) == 2 and y[1] > 0.1 and index == 1 and y[0] > -0.1) else y[1] - 0.05
        middle, half = 0.5 * (z[0] + z[1]), min(0.3, 0.36 * (z[1] - z[0]))
        d.box("handles", grip, (door, d.hx), (edge - 0.012, edge + 0.012), (middle - half, middle - half + 0.03))
        d.box("handles", grip, (door, d.hx), (edge - 0.012, edge + 0.012), (middle + half - 0.03, middle + half))
        d.box("handles", grip, (d.hx - 0.012, d.hx), (edge - 0.012, edge + 0.012), (middle - half, middle + half))


@category("oven", (0.62, 0.6, 0.9), "stove", "gas stove", "range", "cooker")
def oven(d: Draft) -> None:
    """A cooker: plates on top, knobs, an oven door with a window and a rail."""
    color = d.main(WHITES + METALS + DARKS[:1])
    face, top = 0.9 * d.hx, 0.97 * d.Z
    d.box("body", color, (-d.hx, face), (-d.hy, d.hy), (0, top))
    d.box("top", (36, 36, 38), (-d.hx, 0.96 * d.hx), (-d.hy, d.hy), (top, 0.985 * d.Z))
    for x in (-0.45, 0.45):
        for y in (-0.48, 0.48):
            r = 0.34 * min(d.hx, d.hy) * (0.85 if x < 0 else 1)
            d.add("plates", (64, 60, 60), turned_body([(r, 0.98 * d.Z), (0.95 * r, d.Z)]).at(x * d.hx, y * d.hy, 0))
    d.box("door", shade(color, 0.94), (face, 0.95 * d.hx), (-0.95 * d.hy, 0.95 * d.hy), (0.2 * d.Z, 0.8 * d.Z))
    d.box("window", GLASS_DARK, (0.93 * d.hx, 0.956 * d.hx), (-0.7 * d.hy, 0.7 * d.hy), (0.32 * d.Z, 0.64 * d.Z))
    d.add(
        "handle", d.pick(METALS), bar((0.98 * d.hx, -0.8 * d.hy, 0.74 * d.Z), (0.98 * d.hx, 0.8 * d.hy, 0.74 * d.Z), 0.04 * d.hx, 0.02, 8)
    )
    for s in (-1, 1):
        d.box(
            "handle",
            d.pick(METALS),
            (0.94 * d.hx, 0.985 * d.hx),
            (s * 0.75 * d.hy - 0.01, s * 0.75 * d.hy + 0.01),
            (0.73 * d.Z, 0.75 * d.Z),
        )
    for i in range(5):
        knob = cylinder(0.03 * d.Z, (face, 0.97 * d.hx), 10).turned("y", np.pi / 2)
        d.add("knobs", (40, 40, 42), knob.at(0, (-0.8 + 0.4 * i) * d.hy, 0.89 * d.Z))
    d.box("drawer", shade(color, 0.97), (face, 0.94 * d.hx), (-0.95 * d.hy, 0.95 * d.hy), (0.03 * d.Z, 0.17 * d.Z))


@category("microwave", (0.38, 0.48, 0.28), "microwave oven", "toaster oven")
def microwave(d: Draft) -> None:
    """A box with a window door and a key panel to its right."""
    color = d.main(WHITES + METALS + DARKS)
    face = 0.9 * d.hx
    d.box("body", color, (-d.hx, face), (-d.hy, d.hy), (0.03 * d.Z, d.Z))
    split = -0.5 * d.hy
    d.box("door", shade(color, 0.9), (face, 0.95 * d.hx), (split, 0.98 * d.hy), (0.05 * d.Z, 0.97 * d.Z))
    d.box("window", GLASS_DARK, (0.93 * d.hx, 0.955 * d.hx), (split + 0.16 * d.hy, 0.86 * d.hy), (0.2 * d.Z, 0.84 * d.Z))
    d.box("handle", d.pick(METALS), (0.94 * d.hx, d.hx), (split + 0.03 * d.hy, split + 0.09 * d.hy), (0.2 * d.Z, 0.84 * d.Z))
    d.box("panel", (50, 52, 56), (face, 0.94 * d.hx), (-0.97 * d.hy, split - 0.02 * d.hy), (0.05 * d.Z, 0.97 * d.Z))
    for i in range(12):
        row, column = divmod(i, 3)
        y, z = (-0.88 + 0.13 * column) * d.hy, (0.14 + 0.14 * row) * d.Z
        d.box("keys", (190, 190, 188), (0.93 * d.hx, 0.95 * d.hx), (y, y + 0.08 * d.hy), (z, z + 0.08 * d.Z))
    d.box("display", (60, 150, 140), (0.93 * d.hx, 0.95 * d.hx), (-0.9 * d.hy, -0.56 * d.hy), (0.76 * d.Z, 0.9 * d.Z))
    for x, y in d.corners(0.04):
        d.box("feet", (30, 30, 30), (x - 0.012, x + 0.012), (y - 0.012, y + 0.012), (0, 0.04 * d.Z))


@category("washing machine", (0.6, 0.6, 0.85), "washer", "clothes dryer", "dryer")
def washing_machine(d: Draft) -> None:
    """A white body with a round window door and a panel above it."""
    color = d.main(WHITES)
    face = 0.93 * d.hx
    d.box("body", color, (-d.hx, face), (-d.hy, d.hy), (0, 0.97 * d.Z))
    d.box("top", shade(color, 0.96), (-d.hx, 0.95 * d.hx), (-d.hy, d.hy), (0.97 * d.Z, d.Z))
    r = min(0.62 * d.hy, 0.3 * d.Z)
    d.add("ring", d.pick(METALS), band([(r, face - 0.01), (0.92 * r, 0.985 * d.hx)], 0.2 * r).turned("y", np.pi / 2).at(0, 0, 0.44 * d.Z))
    d.add(
        "window",
        (70, 80, 92),
        turned_body([(0.82 * r, face - 0.01), (0.82 * r, 0.5 * (face + d.hx)), (0.5 * r, d.hx)])
        .turned("y", np.pi / 2)
        .at(0, 0, 0.44 * d.Z),
    )
    d.box("panel", shade(color, 0.86), (face, 0.95 * d.hx), (-0.96 * d.hy, 0.96 * d.hy), (0.82 * d.Z, 0.95 * d.Z))
    d.box("drawer", color, (face, 0.96 * d.hx), (0.4 * d.hy, 0.9 * d.hy), (0.84 * d.Z, 0.93 * d.Z))
    d.add("dial", (90, 92, 96), cylinder(0.045 * d.Z, (face, 0.98 * d.hx), 12).turned("y", np.pi / 2).at(0, -0.1 * d.hy, 0.885 * d.Z))


@category("dishwasher", (0.6, 0.6, 0.85))
def dishwasher(d: Draft) -> None:
    """A body with one tall door, a rail and a strip of keys."""
    color = d.main(WHITES + METALS[:1] + METALS[3:])
    face = 0.92 * d.hx
    d.box("body", color, (-d.hx, face), (-d.hy, d.hy), (0, d.Z))
    d.box("door", shade(color, 0.95), (face, 0.96 * d.hx), (-0.98 * d.hy, 0.98 * d.hy), (0.12 * d.Z, 0.86 * d.Z))
    d.box("panel", shade(color, 0.8), (face, 0.96 * d.hx), (-0.98 * d.hy, 0.98 * d.hy), (0.87 * d.Z, 0.98 * d.Z))
    d.box("handle", d.pick(METALS), (0.95 * d.hx, d.hx), (-0.7 * d.hy, 0.7 * d.hy), (0.8 * d.Z, 0.825 * d.Z))
    d.box("plinth", (60, 60, 62), (face - 0.01, face + 0.004), (-0.98 * d.hy, 0.98 * d.hy), (0, 0.1 * d.Z))


@category("toaster", (0.28, 0.17, 0.19))
def toaster(d: Draft) -> None:
    """A rounded body with two slots and a lever at its front."""
    color = d.main(METALS + PLASTICS)
    d.cushion("body", color, (-0.93 * d.hx, 0.93 * d.hx), (-d.hy, d.hy), (0.05 * d.Z, 0.99 * d.Z), 0.3 * d.hy)
    for y in (-0.35, 0.35):
        d.box("slots", (30, 28, 28), (-0.7 * d.hx, 0.7 * d.hx), (y * d.hy - 0.14 * d.hy, y * d.hy + 0.14 * d.hy), (0.9 * d.Z, d.Z))
    d.box("lever", (30, 30, 32), (0.9 * d.hx, d.hx), (-0.2 * d.hy, 0.2 * d.hy), (0.55 * d.Z, 0.63 * d.Z))
    d.box("foot", (36, 36, 38), (-d.hx, 0.9 * d.hx), (-0.9 * d.hy, 0.9 * d.hy), (0, 0.1 * d.Z))


@category("coffee maker", (0.25, 0.18, 0.33), "coffee machine", "espresso machine")
def coffee_maker(d: Draft) -> None:
    """A tower with a brew head over a glass pot."""
    color = d.main(DARKS + METALS)
    d.cushion("tower", color, (-d.hx, -0.15 * d.hx), (-d.hy, d.hy), (0, d.Z), 0.012)
    d.cushion("head", color, (-0.3 * d.hx, d.hx), (-d.hy, d.hy), (0.74 * d.Z, d.Z), 0.012)
    d.box("plate", shade(color, 0.8), (-0.3 * d.hx, d.hx), (-d.hy, d.hy), (0, 0.07 * d.Z))
    r = min(0.52 * d.hx, 0.8 * d.hy)
    coffee = [(0.9 * r, 0.07 * d.Z), (r, 0.2 * d.Z), (r, 0.4 * d.Z), (0.7 * r, 0.6 * d.Z)]
    d.add("pot", (70, 48, 36), turned_body(coffee, circle(16)).at(0.42 * d.hx, 0, 0))


@category("blender", (0.18, 0.18, 0.4), "kitchen mixer", "mixer", "food processor")
def blender(d: Draft) -> None:
    """A motor base with a tall jug and lid."""
    color, r, stretch = d.main(PLASTICS + METALS), d.hx, d.Y / d.X
    d.add("base", color, turned_body([(r, 0), (0.95 * r, 0.1 * d.Z), (0.65 * r, 0.34 * d.Z)], stretch=stretch))
    d.add("jug", (200, 214, 220), vessel([(0.6 * r, 0.34 * d.Z), (0.85 * r, 0.92 * d.Z)], 0.05 * r, 0.02, stretch=stretch))
    d.add("lid", shade(color, 0.7), turned_body([(0.87 * r, 0.9 * d.Z), (0.87 * r, 0.96 * d.Z), (0.3 * r, d.Z)], stretch=stretch))


@category("range hood", (0.5, 0.6, 0.6), "extractor hood", "hood")
def range_hood(d: Draft) -> None:
    """A flared hood under a duct."""
    color = d.main(METALS[:1] + METALS[3:] + WHITES)
    d.box("rim", color, (-d.hx, d.hx), (-d.hy, d.hy), (0, 0.1 * d.Z))
    neck = ((-d.hx, -0.2 * d.hx), (-0.35 * d.hy, 0.35 * d.hy))
    d.add("hood", color, wedge(((-d.hx, d.hx), (-d.hy, d.hy)), neck, (0.1 * d.Z, 0.42 * d.Z)))
    d.box("duct", color, *neck, (0.4 * d.Z, d.Z))
    d.box("lights", (250, 240, 210), (0.2 * d.hx, 0.5 * d.hx), (-0.6 * d.hy, 0.6 * d.hy), (-0.004, 0.02 * d.Z))


@category("air conditioner", (0.22, 0.85, 0.3), "heater", "ac unit")
def air_conditioner(d: Draft) -> None:
    """A rounded wall unit with louvers; a tall one stands on the floor."""
    color = d.main(WHITES)
    d.cushion("body", color, (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z), 0.2 * min(d.X, d.Z))
    for i in range(3):
        z = (0.08 + 0.08 * i) * d.Z
        d.box("louvers", shade(color, 0.72), (0.5 * d.hx, d.hx * 1.01), (-0.85 * d.hy, 0.85 * d.hy), (z, z + 0.03 * d.Z))
    d.box("display", (90, 160, 170), (0.9 * d.hx, d.hx * 1.008), (0.6 * d.hy, 0.75 * d.hy), (0.5 * d.Z, 0.56 * d.Z))


@category("vacuum cleaner", (0.45, 0.28, 0.9), "vacuum", "robot vacuum", free=True)
def vacuum_cleaner(d: Draft) -> None:
    """A canister on wheels with a tube; a flat one is a robot."""
    color = d.main(PLASTICS)
    if d.Z < 0.2:
        d.variant = "robot"
        d.add(
            "body",
            color,
            turned_body([(0.96 * d.hx, 0), (d.hx, 0.3 * d.Z), (d.hx, 0.8 * d.Z), (0.96 * d.hx, 0.9 * d.Z)], stretch=d.Y / d.X),
        )
        d.add("bumper", shade(color, 0.6), cylinder(0.3 * d.hx, (0.85 * d.Z, d.Z)))
        return
    d.cushion("canister", color, (-d.hx, 0.35 * d.hx), (-0.8 * d.hy, 0.8 * d.hy), (0.03 * d.Z, 0.32 * d.Z), 0.06)
    for s in (-1, 1):
        d.add(
            "wheels",
            (34, 34, 36),
            cylinder(0.13 * d.Z, (-0.1 * d.hy, 0.1 * d.hy), 14).turned("x", np.pi / 2).at(-0.5 * d.hx, s * 0.88 * d.hy, 0.13 * d.Z),
        )
    d.box("nozzle", (40, 40, 42), (0.7 * d.hx, d.hx), (-d.hy, d.hy), (0, 0.06 * d.Z))
    d.add("tube", d.pick(METALS), bar((0.85 * d.hx, 0, 0.04 * d.Z), (0.3 * d.hx, 0, 0.97 * d.Z), 0.035, 0.035, 8))
    hose = [(-0.1 * d.hx, 0, 0.3 * d.Z), (-0.2 * d.hx, 0, 0.6 * d.Z), (0.0, 0, 0.9 * d.Z), (0.3 * d.hx, 0, 0.97 * d.Z)]
    d.add("hose", (60, 60, 64), sweep(hose, 0.04, 0.04, 8, up=(0, 1, 0)))


@category("iron", (0.28, 0.12, 0.15), "clothes iron")
def iron(d: Draft) -> None:
    """A pointed sole, a body and a handle."""
    color = d.main(PLASTICS)
    tip = wedge(((-d.hx, d.hx), (-d.hy, d.hy)), ((-d.hx, 0.2 * d.hx), (-0.7 * d.hy, 0.7 * d.hy)), (0.08 * d.Z, 0.55 * d.Z))
    d.add("body", color, tip)
    d.box("sole", d.pick(METALS), (-d.hx, d.hx), (-d.hy, d.hy), (0, 0.08 * d.Z))
    arch = [(-0.8 * d.hx, 0, 0.5 * d.Z), (-0.75 * d.hx, 0, 0.92 * d.Z), (0.1 * d.hx, 0, 0.94 * d.Z), (0.25 * d.hx, 0, 0.4 * d.Z)]
    d.add("handle", shade(color, 0.7), sweep(arch, 0.3 * d.hy, 0.12 * d.Z, 6, up=(0, 1, 0)))
