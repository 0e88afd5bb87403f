"""Screens, machines of an office, and small devices. Screens look to the front, +x."""

from __future__ import annotations

import numpy as np

from tasks.furniture.drafting import Draft, category
from tasks.furniture.palette import DARKS, METALS, PLASTICS, SCREEN, WHITES, Color, shade
from tasks.furniture.solids import band, bar, cushion, cylinder, ellipsoid, sweep, turned_body, wedge

PICTURES: tuple[Color, ...] = ((40, 70, 110), (70, 110, 90), (120, 80, 60), (90, 90, 110), (30, 40, 60))
"""What a screen that is on shows."""


def _screen(d: Draft, frame: Color, x: tuple[float, float], z: tuple[float, float], on: bool) -> None:
    """A flat housing with a dark front and, when on, a picture of a few areas."""
    deep = min(0.006, 0.3 * (x[1] - x[0]))
    d.box("housing", frame, (x[0], x[1] - 0.7 * deep), (-d.hy, d.hy), z)
    edge = min(0.015, 0.05 * d.Y, 0.05 * (z[1] - z[0]))
    y0, y1, z0, z1 = -d.hy + edge, d.hy - edge, z[0] + edge, z[1] - edge
    d.box("screen", SCREEN, (x[1] - deep, x[1] - 0.2 * deep), (y0, y1), (z0, z1))
    if on:
        picture = d.pick(PICTURES)
        d.box("picture", picture, (x[1] - 0.5 * deep, x[1] - 0.1 * deep), (y0 + edge, y1 - edge), (z0 + edge, z1 - edge))
        d.box(
            "picture",
            shade(picture, 1.7),
            (x[1] - 0.35 * deep, x[1]),
            (y0 + 0.3 * d.hy, y1 - 0.9 * d.hy),
            (z0 + 0.3 * (z1 - z0), z0 + 0.75 * (z1 - z0)),
        )
    else:
        d.box("screen", SCREEN, (x[1] - 0.35 * deep, x[1]), (y0, y1), (z0, z1))


@category("tv", (0.22, 1.1, 0.68), "television", "tv set", "flat screen tv", free=True)
def tv(d: Draft) -> None:
    """A wide screen, on two feet when it is deep enough to stand, else for a wall."""
    frame = d.main(DARKS)
    thin = min(0.05, 0.6 * d.X)
    on = d.chance(0.3)
    if d.X < 0.1:
        d.variant = "wall"
        _screen(d, frame, (-d.hx, d.hx), (0, d.Z), on)
        return
    low = 0.09 * d.Z
    _screen(d, frame, (-0.5 * thin, 0.5 * thin), (low, d.Z), on)
    for s in (-1, 1):
        y = s * 0.62 * d.hy
        d.add("feet", frame, bar((-d.hx, y, 0.3 * low), (d.hx, y, 0.3 * low), 0.03, 0.6 * low))
        d.add(
            "feet",
            frame,
            wedge(
                ((-0.4 * d.hx, 0.4 * d.hx), (y - 0.015, y + 0.015)),
                ((-0.4 * thin, 0.4 * thin), (y - 0.015, y + 0.015)),
                (0.5 * low, 1.1 * low),
            ),
        )


@category("monitor", (0.2, 0.55, 0.44), "computer monitor", "screen")
def monitor(d: Draft) -> None:
    """A screen on a stem and a plate."""
    frame = d.main(DARKS + METALS[:1])
    thin = min(0.035, 0.5 * d.X)
    low = 0.26 * d.Z
    front = 0.2 * d.hx
    _screen(d, frame, (front - thin, front), (low, d.Z), d.chance(0.5))
    d.cushion("foot", frame, (-d.hx, d.hx), (-0.4 * d.hy, 0.4 * d.hy), (0, min(0.014, 0.1 * d.Z)), 0.005)
    d.box(
        "stem",
        shade(frame, 1.1),
        (front - thin - 0.03, front - thin + 0.002),
        (-0.09 * d.hy - 0.01, 0.09 * d.hy + 0.01),
        (0.005, 0.6 * d.Z),
    )


