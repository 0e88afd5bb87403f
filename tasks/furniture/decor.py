"""What makes a room lived in: pictures, plants, books, cloth, toys, bags. Pictures and clocks look to +x."""

from __future__ import annotations

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import (
    CLAYS,
    COVERS,
    DARKS,
    FABRICS,
    GREENS,
    LEATHERS,
    LINENS,
    METALS,
    PAPER,
    PLASTICS,
    WHITES,
    WOODS,
    Color,
    mix,
    shade,
)  # fmt: skip
from tasks.furniture.solids import Solid, bar, cushion, cylinder, ellipsoid, rounded_square, sweep, turned_body, vessel, wedge


def _frame(d: Draft, color: Color, width: float, front: float) -> None:
    """Four bars around the wall side."""
    d.box("frame", color, (-d.hx, front), (-d.hy, -d.hy + width), (0, d.Z))
    d.box("frame", color, (-d.hx, front), (d.hy - width, d.hy), (0, d.Z))
    d.box("frame", color, (-d.hx, front), (-d.hy + width, d.hy - width), (0, width))
    d.box("frame", color, (-d.hx, front), (-d.hy + width, d.hy - width), (d.Z - width, d.Z))


@category(
    "picture",
    (0.03, 0.6, 0.45),
    "picture frame",
    "painting",
    "poster",
    "photo",
    "photo frame",
    "portrait",
    "calendar",
    "sign",
    "map",
    free=True,
)
def picture(d: Draft) -> None:
    """A frame with a mat and a painted scene: hills, blocks, or a still life."""
    kind = d.one_of("landscape", "abstract", "portrait")
    if 1.5 * min(d.Y, d.Z) < d.X:  # lying or very deep: a plain block with a printed top
        d.box("block", d.main(COVERS), (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z))
        return
    width = min(0.035, 0.1 * d.Y, 0.1 * d.Z)
    _frame(d, d.main(WOODS + DARKS[:1] + WHITES[:1]), width, d.hx)
    d.box("mat", PAPER, (-0.9 * d.hx, 0.1 * d.hx), (-d.hy + width, d.hy - width), (width, d.Z - width))
    rim = 1.9 * width
    y0, y1, z0, z1 = -d.hy + rim, d.hy - rim, rim, d.Z - rim
    wide, high = y1 - y0, z1 - z0

    def patch(color: Color, y: tuple[float, float], z: tuple[float, float], layer: int) -> None:
        front = (0.2 + 0.12 * layer) * d.hx
        d.box("painting", color, (0, front), (y0 + y[0] * wide, y0 + y[1] * wide), (z0 + z[0] * high, z0 + z[1] * high))

    if kind == "landscape":
        patch((150, 186, 214), (0, 1), (0, 1), 0)
        patch(d.pick(GREENS), (0, 1), (0, 0.42), 1)
        patch(mix(d.pick(GREENS), (90, 110, 130), 0.5), (0.1, 0.7), (0.35, 0.62), 1)
        patch((240, 210, 130), (0.7, 0.82), (0.68, 0.84), 2)
    elif kind == "abstract":
        patch(d.pick(LINENS), (0, 1), (0, 1), 0)
        for layer in range(1, 5):
            a, b = d.between(0.05, 0.6), d.between(0.05, 0.6)
            patch(d.pick(COVERS), (a, a + d.between(0.15, 0.4)), (b, b + d.between(0.15, 0.4)), layer)
    else:
        patch(d.pick(FABRICS), (0, 1), (0, 1), 0)
        patch(d.pick(COVERS), (0.2, 0.8), (0, 0.36), 1)
        patch((214, 170, 140), (0.37, 0.63), (0.36, 0.74), 2)
        patch((70, 46, 34), (0.35, 0.65), (0.7, 0.82), 3)


