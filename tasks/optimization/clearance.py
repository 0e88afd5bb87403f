"""What stands beside something keeps a little clear of it: engines that inflate shapes push apart what touches.

Bullet adds a millimeter to every hull that it reads, so that neighbors without a gap start two millimeters in each other. Furniture that
touches a wall stays at it: a wall goes nowhere, and holds what Bullet lets drift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.mounting import LEANS
from tasks.optimization.default import WALL_M
from tasks.optimization.interior import Interior
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

UP = (0.0, 0.0, 1.0)
"""A way to look, not to go: what is right below the edge of something is pinched as soon as that gives way."""

LOOKS = (UP, *DIRECTIONS, *((x, y, 1.0) for x, y, _ in DIRECTIONS))
"""Where neighbors are looked for: above, beside, and beside what is above."""

WAYS_M = (CLEAR_M, 1.5 * CLEAR_M)
"""How far an object goes [m]: the longer one leaves a corner along both of its sides."""

FROM_BELOW_M = (0.005, 0.01, 0.02, 0.04)
"""How far it goes as well [m] if something is right above it."""

ROUNDING_M = 1e-5
"""Depths that differ by less are the same [m]."""


def keep_clear(interior: Interior, poses: Array, slop: float) -> list[tuple[str, Move]]:
    """Level shifts of standing objects, each with all it carries, after which fewer of their neighbors are nearer than `CLEAR_M` at
    `poses` [m], shape (n, 4, 4). Smaller ones go first; what leans stays where it leans, and what it may lean on beside it; nobody
    leaves what carries them, or goes deeper than `slop` [m] into anything. What is right below something goes farther, up to 4 cm.
    """
    walls = shell_solids(interior.room, WALL_M) if interior.room is not None else ()
    every = np.concatenate([poses, np.tile(np.eye(4), (len(walls), 1, 1))])
    shapes = shapes_of((*interior.solids, *walls), every)
    stand = stand_of(shapes, every[:, :3, 3])
    groups, moves = interior.groups(), []
    leans = np.array([_leans(interior, poses, i) for i in range(len(interior.names))], dtype=np.bool_)
    for at in sorted(range(len(interior.names)), key=lambda i: (_size(interior, i), i)):
        if leans[at] or not _may_go(interior, at):
            continue
        near = _neighbors(interior, stand, groups[at], at, CLEAR_M)
        if not near:
            continue
        near = _neighbors(interior, stand, groups[at], at, FROM_BELOW_M[-1] + CLEAR_M)
        free = [other for other in near if other < len(leans) and not leans[other]]
        now = _met(shapes, stand, groups[at], free, slop)
        way = _way_out(interior, shapes, stand, groups[at], at, near, free, now, slop) if any(now) else None
        if way is not None:
            shift(shapes, stand, groups[at], way)
            moves.append((interior.names[at], (*way, 0.0, 0.0, 0.0)))
    return moves


def _way_out(
    interior: Interior, shapes: Shapes, stand: Stand, group: Sequence[int], at: int, near: Sequence[int], free: Sequence[int],
    now: Sequence[bool], slop: float,
) -> Vector | None:  # fmt: skip
    """The shift [m] after which something of `free` is met in the fewest directions, the shortest of these; None where none is better than
    to stay, or free of what is `near`."""
    depth, is_carried = _depth(shapes, stand, group, near, slop), _is_carried(interior, shapes, stand, at)
    best, fewest = None, sum(now)
    for length in (*WAYS_M, *(FROM_BELOW_M if now[0] else ())):
        for direction in DIRECTIONS:
            way = _scaled(direction, length)
            shift(shapes, stand, group, way)
            is_free = _depth(shapes, stand, group, near, slop) <= depth + ROUNDING_M
            if is_free and (not is_carried or _is_carried(interior, shapes, stand, at)):
                met = sum(_met(shapes, stand, group, free, slop))
                if met < fewest:
                    best, fewest = way, met
            shift(shapes, stand, group, _scaled(way, -1.0))
    return best


def _met(shapes: Shapes, stand: Stand, group: Sequence[int], near: Sequence[int], slop: float) -> list[bool]:
    """Whether something is nearer than `CLEAR_M`, by direction of `LOOKS`."""
    if not near:
        return []
    depth, met = _depth(shapes, stand, group, near, slop), []
    for direction in LOOKS:
        way = _scaled(direction, CLEAR_M)
        shift(shapes, stand, group, way)
        met.append(_depth(shapes, stand, group, near, slop) > depth + ROUNDING_M)
        shift(shapes, stand, group, _scaled(way, -1.0))
    return met


def _scaled(way: Vector, factor: float) -> Vector:
    x, y, z = way
    return factor * x, factor * y, factor * z


def _depth(shapes: Shapes, stand: Stand, group: Sequence[int], near: Sequence[int], slop: float) -> float:
    """Sum of the depths beyond `slop` of a group in its neighbors [m]."""
    pair_depth = compiled()["pair_depth"]
    return float(sum(pair_depth(shapes, stand, body, other, slop)[0] for body in group for other in near))


def _neighbors(interior: Interior, stand: Stand, group: Sequence[int], at: int, reach: float) -> list[int]:
    """Bodies whose boxes are within `reach` [m] of a group's, but for the group, what carries it, and rugs."""
    low, high = stand.low[list(group)].min(axis=0), stand.high[list(group)].max(axis=0)
    is_near = ((stand.low <= high + reach) & (stand.high >= low - reach)).all(axis=1)
    is_near[list(group)] = False
    is_near[: len(interior.names)] &= ~interior.covering
    if interior.parent[at] >= 0 and interior.carriers[at].relation != "inside":
        is_near[interior.parent[at]] = False
    return [int(i) for i in np.flatnonzero(is_near)]


def _is_carried(interior: Interior, shapes: Shapes, stand: Stand, at: int) -> bool:
    """Whether an object stands on what carries it."""
    return min(map(abs, gap_to_carrier(interior, shapes, stand, at))) <= KEPT_M


def _may_go(interior: Interior, at: int) -> bool:
    """Whether an object stands free."""
    return interior.carriers[at].relation in ("floor", "on", "inside") and not interior.fixed[at] and not interior.covering[at]


def _leans(interior: Interior, poses: Array, at: int) -> bool:
    """Whether an object may lean on what is beside it: it is tilted, or one of those that lean."""
    return float(poses[at][2, 2]) < UPRIGHT_COSINE or interior.objects[at].category in LEANS


def _size(interior: Interior, at: int) -> float:
    """Volume of an object's box [m3]."""
    return float(np.prod(interior.objects[at].high - interior.objects[at].low))
