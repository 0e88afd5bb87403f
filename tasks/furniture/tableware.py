"""Objects on tables and in kitchens that are mostly turned: cups, bowls, bottles, pots."""

from __future__ import annotations

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import CERAMICS, CLAYS, COVERS, GLASSES, METALS, PLASTICS, WHITES, WOODS, shade
from tasks.furniture.solids import bar, circle, cylinder, ellipsoid, rounded_square, square, sweep, turned_body, vessel


def _handle(d: Draft, part: str, color: tuple[int, int, int], x0: float, x1: float, z: tuple[float, float], thick: float) -> None:
    """A loop from the body at x0 out to x1 and back, in the plane y = 0."""
    t = np.linspace(-np.pi / 2, np.pi / 2, 7)
    reach = x1 - x0 - 0.5 * thick
    loop = np.column_stack([x0 + reach * np.cos(t), np.zeros(7), 0.5 * (z[0] + z[1]) + 0.5 * (z[1] - z[0]) * np.sin(t)])
    d.add(part, color, sweep(loop, thick, thick, 6, up=(0, 1, 0)))


@category("mug", (0.12, 0.085, 0.1), "coffee mug", "tea mug")
def mug(d: Draft) -> None:
    """A straight cup with a handle at its front."""
    color = d.main(CERAMICS)
    r = d.hy
    d.one_of("straight", "tapered")
    foot = 0.95 if d.variant == "straight" else 0.78
    x = -d.hx + r
    d.add(
        "cup",
        color,
        vessel([(foot * r, 0), (r, 0.1 * d.Z if foot > 0.9 else d.Z * 0.9), (r, d.Z)], 0.07 * r, 0.08 * d.Z).at(x, 0, 0),
    )
    if d.hx > r + 0.002:
        _handle(d, "handle", color, x + 0.93 * r, d.hx, (0.22 * d.Z, 0.8 * d.Z), min(0.18 * r, 0.4 * (d.X - 2 * r)))


@category("cup", (0.085, 0.085, 0.09), "drinking glass", "glass", "tumbler", "paper cup")
def cup(d: Draft) -> None:
    """A cup without a handle, wider at the top."""
    kind = d.one_of("cup", "tumbler")
    color = d.main(GLASSES if kind == "tumbler" else CERAMICS + PLASTICS)
    foot = 0.72 if kind == "cup" else 0.85
    d.add("cup", color, vessel([(foot * d.hx, 0), (d.hx, d.Z)], 0.06 * d.hx, 0.07 * d.Z, stretch=d.Y / d.X))


@category("wine glass", (0.085, 0.085, 0.2), "goblet")
def wine_glass(d: Draft) -> None:
    """A bowl on a stem on a foot."""
    color, r, stretch = d.main(GLASSES), d.hx, d.Y / d.X
    d.add(
        "stem", color, turned_body([(0.9 * r, 0), (0.85 * r, 0.015 * d.Z), (0.1 * r, 0.05 * d.Z), (0.1 * r, 0.46 * d.Z)], stretch=stretch)
    )
    bowl = [(0.2 * r, 0.45 * d.Z), (0.9 * r, 0.62 * d.Z), (r, 0.75 * d.Z), (0.85 * r, d.Z)]
    d.add("bowl", color, vessel(bowl, 0.06 * r, 0.05 * d.Z, stretch=stretch))


@category("bottle", (0.08, 0.08, 0.28), "water bottle", "wine bottle", "soda bottle", "lotion bottle", "shampoo bottle", "spray bottle")
def bottle(d: Draft) -> None:
    """A body, shoulders, a neck and a cap, with a label."""
    r, stretch, z = d.hx, d.Y / d.X, d.Z
    kind = d.one_of("wine", "water", "pump")
    color = d.main(((44, 70, 48), (60, 40, 30), (170, 200, 212)) if kind == "wine" else GLASSES + PLASTICS)
    shoulder = 0.6 if kind == "wine" else 0.72
    neck = 0.34 if kind == "wine" else 0.42
    body = [
        (0.94 * r, 0),
        (r, 0.03 * z),
        (r, shoulder * z),
        (0.7 * r, (shoulder + 0.08) * z),
        (neck * r, (shoulder + 0.14) * z),
        (neck * r, 0.94 * z),
    ]
    d.add("bottle", color, turned_body(body, stretch=stretch))
    cap = shade(color, 0.6) if kind == "wine" else d.pick(PLASTICS)
    if kind == "pump":
        d.add("cap", cap, cylinder(0.5 * r, (0.88 * z, 0.95 * z)))
        d.box("cap", cap, (-0.2 * r, 0.9 * r), (-0.18 * r, 0.18 * r), (0.94 * z, z))
    else:
        d.add("cap", cap, turned_body([(1.12 * neck * r, 0.92 * z), (1.12 * neck * r, z)], stretch=stretch))
    d.add("label", d.pick(COVERS), turned_body([(1.01 * r, 0.18 * z), (1.01 * r, 0.5 * z)], stretch=stretch))