@category("mirror", (0.03, 0.5, 0.9), "wall mirror", free=True)
def mirror(d: Draft) -> None:
    """A light pane in a frame, rectangular or round."""
    frame = d.main(WOODS + METALS + DARKS)
    if d.one_of("framed", "round") == "round" and 0.3 * min(d.Y, d.Z) > d.X:
        stretch = d.Y / d.Z
        for part, color, size, back, front in (("frame", frame, 1.0, -1.0, 0.6), ("pane", (196, 212, 220), 0.92, 0.0, 1.0)):
            disc = turned_body([(size * 0.5 * d.Z, back * d.hx), (size * 0.5 * d.Z, front * d.hx)], stretch=stretch)
            d.add(part, color, disc.turned("y", np.pi / 2).at(0, 0, 0.5 * d.Z))
        return
    width = min(0.04, 0.08 * d.Y, 0.08 * d.Z)
    _frame(d, frame, width, d.hx)
    d.box("pane", (196, 212, 220), (-0.8 * d.hx, 0.5 * d.hx), (-d.hy + width, d.hy - width), (width, d.Z - width))


@category("clock", (0.04, 0.3, 0.3), "wall clock", "alarm clock")
def clock(d: Draft) -> None:
    """A round dial with hands and marks."""
    r, stretch = 0.5 * d.Z, d.Y / d.Z
    rim = d.main(WOODS + DARKS + METALS)
    d.add("case", rim, turned_body([(r, -d.hx), (r, 0.6 * d.hx), (0.94 * r, d.hx)], stretch=stretch).turned("y", np.pi / 2).at(0, 0, r))
    d.add("dial", WHITES[0], turned_body([(0.86 * r, 0), (0.86 * r, 1.02 * d.hx)], stretch=stretch).turned("y", np.pi / 2).at(0, 0, r))
    hour, minute = d.between(0, 2 * np.pi), d.between(0, 2 * np.pi)
    for angle, length, width in ((hour, 0.45, 0.06), (minute, 0.7, 0.04)):
        tip = (1.03 * d.hx, length * d.hy * np.sin(angle), r + length * r * np.cos(angle))
        d.add("hands", (30, 30, 32), bar((1.03 * d.hx, 0, r), tip, width * r, width * r))
    for i in range(12):
        a = i * np.pi / 6
        y, z = 0.76 * d.hy * np.sin(a), r + 0.76 * r * np.cos(a)
        d.box("marks", (60, 60, 62), (0.9 * d.hx, 1.04 * d.hx), (y - 0.02 * r, y + 0.02 * r), (z - 0.04 * r, z + 0.04 * r))


@category("rug", (1.6, 2.3, 0.012), "carpet", "mat", "floor mat", "bath mat", "doormat", "bathmat")
def rug(d: Draft) -> None:
    """A thin cloth on the floor with a border and stripes, or an oval one."""
    color, border = d.main(FABRICS + LINENS), d.pick(FABRICS)
    if d.one_of("bordered", "oval") == "oval":
        for part, tone, size, z in (("rug", border, 1.0, 0.85), ("field", color, 0.82, 1.0)):
            d.add(part, tone, turned_body([(size * d.hx, 0), (size * d.hx, z * d.Z)], stretch=d.Y / d.X))
        return
    d.box("rug", border, (-d.hx, d.hx), (-d.hy, d.hy), (0, 0.8 * d.Z))
    d.box("field", color, (-0.84 * d.hx, 0.84 * d.hx), (-0.88 * d.hy, 0.88 * d.hy), (0, 0.9 * d.Z))
    for i in range(5):
        y = (-0.7 + 0.35 * i) * d.hy
        d.box("stripes", shade(color, 0.8), (-0.78 * d.hx, 0.78 * d.hx), (y - 0.03 * d.hy, y + 0.03 * d.hy), (0, d.Z))


