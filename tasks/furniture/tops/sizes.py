"""Usual sizes: of what stands on tops, and of what has tops; and where on a large object something can stand."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np

from tasks.furniture.storage import BOARD_M, shelf_levels
from tasks.furniture.tops.laws import Extents, Span

ANY = math.pi
"""Spread of the turn of what looks the same from all sides [rad]."""

_QUARTERS = (0.0, 0.0, 0.5 * math.pi, -0.5 * math.pi)

COMMON = (0.92, 1.08)
"""Range of the factor that an object's usual extents are multiplied with."""

OWN = (0.97, 1.03)
"""Range of a further factor, of each extent for itself."""


@dataclasses.dataclass(frozen=True)
class SmallSize:
    """A small object. extents: Usual ones [m]: depth (x), width (y), height (z). bases: Turns that occur alike often, from the front of
    the large object, the anchor or towards the seat, give or take up to `spread` [rad]."""

    extents: Extents
    bases: tuple[float, ...] = (0.0,)
    spread: float = 0.1


def _round(x: float, y: float, z: float) -> SmallSize:
    return SmallSize((x, y, z), (0.0,), ANY)


def _loose(x: float, y: float, z: float) -> SmallSize:
    return SmallSize((x, y, z), _QUARTERS, 0.3)


SMALL: dict[str, SmallSize] = {
    "backpack": SmallSize((0.2, 0.3, 0.42), (0.0,), 0.3),
    "bag": _loose(0.15, 0.32, 0.28),
    "ball": _round(0.2, 0.2, 0.2),
    "basket": _round(0.2, 0.2, 0.15),
    "blanket": SmallSize((0.45, 0.62, 0.09), (0.0,), 0.15),
    "blender": _round(0.16, 0.16, 0.36),
    "book": _loose(0.2, 0.14, 0.03),
    "book stack": SmallSize((0.21, 0.155, 0.135), _QUARTERS, 0.2),
    "bottle": _round(0.075, 0.075, 0.24),
    "bowl": _round(0.15, 0.15, 0.07),
    "box": SmallSize((0.13, 0.18, 0.1), _QUARTERS, 0.12),
    "camera": SmallSize((0.11, 0.12, 0.085), (0.0,), 0.8),
    "can": _round(0.066, 0.066, 0.12),
    "candle": _round(0.065, 0.065, 0.11),
    "cell phone": _loose(0.15, 0.075, 0.01),
    "clock": SmallSize((0.05, 0.11, 0.11), (0.0,), 0.25),
    "clothes": _loose(0.28, 0.23, 0.08),
    "coffee maker": SmallSize((0.25, 0.18, 0.32), (0.0,), 0.08),
    "computer tower": SmallSize((0.38, 0.18, 0.38), (0.0,), 0.04),
    "cup": _round(0.08, 0.08, 0.09),
    "cutting board": SmallSize((0.25, 0.35, 0.02), (0.0, 0.0, 0.5 * math.pi), 0.12),
    "desk lamp": SmallSize((0.32, 0.16, 0.42), (0.0,), 0.5),
    "desk organizer": SmallSize((0.11, 0.2, 0.11), (0.0,), 0.15),
    "headphones": _loose(0.1, 0.16, 0.18),
    "iron": SmallSize((0.25, 0.11, 0.14), (0.0,), 0.5),
    "jar": _round(0.085, 0.085, 0.13),
    "kettle": _round(0.2, 0.15, 0.22),
    "keyboard": SmallSize((0.135, 0.42, 0.025), (0.0,), 0.05),
    "kitchen utensils": _round(0.11, 0.11, 0.29),
    "laptop": SmallSize((0.26, 0.33, 0.22), (0.0,), 0.15),
    "microwave": SmallSize((0.31, 0.44, 0.26), (0.0,), 0.04),
    "mirror": SmallSize((0.04, 0.26, 0.36), (0.0,), 0.1),
    "monitor": SmallSize((0.19, 0.5, 0.42), (0.0,), 0.08),
    "mouse": SmallSize((0.11, 0.062, 0.038), (0.0,), 0.2),
    "mug": _round(0.11, 0.08, 0.095),
    "pan": _loose(0.4, 0.24, 0.06),
    "paper": _loose(0.295, 0.21, 0.01),
    "picture": SmallSize((0.03, 0.14, 0.18), (0.0,), 0.3),
    "pillow": SmallSize((0.16, 0.42, 0.36), (0.0,), 0.12),
    "plant": _round(0.15, 0.15, 0.25),
    "plate": _round(0.21, 0.21, 0.022),
    "pot": _loose(0.26, 0.2, 0.15),
    "printer": SmallSize((0.3, 0.38, 0.22), (0.0,), 0.05),
    "projector": SmallSize((0.25, 0.3, 0.11), (-0.5 * math.pi, 0.5 * math.pi), 0.1),
    "remote control": _loose(0.18, 0.05, 0.022),
    "sculpture": SmallSize((0.14, 0.14, 0.25), (0.0,), 0.4),
    "soap dispenser": SmallSize((0.075, 0.075, 0.17), (0.0,), 0.5),
    "speaker": SmallSize((0.17, 0.16, 0.26), (0.0,), 0.2),
    "storage bin": SmallSize((0.24, 0.3, 0.17), (0.0,), 0.08),
    "stuffed animal": SmallSize((0.18, 0.22, 0.27), (0.0,), 0.5),
    "table lamp": _round(0.17, 0.17, 0.36),
    "tablet": _loose(0.17, 0.24, 0.01),
    "telephone": SmallSize((0.18, 0.16, 0.08), (0.0,), 0.3),
    "tissue box": _loose(0.115, 0.18, 0.09),
    "toaster": SmallSize((0.16, 0.27, 0.19), (0.0,), 0.1),
    "toilet paper": _round(0.11, 0.11, 0.1),
    "towel": SmallSize((0.22, 0.28, 0.07), (0.0,), 0.12),
    "tray": SmallSize((0.28, 0.4, 0.035), (0.0,), 0.12),
    "tv": SmallSize((0.19, 0.86, 0.53), (0.0,), 0.03),
    "vase": _round(0.12, 0.12, 0.25),
    "wine glass": _round(0.08, 0.08, 0.19),
}
"""Small objects by word."""

