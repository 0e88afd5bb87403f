"""Places for what stands on a top: drawn within each item's zone until nothing overlaps, packed in rows where that fails.

What stands there is drawn before and never changes here.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from tasks.furniture.tops.laws import Beside, Extents, Seats, TopItem, Zone
from tasks.furniture.tops.sizes import COMMON, OWN, SMALL, TopSurface

CLEARANCE_M = 0.006
"""Least distance between neighbors; a millimetre more than is promised, for rounding."""

MARGIN_M = 0.003
"""Least distance from the edge of what carries; a millimetre more than is promised."""

ZONE_ROUNDS, ORDERED_ROUNDS, ROUNDS = 2, 5, 10
"""How often all places are drawn anew: while each object keeps to its zone, while the order is that of the rule, and in all."""

TRIES = 12
"""Places that are drawn for an object before all are drawn anew."""

SEAT_M = 0.6
"""Width of a seat at a table."""

SEAT_INSET_M = (0.01, 0.05)
"""Range of the distance of an object from the edge before its seat."""

SEAT_SHIFT_M = 0.05
"""How far an object may be off the middle of its seat."""

SWEEPS = 3
"""How often packed objects are moved apart."""

SHRINK = 0.92
"""Factor by which objects become smaller until they can be packed, on tops that are too small for them."""

_WIDE = Zone()


@dataclasses.dataclass
class PlacedBox:
    """A small object while it is placed, in the frame of what it stands on: the large object, or its carrier.

    size: Extents [m]. x, y: Middle [m]. bottom: Height [m]. yaw: [rad]. carrier: Index among the bodies, -1 for the large object.
    """

    item: TopItem
    size: Extents
    rank: int  # number among the objects of its item
    carrier: int = -1
    load: int = -1
    x: float = 0.0
    y: float = 0.0
    bottom: float = 0.0
    yaw: float = 0.0


@dataclasses.dataclass(frozen=True)
class _Seat:
    """A seat: a point opposite to it on the top's middle line [m], yaw towards who sits there [rad], the edge's distance from it [m]."""

    x: float
    y: float
    out: float
    edge: float

    def middle(self, across: float, along: float, a: float, b: float) -> tuple[float, float]:
        """The middle of an object of these half extents at the seat's edge, by two numbers of 0 to 1 [m]."""
        c, s = math.cos(self.out), math.sin(self.out)
        low, high = SEAT_INSET_M
        depth = self.edge - low - (high - low) * a - MARGIN_M - across * abs(c) - along * abs(s)
        shift = SEAT_SHIFT_M * (2 * b - 1)
        return self.x + c * depth - s * shift, self.y + s * depth + c * shift


@dataclasses.dataclass(frozen=True)
class _Side:
    """A side of an object that is placed already."""

    law: Beside
    anchor: PlacedBox

    def middle(self, body: PlacedBox, a: float, b: float) -> tuple[float, float]:
        """The middle of a turned object there, by two numbers of 0 to 1 [m]."""
        c, s = math.cos(self.anchor.yaw), math.sin(self.anchor.yaw)
        across, along = _reach(body.size, body.yaw - self.anchor.yaw)
        low, high = self.law.gap
        gap, shift = low + (high - low) * a + CLEARANCE_M, (2 * b - 1) * self.law.shift
        front, right = self.law.side
        x = front * (0.5 * self.anchor.size[0] + across + gap) + (shift if front == 0 else 0.0)
        y = right * (0.5 * self.anchor.size[1] + along + gap) + (shift if right == 0 else 0.0)
        return self.anchor.x + c * x - s * y, self.anchor.y + s * x + c * y


Spot = Zone | _Seat | _Side

Rectangle = tuple[float, float, float, float, float, float, float]
"""Middle, cosine and sine of the yaw, half extents, radius [m]."""


def bodies_of(items: Sequence[TopItem], top: TopSurface, rng: np.random.Generator) -> list[PlacedBox]:
    """Objects with sizes, some of them on others, not yet placed on the large one. A carrier comes before its load."""
    factors = rng.uniform(*OWN, (len(items), 3)) * rng.uniform(*COMMON, (len(items), 1))
    bodies: list[PlacedBox] = []
    seen: dict[str, int] = {}
    for item, (a, b, c) in zip(items, factors.tolist(), strict=True):
        x, y, z = item.size or SMALL[item.word].extents
        rank = seen.get(item.word, 0)
        seen[item.word] = rank + 1
        bodies.append(PlacedBox(item, (x * a, y * b, z * c), rank))
    least = min(clearance for _, clearance in top.levels)
    wishes = rng.random(len(bodies))
    for index, body in enumerate(bodies):
        if body.item.carriers and body.load < 0 and wishes[index] < body.item.carried:
            _set_on_another(bodies, index, least, rng)
    order = sorted(range(len(bodies)), key=lambda index: bodies[index].carrier >= 0)
    at = {old: new for new, old in enumerate(order)}
    for body in bodies:
        body.carrier, body.load = at.get(body.carrier, -1), at.get(body.load, -1)
    return [bodies[old] for old in order]


