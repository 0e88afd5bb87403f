"""Simulated annealing of a furnished room (Metropolis et al., 1953; Kirkpatrick et al., 1983), compiled.

Energy [m] of a state: the penetration depths of all counted pairs of pieces, plus a small price for every metre that
an object was moved or turned away. A move shifts or turns one object with all it carries; it is drawn from a symmetric
distribution and taken with probability min(1, exp(-change / temperature)).
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.optimization.search import arrangement
from tasks.optimization.search.arrangement import (
    FIXED,
    HANGING,
    STANDING,
    Arrangement,
    compose,
    displacement,
    evaluate,
    is_near,
    move_group,
    near_pairs,
    off_carrier,
    overlaps,
    put_row,
    restore,
    take_row,
)
from tasks.optimization.shapes import Stand, pair_depth

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


class AnnealingSchedule(NamedTuple):
    """How a chain runs. slop [m]: depth that only touches. step [m], turn [rad]: spread of moves at first. least_step,
    most_step [m]: bounds of the adapted spread. turn_share: share of turns among moves; rise_share: of moves up and down
    among the others, for what is carried. most_turn [rad]: farthest turn. most_rise [m]: highest rise over the carrier, or
    move up or down a wall. most_aside [m]: farthest slide along a wall. most_way [m]: farthest of what stands on the floor.
    price: of a metre of displacement, in metres of depth. temperature [m]: at first. cooling: factor per sweep.
    coldest [m]: then it is warmed up again. warmer: factor on the temperature each time. sweep: moves per active body.
    adapts: whether the spread of moves follows their acceptance. returns: whether objects are brought back towards
    their places once nothing overlaps."""

    slop: float
    step: float
    turn: float
    least_step: float
    most_step: float
    turn_share: float
    rise_share: float
    most_turn: float
    most_rise: float
    most_aside: float
    most_way: float
    price: float
    temperature: float
    cooling: float
    coldest: float
    warmer: float
    sweep: int
    adapts: bool
    returns: bool


class Record(NamedTuple):
    """Space for the moves that a chain keeps: body, move (dx, dy, dz, dyaw), loss [m] and smallest loss so far [m] after
    it, number of the move."""

    bodies: Integers
    moves: Array
    loss: Array
    smallest: Array
    numbers: Integers


@cache
def compiled() -> Kernels:
    """The functions below and those of `arrangement` as machine code, by name."""
    return compile_kernels(bring_back, widen, draw, anneal, known=arrangement.compiled())


def bring_back(
    room: Arrangement,
    plan: AnnealingSchedule,
    stand: Stand,
    kept: Stand,
    offset: Array,
    mark: Integers,
    record: Record,
    done: int,
    number: int,
) -> int:
    """Bring every object back towards its place as far as nothing overlaps, farthest first. Returns the moves recorded."""
    move, before, far = np.zeros(4), np.zeros(4), np.zeros(len(offset))
    for _ in range(2):
        for body in range(len(far)):
            far[body] = -np.sqrt(offset[body, 0] ** 2 + offset[body, 1] ** 2 + offset[body, 2] ** 2) - 0.1 * abs(offset[body, 3])
        for obj in np.argsort(far):
            if far[obj] > -1e-4 or done >= len(record.bodies):
                break
            take_row(before, offset, obj)
            low, high = 0.0, 1.0  # shares of the offset: known not to do, known to do
            for trip in range(7):
                share = 0.0 if trip == 0 else 0.5 * (low + high)
                for k in range(4):
                    move[k] = (share - 1.0) * before[k]
                move_group(room, stand, kept, offset, obj, move)
                if off_carrier(room, offset, obj, plan.most_turn, plan.most_rise, plan.most_aside, plan.most_way) or overlaps(
                    room, stand, obj, plan.slop, mark
                ):
                    low = share
                else:
                    high = share
                put_row(offset, obj, before)
                restore(room, stand, kept, obj)
                if high == 0.0:
                    break
            if high < 1.0:
                for k in range(4):
                    move[k] = (high - 1.0) * before[k]
                move_group(room, stand, kept, offset, obj, move)
                record.bodies[done], record.numbers[done] = obj, number
                put_row(record.moves, done, move)
                record.loss[done], record.smallest[done] = 0.0, 0.0
                done += 1
    return done


def widen(room: Arrangement, active: Booleans, pairs: Integers, loss: Array, neighbors: bool) -> int:
    """Mark the bodies that may be moved: those of overlapping pairs; with `neighbors` what is near them and carries them too."""
    n = len(room.parent)
    seed = active.copy()
    for pair in range(len(pairs)):
        if loss[pair] > 0.0:
            seed[pairs[pair, 0]] = seed[pairs[pair, 1]] = True
    for body in range(n):
        active[body] = active[body] or seed[body]
    if neighbors:
        for pair in range(len(pairs)):
            if seed[pairs[pair, 0]] or seed[pairs[pair, 1]]:
                active[pairs[pair, 0]] = active[pairs[pair, 1]] = True
        for body in range(n):
            if seed[body] and room.parent[body] >= 0:
                active[room.parent[body]] = True
    count = 0
    for body in range(n):
        active[body] = active[body] and room.kind[body] != FIXED
        count += int(active[body])
    return count


def draw(room: Arrangement, plan: AnnealingSchedule, obj: int, step: float, rng: Any, move: Array) -> None:
    """A move of an object, from a distribution that is the same forwards and backwards."""
    for k in range(4):
        move[k] = 0.0
    far = 4.0 if rng.random() < 0.1 else 1.0  # now and then a leap
    kind = room.kind[obj]
    if kind == HANGING:
        along = far * step * rng.normal()
        move[0], move[1] = along * room.along[obj, 0], along * room.along[obj, 1]
        move[2] = step * rng.normal()
    elif kind == STANDING and rng.random() < plan.turn_share:
        move[3] = far * step / plan.step * plan.turn * rng.normal()
    elif room.parent[obj] >= 0 and rng.random() < plan.rise_share:
        move[2] = 0.5 * step * rng.normal()
    else:
        move[0], move[1] = far * step * rng.normal(), far * step * rng.normal()


def anneal(
    room: Arrangement, plan: AnnealingSchedule, stand: Stand, kept: Stand, offset: Array, moves: int, rng: Any, record: Record
) -> tuple[int, int, float, float]:
    """Run a chain of at most so many moves, from no offsets. Fills `record` and `offset`, and leaves the state of the
    smallest loss. Returns the moves recorded, the moves tried, the loss at first [m] and the smallest [m]."""
    n = len(room.parent)
    mark, active, step = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.bool_), np.full(n, plan.step)
    tries, taken, move, before = np.zeros(n), np.zeros(n), np.zeros(4), np.zeros(4)
    price = np.zeros(n)
    for body in range(n):
        price[body] = displacement(room, stand, body)
    pairs, first, which = near_pairs(room, stand)
    built_low, built_high = stand.low.copy(), stand.high.copy()
    loss, trial, changed = np.zeros(len(pairs)), np.zeros(len(pairs)), np.zeros(len(pairs) + 1, dtype=np.int64)
    total, overlapping = 0.0, 0
    for pair in range(len(pairs)):
        loss[pair], _ = pair_depth(room.shapes, stand, pairs[pair, 0], pairs[pair, 1], plan.slop)
        total += loss[pair]
        overlapping += int(loss[pair] > 0.0)
    start, smallest, best, done, number, warmings = total, total, 0, 0, 0, 0
    count = widen(room, active, pairs, loss, False)
    if count == 0:
        count = widen(room, active, pairs, loss, True)
    temperature, in_sweep = plan.temperature, 0
    chosen = np.flatnonzero(active)
    while number < moves and overlapping > 0 and count > 0 and done < len(record.bodies):
        if in_sweep == plan.sweep * count:
            in_sweep = 0
            temperature *= plan.cooling
            if temperature < plan.coldest:
                warmings += 1
                temperature = plan.temperature * plan.warmer**warmings
                count = widen(room, active, pairs, loss, True)
            else:
                count = widen(room, active, pairs, loss, False)
            chosen = np.flatnonzero(active)
            total = 0.0
            for pair in range(len(pairs)):
                total += loss[pair]
        in_sweep += 1
        number += 1
        obj = chosen[rng.integers(0, count)]
        draw(room, plan, obj, step[obj], rng, move)
        take_row(before, offset, obj)
        move_group(room, stand, kept, offset, obj, move)
        tries[obj] += 1.0
        accepted = not off_carrier(room, offset, obj, plan.most_turn, plan.most_rise, plan.most_aside, plan.most_way)
        begin, end = room.first_carried[obj], room.first_carried[obj + 1]
        near = True
        for g in range(begin, end):
            near = near and is_near(stand, built_low, built_high, room.carried[g])
        if accepted and not near:  # new lists around the state before the move, then the move again
            put_row(offset, obj, before)
            restore(room, stand, kept, obj)
            pairs, first, which = near_pairs(room, stand)
            built_low, built_high = stand.low.copy(), stand.high.copy()
            loss, trial, changed = np.zeros(len(pairs)), np.zeros(len(pairs)), np.zeros(len(pairs) + 1, dtype=np.int64)
            for pair in range(len(pairs)):
                loss[pair], _ = pair_depth(room.shapes, stand, pairs[pair, 0], pairs[pair, 1], plan.slop)
            move_group(room, stand, kept, offset, obj, move)
            for g in range(begin, end):
                accepted = accepted and is_near(stand, built_low, built_high, room.carried[g])
        change, more, many, dearer = 0.0, 0, 0, 0.0
        if accepted:
            change, more, many = evaluate(room, stand, obj, plan.slop, pairs, first, which, loss, trial, mark, changed)
            for g in range(begin, end):
                dearer += displacement(room, stand, room.carried[g]) - price[room.carried[g]]
            energy = change + plan.price * dearer
            accepted = energy <= 0.0 or rng.random() < np.exp(-energy / temperature)
        if accepted:
            taken[obj] += 1.0
            for w in range(many):
                loss[changed[w]] = trial[changed[w]]
            for g in range(begin, end):
                price[room.carried[g]] = displacement(room, stand, room.carried[g])
            total, overlapping = max(total + change, 0.0), overlapping + more
            if overlapping == 0:
                total = 0.0
            record.bodies[done], record.numbers[done] = obj, number
            put_row(record.moves, done, move)
            done += 1
            if total < smallest - 1e-12 or overlapping == 0:
                smallest, best = total, done
            record.loss[done - 1], record.smallest[done - 1] = total, smallest
        else:
            put_row(offset, obj, before)
            restore(room, stand, kept, obj)
        if plan.adapts and tries[obj] >= 40.0:
            share = taken[obj] / tries[obj]
            if share > 0.4:
                step[obj] = min(1.3 * step[obj], plan.most_step)
            elif share < 0.2:
                step[obj] = max(step[obj] / 1.3, plan.least_step)
            tries[obj] = taken[obj] = 0.0
    if overlapping > 0 and plan.returns:  # back to the best state: its moves once more, in order
        for body in range(n):
            for c in range(4):
                offset[body, c] = 0.0
        done = best
        for k in range(done):
            for c in range(4):
                offset[record.bodies[k], c] += record.moves[k, c]
        for body in range(n):
            compose(room, stand, offset, body)
    elif overlapping == 0 and plan.returns:
        done = bring_back(room, plan, stand, kept, offset, mark, record, done, number)
    return done, number, start, smallest
