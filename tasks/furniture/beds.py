"""Beds and what lies on them. The head is at -x, the foot end is the front."""

from __future__ import annotations

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import FABRICS, LINENS, METALS, WHITES, WOODS, Color, shade
from tasks.furniture.solids import Solid, convex, cushion, rounded_square


@category("bed", (2.05, 1.5, 0.95), "double bed", "single bed", "queen bed", "day bed")
def bed(d: Draft) -> None:
    """A frame with a headboard, a mattress, a duvet and pillows."""
    kind = d.one_of("panel", "upholstered", "slatted")
    frame = d.main(FABRICS if kind == "upholstered" else WOODS)
    head = min(0.08, 0.06 * d.X)
    deck, top = 0.3 * d.Z, 0.54 * d.Z
    for x, y in d.corners(0.06):
        d.leg("feet", shade(frame, 0.8), (x, y), (x, y), (0, 0.16 * d.Z), 0.06)
    d.box("frame", frame, (-d.hx + 0.5 * head, d.hx), (-d.hy, d.hy), (0.14 * d.Z, deck))
    if kind == "slatted":
        for s in (-1, 1):
            d.box("headboard", frame, (-d.hx, -d.hx + head), sorted_span(s * d.hy, s * (d.hy - 0.06)), (0, d.Z))
        for z in (0.58, 0.72, 0.86):
            d.box("headboard", frame, (-d.hx + 0.2 * head, -d.hx + 0.8 * head), (-d.hy, d.hy), (z * d.Z, (z + 0.09) * d.Z))
    elif kind == "upholstered":
        d.cushion("headboard", frame, (-d.hx, -d.hx + head), (-d.hy, d.hy), (0.1 * d.Z, d.Z), 0.4 * head)
    else:
        d.box("headboard", frame, (-d.hx, -d.hx + head), (-d.hy, d.hy), (0, d.Z))
    linen = d.pick(LINENS)
    _bedding(d, (-d.hx + head, d.hx - 0.02), (-d.hy + 0.02, d.hy - 0.02), deck, top, linen)


def sorted_span(a: float, b: float) -> tuple[float, float]:
    """The span between two coordinates [m]."""
    return (a, b) if a < b else (b, a)


def _bedding(d: Draft, x: tuple[float, float], y: tuple[float, float], deck: float, top: float, linen: Color) -> None:
    """Mattress from `deck` to near `top`, a duvet over the foot part, one or two pillows at the head."""
    long, wide, thick = x[1] - x[0], y[1] - y[0], top - deck
    d.cushion("mattress", d.pick(WHITES), x, y, (deck, deck + 0.85 * thick), 0.25 * thick)
    drape = min(0.02, 0.02 * wide)
    d.cushion("duvet", linen, (x[0] + 0.34 * long, x[1] + drape), (y[0] - drape, y[1] + drape), (deck + 0.3 * thick, top), 0.18 * thick)
    d.cushion(
        "duvet fold",
        shade(linen, 1.1),
        (x[0] + 0.27 * long, x[0] + 0.4 * long),
        (y[0] - drape, y[1] + drape),
        (deck + 0.4 * thick, top + 0.02),
        0.15 * thick,
    )
    count = 2 if wide > 1.2 else 1
    for i in range(count):
        center = y[0] + wide * (i + 0.5) / count
        half = 0.44 * wide / count if count == 2 else 0.4 * wide
        pillow = cushion((0, 0.19 * long), (center - half, center + half), (0, 0.14), 0.07)
        d.add("pillows", d.pick(WHITES), pillow.turned("y", 0.12).at(x[0] + 0.03 * long, 0, top - 0.06))


@category("bunk bed", (2.0, 1.0, 1.65))
def bunk_bed(d: Draft) -> None:
    """Two berths above each other, with a ladder."""
    wood = d.main(WOODS + METALS[:2])
    post = min(0.07, 0.1 * d.Y)
    for x, y in d.corners(0.5 * post):
        d.leg("posts", wood, (x, y), (x, y), (0, d.Z), post)
    for low in (0.16 * d.Z, 0.66 * d.Z):
        d.box("frame", wood, (-d.hx + post, d.hx - post), (-d.hy + 0.01, d.hy - 0.01), (low, low + 0.06 * d.Z))
        d.cushion(
            "mattress", d.pick(WHITES), (-d.hx + post, d.hx - post), (-d.hy + 0.03, d.hy - 0.03), (low + 0.06 * d.Z, low + 0.13 * d.Z), 0.04
        )
        duvet = (low + 0.08 * d.Z, low + 0.15 * d.Z)
        d.cushion("duvet", d.pick(LINENS), (-0.3 * d.hx, d.hx - post), (-d.hy + 0.02, d.hy - 0.02), duvet, 0.04)
        d.cushion(
            "pillow", d.pick(WHITES), (-0.9 * d.hx, -0.6 * d.hx), (-0.7 * d.hy, 0.7 * d.hy), (low + 0.12 * d.Z, low + 0.18 * d.Z), 0.05
        )
        for x in (-d.hx + 0.3 * post, d.hx - 0.7 * post):
            d.box("rails", wood, (x, x + 0.4 * post), (-d.hy + post, d.hy - post), (low + 0.18 * d.Z, low + 0.26 * d.Z))
    for s in (-1, 1):
        edge = sorted_span(s * d.hy, s * (d.hy - 0.03))
        d.box("rails", wood, (-d.hx + post, (0.3 if s > 0 else 1) * (d.hx - post)), edge, (0.86 * d.Z, 0.92 * d.Z))
    for i in range(5):
        z = (0.14 + 0.14 * i) * d.Z
        d.box("ladder", wood, (0.52 * d.hx, 0.82 * d.hx), (d.hy - 0.03, d.hy), (z, z + 0.03))
    for x in (0.5, 0.8):
        d.box("ladder", wood, (x * d.hx, x * d.hx + 0.04), (d.hy - 0.03, d.hy), (0, 0.92 * d.Z))


