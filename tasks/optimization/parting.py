"""Slight overlaps that letting objects down has left are parted: other engines throw apart what starts in something else."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.optimization.contacts import Colliders, Penetration
from tasks.optimization.interior import Interior
from tasks.optimization.search.trace import Move, moved_poses
from tasks.optimization.support.resting import DEEP_M, lost_supports

Array = NDArray[np.float64]

APART_M = 1e-7
"""How far beyond its depth an overlap is parted [m]: rounding."""

LEVEL = 0.7
"""Least horizontal share of the way out of an overlap: what lies deeper in what carries it is lifted by other means."""

MOST_SHIFTS = 40
"""Shifts of a room; a room has no more than two or three such overlaps, and two may take turns."""


def part_slight(
    interior: Interior, poses: Array, met: Sequence[Penetration], allowed: Mapping[tuple[str, str], float], slop: float
) -> list[tuple[str, Move]]:
    """Level shifts of standing objects, each with all it carries, that part overlaps between `slop` and `DEEP_M` [m] at `poses`, (n, 4, 4).

    Of two the lighter in volume goes, else the other; what would be deeper in anything by that, or off its carrier, stays. met: the
    penetrations at `poses`. allowed: depths [m] to which pairs may be in each other, by their names.
    """
    colliders = Colliders(interior.solids, interior.shell)
    parents = {name: carrier.parent_id for name, carrier in zip(interior.names, interior.carriers, strict=True)}
    start = dict(zip(interior.names, poses, strict=True))
    moves: list[tuple[str, Move]] = []
    now = _excess(met, allowed, slop)
    lost = lost_supports(interior, poses) if now else set()
    for _ in range(MOST_SHIFTS):
        for move in _ways(interior, met, now):
            moved = moved_poses(start, parents, [*moves, move])
            there = np.array([moved[name] for name in interior.names])
            parted = colliders.penetrations(there)
            after = _excess(parted, allowed, slop)
            worse = any(depth > now.get(pair, 0.0) + APART_M for pair, depth in after.items())
            if not worse and sum(after.values()) < sum(now.values()) and lost_supports(interior, there) <= lost:
                moves, met, now = [*moves, move], parted, after
                break
        else:
            return moves
    return moves


def _excess(met: Sequence[Penetration], allowed: Mapping[tuple[str, str], float], slop: float) -> dict[tuple[str, str], float]:
    """Depths of what overlaps by more than it may [m], by pair."""
    return {(p.a, p.b): p.depth_m for p in met if p.depth_m > slop + allowed.get((p.a, p.b), 0.0)}


def _ways(interior: Interior, met: Sequence[Penetration], now: Mapping[tuple[str, str], float]) -> list[tuple[str, Move]]:
    """Shifts that would part one of the slight overlaps, those of the deepest first, and of a pair those of the smaller."""
    ways = []
    for p in sorted(met, key=lambda p: (-p.depth_m, p.a, p.b)):
        level = math.hypot(*p.direction[:2])
        if (p.a, p.b) not in now or p.depth_m > DEEP_M or level < LEVEL:
            continue
        way = (p.depth_m + APART_M) / level**2  # so that the part of it along the direction is the depth
        for at, sign in sorted(((p.index_a, 1.0), (p.index_b, -1.0)), key=lambda part: (_volume(interior, part[0]), part[0])):
            if at < len(interior.names) and may_shift(interior, at):
                shift = (sign * way * p.direction[0], sign * way * p.direction[1], 0.0)
                ways.append((interior.names[at], (*shift, 0.0, 0.0, 0.0)))
    return ways


def may_shift(interior: Interior, at: int) -> bool:
    """Whether an object stands free: what hangs stays at its wall, and what is built in or lies under others where it is."""
    stands = interior.carriers[at].relation in ("floor", "on", "inside")
    return stands and not interior.fixed[at] and not interior.covering[at]


def _volume(interior: Interior, at: int) -> float:
    """Of an object's box [m3]; without end for a part of the room."""
    return interior.volume(at) if at < len(interior.objects) else math.inf