def _set_on_another(bodies: list[PlacedBox], index: int, clearance: float, rng: np.random.Generator) -> None:
    """Put an object on the first carrier of its kinds that is free, stands on the large object and is large enough."""
    body = bodies[index]
    for other, carrier in enumerate(bodies):
        if other == index or carrier.load >= 0 or carrier.carrier >= 0 or carrier.item.word not in body.item.carriers:
            continue
        if carrier.size[2] + body.size[2] > clearance - 2 * MARGIN_M:
            continue
        turn = _turn(body.item, rng.random(), rng.random())
        for yaw in (turn, 0.0, 0.5 * math.pi):
            across, along = _reach(body.size, yaw)
            x, y = 0.5 * carrier.size[0] - across - MARGIN_M, 0.5 * carrier.size[1] - along - MARGIN_M
            if x >= 0 and y >= 0:
                body.carrier, carrier.load = other, index
                body.x, body.y, body.yaw = (2 * rng.random() - 1) * x, (2 * rng.random() - 1) * y, yaw
                body.bottom = carrier.size[2]
                return


def place(bodies: list[PlacedBox], top: TopSurface, rng: np.random.Generator) -> None:
    """Place those that stand on the large object itself; those on others go with them. Always succeeds."""
    roots = [index for index, body in enumerate(bodies) if body.carrier < 0]
    for number in range(ROUNDS):
        if number == ORDERED_ROUNDS:  # what is large finds its place while there is some
            roots = _by_size(bodies, roots)
        if _place_once(bodies, roots, top, rng, TRIES if number < ZONE_ROUNDS else 2 * TRIES):
            return
    _pack(bodies, roots, top)
    _loosen(bodies, roots, top, rng)


def _by_size(bodies: list[PlacedBox], roots: list[int]) -> list[int]:
    """The largest first, each followed by what belongs beside it."""
    areas = {index: bodies[index].size[0] * bodies[index].size[1] for index in roots}
    largest: dict[str, float] = {}
    for index, area in areas.items():
        word = bodies[index].item.word
        largest[word] = max(area, largest.get(word, 0.0))
    for index in roots:  # in the rule's order, so that an anchor has its own rank already
        law = bodies[index].item.place
        if isinstance(law, Beside) and law.anchor in largest:
            anchors = [areas[other] for other in roots if bodies[other].item.word == law.anchor]
            areas[index] = (1 - 1e-6) * min(anchors)
    return sorted(roots, key=lambda index: (-areas[index], index))


def _place_once(bodies: list[PlacedBox], roots: list[int], top: TopSurface, rng: np.random.Generator, tries: int) -> bool:
    """Draw a place for each object after the other, after `TRIES` anywhere; False when one finds none."""
    taken: list[list[Rectangle]] = [[] for _ in top.levels]
    placed: dict[str, list[PlacedBox]] = {}
    seats = _seats(top, rng) if any(isinstance(bodies[index].item.place, Seats) for index in roots) else []
    for index in roots:
        body = bodies[index]
        law = body.item.place
        spot: Spot = _WIDE
        if isinstance(law, Zone):
            spot = law
        elif isinstance(law, Seats):
            spot = seats.pop() if seats else _WIDE
        else:
            anchors = placed.get(law.anchor)
            spot = _Side(law, anchors[body.rank % len(anchors)]) if anchors else law.otherwise
        height = body.size[2] + (bodies[body.load].size[2] if body.load >= 0 else 0.0) + MARGIN_M
        for number, (a, b, c, d, e) in enumerate(rng.random((tries, 5)).tolist()):
            if number == TRIES:
                spot = _WIDE
            level = _level(spot, len(top.levels), e)
            if height > top.levels[level][1] or not _settle(body, spot, top, (a, b, c, d)):
                continue
            rectangle = _rectangle(body)
            if not any(_meet(rectangle, other) for other in taken[level]):
                body.bottom = top.levels[level][0]
                taken[level].append(rectangle)
                placed.setdefault(body.item.word, []).append(body)
                break
        else:
            return False
    return True


def _level(spot: Spot, count: int, share: float) -> int:
    """One of a number of levels."""
    low, high = spot.levels if isinstance(spot, Zone) else (0.0, 1.0)
    first, last = round(low * (count - 1)), round(high * (count - 1))
    return first + min(int(share * (last - first + 1)), last - first)


