"""Objects to sit on. Every drawing fills the draft's extents; the front is +x."""

from __future__ import annotations

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import DARKS, FABRICS, LEATHERS, METALS, PLASTICS, WOODS, Color, shade
from tasks.furniture.solids import bar, box, cushion, cylinder, sweep, turned_body, wedge


@category("chair", (0.5, 0.46, 0.88), "dining chair", "side chair", "folding chair", "kitchen chair")
def chair(d: Draft) -> None:
    """Four legs, a seat, and a back of slats, rungs, one panel, or a padded one."""
    kind = d.one_of("slatted", "ladder", "panel", "padded")
    wood = d.main(WOODS)
    seat = 0.51 * d.Z
    side, board = min(0.04, 0.12 * d.Y), min(0.03, 0.06 * d.Z)
    lean = min(0.06, 0.15 * d.X)
    fx, bx, y = d.hx - 0.5 * side, -d.hx + lean + 0.5 * side, d.hy - 0.5 * side
    for s in (-1, 1):
        d.leg("legs", wood, (fx, s * y), (fx, s * y), (0, seat - board), side, 0.75)
        d.leg("legs", wood, (bx - 0.4 * lean, s * y), (bx, s * y), (0, seat), side)
        d.leg("back", wood, (bx, s * y), (bx - lean, s * y), (seat, d.Z), side)
        d.box("legs", wood, (bx, fx), (s * y - 0.3 * side, s * y + 0.3 * side), (0.22 * d.Z, 0.22 * d.Z + 0.6 * side))
    cloth = d.pick(FABRICS)
    d.box("seat", wood, (-d.hx + lean, d.hx), (-d.hy, d.hy), (seat - board, seat))
    if kind == "padded":
        d.cushion(
            "seat pad", cloth, (-d.hx + lean + side, d.hx - 0.01), (-d.hy + 0.01, d.hy - 0.01), (seat, seat + 1.4 * board), 0.5 * board
        )
    _chair_back(d, kind, wood, cloth, seat, side, bx, lean)


def _chair_back(d: Draft, kind: str, wood: Color, cloth: Color, seat: float, side: float, bx: float, lean: float) -> None:
    """What lies between the back posts, following their lean."""
    rise, inner, thin = d.Z - seat, d.hy - side, 0.45 * side

    def rail(low: float, high: float, color: Color = wood, part: str = "back", y: tuple[float, float] = (-inner, inner)) -> None:
        spans = [(bx - lean * t - thin, bx - lean * t + thin) for t in (low, high)]
        d.add(part, color, wedge((spans[0], y), (spans[1], y), (seat + low * rise, seat + high * rise)))

    rail(0.86, 1.0)
    if kind == "ladder":
        for low in (0.22, 0.44, 0.66):
            rail(low, low + 0.1)
    elif kind == "slatted":
        rail(0.2, 0.28)
        count = max(3, round(2 * inner / 0.07))
        for i in range(count):
            center = -inner + 2 * inner * (i + 0.5) / count
            rail(0.28, 0.86, y=(center - 0.25 * inner / count * 1.2, center + 0.25 * inner / count * 1.2))
    elif kind == "panel":
        rail(0.3, 0.86, shade(wood, 1.08))
    else:
        rail(0.25, 0.86, cloth, "back pad")


@category("office chair", (0.62, 0.62, 1.0), "desk chair", "swivel chair", "computer chair")
def office_chair(d: Draft) -> None:
    """A star base on casters, a gas spring, a padded seat and a back."""
    kind = d.one_of("mesh back", "low", "executive")
    cloth = d.main(DARKS + FABRICS[:6])
    metal = d.pick(METALS[1:3])
    r = min(d.hx, d.hy)
    seat = 0.46 * d.Z
    wheel = min(0.032, 0.1 * r)
    for i in range(5):
        angle = 2 * np.pi * i / 5
        tip = (np.cos(angle) * (r - wheel), np.sin(angle) * (r - wheel))
        d.add("base", metal, bar((0, 0, 0.11 * d.Z), (*tip, 2.1 * wheel), 0.045, 0.03))
        d.add("casters", d.pick(DARKS), cylinder(wheel, (-0.4 * wheel, 0.4 * wheel), 10).turned("x", np.pi / 2).at(*tip, wheel))
    d.round_leg("base", metal, 0, 0, (0.07 * d.Z, seat - 0.04), 0.09 * r)
    thick = min(0.09, 0.1 * d.Z)
    d.cushion("seat", cloth, (-0.72 * d.hx, 0.86 * d.hx), (-0.8 * d.hy, 0.8 * d.hy), (seat - 0.5 * thick, seat + 0.5 * thick), 0.4 * thick)
    low = seat + (0.22 if kind == "low" else 0.13) * d.Z
    back = shade(cloth, 1.25) if kind == "mesh back" else cloth
    depth = min(0.04 if kind == "mesh back" else 0.09, 0.3 * d.hx)
    panel = cushion((-0.5 * depth, 0.5 * depth), (-0.72 * d.hy, 0.72 * d.hy), (low, d.Z), 0.42 * depth)
    d.add("back", back, panel.at(-0.85 * d.hx, 0, 0))
    d.add("spine", metal, bar((-0.5 * d.hx, 0, seat - 0.2 * thick), (-0.8 * d.hx, 0, seat), 0.06, 0.025))
    d.add("spine", metal, bar((-0.83 * d.hx, 0, seat - 0.2 * thick), (-0.86 * d.hx, 0, low + 0.2 * d.Z), 0.06, 0.025))
    if kind != "low":
        for s in (-1, 1):
            y = s * 0.92 * d.hy
            d.add("arms", metal, bar((-0.1 * d.hx, s * 0.7 * d.hy, seat), (-0.1 * d.hx, y, seat + 0.04 * d.Z), 0.04))
            d.add("arms", metal, bar((-0.1 * d.hx, y, seat), (-0.1 * d.hx, y, seat + 0.2 * d.Z), 0.04, 0.025))
            d.cushion(
                "arms",
                d.pick(DARKS),
                (-0.5 * d.hx, 0.4 * d.hx),
                (y - 0.07 * d.hy, y + 0.07 * d.hy),
                (seat + 0.2 * d.Z, seat + 0.23 * d.Z),
                0.01,
            )


