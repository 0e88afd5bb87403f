"""Objects that hold other objects: shelves, cupboards, drawers, boxes. The front is +x."""

from __future__ import annotations

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import CARTONS, FABRICS, LEATHERS, METALS, PAINTS, PLASTICS, WHITES, WOODS, Color, shade
from tasks.furniture.solids import band, bar, square, sweep, vessel

BOARD_M = 0.022
"""Usual board of a shelf."""

FRONTED = ("cabinet", "kitchen cabinet", "wardrobe", "dresser", "nightstand", "tv stand", "file cabinet")
"""Categories whose fronts have drawers or doors."""


def shelf_levels(extents: tuple[float, float, float]) -> list[float]:
    """Heights of the tops of the boards of a bookshelf or shelf with these extents [m], from the lowest, without the top."""
    count = max(2, round(extents[2] / 0.36))
    foot = min(0.06, 0.05 * extents[2])
    board = min(BOARD_M, 0.04 * extents[2])
    usable = extents[2] - foot - board
    return [foot + board + usable * i / count for i in range(count)]


@category("bookshelf", (0.32, 0.9, 1.8), "bookcase", "book shelf", "book case")
def bookshelf(d: Draft) -> None:
    """An open case of boards with a back."""
    wood = d.main(WOODS + PAINTS[:1])
    _case(d, wood, back=True)


@category("shelf", (0.35, 0.9, 1.5), "shelves", "rack", "storage shelf", "display shelf", "storage rack", "spice rack", free=True)
def shelf(d: Draft) -> None:
    """Boards between metal posts, a backless case, or a single board on brackets when it is flat."""
    if d.Z < 0.35 * d.Y and d.Z < 0.4:
        wood, metal = d.main(WOODS + WHITES), d.pick(METALS)
        board = min(0.03, 0.4 * d.Z)
        d.variant = "wall"
        d.box("board", wood, (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - board, d.Z))
        for s in (-1, 1):
            y = s * 0.6 * d.hy
            d.box("brackets", metal, (-d.hx, -d.hx + 0.015), (y - 0.015, y + 0.015), (0, d.Z - board))
            d.add("brackets", metal, bar((-d.hx + 0.01, y, 0.02 * d.Z), (0.8 * d.hx, y, d.Z - board), 0.02, 0.01))
        return
    if d.one_of("case", "posts") == "case":
        _case(d, d.main(WOODS + PAINTS[:2]), back=False)
        return
    wood, metal = d.main(WOODS + METALS), d.pick(METALS)
    post = min(0.03, 0.1 * d.X)
    for x, y in d.corners(0.5 * post):
        d.leg("posts", metal, (x, y), (x, y), (0, d.Z), post)
    board = min(BOARD_M, 0.04 * d.Z)
    for level in [*shelf_levels((d.X, d.Y, d.Z)), d.Z]:
        d.box("boards", wood, (-d.hx, d.hx), (-d.hy, d.hy), (level - board, level))


def _case(d: Draft, wood: Color, back: bool) -> None:
    side, board = min(BOARD_M, 0.06 * d.Y), min(BOARD_M, 0.04 * d.Z)
    for s in (-1, 1):
        y0, y1 = sorted((s * d.hy, s * (d.hy - side)))
        d.box("sides", wood, (-d.hx, d.hx), (y0, y1), (0, d.Z))
    levels = shelf_levels((d.X, d.Y, d.Z))
    for level in [*levels, d.Z]:
        d.box("boards", wood, (-d.hx, d.hx - 0.004), (-d.hy + side, d.hy - side), (level - board, level))
    d.box("plinth", shade(wood, 0.9), (-d.hx, d.hx - min(0.02, 0.1 * d.X)), (-d.hy + side, d.hy - side), (0, levels[0] - board))
    if back:
        d.box("back", shade(wood, 0.88), (-d.hx, -d.hx + 0.008), (-d.hy + side, d.hy - side), (levels[0], d.Z - board))