@category("plant", (0.5, 0.5, 0.9), "potted plant", "house plant", "flower", "flowers", "flower pot", "plants", "flowerpot")
def plant(d: Draft) -> None:
    """A pot with long leaves, a leafy crown on a stem, or a bush."""
    kind = d.one_of("palm", "tree", "bush")
    green, clay = d.main(GREENS), d.pick(CLAYS)
    high = min(0.32 * d.Z, 0.3) if d.Z > 0.3 else 0.45 * d.Z
    r = min(0.5 * min(d.hx, d.hy), 0.75 * high)
    d.add("pot", clay, vessel([(0.72 * r, 0), (0.95 * r, 0.85 * high), (r, 0.85 * high), (r, high)], 0.1 * r, 0.1 * high))
    d.add("soil", (70, 52, 40), cylinder(0.8 * r, (0.5 * high, 0.84 * high)))
    if kind == "tree":
        d.add("stem", (110, 84, 60), bar((0, 0, 0.5 * high), (0.03 * d.hx, 0, 0.75 * d.Z), 0.05 * r + 0.012, 0.05 * r + 0.012, 8))
    count = 14 if kind == "palm" else 18
    for i in range(count):
        angle = 2.39996 * i  # the golden angle spreads leaves as plants do
        t = (i + 0.5) / count
        if kind == "palm":
            base, reach = (0.1 * r, 0.75 * high), 0.6 + 0.4 * (1 - t)
            _leaf(d, green, angle, base, reach, 0.4 + 0.6 * t, bend=0.25)
        else:
            low = 0.55 if kind == "tree" else max(0.32, high / d.Z)
            z = (low + (0.97 - low) * t) * d.Z
            size = np.sin(np.pi * (0.15 + 0.8 * t))
            spread = 0.72 * size
            center = (spread * 0.75 * d.hx * np.cos(angle), spread * 0.75 * d.hy * np.sin(angle), z)
            radii = (0.26 * d.hx, 0.26 * d.hy, 0.07 * d.Z)
            d.add("leaves", shade(green, 0.85 + 0.3 * t), ellipsoid(center, radii, 7, 4))
            if kind == "bush" and i % 3 == 0:
                d.add("stem", shade(green, 0.7), bar((0, 0, 0.8 * high), center, 0.012, 0.012, 5))


def _leaf(d: Draft, green: Color, angle: float, base: tuple[float, float], reach: float, rise: float, bend: float) -> None:
    """One arched blade from the pot outward."""
    c, s = np.cos(angle), np.sin(angle)
    radius = np.hypot(d.hx * c, d.hy * s) / np.hypot(c, s) * reach
    start = np.array([base[0] * c, base[0] * s, base[1]])
    top = base[1] + (d.Z - base[1]) * rise
    middle = np.array([0.5 * radius * c, 0.5 * radius * s, base[1] + 0.8 * (top - base[1])])
    end = np.array([radius * c, radius * s, top - bend * (top - base[1]) * (1 - rise)])
    wide = 0.12 * min(d.hx, d.hy) + 0.01
    blade = sweep([start, middle, end], [0.3 * wide, wide, 0.08 * wide], [0.008, 0.006, 0.004], 4)
    d.add("leaves", shade(green, 0.85 + 0.3 * float(d.rng.random())), blade)


def _book(d: Draft, color: Color, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], spine: str) -> None:
    """A closed book from its spans; thin along the axis it lies on; its spine at that side: `-y` or `+x`."""
    thin = {"-y": 2, "+x": 1}[spine]
    spans = [x, y, z]
    low, high = spans[thin]
    cover = min(0.003, *(0.15 * (b - a) for a, b in spans))
    for a, b in ((low, low + cover), (high - cover, high)):
        sides = [*spans]
        sides[thin] = (a, b)
        d.box("covers", color, sides[0], sides[1], sides[2])
    if spine == "-y":
        d.box("covers", color, x, (y[0], y[0] + cover), (low, high))
        d.box("pages", PAPER, (x[0] + cover, x[1] - cover), (y[0] + cover, y[1] - cover), (low + cover, high - cover))
    else:
        d.box("covers", color, (x[1] - cover, x[1]), (low, high), z)
        d.box("pages", PAPER, (x[0] + cover, x[1] - cover), (low + cover, high - cover), (z[0] + cover, z[1] - cover))


