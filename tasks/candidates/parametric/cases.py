"""Templates with boards: tables and desks, straight or with a return, worktops with cut-outs, shelves."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from functools import partial

from tasks.candidates.parametric.drawing import Block, Extents, FurnitureTemplate, Parameter, Values

Span = tuple[float, float]
Rectangle = tuple[Span, Span]

BEND_M = 0.2
"""A return reaches at least so far before the top beside it, else the top is straight."""

INSET_M = 0.02
"""How far legs, panels and drawers stand back below a top."""

PANEL_M = 0.025
"""Thickness of panels."""


BACK_M = 0.01
"""Thickness of a shelf's back."""

LEVEL_M = 0.012
"""How far from where points are most a board may be."""

SLAB_M = 0.2
"""What is not higher is a worktop without a body."""

UPSTAND_M = 0.018
"""Thickness of the strip at the back of a worktop, along its wall."""


@dataclasses.dataclass(frozen=True)
class Level:
    """Height of the top of a board [m]. is_seen: it has points; else an even row of boards has one there."""

    height: float
    is_seen: bool


def tables(extents: Extents, _: object = None) -> list[FurnitureTemplate]:
    """A top, straight or with a return at either side, on legs, panels or a column, with drawers or a shelf below."""
    x, y, z = extents
    thick = Parameter.of("top", 0.012, min(0.12, 0.3 * z), 0.03)
    leg = Parameter.of("leg", 0.02, min(0.14, 0.2 * min(x, y)), 0.05)
    column = Parameter.of("leg", 0.05, 0.4 * min(x, y), 0.12)
    drawers = Parameter.of("drawers", 0.0, min(0.7, 0.5 * y), 0.0, 0.42)
    modesty = Parameter.of("modesty", 0.0, 0.7 * z, 0.0, 0.4 * z)
    shelf = Parameter.of("shelf", 0.0, 0.7 * z, 0.0, 0.35 * z)
    straight = partial(_table, side=0)
    forms = [
        FurnitureTemplate("four-legged", extents, (thick, leg, shelf), partial(straight, base="legs"), (0, 1)),
        *(
            FurnitureTemplate(name, extents, (thick, modesty, drawers), partial(straight, base="panels", chest_side=s))
            for name, s in (("panelled", 1), ("right-handed panelled", -1))
        ),
        FurnitureTemplate("pedestal", extents, (thick, column), partial(straight, base="column"), (0,)),
    ]
    if min(x, y) < 0.9:
        return forms
    deep = Parameter.of("depth", 0.35, x - BEND_M, 0.4 * x, 0.55 * x)
    wide = Parameter.of("return", 0.3, y - BEND_M, 0.3 * y, 0.45 * y)
    chest = Parameter.of("drawers", 0.0, min(0.7, 0.5 * x), 0.0, 0.42)
    for side, name in ((1, "left"), (-1, "right")):
        bent = partial(_table, side=side)
        forms.append(
            FurnitureTemplate(f"L {name} four-legged", extents, (deep, wide, thick, leg, chest, modesty), partial(bent, base="legs"))
        )
        forms.append(FurnitureTemplate(f"L {name} panelled", extents, (deep, wide, thick, chest, modesty), partial(bent, base="panels")))
    return forms