@category("keyboard", (0.14, 0.44, 0.025), "computer keyboard")
def keyboard(d: Draft) -> None:
    """A slab with rows of keys."""
    color = d.main(DARKS + WHITES)
    d.add("body", color, wedge(((-d.hx, d.hx), (-d.hy, d.hy)), ((-d.hx, d.hx), (-d.hy, d.hy)), (0, 0.6 * d.Z)))
    keys = shade(color, 1.6 if sum(color) < 300 else 0.9)
    for row in range(5):
        x0 = -d.hx + d.X * (0.06 + 0.18 * row)
        count = 5 if row == 4 else 14
        for i in range(count):
            y0 = -d.hy + d.Y * (0.03 + 0.94 * i / count)
            d.box("keys", keys, (x0, x0 + 0.15 * d.X), (y0, y0 + 0.8 * d.Y / count), (0.5 * d.Z, d.Z))


@category("mouse", (0.11, 0.062, 0.038), "computer mouse")
def mouse(d: Draft) -> None:
    """A low rounded body with a wheel."""
    color = d.main(DARKS + WHITES)
    d.add("body", color, ellipsoid((0, 0, 0.36 * d.Z), (d.hx, d.hy, 0.62 * d.Z), 14, 8))
    d.cushion("body", color, (-0.75 * d.hx, 0.75 * d.hx), (-0.7 * d.hy, 0.7 * d.hy), (-0.27 * d.Z, 0.4 * d.Z), 0.004)
    d.add(
        "wheel",
        shade(color, 0.5),
        cylinder(0.2 * d.Z, (-0.12 * d.hy, 0.12 * d.hy), 10).turned("x", np.pi / 2).at(0.5 * d.hx, 0, 0.76 * d.Z),
    )


@category("laptop", (0.3, 0.34, 0.24), "notebook computer", free=True)
def laptop(d: Draft) -> None:
    """An open laptop with its user at the front; a flat one is closed."""
    color = d.main(METALS + DARKS)
    if d.Z < 0.06:
        d.variant = "closed"
        d.cushion("body", color, (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z), 0.3 * d.Z)
        return
    thick = min(0.016, 0.1 * d.Z)
    lean = min(0.25 * d.Z, 0.3 * d.X)
    hinge = -d.hx + lean
    d.box("base", color, (hinge, d.hx), (-d.hy, d.hy), (0, thick))
    d.box("keys", (30, 30, 34), (hinge + 0.08 * d.X, hinge + 0.4 * d.X), (-0.9 * d.hy, 0.9 * d.hy), (0.5 * thick, thick * 1.15))
    d.box("pad", shade(color, 0.85), (hinge + 0.46 * d.X, d.hx - 0.06 * d.X), (-0.25 * d.hy, 0.25 * d.hy), (0.5 * thick, thick * 1.08))
    lid = wedge(((hinge, hinge + 0.5 * thick), (-d.hy, d.hy)), ((-d.hx, -d.hx + 0.5 * thick), (-d.hy, d.hy)), (0.5 * thick, d.Z))
    d.add("lid", color, lid)
    inner = 0.93 * d.hy
    glass = wedge(
        ((hinge - 0.06 * lean + 0.3 * thick, hinge - 0.06 * lean + 0.6 * thick), (-inner, inner)),
        ((-d.hx + 0.05 * lean + 0.3 * thick, -d.hx + 0.05 * lean + 0.6 * thick), (-inner, inner)),
        (0.06 * d.Z + 0.5 * thick, 0.95 * d.Z),
    )
    d.add("screen", d.pick((SCREEN, *PICTURES)), glass)


@category("tablet", (0.17, 0.24, 0.01), "ipad", free=True)
def tablet(d: Draft) -> None:
    """A flat slab with a dark glass on top, or to the front when it stands."""
    _glass_slab(d, d.main(METALS + DARKS))


@category("cell phone", (0.15, 0.075, 0.01), "smartphone", "mobile phone", free=True)
def cell_phone(d: Draft) -> None:
    """A small flat slab with a dark glass."""
    _glass_slab(d, d.main(DARKS + WHITES))


def _glass_slab(d: Draft, color: Color) -> None:
    if d.X < d.Z:
        d.box("body", color, (-d.hx, 0.7 * d.hx), (-d.hy, d.hy), (0, d.Z))
        d.box("screen", SCREEN, (0.5 * d.hx, d.hx), (-0.93 * d.hy, 0.93 * d.hy), (0.04 * d.Z, 0.96 * d.Z))
        return
    d.box("body", color, (-d.hx, d.hx), (-d.hy, d.hy), (0, 0.85 * d.Z))
    d.box("screen", SCREEN, (-0.94 * d.hx, 0.94 * d.hx), (-0.93 * d.hy, 0.93 * d.hy), (0.7 * d.Z, d.Z))


