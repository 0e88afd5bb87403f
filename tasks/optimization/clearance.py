"""What stands beside something keeps a little clear of it: engines that inflate shapes push apart what touches.

Bullet adds a millimeter to every hull that it reads, so that neighbors without a gap start two millimeters in each other. What stands at
a wall stays at it: a wall goes nowhere, and holds what Bullet lets drift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.mounting import LEANS
from tasks.optimization.default import WALL_M
from tasks.optimization.interior import Interior
from tasks.optimization.parting import may_shift
from tasks.optimization.search.trace import Move
from tasks.optimization.shapes import Shapes, Stand, shapes_of, stand_of
from tasks.optimization.solids import shell_solids
from tasks.optimization.support.resting import KEPT_M, gap_to_carrier, shift
from tasks.optimization.support.tipping import compiled

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

CLEAR_M = 0.002
"""Gap between neighbors [m]: a millimeter of each."""

UPRIGHT_COSINE = math.cos(math.radians(1.0))
"""What is tilted by more leans on something, and touches it."""

DIRECTIONS = tuple((math.cos(k * math.pi / 4), math.sin(k * math.pi / 4), 0.0) for k in range(8))
"""Level ways to look for neighbors, and to go."""

UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
"""Ways to look, not to go: what is right below the edge of something is pinched as soon as that gives way, and has to be held."""

LOOKS = (UP, DOWN, *DIRECTIONS, *((x, y, 1.0) for x, y, _ in DIRECTIONS))
"""Where neighbors are looked for: above, below, beside, and beside what is above."""

WAYS_M = (CLEAR_M, 1.5 * CLEAR_M)
"""How far an object goes [m]: the longer one leaves a corner along both of its sides."""

FROM_BELOW_M = (0.005, 0.01, 0.02, 0.04)
"""How far it goes as well [m] if something that stands beside it is right above it."""

SAME_LEVEL_M = 0.01
"""What stands beside an object begins this near to its own height [m]; what begins higher may lie on it."""

ROUNDING_M = 1e-5
"""Depths that differ by less are the same [m]."""


def keep_clear(interior: Interior, poses: Array, slop: float) -> list[tuple[str, Move]]:
    """Level shifts of standing objects, each with all it carries, after which they have others within `CLEAR_M` in fewer directions, at
    `poses` [m], shape (n, 4, 4).

    Smaller ones go first. What leans stays where it leans, and what it may lean on beside it; what stands at a wall stays at that; nobody
    leaves what carries them, and no pair gets deeper into each other by that than `slop` [m], or than it was. What is right below
    something that stands beside it goes farther, up to 4 cm, if it stays within the outline of what carries it.
    """
    walls = shell_solids(interior.room, WALL_M) if interior.room is not None else ()
    every = np.concatenate([poses, np.tile(np.eye(4), (len(walls), 1, 1))])
    shapes = shapes_of((*interior.solids, *walls), every)
    stand = stand_of(shapes, every[:, :3, 3])
    groups, moves = interior.groups(), []
    leans = np.array([_leans(interior, poses, i) for i in range(len(interior.names))], dtype=np.bool_)
    for at in sorted(range(len(interior.names)), key=lambda i: (interior.volume(i), i)):
        if leans[at] or not may_shift(interior, at) or not _beside(interior, stand, groups[at], at, leans, CLEAR_M):
            continue
        way = _way_out(interior, shapes, stand, groups[at], at, leans, slop)
        if way is not None:
            shift(shapes, stand, groups[at], way)
            moves.append((interior.names[at], (*way, 0.0, 0.0, 0.0)))
    return moves


def _way_out(
    interior: Interior, shapes: Shapes, stand: Stand, group: Sequence[int], at: int, leans: NDArray[np.bool_], slop: float
) -> Vector | None:
    """The shift [m] after which nothing is met above or below and something beside in the fewest directions, the shortest of these; None
    where it is best to stay."""
    reach = FROM_BELOW_M[-1] + CLEAR_M
    near, beside = _near(stand, group, reach), _beside(interior, stand, group, at, leans, reach)
    walls = [other for other in near if other >= len(interior.names)]
    now, at_walls = _met(interior, shapes, stand, group, beside, slop), _met(interior, shapes, stand, group, walls, slop)
    if not now.any():
        return None
    depths, is_carried = _depths(shapes, stand, group, near, slop), _is_carried(interior, shapes, stand, at)
    was_within = _is_within(interior, stand, at)
    best, fewest = None, int(now.sum())
    for length in (*WAYS_M, *(FROM_BELOW_M if now[0] else ())):
        for direction in DIRECTIONS:
            way = _scaled(direction, length)
            shift(shapes, stand, group, way)
            is_free = bool((_depths(shapes, stand, group, near, slop) <= depths + ROUNDING_M).all())
            stays = not is_carried or _is_carried(interior, shapes, stand, at)
            stays = stays and (length <= WAYS_M[-1] or not was_within or _is_within(interior, stand, at))
            if is_free and stays and bool((_met(interior, shapes, stand, group, walls, slop) >= at_walls).all()):
                met = _met(interior, shapes, stand, group, beside, slop)
                if not met[:2].any() and met.sum() < fewest:
                    best, fewest = way, int(met.sum())
            shift(shapes, stand, group, _scaled(way, -1.0))
    return best


def _met(
    interior: Interior, shapes: Shapes, stand: Stand, group: Sequence[int], neighbors: Sequence[int], slop: float
) -> NDArray[np.bool_]:
    """Whether one of some bodies is nearer than `CLEAR_M`, by direction of `LOOKS`; above only what does not lie on the group."""
    met = np.zeros(len(LOOKS), dtype=np.bool_)
    above = [other for other in neighbors if not _may_lie_on(interior, shapes, stand, other, group[0])]
    last = 2 + len(DIRECTIONS)
    for sides, looks in ((neighbors, range(1, last)), (above, (0, *range(last, len(LOOKS))))):
        if not sides:
            continue
        depths = _depths(shapes, stand, group, sides, slop)
        for look in looks:
            way = _scaled(LOOKS[look], CLEAR_M)
            shift(shapes, stand, group, way)
            met[look] = bool((_depths(shapes, stand, group, sides, slop) > depths + ROUNDING_M).any())
            shift(shapes, stand, group, _scaled(way, -1.0))
    return met


def _may_lie_on(interior: Interior, shapes: Shapes, stand: Stand, other: int, at: int) -> bool:
    """Whether a body may need an object below it as a second support: it begins above where that begins, and stands on what carries it,
    but not with its middle. What hangs does not need it, and what is off its own carrier was propped up by mistake."""
    if other >= len(interior.names) or float(stand.low[other, 2] - stand.low[at, 2]) <= SAME_LEVEL_M:
        return False
    carrier, middle = int(interior.parent[other]), 0.5 * (stand.low[other, :2] + stand.high[other, :2])
    is_off = carrier >= 0 and bool((middle < stand.low[carrier, :2]).any() or (middle > stand.high[carrier, :2]).any())
    return is_off and interior.carriers[other].relation in ("on", "inside") and _is_carried(interior, shapes, stand, other)


def _scaled(way: Vector, factor: float) -> Vector:
    x, y, z = way
    return factor * x, factor * y, factor * z


def _depths(shapes: Shapes, stand: Stand, group: Sequence[int], neighbors: Sequence[int], slop: float) -> Array:
    """Depths beyond `slop` of the bodies of a group in its neighbors [m], shape (bodies, neighbors)."""
    pair_depth = compiled()["pair_depth"]
    return np.array([[pair_depth(shapes, stand, body, other, slop)[1] for other in neighbors] for body in group]).reshape(len(group), -1)


def _near(stand: Stand, group: Sequence[int], reach: float) -> list[int]:
    """Bodies, but for the group, whose boxes are within `reach` [m] of its own."""
    low, high = stand.low[list(group)].min(axis=0), stand.high[list(group)].max(axis=0)
    is_near = ((stand.low <= high + reach) & (stand.high >= low - reach)).all(axis=1)
    is_near[list(group)] = False
    return [int(i) for i in np.flatnonzero(is_near)]


def _beside(interior: Interior, stand: Stand, group: Sequence[int], at: int, leans: NDArray[np.bool_], reach: float) -> list[int]:
    """What a group is to keep clear of: objects near by, but for rugs, what carries it, and what may lean on it."""
    carrier = int(interior.parent[at]) if interior.carriers[at].relation != "inside" else -1
    return [i for i in _near(stand, group, reach) if i < len(leans) and i != carrier and not leans[i] and not interior.covering[i]]


def _is_within(interior: Interior, stand: Stand, at: int) -> bool:
    """Whether the outline of an object lies within that of what carries it; the floor carries everywhere."""
    carrier = int(interior.parent[at])
    low, high = stand.low[at, :2], stand.high[at, :2]
    return carrier < 0 or bool((low >= stand.low[carrier, :2]).all() and (high <= stand.high[carrier, :2]).all())


def _is_carried(interior: Interior, shapes: Shapes, stand: Stand, at: int) -> bool:
    """Whether an object stands on what carries it."""
    return min(map(abs, gap_to_carrier(interior, shapes, stand, at))) <= KEPT_M


def _leans(interior: Interior, poses: Array, at: int) -> bool:
    """Whether an object may lean on what is beside it: it is tilted, or one of those that lean."""
    return float(poses[at][2, 2]) < UPRIGHT_COSINE or interior.objects[at].category in LEANS