@category("armchair", (0.82, 0.8, 0.84), "sofa chair", "recliner", "recliner chair", "easy chair", "lounge chair")
def armchair(d: Draft) -> None:
    """One upholstered seat between arms."""
    _upholstered(d, 1)


@category("sofa", (0.9, 2.0, 0.82), "couch", "loveseat", "settee", "futon")
def sofa(d: Draft) -> None:
    """Two or three upholstered seats between arms."""
    _upholstered(d, max(2, min(4, round(d.Y / 0.7))))


def _upholstered(d: Draft, seats: int) -> None:
    """Base, back, arms and loose cushions for a number of seats."""
    kind = d.one_of("block", "rolled", "slim")
    cloth = d.main(FABRICS + LEATHERS)
    foot = 0.06 * d.Z if kind == "block" else 0.14 * d.Z
    arm = min({"block": 0.2, "rolled": 0.18, "slim": 0.1}[kind], 0.16 * d.Y if seats == 1 else 0.2 * d.Y)
    back = min(0.2, 0.26 * d.X)
    seat, arm_top = 0.5 * d.Z, (0.7 if kind != "slim" else 0.66) * d.Z
    plinth = 0.32 * d.Z
    for x, y in d.corners(0.05):
        d.leg("feet", d.pick(WOODS), (x, y), (x, y), (0, foot + 0.01), 0.05, 0.7)
    d.cushion("base", cloth, (-d.hx, d.hx - 0.01), (-d.hy + 0.02, d.hy - 0.02), (foot, plinth), 0.02)
    d.cushion("back", cloth, (-d.hx, -d.hx + back), (-d.hy + 0.5 * arm, d.hy - 0.5 * arm), (foot, 0.97 * d.Z), 0.05)
    for s in (-1, 1):
        y0, y1 = sorted((s * d.hy, s * (d.hy - arm)))
        d.cushion("arms", cloth, (-d.hx, d.hx), (y0, y1), (foot, arm_top), 0.03)
        if kind == "rolled":
            roll = cylinder(0.55 * arm, (-d.hx + 0.01, d.hx - 0.005), 14).turned("y", np.pi / 2)
            d.add("arms", cloth, roll.at(0, s * (d.hy - 0.55 * arm), arm_top - 0.25 * arm))
    width = (d.Y - 2 * arm) / seats
    pad = shade(cloth, 1.08)
    for i in range(seats):
        y0 = -d.hy + arm + i * width
        d.cushion("seat cushions", pad, (-d.hx + 0.9 * back, d.hx), (y0 + 0.004, y0 + width - 0.004), (plinth, seat), 0.04)
        loose = cushion((0, 0.85 * back), (y0 + 0.008, y0 + width - 0.008), (0, d.Z - seat), 0.06)
        d.add("back cushions", pad, loose.turned("y", -0.14).at(-d.hx + back, 0, seat))