@category("telephone", (0.2, 0.18, 0.09), "phone", "desk phone", "landline phone")
def telephone(d: Draft) -> None:
    """A sloped body with keys and a handset on its left."""
    color = d.main(DARKS + WHITES)
    d.add("body", color, wedge(((-d.hx, d.hx), (-d.hy, d.hy)), ((-d.hx, -0.2 * d.hx), (-d.hy, d.hy)), (0, 0.7 * d.Z)))
    bend = [
        (-0.85 * d.hx, 0.6 * d.hy, 0.78 * d.Z),
        (-0.3 * d.hx, 0.6 * d.hy, 0.93 * d.Z),
        (0.4 * d.hx, 0.6 * d.hy, 0.8 * d.Z),
        (0.9 * d.hx, 0.6 * d.hy, 0.45 * d.Z),
    ]
    d.add("handset", shade(color, 0.8), sweep(bend, 0.5 * d.hy, 0.14 * d.Z, 8))
    for i in range(12):
        row, column = divmod(i, 3)
        t = 0.25 + 0.16 * row
        x, y = -0.2 * d.hx + 1.2 * d.hx * t, -0.75 * d.hy + 0.3 * d.hy * column
        z = 0.7 * d.Z * (1 - t)
        d.box(
            "keys",
            (210, 210, 206),
            (x - 0.06 * d.hx, x + 0.06 * d.hx),
            (y - 0.09 * d.hy, y + 0.09 * d.hy),
            (z - 0.03 * d.Z, z + 0.06 * d.Z),
        )


@category("printer", (0.4, 0.45, 0.3), "scanner", "copier", "fax machine", "photocopier")
def printer(d: Draft) -> None:
    """A rounded body, a lid, a paper slot and a tray with a sheet."""
    color = d.main(WHITES + DARKS + METALS[:1])
    front = 0.82 * d.hx
    d.cushion("body", color, (-d.hx, front), (-d.hy, d.hy), (0, 0.86 * d.Z), 0.02)
    d.cushion("lid", shade(color, 0.85), (-0.9 * d.hx, 0.7 * front), (-0.94 * d.hy, 0.94 * d.hy), (0.84 * d.Z, d.Z), 0.012)
    d.box("slot", (30, 30, 32), (front - 0.01, front + 0.004), (-0.6 * d.hy, 0.6 * d.hy), (0.36 * d.Z, 0.5 * d.Z))
    d.box("tray", shade(color, 0.75), (front - 0.02, d.hx), (-0.6 * d.hy, 0.6 * d.hy), (0.28 * d.Z, 0.32 * d.Z))
    d.box("sheet", (246, 246, 240), (front - 0.02, d.hx * 0.98), (-0.45 * d.hy, 0.45 * d.hy), (0.32 * d.Z, 0.345 * d.Z))
    d.box("panel", (40, 60, 90), (0.75 * front, front * 1.004), (0.55 * d.hy, 0.9 * d.hy), (0.62 * d.Z, 0.78 * d.Z))


@category("computer tower", (0.42, 0.19, 0.42), "pc tower", "computer", "desktop computer")
def computer_tower(d: Draft) -> None:
    """An upright case with a front panel and drives."""
    color = d.main(DARKS + METALS)
    d.box("case", color, (-d.hx, 0.97 * d.hx), (-d.hy, d.hy), (0.02 * d.Z, d.Z))
    d.box("front", shade(color, 1.25), (0.95 * d.hx, d.hx), (-0.9 * d.hy, 0.9 * d.hy), (0.04 * d.Z, 0.96 * d.Z))
    for z in (0.78, 0.86):
        d.box("drives", shade(color, 0.8), (0.97 * d.hx, d.hx * 1.005), (-0.8 * d.hy, 0.8 * d.hy), (z * d.Z, (z + 0.06) * d.Z))
    for x, y in d.corners(0.03):
        d.box("feet", (20, 20, 20), (x - 0.015, x + 0.015), (y - 0.01, y + 0.01), (0, 0.03 * d.Z))


