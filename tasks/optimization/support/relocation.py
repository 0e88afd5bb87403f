"""A last resort: what is still in something else is put at the nearest place where it overlaps nothing."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.pieces import Hull
from tasks.geometry.transforms import rotation_vector
from tasks.kernels import Kernels, compile_kernels
from tasks.optimization.contacts import Colliders
from tasks.optimization.interior import Interior
from tasks.optimization.search import arrangement
from tasks.optimization.search.arrangement import Arrangement, overlaps, restore
from tasks.optimization.search.collisions import plan_ring
from tasks.optimization.search.trace import Move
from tasks.optimization.shapes import Shapes, Stand, bound, cloth_gap, least_gap, stand_of
from tasks.optimization.solids import ConvexParts
from tasks.optimization.support import tipping
from tasks.optimization.support.balance import BASE_SHARE, EDGE_M, balance, base_of
from tasks.optimization.support.boundary import centers_inside
from tasks.optimization.support.resting import COVERING_M, DEEP_M, NEAR_M, Settling, center_as_turned, let_down
from tasks.optimization.support.tipping import CONTACT_M, MOST_POINTS, kept_shape, put_back, tip, turn_along

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]

CELLS_M = ((0.005, 0.1), (0.02, np.inf))
"""Grids of places, cell and reach [m]: fine near by, where a centimetre is a good part of the way."""

AROUND_M = 1.0
"""Where no room is known, objects stay within this of all the others [m]."""

MOST_RUG_M = 0.3
"""Rugs and cloths are put this far away at most [m]."""

MOST_TIPS = 20
"""Places at which an object may tip over before it is put where it cannot stand."""


MOST_ROUNDS = 4
"""How often what stood on an object that was put elsewhere may come down into something else."""


@dataclasses.dataclass(frozen=True)
class LastResort:
    """What was put elsewhere. moves: (object, move, outcome) as for a trace, in order. reasons: the same in words, by object.
    settling: how things stand in the end."""

    moves: list[tuple[int, Move, str]]
    reasons: dict[int, str]
    settling: Settling


@dataclasses.dataclass(frozen=True)
class Relocation:
    """An object that was put elsewhere: shift (3,) [m], then a rotation (3, 3) about its origin and a shift (3,) [m] where it
    was tipped there. on_floor: onto the floor, away from what carried it."""

    obj: int
    shift: Array
    rotation: Array
    settled: Array
    on_floor: bool


def last_resort(
    interior: Interior,
    solids: Sequence[ConvexParts],
    room: Arrangement,
    stand: Stand,
    settling: Settling,
    slop: float,
    most_tilt: float,
    nudge: float = 0.0,
    most_way: float = np.inf,
    anywhere: Collection[int] = (),
) -> LastResort:
    """Put objects that are still in others elsewhere (`relocate`), and let down again what stood on them.

    settling: how things stand before. slop, most_way, anywhere: as for `relocate`. most_tilt: what would tip farther stays [rad].
    nudge: what such a push [m/s] would throw over is laid down. Changes `room.shapes` and `stand`.
    """
    moves: list[tuple[int, Move, str]] = []
    elsewhere: list[int] = []
    floored: set[int] = set()
    for _ in range(MOST_ROUNDS):
        relocated = relocate(interior, solids, room, stand, slop, most_tilt, most_way, anywhere)
        if not relocated:
            break
        for move in relocated:
            moves.append((move.obj, _move(move.shift, np.eye(3)), "relocated"))
            if np.abs(move.rotation - np.eye(3)).max() > 0 or move.settled.any():
                moves.append((move.obj, _move(move.settled, move.rotation), "tipped"))
            elsewhere.append(move.obj)
            if move.on_floor:
                floored.add(move.obj)
        settling = let_down(interior, room.shapes, stand, most_tilt, nudge)
        moves += moves_of(settling)
    reasons = {}
    for i in dict.fromkeys(elsewhere):
        onto, way = " onto the floor" if i in floored else "", stand.place[i, :2] - interior.poses[i][:2, 3]
        reasons[i] = f"moved by {np.hypot(*way):.2f} m{onto}: no room for it where it was"
    return LastResort(moves, reasons, settling)


def moves_of(settling: Settling) -> list[tuple[int, Move, str]]:
    """What letting objects down did, as moves of a trace: (object, move, outcome)."""
    outcomes = (
        "laid_down" if at in settling.laid else "tipped" if np.abs(rotation - np.eye(3)).max() > 0 else "rested"
        for at, (_, _, rotation) in enumerate(settling.moves)
    )  # fmt: skip
    return [(i, _move(shift, rotation), outcome) for (i, shift, rotation), outcome in zip(settling.moves, outcomes, strict=True)]


def _move(shift: Array, rotation: Array) -> Move:
    """A shift (3,) [m] and a rotation (3, 3) as a move of a trace."""
    dx, dy, dz = shift.tolist()
    return (dx, dy, dz, *rotation_vector(rotation))


def relocate(
    interior: Interior, solids: Sequence[ConvexParts], room: Arrangement, stand: Stand, slop: float, most_tilt: float,
    most_way: float = np.inf, anywhere: Collection[int] = (),
) -> list[Relocation]:  # fmt: skip
    """Put objects of pairs that are deeper than `DEEP_M` in each other at the nearest place where they overlap nothing by more
    than `slop` [m], deepest pair first, `most_way` [m] away at most from where they came to rest in the room, or with what carries
    them; those `anywhere` that this does not help, as far as they must. Changes `room.shapes` and `stand`.

    Of a pair the smaller one goes, with all it carries; the other where that is fixed or fits nowhere. Places are looked for
    on what carries it, at the height at which it stands, then on the floor, within the room; where none is, the pair stays.
    """
    room = room._replace(counted=_all_pairs(interior, room))
    groups = interior.groups()
    done: list[Relocation] = []
    for reach, hopeless in ((most_way, set[int]()), *([(np.inf, set(range(len(groups))) - set(anywhere))] if anywhere else [])):
        while pair := next((p for p in _deep_pairs(solids, room, stand) if _movable(interior, groups, p, hopeless)), None):
            for i in _movable(interior, groups, pair, hopeless):
                made = _put_elsewhere(interior, room, stand, i, slop, most_tilt, reach)
                if made is not None:
                    done.append(made)
                    break
                hopeless.add(i)  # what is moved later takes room as often as it makes some
    return done


def _movable(interior: Interior, groups: Sequence[Sequence[int]], pair: tuple[int, int], hopeless: set[int]) -> list[int]:
    """Which objects of a pair may be put elsewhere, smaller first."""
    sides = [(i, other) for i, other in (pair, pair[::-1]) if i < len(groups) and i not in hopeless]
    return sorted((i for i, other in sides if not interior.fixed[i] and other not in groups[i]), key=lambda i: _size(interior, i))


def _all_pairs(interior: Interior, room: Arrangement) -> Booleans:
    """Pairs of bodies that must not overlap, rugs among them, shape (n, n)."""
    counted, n = room.counted.copy(), len(interior.objects)
    loose = np.flatnonzero(interior.covering & ~interior.fixed)
    counted[loose], counted[:, loose] = True, True
    counted[np.arange(len(counted)), np.arange(len(counted))] = False
    counted[n:, n:] = False
    return counted


def _deep_pairs(solids: Sequence[ConvexParts], room: Arrangement, stand: Stand) -> list[tuple[int, int]]:
    """Counted pairs deeper in each other than `DEEP_M`, deepest first."""
    pairs = []
    for a, b in np.argwhere(np.triu(room.counted, 1)).tolist():
        if compiled()["pair_depth"](room.shapes, stand, a, b, DEEP_M)[1] > DEEP_M:  # an upper bound
            placed = [_placed(solids[body], room.shapes, stand, body) for body in (a, b)]
            depth = max(
                (p.depth_m for p in Colliders(placed).penetrations(np.tile(np.eye(4), (2, 1, 1))) if p.b == placed[1].name), default=0.0
            )
            if depth > DEEP_M:
                pairs.append((-depth, a, b))
    return [(a, b) for _, a, b in sorted(pairs)]


def _placed(solid: ConvexParts, shapes: Shapes, stand: Stand, body: int) -> ConvexParts:
    """A body where it stands, as a solid in the world frame."""
    vertices, hulls = vertices_of(shapes, stand, body), []
    for hull in solid.hulls:
        hulls.append(Hull(vertices[: len(hull.vertices)], hull.faces))
        vertices = vertices[len(hull.vertices) :]
    return ConvexParts(solid.name, tuple(hulls))


def vertices_of(shapes: Shapes, stand: Stand, body: int) -> Array:
    """Vertices of a body in the world frame [m], shape (n, 3)."""
    first, last = shapes.first_piece[body], shapes.first_piece[body + 1]
    x, y, z = shapes.vertices[shapes.first_vertex[first] : shapes.first_vertex[last]].T
    c, s = stand.turn[body]
    return np.column_stack([c * x - s * y, s * x + c * y, z]) + stand.place[body]


def _size(interior: Interior, obj: int) -> tuple[float, int]:
    """What orders objects by size: the volume of the box."""
    return interior.volume(obj), obj


def _put_elsewhere(
    interior: Interior, room: Arrangement, stand: Stand, obj: int, slop: float, most_tilt: float, most_way: float
) -> Relocation | None:
    """Move an object, with what it carries, to the nearest place for it; None, and it stays, where there is none."""
    parent, bodies = int(interior.parent[obj]), len(stand.low)
    carrier, cloths = np.zeros((2, bodies), dtype=np.bool_)
    cloths[: len(interior.objects)] = interior.covering
    cloths[interior.groups()[obj]] = False
    if parent >= 0:
        carrier[parent] = True
    came_from = room.pivots[obj, :2] + (stand.place[parent, :2] - room.pivots[parent, :2] if parent >= 0 else 0.0)
    reach = max(most_way, float(np.hypot(*(stand.place[obj, :2] - came_from))))  # it may always be brought back
    if interior.covering[obj]:  # a rug lies where it was seen, or nowhere: with all that stands on it, it goes nowhere else
        reach = min(reach, MOST_RUG_M)
    shifts = _shifts(interior, room, stand, obj, came_from, reach)
    may_fall = float(stand.low[obj, 2]) <= most_way
    for is_strict in (True, False):  # where it stands nowhere, it may as well lie somewhere
        for on_floor in ((False, True) if may_fall else (False,)) if parent >= 0 else (True,):
            near = shifts if on_floor else _above(shifts, stand, obj, parent)
            spot = _first_place(interior, room, stand, obj, near, cloths if on_floor else carrier, on_floor, slop, most_tilt, is_strict)
            if spot is not None:
                return Relocation(obj, *spot, on_floor and parent >= 0)
    return None


def _shifts(interior: Interior, room: Arrangement, stand: Stand, obj: int, came_from: Array, most_way: float) -> Array:
    """Shifts (dx, dy) [m] of an object at which it lies within the room with all it carries and no farther than `most_way` from where it
    came from, nearest first, shape (n, 2)."""
    import shapely

    plan = np.concatenate([vertices_of(room.shapes, stand, body)[:, :2] for body in interior.groups()[obj]])
    n = len(interior.objects)
    if interior.ring is not None:
        ring = plan_ring(plan)
        center, region = ring.mean(axis=0), centers_inside(ring, interior.ring)
    else:
        center = plan.mean(axis=0)
        region = shapely.box(*(stand.low[:n, :2].min(axis=0) - AROUND_M), *(stand.high[:n, :2].max(axis=0) + AROUND_M))
    if region.is_empty:
        return np.zeros((0, 2))
    shapely.prepare(region)
    grids, low, high = [], *np.array(region.bounds).reshape(2, 2)
    for cell, reach in CELLS_M:
        lowest, highest = np.maximum(low - center, -reach), np.minimum(high - center, reach)
        x, y = (np.arange(np.ceil(lowest[k] / cell), np.floor(highest[k] / cell) + 1) * cell for k in range(2))
        grids.append(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2))
    shifts = np.concatenate(grids)
    shifts = shifts[np.hypot(*(stand.place[obj, :2] + shifts - came_from).T) <= most_way]
    shifts = shifts[shapely.intersects_xy(region, shifts + center)]
    return np.ascontiguousarray(shifts[np.lexsort((shifts[:, 1], shifts[:, 0], np.round(np.hypot(*shifts.T), 9)))])


def _above(shifts: Array, stand: Stand, obj: int, carrier: int) -> Array:
    """Those of some shifts, shape (n, 2) [m], that leave the middle of an object's box above or below its carrier's."""
    middle = 0.5 * (stand.low[obj, :2] + stand.high[obj, :2]) + shifts
    return np.ascontiguousarray(shifts[((middle >= stand.low[carrier, :2]) & (middle <= stand.high[carrier, :2])).all(axis=1)])


def _first_place(
    interior: Interior, room: Arrangement, stand: Stand, obj: int, shifts: Array, below: Booleans, on_floor: bool, slop: float,
    most_tilt: float, is_strict: bool,
) -> tuple[Array, Array, Array] | None:  # fmt: skip
    """The first of some shifts, shape (n, 2) [m], at which an object comes to rest without overlaps: its shift (3,) [m], and the
    rotation (3, 3) and shift (3,) [m] by which it is tipped there. Leaves it there; None leaves it where it was.

    `is_strict`: it must stand safely there.
    """
    kept, mark = stand_of(room.shapes, stand.place), np.zeros(len(stand.low), dtype=np.int64)
    origin, group = stand.place[obj].copy(), interior.groups()[obj]
    is_other = np.ones(len(stand.low), dtype=np.bool_)
    is_other[group] = False
    shape = [kept_shape(room.shapes, body) for body in group]
    at, tips = 0, 0
    for body in group:
        compiled()["save"](room, stand, kept, body)
    while at < len(shifts) and tips < MOST_TIPS:
        at = compiled()["next_place"](room, stand, kept, obj, shifts, at, below, on_floor, slop, mark) + 1
        if at == 0:
            return None
        if is_strict and not _is_safe(interior, room.shapes, stand, obj, below if not on_floor else is_other):
            continue
        there = stand.place[obj].copy()
        if not is_strict:
            return there - origin, np.eye(3), np.zeros(3)
        tips += 1
        made = tip(room.shapes, stand, obj, center_as_turned(interior, room.shapes, obj), is_other, most_tilt)
        if made is not None:
            for body in group[1:]:
                turn_along(room.shapes, stand, body, made, there)
            if not compiled()["overlaps"](room, stand, obj, DEEP_M, mark):
                return there - origin, made.rotation, made.shift
        for body, (vertices, normals) in zip(group, shape, strict=True):
            put_back(room.shapes, stand, body, vertices, normals, kept.place[body])
    for body in group:
        compiled()["save"](room, kept, stand, body)
    return None


def _is_safe(interior: Interior, shapes: Shapes, stand: Stand, obj: int, among: Booleans) -> bool:
    """Whether an object stands with its center of mass well within its contacts, or has no base that would allow that."""
    own = center_as_turned(interior, shapes, obj)[:2]  # as the base, before the object's yaw
    wanted = min(EDGE_M, BASE_SHARE * balance(base_of(shapes, stand, obj), own)[0])
    c, s = stand.turn[obj]
    center = stand.place[obj][:2] + np.array([c * own[0] - s * own[1], s * own[0] + c * own[1]])
    points = np.empty((MOST_POINTS, 3))
    count = compiled()["contact_points"](shapes, stand, obj, among, CONTACT_M, points)
    return wanted <= 0.0 or (count > 0 and balance(points[:count, :2], center)[0] >= wanted - 1e-6)


@cache
def compiled() -> Kernels:
    """The functions below and those of `arrangement` and `tipping` as machine code, by name."""
    known = {**tipping.compiled(), **arrangement.compiled()}
    called = {name: known[name] for name in ("bound", "cloth_gap", "least_gap", "overlaps", "restore", "save")}
    return known | compile_kernels(carry, next_place, known=called)


def carry(room: Arrangement, stand: Stand, obj: int, x: float, y: float, z: float) -> None:
    """Shift an object with all it carries [m]."""
    for g in range(room.first_carried[obj], room.first_carried[obj + 1]):
        body = room.carried[g]
        for k in range(3):
            way = x if k == 0 else (y if k == 1 else z)
            stand.place[body, k] += way
            stand.low[body, k] += way
            stand.high[body, k] += way
            for p in range(room.shapes.first_piece[body], room.shapes.first_piece[body + 1]):
                stand.piece_low[p, k] += way
                stand.piece_high[p, k] += way


def next_place(
    room: Arrangement, stand: Stand, kept: Stand, obj: int, shifts: Array, start: int, below: Booleans, on_floor: bool, slop: float,
    mark: Integers,
) -> int:  # fmt: skip
    """Number of the first of some shifts, shape (n, 2) [m], from `start` on, at which an object that comes down onto the bodies
    marked in `below`, and the floor if `on_floor`, overlaps nothing; -1 when there is none. Leaves it there, or as `kept`."""
    for number in range(start, len(shifts)):
        restore(room, stand, kept, obj)
        carry(room, stand, obj, shifts[number, 0], shifts[number, 1], 0.0)
        if on_floor:
            carry(room, stand, obj, 0.0, 0.0, -stand.low[obj, 2])
            gap = min(0.0, cloth_gap(room.shapes, stand, obj, below, COVERING_M))
        else:
            gap, _ = least_gap(room.shapes, stand, obj, below, NEAR_M)
            if abs(gap) > NEAR_M:
                continue
        carry(room, stand, obj, 0.0, 0.0, -gap)
        if not overlaps(room, stand, obj, slop, mark):
            for g in range(room.first_carried[obj], room.first_carried[obj + 1]):
                bound(room.shapes, stand, room.carried[g])
            return number
    restore(room, stand, kept, obj)
    return -1
