"""A room whose objects may be moved: what may move how, what must not overlap, and the compiled bookkeeping of a move."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.optimization import shapes
from tasks.optimization.shapes import Shapes, Stand, bound, pair_depth

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

FIXED, STANDING, HANGING, OVERHEAD = 0, 1, 2, 3
"""How a body may move: not at all; along x, y and turning; along its wall and z; along x and y."""


class Arrangement(NamedTuple):
    """A room at rest before any move. n bodies, the room's walls among them; parents come before what they carry.

    pivots: [m], shape (n, 3). counted: pairs that must not overlap, shape (n, n). parent: index of the carrier or -1,
    shape (n,). first_carried, carried: body i with all that moves along is `carried[first_carried[i]:first_carried[i + 1]]`,
    carriers first. kind: how it may move, shape (n,). along: unit direction of its wall, shape (n, 2). map_of: which of
    `maps` says where it may stand on its carrier, or -1, shape (n,). maps: shape (m, 2 k + 1, 2 k + 1), in cells of
    `cell` [m] around its place. lever: what a turn by one radian costs in metres, shape (n,).
    """

    shapes: Shapes
    pivots: Array
    counted: Booleans
    parent: Integers
    first_carried: Integers
    carried: Integers
    kind: Integers
    along: Array
    map_of: Integers
    maps: Booleans
    cell: float
    lever: Array


REACH_M = 0.3
"""Pairs whose boxes are farther apart than this are not looked at until one has come nearer [m]."""


@cache
def compiled() -> Kernels:
    """The functions below and those of `shapes` as machine code, by name."""
    moving = (compose, put_row, take_row, save, restore, displacement, move_group)
    return compile_kernels(*moving, off_carrier, near_pairs, is_near, evaluate, overlaps, known=shapes.compiled())


def compose(room: Arrangement, stand: Stand, offset: Array, body: int) -> None:
    """Put a body where its own offset (x, y, z [m], yaw [rad]), shape (n, 4), and its carrier's stand have it."""
    c, s = np.cos(offset[body, 3]), np.sin(offset[body, 3])
    x, y, z = room.pivots[body, 0] + offset[body, 0], room.pivots[body, 1] + offset[body, 1], room.pivots[body, 2] + offset[body, 2]
    carrier = room.parent[body]
    if carrier >= 0:
        cc, cs = stand.turn[carrier, 0], stand.turn[carrier, 1]
        x, y, z = x - room.pivots[carrier, 0], y - room.pivots[carrier, 1], z - room.pivots[carrier, 2]
        x, y = cc * x - cs * y + stand.place[carrier, 0], cs * x + cc * y + stand.place[carrier, 1]
        z += stand.place[carrier, 2]
        c, s = cc * c - cs * s, cs * c + cc * s
    stand.turn[body, 0], stand.turn[body, 1] = c, s
    stand.place[body, 0], stand.place[body, 1], stand.place[body, 2] = x, y, z
    bound(room.shapes, stand, body)


def put_row(rows: Array, row: int, values: Array) -> None:
    """Set a row. A loop: machine code of NumPy's assignment takes seconds to make."""
    for k in range(values.shape[0]):
        rows[row, k] = values[k]


def take_row(values: Array, rows: Array, row: int) -> None:
    """Set values to those of a row."""
    for k in range(values.shape[0]):
        values[k] = rows[row, k]


def save(room: Arrangement, stand: Stand, kept: Stand, body: int) -> None:
    """Remember where a body stands."""
    for k in range(2):
        kept.turn[body, k] = stand.turn[body, k]
    for k in range(3):
        kept.place[body, k], kept.low[body, k], kept.high[body, k] = stand.place[body, k], stand.low[body, k], stand.high[body, k]
    for p in range(room.shapes.first_piece[body], room.shapes.first_piece[body + 1]):
        for k in range(3):
            kept.piece_low[p, k], kept.piece_high[p, k] = stand.piece_low[p, k], stand.piece_high[p, k]


def restore(room: Arrangement, stand: Stand, kept: Stand, obj: int) -> None:
    """Put an object and all it carries back where it was remembered."""
    for g in range(room.first_carried[obj], room.first_carried[obj + 1]):
        save(room, kept, stand, room.carried[g])


def displacement(room: Arrangement, stand: Stand, body: int) -> float:
    """How far a body stands from where it was [m], turns counted by its lever."""
    dx, dy = stand.place[body, 0] - room.pivots[body, 0], stand.place[body, 1] - room.pivots[body, 1]
    dz = stand.place[body, 2] - room.pivots[body, 2]
    dc, ds = stand.turn[body, 0] - 1.0, stand.turn[body, 1]
    return float(np.sqrt(dx * dx + dy * dy + dz * dz) + room.lever[body] * np.sqrt(dc * dc + ds * ds))


