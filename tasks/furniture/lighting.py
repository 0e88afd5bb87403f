"""Lamps, and fans that hang where lamps hang."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import BRASSES, CERAMICS, METALS, WHITES, shade
from tasks.furniture.solids import band, bar, circle, cylinder, ellipsoid, turned_body

GLOW = (252, 240, 206)
"""A lit bulb or shade."""


def _shade_and_bulb(d: Draft, low: float, high: float, radius: float, slope: float, stretch: float = 1.0) -> None:
    """An open cloth shade with a bulb and its holder inside."""
    cloth = d.main(((236, 224, 196), (214, 196, 160), (240, 238, 230), (150, 120, 90), (96, 110, 120)))
    d.add("shade", cloth, band([(radius, low), (slope * radius, high)], min(0.006, 0.1 * radius), stretch=stretch))
    middle = 0.5 * (low + high)
    d.add("bulb", GLOW, ellipsoid((0, 0, middle), (0.22 * radius, 0.22 * radius, 0.2 * (high - low))))
    for angle in (0.0, np.pi / 2):
        reach = 0.5 * (1 + slope) * radius - 0.003
        c, s = np.cos(angle) * reach, np.sin(angle) * reach * stretch
        d.add("holder", d.pick(BRASSES), bar((-c, -s, middle), (c, s, middle), 0.006, 0.006))


@category("floor lamp", (0.4, 0.4, 1.6), "standing lamp")
def floor_lamp(d: Draft) -> None:
    """A tall stem on a disc or three legs under a cloth shade."""
    metal = d.pick(BRASSES + METALS)
    r, stretch = d.hx, d.Y / d.X
    low = 0.8 * d.Z
    if d.one_of("disc", "tripod") == "disc":
        d.add("foot", metal, turned_body([(0.75 * r, 0), (0.75 * r, 0.015), (0.06, 0.035)]))
        d.round_leg("stem", metal, 0, 0, (0.02, 0.92 * d.Z), 0.013)
    else:
        for i in range(3):
            angle = 2 * np.pi * i / 3
            foot = (0.9 * r * np.cos(angle), 0.9 * r * np.sin(angle), 0.0)
            d.add("legs", metal, bar(foot, (0.02 * np.cos(angle), 0.02 * np.sin(angle), 0.76 * d.Z), 0.028, 0.028, 6))
        d.round_leg("stem", metal, 0, 0, (0.7 * d.Z, 0.92 * d.Z), 0.016)
    _shade_and_bulb(d, low, d.Z, r, 0.75, stretch)


@category("table lamp", (0.28, 0.28, 0.48), "lamp", "bedside lamp", free=True)
def table_lamp(d: Draft) -> None:
    """A turned foot of pottery or metal under a cloth shade; a tall one is a floor lamp."""
    if d.Z > 1.0:
        floor_lamp(d)
        return
    pot = d.pick(CERAMICS)
    r = d.hx
    low, neck = 0.52 * d.Z, 0.5 * d.Z
    if d.one_of("pottery", "column") == "pottery":
        profile = [
            (0.4 * r, 0),
            (0.42 * r, 0.02 * d.Z),
            (0.62 * r, 0.16 * d.Z),
            (0.55 * r, 0.3 * d.Z),
            (0.2 * r, 0.44 * d.Z),
            (0.12 * r, neck),
        ]
    else:
        profile = [(0.5 * r, 0), (0.5 * r, 0.04 * d.Z), (0.14 * r, 0.07 * d.Z), (0.12 * r, neck)]
    d.add("foot", pot, turned_body(profile, circle(16)))
    d.round_leg("stem", d.pick(BRASSES), 0, 0, (neck - 0.01, 0.8 * d.Z), 0.05 * r)
    _shade_and_bulb(d, low, d.Z, r, 0.65, d.Y / d.X)


@category("desk lamp", (0.38, 0.18, 0.45), "reading lamp", "work lamp")
def desk_lamp(d: Draft) -> None:
    """A foot, two jointed arms and a cone that shines forward."""
    color = d.main(METALS + CERAMICS[1:4] + WHITES)
    r = d.hy
    base = -d.hx + r
    joint, head = (-0.85 * d.hx, 0.0, 0.62 * d.Z), (0.5 * d.hx, 0.0, 0.9 * d.Z)
    d.add("foot", color, turned_body([(r, 0), (r, 0.02), (0.8 * r, 0.03)]).at(base, 0, 0))
    arm = min(0.016, 0.3 * r)
    d.add("arm", color, bar((base, 0, 0.02), joint, arm, arm, 6))
    d.add("arm", color, bar(joint, head, arm, arm, 6))
    d.add("joints", shade(color, 0.7), ellipsoid(joint, (1.1 * arm,) * 3, 10, 6))
    cone = turned_body([(0.62 * r, -0.16 * d.Z), (0.55 * r, -0.14 * d.Z), (0.25 * r, 0.06 * d.Z), (0.12 * r, 0.1 * d.Z)])
    d.add("head", color, cone.turned("y", -0.6).at(*head))
    d.add("bulb", GLOW, cylinder(0.5 * r, (-0.168 * d.Z, -0.155 * d.Z)).turned("y", -0.6).at(*head))


@category("ceiling lamp", (0.4, 0.4, 0.35), "ceiling light", "light", "pendant lamp", "hanging lamp", free=True)
def ceiling_lamp(d: Draft) -> None:
    """A pendant shade on a cord, a glass globe, or a flat disc under the ceiling."""
    metal = d.pick(METALS + BRASSES)
    r, stretch = d.hx, d.Y / d.X
    if d.Z < 0.35 * d.X:
        d.variant = "flush"
        d.add("plate", d.main(METALS), turned_body([(0.9 * r, 0.8 * d.Z), (0.9 * r, d.Z)], stretch=stretch))
        d.add("diffuser", GLOW, turned_body([(0.7 * r, 0), (r, 0.35 * d.Z), (r, 0.8 * d.Z)], stretch=stretch))
        return
    d.add("rose", metal, turned_body([(0.05 + 0.1 * r, 0.97 * d.Z), (0.06 + 0.1 * r, d.Z)]))
    d.round_leg("cord", (40, 40, 40), 0, 0, (0.5 * d.Z, 0.98 * d.Z), 0.006)
    if d.one_of("shade", "globe") == "globe":
        d.add("globe", d.main((GLOW,)), ellipsoid((0, 0, 0.3 * d.Z), (r, r * stretch, 0.3 * d.Z), 16, 10))
    else:
        _shade_and_bulb(d, 0, 0.55 * d.Z, r, 0.45, stretch)


@category("chandelier", (0.75, 0.75, 0.7))
def chandelier(d: Draft) -> None:
    """Curved arms around a stem, each with a candle bulb."""
    metal = d.main(BRASSES + METALS)
    r = min(d.hx, d.hy)
    d.add("rose", metal, turned_body([(0.07, 0.97 * d.Z), (0.08, d.Z)]))
    stem = [(0.02, 0.0), (0.05, 0.06 * d.Z), (0.02, 0.14 * d.Z), (0.012, 0.3 * d.Z), (0.012, 0.98 * d.Z)]
    d.add("stem", metal, turned_body(stem, circle(16)))
    for i in range(6):
        angle = np.pi / 3 * i
        c, s = np.cos(angle), np.sin(angle)
        points = [(0.02, 0.12), (0.45 * r, 0.06), (0.9 * r, 0.22)]
        for (a, za), (b, zb) in pairwise(points):
            d.add("arms", metal, bar((a * c, a * s, za * d.Z), (b * c, b * s, zb * d.Z), 0.018, 0.018, 6))
        x, y = 0.9 * r * c, 0.9 * r * s
        d.add("cups", metal, turned_body([(0.02, 0), (0.1 * r, 0.03 * d.Z)], circle(16)).at(x, y, 0.2 * d.Z))
        d.add("bulbs", GLOW, ellipsoid((x, y, 0.32 * d.Z), (0.05 * r, 0.05 * r, 0.1 * d.Z), 8, 6))


@category("ceiling fan", (1.1, 1.1, 0.4))
def ceiling_fan(d: Draft) -> None:
    """Blades around a motor under a rod."""
    metal, blade = d.pick(METALS + WHITES), d.main(((110, 78, 52), (230, 228, 222), (60, 60, 62)))
    r = min(d.hx, d.hy)
    d.add("rod", metal, cylinder(0.02, (0.3 * d.Z, d.Z)))
    d.add("motor", metal, turned_body([(0.08 * r, 0), (0.2 * r, 0.08 * d.Z), (0.2 * r, 0.35 * d.Z), (0.08 * r, 0.5 * d.Z)]))
    for i in range(4):
        angle = i * np.pi / 2
        tip, root = np.array([np.cos(angle), np.sin(angle), 0]), 0.15 * r
        d.add("blades", blade, bar(root * tip + [0, 0, 0.25 * d.Z], r * tip + [0, 0, 0.25 * d.Z], 0.14 * r, 0.012))


@category("fan", (0.35, 0.4, 1.1), "standing fan", "desk fan")
def fan(d: Draft) -> None:
    """A foot, a stem and blades in a ring."""
    color = d.main(WHITES + METALS)
    r = min(d.hy, 0.45 * d.Z)
    center = d.Z - r
    d.add("foot", color, turned_body([(0.8 * d.hx, 0), (0.8 * d.hx, 0.02), (0.2 * d.hx, 0.05)], stretch=min(d.Y / d.X, 1.2)))
    if center > 0.05:
        d.round_leg("stem", color, 0, 0, (0.02, center), 0.02)
    cage = band([(r, -0.25 * d.hx), (r, 0.25 * d.hx)], 0.012).turned("y", np.pi / 2)
    d.add("cage", color, cage.at(0.2 * d.hx, 0, center))
    d.add(
        "hub",
        shade(color, 0.8),
        turned_body([(0.25 * r, -0.8 * d.hx), (0.25 * r, 0.3 * d.hx)]).turned("y", np.pi / 2).at(0.2 * d.hx, 0, center),
    )
    for i in range(10):
        angle = np.pi * i / 5
        tip = (0.2 * d.hx, r * np.cos(angle), center + r * np.sin(angle))
        d.add("blades", shade(color, 0.9), bar((0.2 * d.hx, 0, center), tip, 0.012 if i % 2 else 0.22 * r, 0.012))