@category("speaker", (0.22, 0.2, 0.35), "loudspeaker", "radio", "stereo", "subwoofer")
def speaker(d: Draft) -> None:
    """A cabinet with two cones in its front."""
    color = d.main(((84, 56, 40), *DARKS))
    front = 0.94 * d.hx
    d.box("cabinet", color, (-d.hx, front), (-d.hy, d.hy), (0, d.Z))
    for z, size in ((0.34, 0.72), (0.76, 0.42)):
        r = min(size * d.hy, 0.24 * d.Z)
        cone = turned_body([(r, 0), (r, 0.5 * (d.hx - front)), (0.4 * r, d.hx - front)]).turned("y", np.pi / 2)
        d.add("cones", (60, 60, 64), cone.at(front - 0.001, 0, z * d.Z))


@category("remote control", (0.19, 0.05, 0.022), "remote", "tv remote")
def remote(d: Draft) -> None:
    """A slim body with rows of buttons."""
    d.cushion("body", d.main(DARKS), (-d.hx, d.hx), (-d.hy, d.hy), (0, 0.85 * d.Z), 0.3 * d.Z)
    for i in range(12):
        row, column = divmod(i, 3)
        x, y = (-0.6 + 0.36 * row) * d.hx, (-0.5 + 0.5 * column) * d.hy
        color = (190, 60, 50) if i == 11 else (120, 120, 124)
        d.box("buttons", color, (x - 0.1 * d.hx, x + 0.1 * d.hx), (y - 0.15 * d.hy, y + 0.15 * d.hy), (0.6 * d.Z, d.Z))


@category("headphones", (0.1, 0.17, 0.19), "headset")
def headphones(d: Draft) -> None:
    """Two cups joined by a band."""
    color = d.main(DARKS + WHITES + PLASTICS[2:4])
    t = np.linspace(0.08 * np.pi, 0.92 * np.pi, 9)
    arch = np.column_stack([np.zeros(9), 0.88 * d.hy * np.cos(t), 0.25 * d.Z + 0.72 * d.Z * np.sin(t)])
    d.add("band", color, sweep(arch, 0.35 * d.X, 0.05 * d.Z, 4, up=(1, 0, 0)))
    for s in (-1, 1):
        cup = turned_body([(0.9 * d.hx, -0.1 * d.hy), (d.hx, 0), (0.9 * d.hx, 0.1 * d.hy)], stretch=1.1).turned("x", np.pi / 2)
        d.add("cups", shade(color, 0.8), cup.at(0, s * 0.88 * d.hy, 0.25 * d.Z))


@category("camera", (0.12, 0.13, 0.09), "security camera", "webcam")
def camera(d: Draft) -> None:
    """A body with a lens at the front."""
    color = d.main(DARKS + WHITES[:1])
    d.add("body", color, cushion((-d.hx, 0.3 * d.hx), (-d.hy, d.hy), (0, 0.85 * d.Z), 0.008))
    d.box("finder", color, (-0.7 * d.hx, 0.1 * d.hx), (-0.3 * d.hy, 0.3 * d.hy), (0.8 * d.Z, d.Z))
    r = min(0.55 * d.hy, 0.38 * d.Z)
    d.add("lens", shade(color, 0.8), cylinder(r, (0.2 * d.hx, d.hx)).turned("y", np.pi / 2).at(0, 0, 0.42 * d.Z))
    d.add("glass", (60, 70, 110), cylinder(0.8 * r, (d.hx * 0.98, d.hx * 1.01)).turned("y", np.pi / 2).at(0, 0, 0.42 * d.Z))


@category("projector", (0.28, 0.34, 0.13))
def projector(d: Draft) -> None:
    """A flat box with a lens at one side of its front."""
    color = d.main(WHITES + DARKS)
    d.cushion("body", color, (-d.hx, 0.9 * d.hx), (-d.hy, d.hy), (0.08 * d.Z, d.Z), 0.015)
    d.add("lens", (50, 60, 90), cylinder(0.3 * d.Z, (0.8 * d.hx, d.hx)).turned("y", np.pi / 2).at(0, 0.45 * d.hy, 0.5 * d.Z))
    d.add(
        "ring",
        (40, 40, 42),
        band([(0.38 * d.Z, 0.85 * d.hx), (0.38 * d.Z, 0.97 * d.hx)], 0.06 * d.Z).turned("y", np.pi / 2).at(0, 0.45 * d.hy, 0.5 * d.Z),
    )
    for x, y in d.corners(0.05):
        d.box("feet", (30, 30, 30), (x - 0.01, x + 0.01), (y - 0.01, y + 0.01), (0, 0.1 * d.Z))
