"""Templates to sit on: sofas, straight and round a bend, and chairs."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from tasks.candidates.parametric.drawing import Block, Extents, FurnitureTemplate, Parameter, Values

FOOT_M = 0.05
"""Side of a sofa's foot."""

BEND_M = 0.25
"""A return reaches at least so far before the seat beside it, else the sofa is straight."""


def sofas(extents: Extents, _: object = None) -> list[FurnitureTemplate]:
    """A straight sofa, an L with its return at either side, and a U."""
    x, y, z = extents
    seat = Parameter.of("seat", 0.25 * z, 0.75 * z, 0.5 * z)
    common = (
        Parameter.of("back", 0.08, min(0.35, 0.45 * x), 0.2),
        Parameter.of("arm", 0.0, min(0.35, 0.3 * y), 0.0, 0.18),
        Parameter.of("arm_top", 0.4 * z, z, 0.7 * z),
        Parameter.of("foot", 0.0, min(0.2, 0.2 * z), 0.06),
    )
    forms = [FurnitureTemplate("straight", extents, (seat, *common), partial(_sofa, sides=()))]
    if min(x, y) < 1.1:
        return forms
    deep = Parameter.of("depth", 0.55, x - BEND_M, 0.4 * x, 0.55 * x)
    for name, sides in (("L left", (1,)), ("L right", (-1,)), ("U", (-1, 1))):
        room = (y - BEND_M) / len(sides)
        if room < 0.5:
            continue
        wide = Parameter.of("return", 0.45, room, 0.3 * y, 0.45 * y)
        reach = Parameter.of("return_back", 0.0, x, 0.0, x)
        forms.append(FurnitureTemplate(name, extents, (deep, wide, reach, seat, *common), partial(_sofa, sides=sides)))
    return forms


def _sofa(p: Values, extents: Extents, sides: tuple[int, ...]) -> Iterable[Block]:
    """Seats from the feet up, backs and arms upon them. sides: of y that have a return."""
    x, y, z = 0.5 * extents[0], 0.5 * extents[1], extents[2]
    foot, seat, back, arm = p["foot"], p["seat"], p["back"], p["arm"]
    top, front = max(p["arm_top"], seat), -x + p["depth"] if sides else x
    open_sides = [s for s in (-1, 1) if s not in sides]
    yield Block("seat", (-x, front), (-y, y), (foot, seat), is_soft=True)
    yield Block("back", (-x, -x + back), (-y, y), (seat, z), is_soft=True)
    for s in open_sides:
        yield Block("arms", (-x + back, front), _span(s * y, s * (y - arm)), (seat, top), is_soft=True)
    for s in sides:
        across = _span(s * y, s * (y - p["return"]))
        yield Block("seat", (front, x), across, (foot, seat), is_soft=True)
        end = min(-x + p["return_back"], x - arm)
        yield Block("back", (-x + back, end), _span(s * y, s * (y - back)), (seat, z), is_soft=True)
        yield Block("arms", (max(x - arm, -x + back), x), across, (seat, top), is_soft=True)
    if foot > 0.02:
        spots = [(-x, -y), (-x, y - FOOT_M)]
        spots += [(front - FOOT_M, s * y - (FOOT_M if s > 0 else 0.0)) for s in open_sides]
        for s in sides:
            low, high = _span(s * y, s * (y - p["return"]))
            spots += [(x - FOOT_M, low), (x - FOOT_M, high - FOOT_M)]
        for a, b in spots:
            yield Block("feet", (a, a + FOOT_M), (b, b + FOOT_M), (0.0, foot))


def chairs(extents: Extents, _: object = None) -> list[FurnitureTemplate]:
    """A seat with a back, with arms or without, on four legs, on one column with a foot, or on a closed base."""
    x, y, z = extents
    parameters = (
        Parameter.of("seat", 0.3 * z, 0.7 * z, 0.45 * z, 0.55 * z),
        Parameter.of("pad", 0.02, 0.2 * z, 0.05),
        Parameter.of("back", 0.02, 0.35 * x, 0.05, 0.2 * x),
        Parameter.of("gap", 0.0, 0.3 * z, 0.0, 0.12 * z),
        Parameter.of("arm", 0.0, 0.25 * y, 0.0, 0.08),
        Parameter.of("arm_top", 0.5 * z, 0.95 * z, 0.7 * z),
    )
    legs = Parameter.of("leg", 0.02, 0.12 * min(x, y), 0.04)
    column = Parameter.of("leg", 0.04, 0.3 * min(x, y), 0.08)
    return [
        FurnitureTemplate("four-legged", extents, (*parameters, legs), partial(_chair, base="legs")),
        FurnitureTemplate("pedestal", extents, (*parameters, column), partial(_chair, base="column")),
        FurnitureTemplate("upholstered", extents, (*parameters, legs), partial(_chair, base="body")),
    ]


def _chair(p: Values, extents: Extents, base: str) -> Iterable[Block]:
    x, y, z = 0.5 * extents[0], 0.5 * extents[1], extents[2]
    seat, back, leg = p["seat"], p["back"], p["leg"]
    under = max(seat - p["pad"], 0.05)
    yield Block("seat", (-x, x), (-y, y), (under, seat), is_soft=True)
    low = max(min(seat + p["gap"], z - 0.1), seat)
    posts = min(leg, back)
    yield Block("back", (-x, -x + back), (-y, y), (low, z), is_soft=True)
    for s in (-1, 1):
        if low > seat:
            yield Block("back", (-x, -x + posts), _span(s * y, s * (y - leg)), (seat, low))
        yield Block("arms", (-x + back, 0.8 * x), _span(s * y, s * (y - p["arm"])), (seat, max(p["arm_top"], seat)), is_soft=True)
    if base == "legs":
        for a in (-x, x - leg):
            for b in (-y, y - leg):
                yield Block("legs", (a, a + leg), (b, b + leg), (0.0, under))
    elif base == "body":
        yield Block("base", (-x, x), (-y, y), (0.0, under))
    else:
        foot = min(0.05, 0.5 * under)
        yield Block("legs", (-0.5 * leg, 0.5 * leg), (-0.5 * leg, 0.5 * leg), (foot, under))
        yield Block("foot", (-0.8 * x, 0.8 * x), (-0.08 * y, 0.08 * y), (0.0, foot))
        for s in (-1, 1):
            yield Block("foot", (-0.08 * x, 0.08 * x), _span(s * 0.08 * y, s * 0.8 * y), (0.0, foot))


def _span(first: float, other: float) -> tuple[float, float]:
    return min(first, other), max(first, other)