@category("can", (0.066, 0.066, 0.12), "soda can", "tin can", "tin", "jar lid")
def can(d: Draft) -> None:
    """A printed cylinder with drawn-in ends."""
    r, z, stretch = d.hx, d.Z, d.Y / d.X
    metal = d.pick(METALS[:1] + METALS[3:])
    d.add("can", d.main(COVERS), turned_body([(r, 0.06 * z), (r, 0.92 * z)], stretch=stretch))
    d.add("ends", metal, turned_body([(0.82 * r, 0), (0.99 * r, 0.06 * z), (0.99 * r, 0.92 * z), (0.82 * r, z)], stretch=stretch))


@category("jar", (0.09, 0.09, 0.14), "storage jar", "spice jar", "candle jar")
def jar(d: Draft) -> None:
    """A wide glass with a screw lid and something inside."""
    r, z, stretch = d.hx, d.Z, d.Y / d.X
    fill = d.main(((196, 150, 80), (120, 70, 40), (210, 200, 170), (150, 60, 50)))
    d.add("filling", fill, turned_body([(0.95 * r, 0.0), (r, 0.06 * z), (r, 0.66 * z)], stretch=stretch))
    d.add("glass", d.pick(GLASSES), turned_body([(r, 0.66 * z), (0.82 * r, 0.8 * z), (0.82 * r, 0.84 * z)], stretch=stretch))
    d.add("lid", d.pick(METALS + COVERS), turned_body([(0.9 * r, 0.84 * z), (0.9 * r, z)], stretch=stretch))


@category("bowl", (0.18, 0.18, 0.08), "fruit bowl", "salad bowl")
def bowl(d: Draft) -> None:
    """An open bowl, sometimes with fruit."""
    r, stretch = d.hx, d.Y / d.X
    color = d.main(CERAMICS + WOODS[:2])
    filled = d.one_of("empty", "fruit") == "fruit" and d.X > 0.16 and d.Z > 0.06
    top = 0.72 * d.Z if filled else d.Z
    d.add(
        "bowl",
        color,
        vessel([(0.45 * r, 0), (0.78 * r, 0.35 * top), (0.94 * r, 0.7 * top), (r, top)], 0.05 * r, 0.1 * top, stretch=stretch),
    )
    if filled:
        for i in range(4):
            angle, size = np.pi / 2 * i + 0.4, 0.27 * r
            center = (0.38 * r * np.cos(angle), 0.38 * r * stretch * np.sin(angle), 0.12 * top + size + 0.02 * d.Z * i)
            d.add("fruit", d.pick(((204, 60, 44), (226, 160, 50), (120, 160, 60))), ellipsoid(center, (size, size, min(size, 0.5 * d.Z))))


@category("plate", (0.25, 0.25, 0.025), "dish", "saucer", "tableware")
def plate(d: Draft) -> None:
    """A flat disc with a raised rim."""
    color, r, stretch = d.main(CERAMICS), d.hx, d.Y / d.X
    d.add("plate", color, vessel([(0.6 * r, 0), (0.7 * r, 0.3 * d.Z), (r, d.Z)], 0.12 * r, 0.3 * d.Z, stretch=stretch))


@category("tray", (0.3, 0.42, 0.04), "serving tray", "dish tray")
def tray(d: Draft) -> None:
    """A shallow rectangle with a rim."""
    d.add(
        "tray", d.main(WOODS + PLASTICS), vessel([(0.94 * d.hx, 0), (d.hx, d.Z)], 0.02, 0.25 * d.Z, rounded_square(0.2, 2), d.Y / d.X, 12)
    )