def off_carrier(
    room: Arrangement, offset: Array, body: int, most_turn: float, most_rise: float, most_aside: float, most_way: float
) -> bool:
    """Whether an object stands where its carrier does not carry it, or is turned, raised, moved or slid along its wall too far."""
    if abs(offset[body, 3]) > most_turn:
        return True
    if room.kind[body] == HANGING:
        aside = np.sqrt(offset[body, 0] ** 2 + offset[body, 1] ** 2)
        return bool(aside > most_aside or abs(offset[body, 2]) > most_rise)
    which = room.map_of[body]
    if which < 0:
        return bool(offset[body, 0] ** 2 + offset[body, 1] ** 2 > most_way**2)
    if offset[body, 2] < 0.0 or offset[body, 2] > most_rise:
        return True
    reach = (room.maps.shape[1] - 1) // 2
    i = int(np.floor(offset[body, 0] / room.cell + 0.5)) + reach
    j = int(np.floor(offset[body, 1] / room.cell + 0.5)) + reach
    return bool(i < 0 or j < 0 or i > 2 * reach or j > 2 * reach or not room.maps[which, i, j])


def near_pairs(room: Arrangement, stand: Stand) -> tuple[Integers, Integers, Integers]:
    """Counted pairs whose boxes are within reach, shape (m, 2), and those of every body: first (n + 1,), which (2 m,)."""
    n = len(room.parent)
    for fill in range(2):
        if fill == 0:
            first = np.zeros(n + 1, dtype=np.int64)
        else:
            pairs, which, at = np.empty((first[n] // 2, 2), dtype=np.int64), np.empty(first[n], dtype=np.int64), first[:n].copy()
        count = 0
        for a in range(n):
            for b in range(a + 1, n):
                if not room.counted[a, b]:
                    continue
                near = True
                for k in range(3):
                    near = near and stand.low[a, k] <= stand.high[b, k] + REACH_M and stand.low[b, k] <= stand.high[a, k] + REACH_M
                if not near:
                    continue
                if fill == 0:
                    first[a + 1] += 1
                    first[b + 1] += 1
                else:
                    pairs[count, 0], pairs[count, 1] = a, b
                    which[at[a]] = which[at[b]] = count
                    at[a] += 1
                    at[b] += 1
                    count += 1
        if fill == 0:
            for a in range(n):
                first[a + 1] += first[a]
    return pairs, first, which


def is_near(stand: Stand, built_low: Array, built_high: Array, body: int) -> bool:
    """Whether a body is still where its list of pairs holds: two such bodies are no nearer than the reach allows."""
    for k in range(3):
        if stand.low[body, k] < built_low[body, k] - 0.5 * REACH_M or stand.high[body, k] > built_high[body, k] + 0.5 * REACH_M:
            return False
    return True


def evaluate(
    room: Arrangement, stand: Stand, obj: int, slop: float, pairs: Integers, first: Integers, which: Integers, loss: Array, trial: Array,
    mark: Integers, changed: Integers,
) -> tuple[float, int, int]:  # fmt: skip
    """Losses of the pairs that a move of an object changes, into `trial`. Returns the change of the sum [m], of the number
    of overlapping pairs, and how many pairs are in `changed`."""
    change, overlapping, count = 0.0, 0, 0
    begin, end = room.first_carried[obj], room.first_carried[obj + 1]
    for g in range(begin, end):
        mark[room.carried[g]] = 1
    for g in range(begin, end):
        body = room.carried[g]
        for w in range(first[body], first[body + 1]):
            pair = which[w]
            other = pairs[pair, 0] + pairs[pair, 1] - body
            if mark[other] == 1:  # moves along: nothing changes between the two
                continue
            now, _ = pair_depth(room.shapes, stand, body, other, slop)
            trial[pair] = now
            changed[count] = pair
            count += 1
            change += now - loss[pair]
            overlapping += int(now > 0.0) - int(loss[pair] > 0.0)
    for g in range(begin, end):
        mark[room.carried[g]] = 0
    return change, overlapping, count


def move_group(room: Arrangement, stand: Stand, kept: Stand, offset: Array, obj: int, move: Array) -> None:
    """Move an object with all it carries, remembering where it stood."""
    for k in range(4):
        offset[obj, k] += move[k]
    for g in range(room.first_carried[obj], room.first_carried[obj + 1]):
        save(room, stand, kept, room.carried[g])
        compose(room, stand, offset, room.carried[g])


def overlaps(room: Arrangement, stand: Stand, obj: int, slop: float, mark: Integers) -> bool:
    """Whether an object, or anything that it carries, overlaps anything else that counts."""
    begin, end = room.first_carried[obj], room.first_carried[obj + 1]
    for g in range(begin, end):
        mark[room.carried[g]] = 1
    any_overlap = False
    for g in range(begin, end):
        body = room.carried[g]
        for other in range(len(room.parent)):
            if room.counted[body, other] and mark[other] == 0:
                total, _ = pair_depth(room.shapes, stand, body, other, slop)
                any_overlap = any_overlap or total > 0.0
    for g in range(begin, end):
        mark[room.carried[g]] = 0
    return any_overlap