def _table(p: Values, extents: Extents, side: int, base: str, chest_side: int = 1) -> Iterable[Block]:
    """side: of y at which the return is, 0 without one. chest_side: of y at which drawers are where there is no return."""
    x, y, z = 0.5 * extents[0], 0.5 * extents[1], extents[2]
    front = -x + p["depth"] if side else x
    under = z - p["top"]
    yield Block("top", (-x, front), (-y, y), (under, z))
    low, high = -x + INSET_M, front - INSET_M
    chest, modesty, leg = p.get("drawers", 0.0), p.get("modesty", 0.0), p.get("leg", PANEL_M)
    end = _span(side * y, side * (y - p["return"])) if side else (-y, y)
    if side:
        yield Block("top", (front, x), end, (under, z))
    taken: list[Rectangle] = []
    if chest > 0.2:
        beside = _span(chest_side * (y - INSET_M), chest_side * (y - INSET_M - chest))
        drawers: Rectangle = ((x - INSET_M - chest, x - INSET_M), _inner(end)) if side else ((low, high), beside)
        yield Block("drawers", *drawers, (0.0, under))
        taken.append(drawers)
    if base == "column":
        foot = min(0.04, 0.3 * under)
        yield Block("legs", (-0.5 * leg, 0.5 * leg), (-0.5 * leg, 0.5 * leg), (foot, under))
        yield Block("foot", (-0.55 * x, 0.55 * x), (-0.55 * y, 0.55 * y), (0.0, foot))
        return
    ends = [s for s in (-1, 1) if s != side or not side]
    if base == "panels":
        stands: list[Rectangle] = [((low, high), _span(s * (y - INSET_M), s * (y - INSET_M - PANEL_M))) for s in ends]
        if side:
            stands.append(((x - INSET_M - PANEL_M, x - INSET_M), _inner(end)))
            stands.append(((low, low + PANEL_M), _inner(end)))
    else:
        stands = [((a, a + leg), _span(s * (y - INSET_M), s * (y - INSET_M - leg))) for s in ends for a in (low, high - leg)]
        if side:
            (a, b), inner = _inner(end), (low, low + leg)
            stands += [(inner, (b - leg, b) if side > 0 else (a, a + leg))]
            stands += [((x - INSET_M - leg, x - INSET_M), span) for span in ((a, a + leg), (b - leg, b))]
    for stand in stands:
        if not any(_meet(stand, other) for other in taken):
            yield Block("legs", *stand, (0.0, under))
            taken.append(stand)
    if 0.05 < modesty < under - 0.05:
        behind = low + (leg if base == "legs" else PANEL_M if side else 0.0)
        reach = [y - INSET_M - PANEL_M] * 2 if base == "panels" else [y - 0.1] * 2
        if chest > 0.2 and not side:
            reach[max(chest_side, 0)] = y - INSET_M - chest
        panel: Rectangle = ((behind, behind + 0.015), (-reach[0], reach[1]))
        if not any(_meet(panel, other) for other in taken):
            yield Block("modesty panel", *panel, (modesty, under))
    shelf = p.get("shelf", 0.0)
    if 0.06 < shelf < under - 0.06:
        yield Block("shelf", (low + leg, high - leg), (-y + INSET_M + leg, y - INSET_M - leg), (shelf - 0.02, shelf))


def counters(extents: Extents, holes: Sequence[Rectangle] = ()) -> list[FurnitureTemplate]:
    """A worktop, straight or round a corner, alone or on a body down to the floor, cut out where something is let into it.

    holes: x and y spans in the template's frame [m].
    """
    x, y, z = extents
    rise = Parameter.of("upstand", 0.0, min(0.3, 0.6 * z), 0.0, 0.3 * z)
    own: tuple[Parameter, ...] = (rise,)
    if z > SLAB_M:
        own = (
            rise,
            Parameter.of("top", 0.012, 0.1, 0.04),
            Parameter.of("set_back", 0.0, min(0.12, 0.3 * x), 0.04),
            Parameter.of("plinth", 0.0, 0.2 * z, 0.0, 0.1 * z),
        )
    forms = [FurnitureTemplate("straight", extents, own, partial(_counter, side=0, holes=holes))] if x <= y else []
    if min(x, y) >= 0.9:
        deep = Parameter.of("depth", 0.45, x - BEND_M, 0.4 * x, 0.6)
        wide = Parameter.of("return", 0.45, y - BEND_M, 0.3 * y, 0.6)
        for side, name in ((1, "left"), (-1, "right")):
            forms.append(FurnitureTemplate(f"L {name}", extents, (deep, wide, *own), partial(_counter, side=side, holes=holes)))
    return forms


def _counter(p: Values, extents: Extents, side: int, holes: Sequence[Rectangle]) -> Iterable[Block]:
    x, y, z = 0.5 * extents[0], 0.5 * extents[1], extents[2] - p["upstand"]
    front = -x + p["depth"] if side else x
    under = z - p["top"] if "top" in p else 0.0
    end = _span(side * y, side * (y - p["return"])) if side else (-y, y)
    tops: list[Rectangle] = [((-x, front), (-y, y)), *([((front, x), end)] if side else [])]
    for top in tops:
        for rest in cut_out(top, holes):
            yield Block("top", *rest, (under, z))
    strip = (-x, -x + UPSTAND_M)
    for rest in cut_out((strip, (-y, y)), holes):
        yield Block("upstand", *rest, (z, extents[2]))
    if under <= 0.0:
        return
    inner = front - p["set_back"]
    bodies: list[Rectangle] = [((-x, inner), (-y, y))]
    if side:
        bodies.append(((inner, x), _span(side * y, side * (y - p["return"] + p["set_back"]))))
    for body in bodies:
        for rest in cut_out(body, holes):  # what is let in hangs within
            yield Block("body", *rest, (p["plinth"], under))
        yield Block("plinth", *body, (0.0, p["plinth"]))