@category("vase", (0.14, 0.14, 0.28), "flower vase")
def vase(d: Draft) -> None:
    """A turned vase with an open neck, empty or with a few stems."""
    r, stretch, color = d.hx, d.Y / d.X, d.main(CERAMICS + GLASSES)
    kind = d.one_of("bellied", "slim", "flared")
    flowers = d.Z > 0.2 and d.chance(0.4)
    z = 0.55 * d.Z if flowers else d.Z
    w = 0.55 * r if flowers else r
    shapes = {
        "bellied": [(0.5, 0), (0.9, 0.2), (1.0, 0.42), (0.8, 0.65), (0.4, 0.85), (0.48, 1.0)],
        "slim": [(0.7, 0), (0.95, 0.25), (1.0, 0.5), (0.75, 0.85), (0.7, 1.0)],
        "flared": [(0.55, 0), (0.5, 0.3), (0.6, 0.6), (1.0, 1.0)],
    }
    d.add("vase", color, vessel([(p * w, t * z) for p, t in shapes[kind]], 0.08 * w, 0.06 * z, stretch=stretch))
    if flowers:
        d.variant += " filled"
        petals = d.pick(((220, 90, 100), (240, 200, 90), (230, 230, 240), (160, 100, 180)))
        for i in range(5):
            angle = 2 * np.pi * i / 5 + 0.3
            tip = (0.72 * r * np.cos(angle), 0.72 * r * stretch * np.sin(angle), (0.86 + 0.05 * (i % 2)) * d.Z)
            d.add("stems", (74, 118, 62), bar((0, 0, 0.1 * z), tip, 0.006, 0.006, 6))
            d.add("flowers", petals, ellipsoid(tip, (0.26 * r, 0.26 * r, 0.07 * d.Z), 8, 5))


@category("pot", (0.3, 0.24, 0.18), "cooking pot", "saucepan", "stock pot")
def pot(d: Draft) -> None:
    """A lidded pot with a grip on either side."""
    color, r = d.main(METALS + COVERS[:3]), d.hy
    stretch = 1.0
    top = 0.74 * d.Z
    d.add("pot", color, turned_body([(0.96 * r, 0), (r, 0.05 * d.Z), (r, top)], stretch=stretch))
    d.add("lid", shade(color, 1.1), turned_body([(1.02 * r, top), (1.0 * r, top + 0.04 * d.Z), (0.3 * r, 0.88 * d.Z)]))
    d.add("knob", (34, 34, 36), turned_body([(0.08 * r, 0.86 * d.Z), (0.14 * r, d.Z)]))
    if d.hx > r:
        for s in (-1, 1):
            x0, x1 = sorted((s * 0.95 * r, s * d.hx))
            d.box("grips", (34, 34, 36), (x0, x1), (-0.3 * r, 0.3 * r), (0.55 * d.Z, 0.63 * d.Z))


@category("pan", (0.45, 0.26, 0.06), "frying pan", "skillet")
def pan(d: Draft) -> None:
    """A shallow dish with one long handle at its front."""
    color, r = d.main(METALS[2:3] + METALS[:1]), d.hy
    x = -d.hx + r
    d.add("pan", color, vessel([(0.8 * r, 0), (r, 0.7 * d.Z)], 0.03 * r, 0.12 * d.Z).at(x, 0, 0))
    d.add("handle", (34, 34, 36), bar((x + 0.93 * r, 0, 0.55 * d.Z), (d.hx, 0, d.Z - 0.01), 0.025, 0.016, 8))


@category("kettle", (0.24, 0.18, 0.24), "tea kettle", "teapot", "electric kettle", "pitcher", "tea pot")
def kettle(d: Draft) -> None:
    """A bellied pot with a spout at its front and a handle at its back."""
    color, r = d.main(METALS + CERAMICS), d.hy
    d.add("pot", color, turned_body([(0.85 * r, 0), (r, 0.2 * d.Z), (0.85 * r, 0.5 * d.Z), (0.55 * r, 0.8 * d.Z), (0.3 * r, 0.93 * d.Z)]))
    d.add("knob", (34, 34, 36), turned_body([(0.1 * r, 0.9 * d.Z), (0.12 * r, d.Z)]))
    d.add("spout", color, sweep([(0.6 * r, 0, 0.4 * d.Z), (d.hx, 0, 0.82 * d.Z)], [0.5 * r, 0.2 * r], [0.5 * r, 0.2 * r], 8, up=(0, 1, 0)))
    t = np.linspace(np.pi / 2, 3 * np.pi / 2, 7)
    reach = d.hx - 0.7 * r
    loop = np.column_stack([-0.7 * r + reach * np.cos(t), np.zeros(7), 0.5 * d.Z + 0.32 * d.Z * np.sin(t)])
    d.add("handle", (34, 34, 36), sweep(loop, 0.02, 0.02, 6, up=(0, 1, 0)))