def _turn(item: TopItem, base: float, share: float) -> float:
    """A turn by the law of its word, from two numbers of 0 to 1 [rad]."""
    kind = SMALL[item.word]
    return kind.bases[int(base * len(kind.bases))] + (2 * share - 1) * kind.spread


def _reach(size: Extents, yaw: float) -> tuple[float, float]:
    """Half extents along the frame's axes of an object turned by a yaw [m]."""
    c, s = abs(math.cos(yaw)), abs(math.sin(yaw))
    return 0.5 * (size[0] * c + size[1] * s), 0.5 * (size[0] * s + size[1] * c)


def _settle(body: PlacedBox, spot: Spot, top: TopSurface, draws: tuple[float, float, float, float]) -> bool:
    """Put an object at a spot by four numbers of 0 to 1; False when it would reach over the edge."""
    a, b, c, d = draws
    body.yaw = _turn(body.item, c, d)
    if isinstance(spot, _Side):
        body.yaw += spot.anchor.yaw
    elif isinstance(spot, _Seat):
        body.yaw += spot.out
    across, along = _reach(body.size, body.yaw)
    if 2 * (across + MARGIN_M) > top.x[1] - top.x[0] or 2 * (along + MARGIN_M) > top.y[1] - top.y[0]:
        body.yaw = 0.0  # straight it is narrower
        across, along = 0.5 * body.size[0], 0.5 * body.size[1]
    low_x, high_x = top.x[0] + across + MARGIN_M, top.x[1] - across - MARGIN_M
    low_y, high_y = top.y[0] + along + MARGIN_M, top.y[1] - along - MARGIN_M
    if low_x > high_x or low_y > high_y:
        return False
    if isinstance(spot, Zone):
        body.x = low_x + 0.5 * (1 + spot.x[0] + (spot.x[1] - spot.x[0]) * a) * (high_x - low_x)
        body.y = low_y + 0.5 * (1 + spot.y[0] + (spot.y[1] - spot.y[0]) * b) * (high_y - low_y)
        return True
    if isinstance(spot, _Seat):
        body.x, body.y = spot.middle(across, along, a, b)
    else:
        body.x, body.y = spot.middle(body, a, b)
    return low_x <= body.x <= high_x and low_y <= body.y <= high_y


def _seats(top: TopSurface, rng: np.random.Generator) -> list[_Seat]:
    """Seats round a top, the last taken first: in a drawn order, the long sides before the ends."""
    x, y = 0.5 * (top.x[0] + top.x[1]), 0.5 * (top.y[0] + top.y[1])
    deep, wide = top.x[1] - top.x[0], top.y[1] - top.y[0]
    count = max(1, int(wide / SEAT_M))
    alongs = [y + wide * ((i + 0.5) / count - 0.5) for i in range(count)]
    sides = [_Seat(x, at, out, 0.5 * deep) for out in (0.0, math.pi) for at in alongs]
    ends = [_Seat(x, y, out, 0.5 * wide) for out in (0.5 * math.pi, -0.5 * math.pi)]
    return [ends[i] for i in rng.permutation(2).tolist()] + [sides[i] for i in rng.permutation(2 * count).tolist()]


def _rectangle(body: PlacedBox) -> Rectangle:
    half_x, half_y = 0.5 * body.size[0], 0.5 * body.size[1]
    return body.x, body.y, math.cos(body.yaw), math.sin(body.yaw), half_x, half_y, math.hypot(half_x, half_y)


def _meet(entry: Rectangle, other: Rectangle) -> bool:
    """Whether two rectangles come nearer than the clearance, by the axes of their sides."""
    x0, y0, c0, s0, a0, b0, r0 = entry
    x1, y1, c1, s1, a1, b1, r1 = other
    dx, dy, reach = x1 - x0, y1 - y0, r0 + r1 + CLEARANCE_M
    if dx * dx + dy * dy > reach * reach:
        return False
    c, s = abs(c0 * c1 + s0 * s1), abs(c0 * s1 - s0 * c1)
    return (
        abs(dx * c0 + dy * s0) < a0 + a1 * c + b1 * s + CLEARANCE_M
        and abs(dy * c0 - dx * s0) < b0 + a1 * s + b1 * c + CLEARANCE_M
        and abs(dx * c1 + dy * s1) < a1 + a0 * c + b0 * s + CLEARANCE_M
        and abs(dy * c1 - dx * s1) < b1 + a0 * s + b0 * c + CLEARANCE_M
    )