def _fronts(d: Draft, body: Color, rows: int, columns: int, z: tuple[float, float], knob: str) -> None:
    """Doors or drawers in a grid on the front of a body that ends 2 cm plus a handle before the front; one panel of a plain front."""
    if d.has_plain_front:
        d.box("fronts", body, (d.hx - min(0.04, 0.1 * d.X), d.hx), (-d.hy, d.hy), z)
        return
    face, grip = d.hx - min(0.04, 0.1 * d.X), min(0.02, 0.05 * d.X)
    metal = d.pick(METALS)
    high, wide = (z[1] - z[0]) / rows, d.Y / columns
    gap = min(0.004, 0.05 * high)
    for r in range(rows):
        for c in range(columns):
            y0, y1 = -d.hy + c * wide + gap, -d.hy + (c + 1) * wide - gap
            z0, z1 = z[0] + r * high + gap, z[0] + (r + 1) * high - gap
            d.box("fronts", shade(body, 1.06), (face, d.hx - grip), (y0, y1), (z0, z1))
            if knob == "bar":
                middle, half = 0.5 * (y0 + y1), min(0.08, 0.25 * wide)
                d.box(
                    "handles",
                    metal,
                    (d.hx - grip, d.hx),
                    (middle - half, middle + half),
                    (z0 + 0.6 * (z1 - z0), z0 + 0.6 * (z1 - z0) + 0.012),
                )
            elif knob == "knob":
                middle, half = 0.5 * (y0 + y1), min(0.014, 0.1 * wide)
                d.cushion(
                    "handles",
                    metal,
                    (d.hx - grip, d.hx),
                    (middle - half, middle + half),
                    (0.5 * (z0 + z1) - half, 0.5 * (z0 + z1) + half),
                    0.005,
                )
            else:  # upright grips at the meeting edge of doors
                y = y1 - 0.04 * wide - 0.02 if c % 2 == 0 else y0 + 0.04 * wide + 0.008
                middle, half = 0.5 * (z0 + z1), min(0.1, 0.2 * (z1 - z0))
                d.box("handles", metal, (d.hx - grip, d.hx), (y, y + 0.012), (middle - half, middle + half))


def _body(d: Draft, color: Color, foot: str) -> float:
    """A closed body on legs or a plinth; returns the height of its bottom [m]."""
    face = d.hx - min(0.04, 0.1 * d.X)
    low = {"legs": min(0.14, 0.2 * d.Z), "plinth": min(0.07, 0.1 * d.Z)}[foot]
    if foot == "legs":
        for x, y in d.corners(0.05):
            d.leg("legs", shade(color, 0.75), (x, y), (x, y), (0, low), min(0.05, 0.2 * d.X), 0.6)
    else:
        d.box("plinth", shade(color, 0.7), (-d.hx, face - 0.02), (-d.hy + 0.01, d.hy - 0.01), (0, low))
    d.box("body", color, (-d.hx, face), (-d.hy, d.hy), (low, d.Z - 0.02))
    d.box("top", shade(color, 1.03), (-d.hx, d.hx - min(0.02, 0.05 * d.X)), (-d.hy, d.hy), (d.Z - 0.02, d.Z))
    return low


@category("cabinet", (0.42, 0.9, 0.95), "cupboard", "sideboard", "storage cabinet", "chest", "credenza", "buffet", "closet shelf")
def cabinet(d: Draft) -> None:
    """A closed body with doors."""
    kind = d.one_of("legs", "plinth")
    color = d.main(WOODS + PAINTS)
    low = _body(d, color, kind)
    _fronts(d, color, 1, max(1, round(d.Y / 0.45)), (low, d.Z - 0.02), "grip")


@category("kitchen cabinet", (0.36, 1.0, 0.7), "wall cabinet", "bathroom cabinet", "medicine cabinet", "bathroom vanity")
def kitchen_cabinet(d: Draft) -> None:
    """A wall cupboard: doors, no feet."""
    color = d.main(PAINTS + WOODS[3:5])
    d.box("body", color, (-d.hx, d.hx - min(0.04, 0.1 * d.X)), (-d.hy, d.hy), (0, d.Z))
    _fronts(d, color, 1, max(1, round(d.Y / 0.5)), (0, d.Z), d.one_of("grip", "knob"))