@category("crib", (1.25, 0.7, 0.95), "cot", "baby bed")
def crib(d: Draft) -> None:
    """A small mattress inside four barred sides."""
    wood = d.main(WOODS[3:5] + WHITES)
    post = min(0.05, 0.1 * d.Y)
    for x, y in d.corners(0.5 * post):
        d.leg("posts", wood, (x, y), (x, y), (0, d.Z), post)
    for z in (0.3, 0.93):
        for s in (-1, 1):
            d.box("rails", wood, (-d.hx + post, d.hx - post), sorted_span(s * d.hy, s * (d.hy - 0.5 * post)), (z * d.Z, (z + 0.05) * d.Z))
            d.box("rails", wood, sorted_span(s * d.hx, s * (d.hx - 0.5 * post)), (-d.hy + post, d.hy - post), (z * d.Z, (z + 0.05) * d.Z))
    count = max(4, round(d.X / 0.11))
    for i in range(1, count):
        x = -d.hx + d.X * i / count
        for s in (-1, 1):
            d.round_leg("bars", wood, x, s * (d.hy - 0.25 * post), (0.33 * d.Z, 0.94 * d.Z), 0.008)
    for i in range(1, max(3, count // 2)):
        y = -d.hy + d.Y * i / max(3, count // 2)
        for s in (-1, 1):
            d.round_leg("bars", wood, s * (d.hx - 0.25 * post), y, (0.33 * d.Z, 0.94 * d.Z), 0.008)
    inner = 0.5 * post + 0.005
    d.cushion("mattress", d.pick(WHITES), (-d.hx + inner, d.hx - inner), (-d.hy + inner, d.hy - inner), (0.3 * d.Z, 0.42 * d.Z), 0.03)
    d.cushion("blanket", d.pick(LINENS), (-0.1 * d.hx, 0.85 * d.hx), (-0.8 * d.hy, 0.8 * d.hy), (0.38 * d.Z, 0.45 * d.Z), 0.02)


@category("mattress", (2.0, 1.4, 0.22))
def mattress(d: Draft) -> None:
    """A rounded block with piping around its edges."""
    cloth = d.main(WHITES + LINENS[:1])
    d.cushion("body", cloth, (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z), 0.3 * d.Z)
    for z in (0.2, 0.76):
        d.cushion("piping", shade(cloth, 0.8), (-d.hx, d.hx), (-d.hy, d.hy), (z * d.Z, (z + 0.04) * d.Z), 0.018 * d.Z)


@category("pillow", (0.14, 0.5, 0.36), "cushion", "throw pillow", "couch pillow", free=True)
def pillow(d: Draft) -> None:
    """A filled square of cloth, thick in the middle; standing or lying, as its extents have it."""
    d.add("pillow", d.main(LINENS + FABRICS + WHITES), _filled(d))


def _filled(d: Draft) -> Solid:
    """A lens over a rounded square, its short axis along the shortest extent."""
    sides = np.array([d.X, d.Y, d.Z])
    short = int(sides.argmin())
    section = rounded_square(0.35, 4)
    rings = []
    for t in np.linspace(-1, 1, 9):
        size = (1 - abs(t) ** 3) ** 0.5 if abs(t) < 1 else 0.0
        rings.append(np.column_stack([section * size, np.full(len(section), t)]))
    # the lens's axis goes to the shortest side, the two others stay in cyclic order so that nothing is mirrored
    order = [(short + 1) % 3, (short + 2) % 3, short]
    stack = np.empty((9, len(section), 3))
    stack[..., order] = 0.5 * np.array(rings) * sides[order]
    return convex(stack + np.array([0, 0, 0.5 * d.Z]))
