"""Colors of objects in rooms, RGB 0..255: one row per material, the usual ones of each."""

from __future__ import annotations

import numpy as np

Color = tuple[int, int, int]

WOODS: tuple[Color, ...] = ((176, 128, 84), (139, 94, 60), (101, 67, 44), (205, 170, 125), (222, 196, 156), (84, 56, 40), (160, 106, 66))
PAINTS: tuple[Color, ...] = (
    (240, 238, 232),
    (228, 224, 214),
    (70, 74, 80),
    (188, 196, 190),
    (120, 144, 156),
    (52, 58, 66),
    (214, 202, 180),
)
FABRICS: tuple[Color, ...] = (
    (92, 104, 122), (140, 130, 118), (168, 84, 66), (64, 88, 84), (196, 182, 158), (58, 62, 78), (122, 62, 70), (108, 124, 92),
    (188, 150, 84),
)  # fmt: skip
LEATHERS: tuple[Color, ...] = ((60, 44, 38), (110, 70, 46), (40, 40, 42), (148, 98, 62))
METALS: tuple[Color, ...] = ((168, 172, 176), (120, 124, 128), (56, 58, 62), (196, 198, 200))
BRASSES: tuple[Color, ...] = ((190, 154, 86), (164, 126, 70), (60, 56, 52))
PLASTICS: tuple[Color, ...] = (
    (34, 36, 40), (226, 226, 222), (60, 110, 160), (176, 52, 48), (84, 140, 90), (226, 180, 60), (120, 124, 130),
)  # fmt: skip
DARKS: tuple[Color, ...] = ((28, 30, 34), (40, 42, 46), (22, 24, 28))
WHITES: tuple[Color, ...] = ((238, 238, 234), (226, 228, 228), (244, 240, 232))
CERAMICS: tuple[Color, ...] = (
    (240, 236, 226), (70, 104, 140), (182, 90, 66), (96, 132, 108), (222, 190, 110), (58, 62, 70), (204, 214, 216), (150, 70, 84),
)  # fmt: skip
LINENS: tuple[Color, ...] = ((236, 232, 222), (186, 198, 208), (214, 196, 184), (150, 164, 150), (98, 112, 140), (180, 120, 108))
CARTONS: tuple[Color, ...] = ((186, 148, 104), (170, 130, 88), (200, 166, 124))
GREENS: tuple[Color, ...] = ((74, 118, 62), (56, 98, 58), (102, 140, 76), (88, 124, 84))
CLAYS: tuple[Color, ...] = ((172, 96, 64), (226, 222, 212), (90, 92, 96), (142, 118, 96))
COVERS: tuple[Color, ...] = (
    (150, 46, 42), (36, 62, 104), (58, 98, 74), (204, 160, 70), (88, 60, 96), (210, 204, 190), (60, 60, 64), (178, 98, 58), (90, 140, 160),
)  # fmt: skip
GLASSES: tuple[Color, ...] = ((190, 210, 216), (178, 200, 190), (206, 216, 220))
SCREEN: Color = (18, 20, 26)
PAPER: Color = (240, 236, 224)


def pick(colors: tuple[Color, ...], rng: np.random.Generator, spread: int = 8) -> Color:
    """One of the colors, each channel moved together by up to `spread`."""
    base = np.array(colors[int(rng.integers(len(colors)))])
    moved = np.clip(base + int(rng.integers(-spread, spread + 1)), 0, 255)
    return int(moved[0]), int(moved[1]), int(moved[2])


def shade(color: Color, factor: float) -> Color:
    """The color darker (factor < 1) or lighter (> 1)."""
    r, g, b = (min(255, max(0, round(c * factor))) for c in color)
    return r, g, b


def mix(first: Color, second: Color, share: float) -> Color:
    """Blend of two colors, `share` of the second."""
    r, g, b = (round((1 - share) * p + share * q) for p, q in zip(first, second, strict=True))
    return r, g, b