@category("wardrobe", (0.6, 1.2, 2.0), "closet", "armoire")
def wardrobe(d: Draft) -> None:
    """Tall doors, sometimes above drawers."""
    color = d.main(WOODS + PAINTS[:2])
    low = _body(d, color, "plinth")
    columns = max(2, round(d.Y / 0.55))
    if d.one_of("doors", "drawers below") == "doors":
        _fronts(d, color, 1, columns, (low, d.Z - 0.02), "grip")
        return
    split = low + 0.22 * (d.Z - low)
    _fronts(d, color, 1, max(1, columns // 2), (low, split), "bar")
    _fronts(d, color, 1, columns, (split, d.Z - 0.02), "grip")


@category("dresser", (0.46, 1.1, 0.85), "drawer", "chest of drawers", "commode")
def dresser(d: Draft) -> None:
    """Rows of drawers on legs or a plinth."""
    color = d.main(WOODS + PAINTS[:2])
    low = _body(d, color, d.one_of("legs", "plinth"))
    _fronts(d, color, max(2, round((d.Z - low) / 0.22)), max(1, round(d.Y / 0.7)), (low, d.Z - 0.02), d.one_of("bar", "knob"))


@category("nightstand", (0.4, 0.45, 0.52), "night stand", "bedside table")
def nightstand(d: Draft) -> None:
    """One or two drawers on legs, or a drawer over an open compartment."""
    color = d.main(WOODS + PAINTS[:2])
    if d.one_of("drawers", "open") == "drawers":
        low = _body(d, color, "legs")
        _fronts(d, color, 2, 1, (low, d.Z - 0.02), "knob")
        return
    side, face, split = 0.02, d.hx - 0.04, 0.62 * d.Z
    for s in (-1, 1):
        y0, y1 = sorted((s * d.hy, s * (d.hy - side)))
        d.box("sides", color, (-d.hx, face), (y0, y1), (0, split))
    d.box("back", shade(color, 0.9), (-d.hx, -d.hx + 0.01), (-d.hy + side, d.hy - side), (0.08 * d.Z, split))
    d.box("board", color, (-d.hx, face), (-d.hy + side, d.hy - side), (0.08 * d.Z, 0.08 * d.Z + side))
    d.box("body", color, (-d.hx, face), (-d.hy, d.hy), (split, d.Z - 0.02))
    d.box("top", color, (-d.hx, d.hx - 0.015), (-d.hy, d.hy), (d.Z - 0.02, d.Z))
    _fronts(d, color, 1, 1, (split, d.Z - 0.02), "bar")


@category("tv stand", (0.42, 1.4, 0.5), "media console", "tv cabinet", "entertainment center", "tv console")
def tv_stand(d: Draft) -> None:
    """Low: doors left and right, open compartments in the middle."""
    color = d.main(WOODS + PAINTS[:3])
    low, face, board = min(0.1, 0.2 * d.Z), d.hx - 0.04, 0.02
    third = d.Y / 3
    for x, y in d.corners(0.06):
        d.leg("legs", shade(color, 0.75), (x, y), (x, y), (0, low), 0.04, 0.6)
    d.box("top", color, (-d.hx, d.hx - 0.015), (-d.hy, d.hy), (d.Z - board, d.Z))
    for s in (-1, 1):
        y0, y1 = sorted((s * d.hy, s * 0.5 * third))
        d.box("body", color, (-d.hx, face), (y0, y1), (low, d.Z - board))
        d.box("fronts", shade(color, 1.07), (face, d.hx - 0.015), (y0 + 0.004, y1 - 0.004), (low + 0.004, d.Z - board - 0.004))
        if d.has_plain_front:
            continue
        middle = 0.5 * (y0 + y1)
        d.box("handles", d.pick(METALS), (d.hx - 0.015, d.hx), (middle - 0.05, middle + 0.05), (d.Z - 0.09, d.Z - 0.08))
    for z in (low, 0.5 * (low + d.Z)):
        d.box("boards", color, (-d.hx, face), (-0.5 * third, 0.5 * third), (z, z + board))
    d.box("back", shade(color, 0.8), (-d.hx, -d.hx + 0.008), (-0.5 * third, 0.5 * third), (low, d.Z - board))


@category("file cabinet", (0.6, 0.42, 1.0), "filing cabinet")
def file_cabinet(d: Draft) -> None:
    """A metal body with deep drawers."""
    color = d.main(METALS + PAINTS[2:4])
    d.box("body", color, (-d.hx, d.hx - min(0.04, 0.1 * d.X)), (-d.hy, d.hy), (0, d.Z))
    _fronts(d, color, max(2, round(d.Z / 0.33)), 1, (0.01, d.Z - 0.01), "bar")


@category("box", (0.3, 0.4, 0.28), "cardboard box", "carton", "package", free=True)
def carton(d: Draft) -> None:
    """A closed carton with tape, or an open one with its flaps out."""
    color = d.main(CARTONS)
    if d.one_of("closed", "open") == "closed" or d.Z < 0.1:
        d.box("box", color, (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z * 0.995))
        d.box("tape", (206, 190, 150), (-0.12 * d.X, 0.12 * d.X), (-d.hy, d.hy), (0.7 * d.Z, d.Z))
        d.box("label", (240, 238, 230), (0.5 * d.hx, d.hx * 1.002), (-0.5 * d.hy, 0.1 * d.hy), (0.3 * d.Z, 0.6 * d.Z))
        return
    x, y, top = 0.8 * d.hx, 0.8 * d.hy, 0.94 * d.Z
    d.add("box", color, vessel([(x, 0), (x, top)], 0.008, 0.008, square(), y / x, 4))
    for s in (-1, 1):
        d.add("flaps", shade(color, 1.05), bar((s * (x - 0.004), 0, top), (s * d.hx, 0, d.Z), 2 * y, 0.006))
        d.add("flaps", shade(color, 1.05), bar((0, s * (y - 0.004), top), (0, s * d.hy, 0.98 * d.Z), 2 * x, 0.006))


@category("storage bin", (0.4, 0.55, 0.3), "container", "storage container", "crate", "plastic bin", "plastic box", "bin", "toolbox")
def storage_bin(d: Draft) -> None:
    """A tapered tub, with a lid or without."""
    color = d.main(PLASTICS)
    r, stretch = d.hx, d.Y / d.X
    lid = d.one_of("lidded", "open") == "lidded"
    top = 0.88 * d.Z if lid else d.Z
    body = [(0.84 * r, 0), (0.97 * r, top - 0.03 * d.Z), (r, top - 0.03 * d.Z), (r, top)]
    d.add("tub", color, vessel(body, min(0.06 * r, 0.012 + 0.03 * r), 0.01, square(), stretch, 4))
    if lid:
        d.cushion("lid", shade(color, 0.8), (-d.hx, d.hx), (-d.hy, d.hy), (top, d.Z), 0.01)


@category("basket", (0.36, 0.36, 0.32), "laundry basket", "laundry hamper", "hamper", "wicker basket")
def basket(d: Draft) -> None:
    """A woven pot: bands of two tones, with two handles."""
    color = d.main(((176, 138, 92), (150, 112, 70), (200, 178, 140)))
    r, stretch, top = 0.96 * d.hx, d.Y / d.X, 0.9 * d.Z
    bands = 4
    for i in range(bands):
        z0, z1 = top * i / bands, top * (i + 1) / bands
        profile = [(r * (0.78 + 0.22 * z / top), z) for z in (z0, z1)]
        wall = vessel(profile, 0.014, 0.014, stretch=stretch) if i == 0 else band(profile, 0.014, stretch=stretch)
        d.add("weave", shade(color, 1.0 if i % 2 else 0.84), wall)
    for s in (-1, 1):
        t = np.linspace(0, np.pi, 9)
        arch = np.column_stack([0.3 * r * np.cos(t), np.full(9, s * 0.99 * r * stretch), top - 0.02 + (d.Z - top + 0.01) * np.sin(t)])
        d.add("handles", shade(color, 0.8), sweep(arch, 0.016, 0.016, 6, run=2, up=(0, 1, 0)))


@category("suitcase", (0.26, 0.46, 0.68), "luggage")
def suitcase(d: Draft) -> None:
    """A ribbed shell on wheels with a handle."""
    color = d.main(PLASTICS + FABRICS)
    d.cushion("shell", color, (-d.hx, d.hx), (-d.hy, d.hy), (0.06 * d.Z, 0.9 * d.Z), 0.3 * d.X)
    for i in range(4):
        y = (-0.6 + 0.4 * i) * d.hy
        d.cushion("ribs", shade(color, 0.85), (-d.hx - 0.004, d.hx + 0.004), (y - 0.012, y + 0.012), (0.14 * d.Z, 0.82 * d.Z), 0.006)
    for x, y in d.corners(0.06):
        d.box("wheels", (30, 30, 32), (x - 0.02, x + 0.02), (y - 0.012, y + 0.012), (0, 0.08 * d.Z))
    for s in (-1, 1):
        d.box(
            "handle", d.pick(METALS), (-0.5 * d.hx, -0.4 * d.hx), (s * 0.3 * d.hy - 0.008, s * 0.3 * d.hy + 0.008), (0.85 * d.Z, 0.98 * d.Z)
        )
    d.box("handle", (40, 40, 42), (-0.55 * d.hx, -0.35 * d.hx), (-0.36 * d.hy, 0.36 * d.hy), (0.97 * d.Z, d.Z))


@category("shoe rack", (0.3, 0.8, 0.5), "shoe shelf")
def shoe_rack(d: Draft) -> None:
    """Rails of bars between two frames."""
    color = d.main(METALS + WOODS)
    post = min(0.025, 0.15 * d.X)
    for x, y in d.corners(0.5 * post):
        d.leg("posts", color, (x, y), (x, y), (0, d.Z), post)
    for level in (0.16, 0.56, 0.96):
        for i in range(4):
            x = -d.hx + post + (d.X - 2 * post) * i / 3
            d.add("rails", color, bar((x, -d.hy, level * d.Z), (x, d.hy, level * d.Z), 0.014, 0.014, 6))


@category("coat rack", (0.45, 0.45, 1.75), "clothing rack", "coat hanger stand")
def coat_rack(d: Draft) -> None:
    """A post on four feet with hooks around its top."""
    color = d.main(WOODS + METALS[1:3])
    r = min(d.hx, d.hy)
    d.round_leg("post", color, 0, 0, (0.04 * d.Z, d.Z), 0.022)
    for i in range(4):
        c, s = np.cos(i * np.pi / 2), np.sin(i * np.pi / 2)
        d.add("feet", color, bar((0.015 * c, 0.015 * s, 0.12 * d.Z), (0.97 * r * c, 0.97 * r * s, 0.012), 0.03, 0.024))
    for i in range(8):
        angle = (i + 0.5) * np.pi / 4
        low = (0.84 if i % 2 else 0.92) * d.Z
        tip = (0.6 * r * np.cos(angle), 0.6 * r * np.sin(angle), low + 0.07 * d.Z)
        d.add("hooks", color, bar((0, 0, low), tip, 0.016, 0.016, 6))


@category("desk organizer", (0.12, 0.25, 0.12), "pen holder", "paper tray", "storage organizer", "magazine rack")
def organizer(d: Draft) -> None:
    """An open box with partitions and a few pens."""
    color = d.main(PLASTICS + LEATHERS + METALS)
    top = 0.75 * d.Z
    d.add("box", color, vessel([(d.hx, 0), (d.hx, top)], 0.005, 0.005, square(), d.Y / d.X, 4))
    for t in (-0.33, 0.33):
        d.box("partitions", shade(color, 0.9), (-d.hx + 0.004, d.hx - 0.004), (t * d.hy - 0.002, t * d.hy + 0.002), (0.004, 0.9 * top))
    for _ in range(4):
        x, y = d.between(-0.4, 0.4) * d.hx, d.between(0.5, 0.85) * d.hy
        tip = (x + 0.15 * d.hx * d.between(-1, 1), y, d.Z * d.between(0.94, 1.0))
        d.add("pens", d.pick(PLASTICS), bar((x, y, 0.006), tip, 0.008, 0.008, 6))