@category("book", (0.24, 0.17, 0.03), "notebook", "magazine", "folder", "binder", "newspaper", free=True)
def book(d: Draft) -> None:
    """A closed book that lies, or stands with its spine to the front."""
    color = d.main(COVERS)
    if d.Y < d.Z:
        d.variant = "standing"
        _book(d, color, (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z), "+x")
    else:
        _book(d, color, (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z), "-y")


@category("book stack", (0.24, 0.3, 0.2), "books", "books stack", "row of books", "stack of books", free=True)
def book_stack(d: Draft) -> None:
    """Books lying on each other, or standing in a row when wide."""
    if d.Y > 1.25 * d.Z:
        d.variant = "row"
        count = max(2, min(16, round(d.Y / 0.032)))
        widths = d.rng.uniform(0.6, 1.4, count)
        edges = -d.hy + d.Y * np.concatenate([[0], np.cumsum(widths) / widths.sum()])
        for i in range(count):
            height = d.Z * (1.0 if i == count // 2 else d.between(0.78, 1.0))
            deep = d.X * (1.0 if i == 0 else d.between(0.8, 1.0))
            span = (float(edges[i]), float(edges[i + 1]) - 0.001)
            _book(d, d.main(COVERS) if i == 0 else d.pick(COVERS), (-d.hx, -d.hx + deep), span, (0, height), "+x")
        return
    d.variant = "pile"
    count = max(2, min(9, round(d.Z / 0.035)))
    edges = np.linspace(0, d.Z, count + 1)
    for i in range(count):
        x, y = d.hx * (1.0 if i == 0 else d.between(0.75, 0.97)), d.hy * (1.0 if i == 0 else d.between(0.75, 0.97))
        shift = d.between(-1, 1) * (d.hy - y)
        _book(
            d, d.main(COVERS) if i == 0 else d.pick(COVERS), (-x, x), (-y + shift, y + shift), (float(edges[i]), float(edges[i + 1])), "-y"
        )


@category("blanket", (1.0, 0.8, 0.12), "quilt", "comforter", "bedding", "bed sheet", "throw")
def blanket(d: Draft) -> None:
    """Folded cloth, layer on layer."""
    color = d.main(LINENS + FABRICS)
    layers = 3
    for i in range(layers):
        z0, z1 = d.Z * i / layers, d.Z * (i + 1) / layers
        x1 = d.hx * (1.0 if i == 0 else d.between(0.88, 0.98))
        d.cushion("folds", shade(color, 1 - 0.05 * (i % 2)), (-d.hx, x1), (-d.hy, d.hy), (z0, z1), 0.45 * (z1 - z0))
    d.cushion("stripe", shade(color, 0.7), (0.4 * d.hx, 0.55 * d.hx), (-d.hy, d.hy), (0.66 * d.Z, d.Z * 1.01), 0.1 * d.Z)


@category("clothes", (0.5, 0.4, 0.12), "shirt", "jacket", "coat", "clothing", "laundry", "hat", "scarf")
def clothes(d: Draft) -> None:
    """A soft heap of a few folded pieces."""
    for i in range(4):
        z0, z1 = d.Z * i / 4, d.Z * (i + 1.1) / 4
        color = d.main(FABRICS) if i == 0 else d.pick(FABRICS + LINENS)
        part = cushion((-0.95 * d.hx, 0.95 * d.hx), (-0.9 * d.hy, 0.9 * d.hy), (z0, min(z1, d.Z)), 0.12 * d.Z)
        d.add("cloth", color, part.turned("z", d.between(-0.15, 0.15)) if i else part)


@category("ball", (0.22, 0.22, 0.22), "exercise ball", "basketball", "soccer ball", "toy ball", "globe")
def ball(d: Draft) -> None:
    """A ball with two seams."""
    color = d.main(PLASTICS + COVERS)
    d.add("ball", color, ellipsoid((0, 0, 0.5 * d.Z), (d.hx, d.hy, 0.5 * d.Z), 20, 14))
    for axis in ("x", "y"):
        seam = turned_body([(1.004, -0.02), (1.004, 0.02)]).turned(axis, np.pi / 2)
        d.add("seams", shade(color, 0.6), seam.moved(np.diag([d.hx, d.hy, 0.5 * d.Z, 1.0])).at(0, 0, 0.5 * d.Z))


@category("backpack", (0.2, 0.32, 0.46), "school bag", "rucksack")
def backpack(d: Draft) -> None:
    """A rounded bag with a stiff base, a front pocket, a loop and two straps at its back."""
    color = d.main(FABRICS + PLASTICS)
    d.cushion("bag", color, (-0.6 * d.hx, 0.7 * d.hx), (-d.hy, d.hy), (0, 0.94 * d.Z), 0.3 * d.X)
    d.box("base", shade(color, 0.6), (-0.55 * d.hx, 0.8 * d.hx), (-0.85 * d.hy, 0.85 * d.hy), (0, 0.03 * d.Z))  # stiff, so that it stands
    d.cushion("pocket", shade(color, 0.85), (0.3 * d.hx, d.hx), (-0.7 * d.hy, 0.7 * d.hy), (0.06 * d.Z, 0.5 * d.Z), 0.1 * d.X)
    d.box("zip", (40, 40, 42), (0.6 * d.hx, 0.72 * d.hx), (-0.8 * d.hy, 0.8 * d.hy), (0.6 * d.Z, 0.612 * d.Z))
    _loop(d, shade(color, 0.7), 0.25 * d.hy, 0.9 * d.Z, d.Z)
    for s in (-1, 1):
        y = s * 0.5 * d.hy
        strap = [(-0.5 * d.hx, y, 0.85 * d.Z), (-0.95 * d.hx, y, 0.7 * d.Z), (-0.95 * d.hx, y, 0.35 * d.Z), (-0.5 * d.hx, y, 0.1 * d.Z)]
        d.add("straps", shade(color, 0.7), sweep(strap, 0.18 * d.hy, 0.02, 4, up=(0, 1, 0)))


def _loop(d: Draft, color: Color, half: float, low: float, high: float) -> None:
    """A carrying handle over the middle."""
    t = np.linspace(0, np.pi, 7)
    arch = np.column_stack([np.zeros(7), half * np.cos(t), low + (high - low - 0.006) * np.sin(t)])
    d.add("handle", color, sweep(arch, 0.012, 0.012, 6, up=(1, 0, 0)))


@category("bag", (0.18, 0.4, 0.35), "handbag", "hand bag", "paper bag", "shopping bag", "purse", "briefcase", "plastic bag")
def bag(d: Draft) -> None:
    """A soft or stiff bag with two handles."""
    color = d.main(LEATHERS + FABRICS)
    top = 0.68 * d.Z
    d.add("bag", color, wedge(((-d.hx, d.hx), (-d.hy, d.hy)), ((-0.6 * d.hx, 0.6 * d.hx), (-0.86 * d.hy, 0.86 * d.hy)), (0, top)))
    d.box("rim", shade(color, 0.8), (-0.62 * d.hx, 0.62 * d.hx), (-0.88 * d.hy, 0.88 * d.hy), (0.95 * top, 1.02 * top))
    t = np.linspace(0, np.pi, 9)
    for s in (-1, 1):
        x = s * 0.45 * d.hx
        arch = np.column_stack([np.full(9, x), 0.42 * d.hy * np.cos(t), 0.98 * top + (d.Z - top - 0.002) * np.sin(t)])
        d.add("handles", shade(color, 0.8), sweep(arch, 0.014, 0.014, 6, run=2, up=(1, 0, 0)))


@category("shoe", (0.28, 0.22, 0.11), "shoes", "slippers", "sneakers", "boots")
def shoes(d: Draft) -> None:
    """A pair, toes to the front."""
    color = d.main(LEATHERS + FABRICS + WHITES)
    for s in (-1, 1):
        y = s * 0.52 * d.hy
        half = 0.42 * d.hy
        d.cushion("soles", (230, 228, 222), (-d.hx, d.hx), (y - half, y + half), (0, 0.25 * d.Z), 0.12 * d.Z)
        d.cushion("uppers", color, (-0.96 * d.hx, 0.92 * d.hx), (y - 0.9 * half, y + 0.9 * half), (0.15 * d.Z, 0.6 * d.Z), 0.2 * d.Z)
        d.cushion("uppers", color, (-0.96 * d.hx, -0.05 * d.hx), (y - 0.85 * half, y + 0.85 * half), (0.4 * d.Z, d.Z), 0.15 * d.Z)


@category("stuffed animal", (0.2, 0.26, 0.32), "teddy bear", "toy", "doll")
def teddy(d: Draft) -> None:
    """A sitting bear."""
    color = d.main(((150, 104, 66), (196, 160, 120), (120, 120, 126), (220, 196, 190)))

    def blob(part: str, tone: Color, x: float, y: float, z: float, rx: float, ry: float, rz: float) -> None:
        d.add(part, tone, ellipsoid((x * d.hx, y * d.hy, z * d.Z), (rx * d.hx, ry * d.hy, rz * d.Z), 12, 8))

    blob("body", color, -0.3, 0, 0.3, 0.6, 0.58, 0.3)
    blob("head", color, -0.15, 0, 0.72, 0.55, 0.52, 0.22)
    blob("muzzle", shade(color, 1.3), 0.35, 0, 0.67, 0.25, 0.22, 0.08)
    for s in (-1, 1):
        blob("ears", shade(color, 0.85), -0.2, 0.45 * s, 0.91, 0.15, 0.2, 0.09)
        blob("arms", color, 0.0, 0.72 * s, 0.42, 0.3, 0.27, 0.12)
        blob("legs", color, 0.5, 0.5 * s, 0.12, 0.5, 0.3, 0.12)
        blob("eyes", (30, 26, 24), 0.36, 0.2 * s, 0.77, 0.06, 0.06, 0.025)


@category("dumbbell", (0.14, 0.3, 0.13), "barbell", "weights")
def dumbbell(d: Draft) -> None:
    """A bar between two weights."""
    r = min(d.hx, 0.5 * d.Z)
    d.add("grip", METALS[0], bar((0, -0.6 * d.hy, 0.5 * d.Z), (0, 0.6 * d.hy, 0.5 * d.Z), 0.5 * r, 0.5 * r, 8))
    for s in (-1, 1):
        y0, y1 = sorted((s * 0.5 * d.hy, s * d.hy))
        disc = turned_body([(r, y0), (r, y1)], rounded_square(0.6, 2)).turned("x", -np.pi / 2)
        d.add("weights", d.main(DARKS), disc.at(0, 0, 0.5 * d.Z))


@category("umbrella", (0.12, 0.12, 0.85))
def umbrella(d: Draft) -> None:
    """A closed umbrella standing on its tip."""
    color, r = d.main(FABRICS + DARKS), d.hx
    d.add("cloth", color, turned_body([(0.1 * r, 0.06 * d.Z), (0.75 * r, 0.55 * d.Z), (0.3 * r, 0.74 * d.Z)], stretch=d.Y / d.X))
    d.add("stick", METALS[2], cylinder(0.07 * r, (0, 0.9 * d.Z), 8))
    t = np.linspace(0, np.pi, 7)
    hook = np.column_stack([0.45 * r * (1 - np.cos(t)), np.zeros(7), 0.9 * d.Z + 0.08 * d.Z * np.sin(t)])
    d.add("handle", WOODS[2], sweep(hook, 0.15 * r, 0.15 * r, 6, up=(0, 1, 0)))


@category("tissue box", (0.12, 0.23, 0.1), "tissues", "kleenex box", "paper towel dispenser")
def tissue_box(d: Draft) -> None:
    """A printed box with a tissue out of its slot."""
    color, top = d.main(LINENS + COVERS), 0.74 * d.Z
    d.box("box", color, (-d.hx, d.hx), (-d.hy, d.hy), (0, top))
    d.box("slot", shade(color, 0.6), (-0.2 * d.hx, 0.2 * d.hx), (-0.55 * d.hy, 0.55 * d.hy), (0.95 * top, 1.01 * top))
    sheet = wedge(
        ((-0.05 * d.hx, 0.05 * d.hx), (-0.2 * d.hy, 0.2 * d.hy)), ((-0.35 * d.hx, 0.3 * d.hx), (-0.4 * d.hy, 0.35 * d.hy)), (top, d.Z)
    )
    d.add("tissue", WHITES[0], sheet)


@category("paper", (0.3, 0.21, 0.01), "papers", "envelope", "document", "mail")
def paper(d: Draft) -> None:
    """A few sheets on each other."""
    for i in range(3):
        part: Solid = cushion((-0.94 * d.hx, 0.94 * d.hx), (-0.92 * d.hy, 0.92 * d.hy), (d.Z * i / 3, d.Z * (i + 1) / 3), 0.0001)
        d.add("sheets", d.main(((246, 246, 242),)), part.turned("z", 0.05 * (i - 1)))


@category("sculpture", (0.16, 0.16, 0.3), "statue", "decoration", "ornament", "figurine", "trophy")
def sculpture(d: Draft) -> None:
    """A turned abstract figure on a plinth."""
    color = d.main(METALS + CLAYS)
    d.box("plinth", shade(color, 0.6), (-0.9 * d.hx, 0.9 * d.hx), (-0.9 * d.hy, 0.9 * d.hy), (0, 0.12 * d.Z))
    body = [(0.5, 0.12), (0.75, 0.25), (0.9, 0.4), (0.45, 0.55), (0.25, 0.65), (0.35, 0.72)]
    d.add("figure", color, turned_body([(r * d.hx, z * d.Z) for r, z in body], stretch=d.Y / d.X))
    d.add("figure", color, ellipsoid((0, 0, 0.85 * d.Z), (0.5 * d.hx, 0.5 * d.hy, 0.15 * d.Z), 14, 8))


@category("guitar", (0.12, 0.38, 1.0), "violin", "guitar case")
def guitar(d: Draft) -> None:
    """An upright guitar, strings to the front."""
    wood = d.main(WOODS)
    for z, r in ((0.19, 0.19), (0.38, 0.14)):
        disc = turned_body([(r * d.Z, -d.hx), (r * d.Z, 0.4 * d.hx)], stretch=d.hy / (0.19 * d.Z)).turned("y", np.pi / 2)
        d.add("body", wood, disc.at(0, 0, z * d.Z))
    d.add("hole", (40, 30, 24), cylinder(0.22 * d.hy, (0, 0.5 * d.hx)).turned("y", np.pi / 2).at(0, 0, 0.34 * d.Z))
    d.box("neck", shade(wood, 0.6), (0.1 * d.hx, 0.7 * d.hx), (-0.14 * d.hy, 0.14 * d.hy), (0.4 * d.Z, 0.88 * d.Z))
    d.box("head", shade(wood, 0.6), (-0.3 * d.hx, 0.5 * d.hx), (-0.22 * d.hy, 0.22 * d.hy), (0.87 * d.Z, d.Z))
    d.box("bridge", (40, 30, 24), (0.3 * d.hx, 0.65 * d.hx), (-0.4 * d.hy, 0.4 * d.hy), (0.16 * d.Z, 0.18 * d.Z))
    for i in range(4):
        y = (-0.1 + 0.066 * i) * d.hy
        d.box("strings", (220, 214, 196), (0.6 * d.hx, d.hx), (y, y + 0.012 * d.hy), (0.17 * d.Z, 0.9 * d.Z))
