"""Furniture round a bend: L- and U-shaped sofas, desks with returns; rugs as flat as cloth; platforms and steps.

None of it is in the registry of categories: a replica's asset for such a sofa is found, or it is a straight one. Models are in
the canonical frame: +Z up, front +X, origin at the bottom center of the box [m].
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np

from tasks.furniture.drafting import Draft, Extents, FurnitureModel
from tasks.furniture.palette import DARKS, FABRICS, LEATHERS, LINENS, METALS, WHITES, WOODS, Color, shade
from tasks.furniture.solids import Span

Block = tuple[Span, Span, Span]
"""Spans of a box in a model's frame [m]."""


def ordered(first: float, other: float) -> Span:
    """A span from two ends in any order."""
    return min(first, other), max(first, other)


@dataclasses.dataclass(frozen=True)
class ShapedModel:
    """A model whose box is partly empty: it keeps to its blocks, and `bend` is where something may stand between them."""

    model: FurnitureModel
    extents: Extents
    blocks: tuple[Block, ...]
    bend: tuple[Span, Span]


def corner_sofa(rng: np.random.Generator, arms: int, width: float, reach: float, side: int) -> ShapedModel:
    """A sofa along a wall with one return (an L, at `side` -1 or 1 of y) or two (a U); `width` along the wall, `reach` [m]."""
    deep, tall = float(rng.uniform(0.84, 0.94)), float(rng.uniform(0.74, 0.86))
    d = Draft("sofa", (reach, width, tall), rng, None)
    kind = d.one_of("L" if arms == 1 else "U")
    cloth, wood = d.main(FABRICS + LEATHERS), d.pick(WOODS)
    sides = (side,) if arms == 1 else (-1, 1)
    foot, plinth, seat, back, arm = 0.08, 0.27, 0.5 * tall, 0.2, 0.16
    pad = shade(cloth, 1.08)
    along = (-d.hy, d.hy)
    d.cushion("base", cloth, (-d.hx, -d.hx + deep), along, (foot, plinth), 0.02)
    d.cushion("back", cloth, (-d.hx, -d.hx + back), along, (foot, tall), 0.05)
    for s in sides:
        y0, y1 = sorted((s * d.hy, s * (d.hy - deep)))
        d.cushion("base", cloth, (-d.hx + deep - 0.03, d.hx - 0.01), (y0, y1), (foot, plinth), 0.02)
        y2, y3 = sorted((s * d.hy, s * (d.hy - back)))
        d.cushion("back", cloth, (-d.hx + 0.5 * back, d.hx - arm), (y2, y3), (foot, tall), 0.05)
        d.cushion("arms", cloth, (d.hx - arm, d.hx), (y0, y1), (foot, 0.66 * tall), 0.03)
        y4, y5 = sorted((s * (d.hy - back), s * (d.hy - deep)))
        _seats(d, pad, (-d.hx + deep, d.hx - arm), (y4, y5), (plinth, seat), across=False)
    low = -d.hy + (back if -1 in sides else arm)
    high = d.hy - (back if 1 in sides else arm)
    for s in {-1, 1} - set(sides):
        y0, y1 = sorted((s * d.hy, s * (d.hy - arm)))
        d.cushion("arms", cloth, (-d.hx, -d.hx + deep), (y0, y1), (foot, 0.66 * tall), 0.03)
    _seats(d, pad, (-d.hx + back, -d.hx + deep), (low, high), (plinth, seat), across=True)
    for x, y in _feet(d, sides, deep):
        d.leg("feet", wood, (x, y), (x, y), (0, foot + 0.01), 0.05, 0.7)
    blocks: list[Block] = [((-d.hx, -d.hx + deep), along, (0.0, tall))]
    for s in sides:
        y0, y1 = sorted((s * d.hy, s * (d.hy - deep)))
        blocks.append(((-d.hx, d.hx), (y0, y1), (0.0, tall)))
    bend = (-d.hy + (deep if -1 in sides else 0.0), d.hy - (deep if 1 in sides else 0.0))
    assert kind in d.variant
    return ShapedModel(d.model((reach, width, tall)), (reach, width, tall), tuple(blocks), ((-d.hx + deep, d.hx), bend))


def _seats(d: Draft, color: Color, x: Span, y: Span, z: Span, across: bool) -> None:
    """Seat cushions side by side, along y when they lie across the wall's sofa, else along x."""
    first, last = y if across else x
    count = max(1, round((last - first) / 0.75))
    edges = np.linspace(first, last, count + 1)
    for a, b in pairwise(edges):
        span = (float(a) + 0.003, float(b) - 0.003)
        d.cushion("seat cushions", color, x if across else span, span if across else y, z, 0.04)