LARGE: dict[str, tuple[Span, Span, Span]] = {
    "bed": ((1.95, 2.1), (1.3, 1.7), (0.85, 1.05)),
    "bookshelf": ((0.3, 0.35), (0.8, 1.0), (1.7, 2.0)),
    "cabinet": ((0.42, 0.5), (0.9, 1.3), (0.85, 1.0)),
    "coffee table": ((0.52, 0.64), (0.95, 1.25), (0.38, 0.46)),
    "desk": ((0.64, 0.8), (1.3, 1.7), (0.72, 0.77)),
    "dresser": ((0.45, 0.52), (1.0, 1.4), (0.78, 0.92)),
    "kitchen counter": ((0.6, 0.65), (1.6, 2.2), (0.88, 0.93)),
    "nightstand": ((0.4, 0.46), (0.45, 0.6), (0.48, 0.58)),
    "side table": ((0.37, 0.43), (0.6, 0.72), (0.5, 0.6)),
    "sofa": ((0.86, 0.98), (1.8, 2.3), (0.78, 0.88)),
    "table": ((0.8, 0.95), (1.25, 1.8), (0.73, 0.77)),
    "tv stand": ((0.4, 0.46), (1.3, 1.7), (0.45, 0.56)),
    "washing machine": ((0.58, 0.63), (0.58, 0.62), (0.84, 0.87)),
}
"""Ranges of depth, width and height of what has tops [m]. Tables are so long that none of them is drawn round."""


@dataclasses.dataclass(frozen=True)
class TopSurface:
    """Where something can stand on a large object, in its frame. x, y: Spans [m]. levels: Heights with the clearance above each [m]."""

    x: Span
    y: Span
    levels: tuple[tuple[float, float], ...]


def typical_size(word: str, rng: np.random.Generator) -> Extents:
    """Extents of a large object of that word [m], shape (3,): depth, width, height, each evenly from its range."""
    x, y, z = (float(rng.uniform(low, high)) for low, high in LARGE[word])
    return x, y, z


def surface(word: str, size: Extents) -> TopSurface:
    """What carries in a large object of these extents [m], shape (3,): its top, its seat, or the boards of a shelf."""
    x, y, z = 0.5 * size[0], 0.5 * size[1], size[2]
    if word == "bookshelf":
        levels = [*shelf_levels(size), z]
        board = min(BOARD_M, 0.04 * z)
        inset = min(0.035, 0.1 * y)
        boards = tuple((low, high - low - board) for low, high in pairwise(levels))
        return TopSurface((-x + min(0.012, 0.05 * x), x - min(0.008, 0.05 * x)), (-y + inset, y - inset), boards)
    if word == "bed":
        return TopSurface((-x + 0.24 * size[0], x - 0.03 * size[0]), (-0.95 * y, 0.95 * y), ((0.52 * z, math.inf),))
    if word == "sofa":
        return TopSurface((-x + 0.4 * size[0], x - 0.03 * size[0]), (-y + 0.1 * size[1], y - 0.1 * size[1]), ((0.48 * z, math.inf),))
    # fronts and handles reach a little beyond the board on top
    return TopSurface(
        (-x + min(0.01, 0.1 * x), x - min(0.025, 0.1 * x)), (-y + min(0.01, 0.1 * y), y - min(0.01, 0.1 * y)), ((z, math.inf),)
    )