@category("stool", (0.36, 0.36, 0.46), "step stool", "foot stool")
def stool(d: Draft) -> None:
    """A round or square seat on legs."""
    kind = d.one_of("round", "square")
    wood = d.main(WOODS + PLASTICS[:3])
    top = min(0.04, 0.12 * d.Z)
    r = min(d.hx, d.hy)
    if kind == "round":
        d.add("seat", wood, turned_body([(0.95 * r, d.Z - top), (r, d.Z - 0.5 * top), (0.95 * r, d.Z)]))
        spots = [(0.72 * r * np.cos(a), 0.72 * r * np.sin(a)) for a in np.pi / 4 + np.arange(4) * np.pi / 2]
    else:
        d.cushion("seat", wood, (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - top, d.Z), 0.3 * top)
        spots = d.corners(0.045)
    for x, y in spots:
        d.leg("legs", wood, (1.15 * x, 1.15 * y) if kind == "round" else (x, y), (0.8 * x, 0.8 * y), (0, d.Z - top), 0.035)
    d.box("legs", wood, (-0.7 * r, 0.7 * r), (-0.012, 0.012), (0.3 * d.Z, 0.3 * d.Z + 0.025))
    d.box("legs", wood, (-0.012, 0.012), (-0.7 * r, 0.7 * r), (0.3 * d.Z, 0.3 * d.Z + 0.025))


@category("bar stool", (0.42, 0.42, 0.76))
def bar_stool(d: Draft) -> None:
    """A disc foot or four legs, a foot ring and a small padded seat."""
    metal, cloth = d.pick(METALS), d.main(LEATHERS + FABRICS)
    r = min(d.hx, d.hy)
    pad = min(0.07, 0.12 * d.Z)
    d.add("seat", cloth, turned_body([(0.82 * r, d.Z - pad), (0.9 * r, d.Z - 0.5 * pad), (0.82 * r, d.Z - 0.15 * pad), (0.6 * r, d.Z)]))
    if d.one_of("disc", "legged") == "disc":
        d.add("foot", metal, turned_body([(r, 0), (r, 0.012), (0.15 * r, 0.035 + 0.01 * d.Z)]))
        d.round_leg("foot", metal, 0, 0, (0.01, d.Z - pad), 0.12 * r)
    else:
        for x, y in d.corners(0.02):
            d.leg("legs", metal, (x, y), (0.5 * x, 0.5 * y), (0, d.Z - pad), 0.028)
    angle = np.linspace(0, 2 * np.pi, 17)
    ring = np.column_stack([0.7 * r * np.cos(angle), 0.7 * r * np.sin(angle), np.full(17, 0.3 * d.Z)])
    d.add("foot ring", metal, sweep(ring, 0.02, 0.02, 6, run=2))


@category("bench", (0.4, 1.2, 0.46), "piano bench", "stool bench")
def bench(d: Draft) -> None:
    """A long plank on two trestles or four legs, sometimes padded."""
    kind = d.one_of("plank", "padded", "trestle")
    wood = d.main(WOODS)
    top = min(0.05, 0.12 * d.Z)
    d.box("seat", wood, (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - (2 if kind == "padded" else 1) * top, d.Z - (top if kind == "padded" else 0)))
    if kind == "padded":
        d.cushion("pad", d.pick(FABRICS), (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - top, d.Z), 0.4 * top)
    if kind == "trestle":
        for s in (-1, 1):
            y = s * 0.8 * d.hy
            d.add(
                "legs",
                wood,
                wedge(((-0.9 * d.hx, 0.9 * d.hx), (y - 0.02, y + 0.02)), ((-0.7 * d.hx, 0.7 * d.hx), (y - 0.02, y + 0.02)), (0, d.Z - top)),
            )
        d.box("legs", wood, (-0.02, 0.02), (-0.8 * d.hy, 0.8 * d.hy), (0.35 * d.Z, 0.35 * d.Z + 0.06))
        return
    for x, y in d.corners(0.05):
        d.leg("legs", wood, (x, y), (x, y), (0, d.Z - top), 0.05, 0.8)
    d.box("apron", wood, (-d.hx + 0.05, d.hx - 0.05), (-d.hy + 0.05, d.hy - 0.05), (d.Z - 2.6 * top, d.Z - top))


@category("ottoman", (0.55, 0.6, 0.42), "pouf", "bean bag", "bean bag chair")
def ottoman(d: Draft) -> None:
    """A padded block on short feet, or a round pouf."""
    cloth = d.main(FABRICS + LEATHERS)
    foot = 0.14 * d.Z
    if d.one_of("block", "round") == "round":
        r, stretch = d.hx, d.Y / d.X
        profile = [(0.86 * r, 0.0), (r, 0.3 * d.Z), (r, 0.7 * d.Z), (0.9 * r, 0.94 * d.Z), (0.6 * r, d.Z)]
        d.add("body", cloth, turned_body(profile, stretch=stretch))
        return
    d.cushion("body", cloth, (-d.hx, d.hx), (-d.hy, d.hy), (foot, 0.72 * d.Z), 0.02)
    d.cushion("top", shade(cloth, 1.08), (-d.hx, d.hx), (-d.hy, d.hy), (0.72 * d.Z, d.Z), 0.05)
    for x, y in d.corners(0.06):
        d.add("feet", d.pick(WOODS), box((x - 0.02, x + 0.02), (y - 0.02, y + 0.02), (0, foot)))
