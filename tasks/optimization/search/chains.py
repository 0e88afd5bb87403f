"""Chains of simulated annealing, each with a generator of its own; the best of them is kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.optimization.search.annealing import AnnealingSchedule, Record, compiled
from tasks.optimization.search.arrangement import Arrangement
from tasks.optimization.shapes import stand_of
from tasks.stage import in_turn

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Chain:
    """What a chain came to: every move it kept (bodies (m,), moves (m, 4) as dx, dy, dz [m] and dyaw [rad], loss and
    smallest loss after it [m], number of the move), moves tried, the loss at first and in the end [m], and the mean
    displacement of all bodies [m]."""

    bodies: NDArray[np.int64]
    moves: Array
    loss: Array
    smallest: Array
    numbers: NDArray[np.int64]
    tried: int
    start: float
    final: float
    displacement: float


def run_chain(job: tuple[Arrangement, AnnealingSchedule, int, int, np.random.Generator]) -> Chain:
    """One chain: a room, its schedule, the most moves to try and to keep, and a generator. Runs in any process."""
    room, schedule, max_moves, max_kept, rng = job
    functions = compiled()
    stand, kept = stand_of(room.shapes, room.pivots), stand_of(room.shapes, room.pivots)
    offset = np.zeros((len(room.parent), 4))
    most = min(max_moves, max_kept) + 2 * len(room.parent)
    integers = np.zeros(most, dtype=np.int64)
    record = Record(integers, np.zeros((most, 4)), np.zeros(most), np.zeros(most), integers.copy())
    done, tried, start, final = functions["anneal"](room, schedule, stand, kept, offset, max_moves, rng, record)
    away = np.linalg.norm((stand.place - room.pivots)[:, :2], axis=1)
    return Chain(
        record.bodies[:done], record.moves[:done], record.loss[:done], record.smallest[:done], record.numbers[:done],
        int(tried), float(start), float(final), float(away.mean()) if len(away) else 0.0,
    )  # fmt: skip


def anneal(
    room: Arrangement, schedule: AnnealingSchedule, max_moves: int, max_kept: int, generators: Sequence[np.random.Generator],
    spread: Callable[[Any, Sequence[Any]], list[Any]],
) -> tuple[Chain, int]:  # fmt: skip
    """The best of several chains: the smallest loss, then the least displacement; and the moves that all of them tried.

    `spread` maps a function over jobs, in other processes if it can; the result is the same.
    """
    jobs = [(room, schedule, max_moves, max_kept, rng) for rng in generators]
    first = run_chain(jobs[0])
    if first.start == 0.0:  # nothing overlaps: all chains would say so
        return first, 0
    # where the first one has found a way, the others are over before a process has started
    chains = [first, *(in_turn if first.final == 0.0 else spread)(run_chain, jobs[1:])]
    best = min(range(len(chains)), key=lambda c: (chains[c].final, chains[c].displacement, c))
    return chains[best], sum(chain.tried for chain in chains)