def _feet(d: Draft, sides: tuple[int, ...], deep: float) -> list[tuple[float, float]]:
    spots = [(-d.hx + 0.06, -d.hy + 0.06), (-d.hx + 0.06, d.hy - 0.06)]
    for s in (-1, 1):
        x = d.hx if s in sides else -d.hx + deep
        spots += [(x - 0.07, s * (d.hy - 0.06))]
        if s in sides:
            spots += [(x - 0.07, s * (d.hy - deep + 0.06))]
    return spots


def corner_desk(rng: np.random.Generator, width: float, reach: float, side: int) -> ShapedModel:
    """A desk with a return at `side` -1 or 1 of y: two boards on panels, drawers below the return; sides in [m]."""
    deep, back, tall = float(rng.uniform(0.6, 0.72)), float(rng.uniform(0.48, 0.58)), float(rng.uniform(0.72, 0.76))
    d = Draft("desk", (reach, width, tall), rng, None)
    d.one_of("corner")
    wood, metal, board = d.main(WOODS + WHITES), d.pick(METALS + DARKS), 0.03
    d.box("top", wood, (-d.hx, -d.hx + deep), (-d.hy, d.hy), (tall - board, tall))
    y0, y1 = sorted((side * d.hy, side * (d.hy - back)))
    d.box("top", wood, (-d.hx + deep, d.hx), (y0, y1), (tall - board, tall))
    far = -side * (d.hy - 0.03)
    d.box("panels", shade(wood, 0.94), (-d.hx + 0.02, -d.hx + deep - 0.04), ordered(far, far + side * 0.025), (0, tall - board))
    d.box("modesty", shade(wood, 0.9), (-d.hx + 0.02, -d.hx + 0.04), (-d.hy + 0.06, d.hy - 0.06), (0.3, tall - board))
    for x, y in ((-d.hx + 0.03, side * (d.hy - 0.03)), (-d.hx + deep - 0.05, side * (d.hy - back + 0.03))):
        d.leg("legs", metal, (x, y), (x, y), (0, tall - board), 0.04)
    drawers = (d.hx - 0.42, d.hx - 0.01)
    d.box("drawers", shade(wood, 0.94), drawers, (y0 + 0.01, y1 - 0.01), (0, tall - board))
    front = y0 + 0.01 if side > 0 else y1 - 0.01
    for z in (0.1, 0.32, 0.54):
        span = ordered(front, front - side * 0.006)
        d.box("fronts", shade(wood, 1.06), (drawers[0] + 0.01, drawers[1] - 0.01), span, (z, z + 0.14))
    blocks: tuple[Block, ...] = (((-d.hx, -d.hx + deep), (-d.hy, d.hy), (0.0, tall)), ((-d.hx, d.hx), (y0, y1), (0.0, tall)))
    bend = (-d.hy, d.hy - back) if side > 0 else (-d.hy + back, d.hy)
    return ShapedModel(d.model((reach, width, tall)), (reach, width, tall), blocks, ((-d.hx + deep, d.hx), bend))


def flat_rug(rng: np.random.Generator, extents: Extents) -> FurnitureModel:
    """A rug with a border and stripes woven in: its top is one plane, so that what stands on it stands level."""
    d = Draft("rug", extents, rng, None)
    d.one_of("flat")
    color, border = d.main(FABRICS + LINENS), d.pick(FABRICS)
    x, y, top = 0.88 * d.hx, 0.9 * d.hy, (0.0, d.Z)
    for s in (-1, 1):
        d.box("rug", border, (-d.hx, d.hx), ordered(s * y, s * d.hy), top)
        d.box("rug", border, ordered(s * x, s * d.hx), (-y, y), top)
    edges = np.linspace(-y, y, 10)
    for k, (a, b) in enumerate(pairwise(edges)):
        d.box("field", color if k % 2 == 0 else shade(color, 0.82), (-x, x), (float(a), float(b)), top)
    return d.model(extents)


def lying_pillow(rng: np.random.Generator, extents: Extents) -> FurnitureModel:
    """A pillow that lies: the seat below has flattened its underside."""
    d = Draft("pillow", extents, rng, None)
    d.one_of("lying")
    d.cushion("pillow", d.main(FABRICS + LINENS), (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z), 0.42 * d.Z)
    return d.model(extents)


def platform(rng: np.random.Generator, extents: Extents, category: str = "platform") -> FurnitureModel:
    """A raised floor, or a step, of boards."""
    d = Draft(category, extents, rng, None)
    wood = d.main(WOODS[2:5])
    d.box("body", shade(wood, 0.8), (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z - 0.02))
    edges = np.linspace(-d.hy, d.hy, max(2, round(d.Y / 0.16)) + 1)
    for a, b in pairwise(edges):
        d.box("boards", shade(wood, d.between(0.94, 1.06)), (-d.hx, d.hx), (float(a), float(b)), (d.Z - 0.02, d.Z))
    return d.model(extents)