@category("kitchen utensils", (0.12, 0.12, 0.32), "cutlery", "utensils")
def utensils(d: Draft) -> None:
    """Spoons and spatulas in a jar."""
    r, top = d.hx, 0.5 * d.Z
    d.add("jar", d.main(CERAMICS), vessel([(0.62 * r, 0), (0.66 * r, top)], 0.05 * r, 0.03 * d.Z, stretch=d.Y / d.X))
    for i in range(5):
        angle = 2 * np.pi * i / 5
        tip = np.array([0.85 * r * np.cos(angle), 0.85 * d.hy * np.sin(angle), (0.86 + 0.03 * (i % 3)) * d.Z])
        color = d.pick(WOODS + METALS)
        d.add("utensils", color, bar((0.1 * r * np.cos(angle), 0.1 * r * np.sin(angle), 0.05 * d.Z), tip, 0.008, 0.008, 6))
        d.add("utensils", color, ellipsoid(tip, (0.16 * r, 0.2 * r, 0.08 * d.Z), 8, 5))


@category("trash can", (0.3, 0.3, 0.45), "recycling bin", "garbage bin", "waste bin", "waste basket", "trash bin", "trash", "garbage can")
def trash_can(d: Draft) -> None:
    """A tapered bin: open, with a swing lid, or a pedal bin."""
    kind = d.one_of("open", "lidded", "square")
    color, r, stretch = d.main(PLASTICS + METALS), d.hx, d.Y / d.X
    section = rounded_square(0.3, 2) if kind == "square" else circle()
    if kind == "lidded":
        top = 0.84 * d.Z
        d.add("bin", color, turned_body([(0.9 * r, 0), (r, 0.03 * d.Z), (r, top)], section, stretch))
        d.add("lid", shade(color, 0.7), turned_body([(r, top), (0.97 * r, top + 0.06 * d.Z), (0.5 * r, d.Z)], section, stretch))
        return
    profile = [(0.76 * r, 0), (0.97 * r, 0.95 * d.Z), (r, 0.95 * d.Z), (r, d.Z)]
    d.add("bin", color, vessel(profile, 0.04 * r, 0.02 * d.Z, section, stretch, 12 if kind == "square" else 8))
    if d.chance(0.6):
        rubbish = [(0.8 * r, 0.62 * d.Z), (0.82 * r, 0.7 * d.Z), (0.3 * r, 0.78 * d.Z)]
        d.add("rubbish", d.pick(WHITES), turned_body(rubbish, section, stretch))


@category("bucket", (0.3, 0.3, 0.36), "pail")
def bucket(d: Draft) -> None:
    """A pail with a bail handle standing up."""
    color, r, stretch = d.main(PLASTICS + METALS), d.hx, d.Y / d.X
    top = 0.74 * d.Z
    profile = [(0.72 * r, 0), (0.95 * r, 0.9 * top), (r, 0.9 * top), (r, top)]
    d.add("pail", color, vessel(profile, 0.06 * r, 0.03 * d.Z, stretch=stretch))
    t = np.linspace(0, np.pi, 11)
    arch = np.column_stack([np.zeros(11), 0.96 * d.hy * np.cos(t), 0.93 * top + (d.Z - 0.93 * top - 0.004) * np.sin(t)])
    d.add("bail", d.pick(METALS), sweep(arch, 0.008, 0.008, 6, run=2, up=(1, 0, 0)))


@category("candle", (0.07, 0.07, 0.12), "candlestick")
def candle(d: Draft) -> None:
    """Wax with a wick, in a saucer."""
    d.add("saucer", d.pick(CLAYS), turned_body([(0.9 * d.hx, 0), (d.hx, 0.08 * d.Z)], stretch=d.Y / d.X))
    d.add("wax", d.main(((240, 232, 210), (200, 80, 70), (220, 190, 150))), cylinder(0.72 * d.hx, (0.04 * d.Z, 0.9 * d.Z)))
    d.add("wick", (50, 40, 34), cylinder(0.003, (0.88 * d.Z, d.Z), 6))


@category("cutting board", (0.28, 0.4, 0.025), "chopping board")
def cutting_board(d: Draft) -> None:
    """A board with rounded corners and a grip hole's rim."""
    wood = d.main(WOODS)
    d.add("board", wood, turned_body([(d.hx, 0), (d.hx, 0.9 * d.Z)], rounded_square(0.2, 3), d.Y / d.X))
    d.add("groove", shade(wood, 0.8), turned_body([(0.5 * d.hx, 0.5 * d.Z), (0.5 * d.hx, d.Z)], square(), d.Y / d.X))