def cut_out(rectangle: Rectangle, holes: Sequence[Rectangle]) -> list[Rectangle]:
    """A rectangle without holes, as up to four rectangles for each."""
    rest = [rectangle]
    for (hx0, hx1), (hy0, hy1) in holes:
        cut: list[Rectangle] = []
        for (x0, x1), (y0, y1) in rest:
            a, b, c, d = max(x0, hx0), min(x1, hx1), max(y0, hy0), min(y1, hy1)
            if a >= b or c >= d:
                cut.append(((x0, x1), (y0, y1)))
                continue
            cut += [((x0, a), (y0, y1)), ((b, x1), (y0, y1)), ((a, b), (y0, c)), ((a, b), (d, y1))]
        rest = cut
    return rest


def shelves(extents: Extents, levels: Sequence[Level]) -> list[FurnitureTemplate]:
    """A case with boards at `levels`, the lowest first, and a top: open or with a back, with uprights, closed below or not. None without
    a board between the lowest and the top."""
    _, y, z = extents
    if len(levels) < 2:
        return []
    thick = Parameter.of("board", 0.012, min(0.06, 0.1 * z), 0.022)
    play = [LEVEL_M if level.is_seen else 0.0 for level in levels]
    heights = [Parameter.of(f"level {k}", v.height - p, v.height + p, v.height) for k, (v, p) in enumerate(zip(levels, play, strict=True))]
    parameters = (thick, *heights)
    forms = []
    boards = f"{len(levels) + 1} boards"
    for backed in (True, False):
        for uprights in (0, 1, 2) if y > 0.6 else (0,):
            name = f"{boards}{', back' if backed else ''}{f', {uprights} uprights' if uprights else ''}"
            forms.append(FurnitureTemplate(name, extents, parameters, partial(_shelf, backed=backed, uprights=uprights, closed=False)))
    forms.append(FurnitureTemplate(f"{boards}, closed below", extents, parameters, partial(_shelf, backed=True, uprights=0, closed=True)))
    return forms


def _shelf(p: Values, extents: Extents, backed: bool, uprights: int, closed: bool) -> Iterable[Block]:
    x, y, z = 0.5 * extents[0], 0.5 * extents[1], extents[2]
    thick = p["board"]
    behind = -x + (BACK_M if backed else 0.0)
    if backed:
        yield Block("back", (-x, behind), (-y, y), (0.0, z))
    for s in (-1, 1):
        yield Block("sides", (behind, x), _span(s * y, s * (y - thick)), (0.0, z))
    across = (-y + thick, y - thick)
    wide = (2 * y - (2 + uprights) * thick) / (uprights + 1)
    tops = [*sorted(max(v, thick) for k, v in p.items() if k.startswith("level")), z]
    for k, top in enumerate(tops):
        below = tops[k - 1] if k else 0.0
        if top - thick < below:
            continue
        yield Block("boards", (behind, x), across, (top - thick, top))
        if k == 0:
            yield Block("plinth", (x - BACK_M - thick, x - BACK_M), across, (0.0, top - thick))
        elif closed and k == 1:
            yield Block("doors", (x - thick, x), across, (below, top - thick))
        for u in range(uprights) if k else ():
            at = -y + thick + (u + 1) * wide + u * thick
            yield Block("uprights", (behind, x), (at, at + thick), (below, top - thick))


def _inner(span: Span) -> Span:
    return span[0] + INSET_M, span[1] - INSET_M


def _meet(first: Rectangle, second: Rectangle) -> bool:
    """Whether rectangles share area."""
    return all(a[0] < b[1] - 1e-9 and b[0] < a[1] - 1e-9 for a, b in zip(first, second, strict=True))


def _span(first: float, other: float) -> Span:
    return min(first, other), max(first, other)