def _pack(bodies: list[PlacedBox], roots: list[int], top: TopSurface) -> None:
    """Set all straight and against each other or the edges, the largest first, each as near to its zone as it can; smaller and smaller
    until they fit."""
    order = sorted(roots, key=lambda index: (-bodies[index].size[0] * bodies[index].size[1], index))
    gap = CLEARANCE_M
    space = len(top.levels) * (top.x[1] - top.x[0] + gap) * (top.y[1] - top.y[0] + gap)
    while sum((bodies[at].size[0] + gap) * (bodies[at].size[1] + gap) for at in roots) > space or not _pack_once(bodies, order, top):
        for body in bodies:  # carriers come before their loads
            body.size = (body.size[0] * SHRINK, body.size[1] * SHRINK, body.size[2] * SHRINK)
            if body.carrier >= 0:
                _keep_within(body, bodies[body.carrier])


def _keep_within(body: PlacedBox, carrier: PlacedBox) -> None:
    """Keep what stands on another object within its edges, after both became smaller; their margin does not."""
    across, along = _reach(body.size, body.yaw)
    free_x, free_y = 0.5 * carrier.size[0] - MARGIN_M, 0.5 * carrier.size[1] - MARGIN_M
    fit = min(1.0, free_x / across, free_y / along)
    body.size = (body.size[0] * fit, body.size[1] * fit, body.size[2] * fit)
    free_x, free_y = free_x - fit * across, free_y - fit * along
    body.x, body.y, body.bottom = min(max(body.x, -free_x), free_x), min(max(body.y, -free_y), free_y), carrier.size[2]


def _loosen(bodies: list[PlacedBox], roots: list[int], top: TopSurface, rng: np.random.Generator) -> None:
    """Draw places again for packed objects, one by one, where another one than the packed is free."""
    first = {bodies[index].item.word: bodies[index] for index in reversed(roots)}
    for _ in range(SWEEPS):
        for index in roots:
            body = bodies[index]
            rest = [_rectangle(bodies[other]) for other in roots if other != index and bodies[other].bottom == body.bottom]
            packed = body.x, body.y, body.yaw
            law = body.item.place
            own: Spot = law if isinstance(law, Zone) else _WIDE
            if isinstance(law, Beside) and law.anchor in first and first[law.anchor].bottom == body.bottom:
                own = _Side(law, first[law.anchor])
            for number, draws in enumerate(rng.random((TRIES, 4)).tolist()):
                spot = own if 2 * number < TRIES else _WIDE
                if _settle(body, spot, top, draws) and not any(_meet(_rectangle(body), other) for other in rest):
                    break
                body.x, body.y, body.yaw = packed


def _pack_once(bodies: list[PlacedBox], order: list[int], top: TopSurface) -> bool:
    """One attempt; False when not all fit."""
    taken: list[list[Rectangle]] = [[] for _ in top.levels]
    for index in order:
        body = bodies[index]
        zone = body.item.place if isinstance(body.item.place, Zone) else _WIDE
        aim_x = 0.5 * (top.x[0] + top.x[1]) + 0.25 * sum(zone.x) * (top.x[1] - top.x[0])
        aim_y = 0.5 * (top.y[0] + top.y[1]) + 0.25 * sum(zone.y) * (top.y[1] - top.y[0])
        height = body.size[2] + (bodies[body.load].size[2] if body.load >= 0 else 0.0) + MARGIN_M
        spots = []
        for level, (_, clearance) in enumerate(top.levels):
            if height <= clearance:
                for yaw in (0.0, 0.5 * math.pi):
                    spots += [(math.hypot(x - aim_x, y - aim_y), level, x, y, yaw) for x, y in _corners(body, yaw, taken[level], top)]
        for _, level, x, y, yaw in sorted(spots):
            body.x, body.y, body.yaw, body.bottom = x, y, yaw, top.levels[level][0]
            rectangle = _rectangle(body)
            if not any(_meet(rectangle, other) for other in taken[level]):
                taken[level].append(rectangle)
                break
        else:
            return False
    return True


def _corners(body: PlacedBox, yaw: float, taken: list[Rectangle], top: TopSurface) -> list[tuple[float, float]]:
    """Middles at which an object touches, along each axis, an edge of the top or an object that stands there [m]."""
    ways = []
    for axis, (half, (low, high)) in enumerate(zip(_reach(body.size, yaw), (top.x, top.y), strict=True)):
        low, high, away = low + half + MARGIN_M, high - half - MARGIN_M, half + CLEARANCE_M + 1e-9
        sides = [low, high]
        for other in taken:
            reach = other[4 + axis] if abs(other[2]) > 0.5 else other[5 - axis]
            sides += [other[axis] - reach - away, other[axis] + reach + away]
        ways.append([side for side in sides if low <= side <= high])
    return [(x, y) for x in ways[0] for y in ways[1]]
