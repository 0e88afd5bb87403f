"""Algorithm 1 in plain Python: what the compiled loop is measured against, move by move.

It is the algorithm of `tasks.optimization.released`: carried objects move along and stay on
their carriers, hung objects do not move, moves out of the room are undone, and the loop ends once no move helps. Of the
optimization it uses the drawn room, the four moves, the names of outcomes and the limits of rounding; losses and outlines are
computed anew, without numpy, for all pairs at every move.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tasks.optimization.search.collisions import MOVES, OUTCOMES, Crowd, Trace, descend, room_triangles, stacked
from tasks.optimization.search.descent import ROUNDING_M2, ROUNDING_M3, TOUCH_M

Point = tuple[float, float]
Loop = Callable[[Crowd, float, int, np.random.Generator], Trace]

AREA_PER_OBJECT_M2 = 0.75
"""Floor of a drawn room for every object in it: 39 objects have 29 m2, a full living room."""

REPEATS = 5
"""Runs of every loop that is timed; their median counts."""


def descend_plainly(crowd: Crowd, step: float, max_steps: int, rng: np.random.Generator) -> Trace:
    """`tasks.optimization.search.collisions.descend`, with the loss of all pairs summed anew at every move. Step in [m]."""
    movable = np.flatnonzero(crowd.movable)
    if not len(movable) or max_steps <= 0:
        movable, max_steps = np.zeros(1, dtype=np.int64), 0
    objects = movable[rng.integers(0, len(movable), max_steps)].tolist()
    directions = rng.integers(0, 4, max_steps).tolist()
    first_low, first_high, counted = crowd.low.tolist(), crowd.high.tolist(), crowd.counted.tolist()
    rings = [ring[:count].tolist() for ring, count in zip(crowd.outlines, crowd.corners, strict=True)]
    triangles, carrier, shifts = crowd.room.tolist(), crowd.carrier.tolist(), crowd.shifts.tolist()
    carries = [np.flatnonzero(row).tolist() for row in crowd.carries]
    moved = [[0, 0] for _ in first_low]
    boxes = [(list(low), list(high)) for low, high in zip(first_low, first_high, strict=True)]

    def put(i: int) -> None:
        low, high = boxes[i]
        for k in range(2):
            low[k], high[k] = first_low[i][k] + moved[i][k] * step, first_high[i][k] + moved[i][k] * step

    def outside(i: int) -> float:
        x, y = rings[i][0]
        dx, dy = moved[i][0] * step, moved[i][1] * step
        room = [[(a - x - dx, b - y - dy) for a, b in triangle] for triangle in triangles]
        ring = [(a - x, b - y) for a, b in rings[i]]
        return area(ring) - sum(area(clipped(ring, triangle)) for triangle in room) if room else 0.0

    def off_support(i: int) -> bool:
        if carrier[i] < 0:
            return False
        reach = (len(shifts[i]) - 1) // 2
        across, along = (moved[i][k] - moved[carrier[i]][k] + reach for k in range(2))
        return not (0 <= across <= 2 * reach and 0 <= along <= 2 * reach and shifts[i][across][along])

    was_outside = [outside(i) for i in range(len(boxes))]
    smallest = start = loss_of(boxes, counted)
    trace: list[tuple[float, float, int]] = []
    tried: set[tuple[int, int]] = set()
    for obj, direction in zip(objects, directions, strict=True):
        if smallest == 0 or len(tried) == 4 * int(crowd.movable.sum()):
            break
        dx, dy = MOVES[direction].tolist()
        for i in carries[obj]:
            moved[i] = [moved[i][0] + dx, moved[i][1] + dy]
            put(i)
        is_outside = [outside(i) for i in carries[obj]]
        loss = smallest
        if any(now > was_outside[i] + ROUNDING_M2 for i, now in zip(carries[obj], is_outside, strict=True)):
            outcome = "left_room"
        elif off_support(obj):
            outcome = "left_support"
        else:
            loss = loss_of(boxes, counted)
            outcome = "kept" if loss < smallest - ROUNDING_M3 else "reverted"
        if outcome == "kept":
            smallest, tried = loss, set()
            for i, now in zip(carries[obj], is_outside, strict=True):
                was_outside[i] = now
        else:
            tried.add((obj, direction))
            for i in carries[obj]:
                moved[i] = [moved[i][0] - dx, moved[i][1] - dy]
                put(i)
        trace.append((loss, smallest, OUTCOMES.index(outcome)))
    count = len(trace)
    return Trace(
        objects=np.array(objects[:count], dtype=np.int64),
        moves=MOVES[directions[:count]],
        loss=np.array([row[0] for row in trace]),
        smallest=np.array([row[1] for row in trace]),
        outcome=np.array([row[2] for row in trace], dtype=np.int64),
        moved=np.array(moved, dtype=np.int64).reshape(-1, 2),
        start=start,
        exhausted=smallest > 0 and len(tried) == 4 * int(crowd.movable.sum()),
    )


def loss_of(boxes: list[tuple[list[float], list[float]]], counted: list[list[bool]]) -> float:
    """Sum of the volumes in which two boxes of (low, high) corners overlap, over all pairs that count [m3] (equation A1)."""
    total = 0.0
    for i, (low, high) in enumerate(boxes):
        for j in range(i + 1, len(boxes)):
            if counted[i][j]:
                other_low, other_high = boxes[j]
                x = min(high[0], other_high[0]) - max(low[0], other_low[0])
                y = min(high[1], other_high[1]) - max(low[1], other_low[1])
                z = min(high[2], other_high[2]) - max(low[2], other_low[2])
                if x > TOUCH_M and y > TOUCH_M and z > TOUCH_M:
                    total += x * y * z
    return total


def area(ring: list[Point]) -> float:
    """Area of a counter-clockwise ring [m2]."""
    return 0.5 * sum(ring[v - 1][0] * ring[v][1] - ring[v][0] * ring[v - 1][1] for v in range(len(ring)))


def clipped(ring: list[Point], triangle: list[Point]) -> list[Point]:
    """The part of a convex ring inside a counter-clockwise triangle, edge by edge (Sutherland and Hodgman 1974)."""
    for e in range(3):
        (ax, ay), (bx, by) = triangle[e], triangle[(e + 1) % 3]
        sides = [(bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in ring]
        kept: list[Point] = []
        for v, here in enumerate(sides):
            (px, py), (x, y), before = ring[v - 1], ring[v], sides[v - 1]
            if (before >= 0) != (here >= 0):
                s = before / (before - here)
                kept.append((px + s * (x - px), py + s * (y - py)))
            if here >= 0:
                kept.append((x, y))
        ring = kept
    return ring


def crowd_of(count: int, rng: np.random.Generator) -> Crowd:
    """A furnished room of `count` objects, at the same density for every count: an L-shaped room that grows with them.

    Of ten objects six stand on the floor anywhere in the room, overlaps and all; three stand on one of those and move
    along with it; one hangs and is not moved. Outlines are boxes turned by the upright axis.
    """
    side = float(np.sqrt(AREA_PER_OBJECT_M2 * count / 0.75))
    room = np.array([[0, 0], [side, 0], [side, side / 2], [side / 2, side / 2], [side / 2, side], [0, side]])
    kinds = np.array([("floor", "on", "floor", "floor", "hung", "on", "floor", "floor", "on", "floor")[i % 10] for i in range(count)])
    standing = np.flatnonzero(kinds == "floor")
    low, high, rings = np.empty((count, 3)), np.empty((count, 3)), []
    carrier = np.full(count, -1, dtype=np.int64)
    shifts = np.zeros((count, 25, 25), dtype=np.bool_)
    for i in [*standing.tolist(), *np.flatnonzero(kinds != "floor").tolist()]:
        size = rng.uniform((0.3, 0.3, 0.4), (1.1, 0.8, 1.8)) if kinds[i] == "floor" else rng.uniform(0.05, 0.3, 3)
        center, bottom = _in_room(side, rng), 0.0
        if kinds[i] == "on":
            carrier[i] = rng.choice(standing)
            below, above = low[carrier[i]], high[carrier[i]]
            center, bottom = rng.uniform(below[:2], above[:2]), float(above[2])
            steps = center + 0.05 * np.stack(np.meshgrid(np.arange(-12, 13), np.arange(-12, 13), indexing="ij"), axis=-1)
            shifts[i] = ((steps >= below[:2]) & (steps <= above[:2])).all(axis=-1)
            shifts[i, 12, 12] = True
        if kinds[i] == "hung":
            bottom = 1.5
        yaw = rng.uniform(-np.pi, np.pi)
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        ring = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * size[:2] @ turn.T + center
        rings.append((i, ring))
        low[i] = [*ring.min(axis=0), bottom]
        high[i] = [*ring.max(axis=0), bottom + size[2]]
    outlines, corners = stacked([ring for _, ring in sorted(rings, key=lambda pair: pair[0])])
    carries: NDArray[np.bool_] = np.eye(count, dtype=np.bool_)
    carries[carrier[carrier >= 0], np.flatnonzero(carrier >= 0)] = True
    return Crowd(
        low=low, high=high, counted=~(carries | carries.T), movable=kinds != "hung", carries=carries,
        outlines=outlines, corners=corners, room=room_triangles(room), carrier=carrier, shifts=shifts,
    )  # fmt: skip


def compare(count: int, seed: int, max_steps: int = 2000, step: float = 0.05) -> dict[str, float | int | bool]:
    """The compiled loop and the plain one on the same drawn room and the same moves.

    count, moves: objects and moves. plain_seconds, compiled_seconds: processor time per move, set-up included, compilation
    not, the median of `REPEATS` equal runs of each. speedup: their ratio. largest_difference_m3: of any loss, nan where
    the traces are not the same. is_same: the same moves with the same outcomes.
    """
    crowd = crowd_of(count, np.random.default_rng(seed))
    compiled_seconds, compiled = _timed(descend, crowd, step, max_steps, seed)
    plain_seconds, plain = _timed(descend_plainly, crowd, step, max_steps, seed)
    is_same = (
        np.array_equal(plain.objects, compiled.objects)
        and np.array_equal(plain.moves, compiled.moves)
        and np.array_equal(plain.outcome, compiled.outcome)
        and np.array_equal(plain.moved, compiled.moved)
    )
    losses = [np.concatenate([[trace.start], trace.loss, trace.smallest]) for trace in (plain, compiled)]
    largest = float(np.abs(losses[0] - losses[1]).max()) if is_same else float("nan")
    return {
        "count": count,
        "moves": len(plain.loss),
        "repeats": REPEATS,
        "plain_seconds": plain_seconds,
        "compiled_seconds": compiled_seconds,
        "speedup": plain_seconds / compiled_seconds,
        "largest_difference_m3": largest,
        "is_same": is_same,
    }


def compiled_seconds(count: int, seed: int, moves_per_object: int = 100, step: float = 0.05) -> float:
    """Processor time per move of the compiled loop in a drawn room of `count` objects, set-up included, compilation not [s].

    The median of `REPEATS` equal runs.
    """
    crowd = crowd_of(count, np.random.default_rng(seed))
    return _timed(descend, crowd, step, moves_per_object * count, seed)[0]


def _timed(loop: Loop, crowd: Crowd, step: float, max_steps: int, seed: int) -> tuple[float, Trace]:
    """Seconds per move of a loop, the median of a few equal runs, and what they did."""
    loop(crowd, step, 1, np.random.default_rng(seed))  # compiled before the clock starts
    runs = []
    for _ in range(REPEATS):
        rng, clock = np.random.default_rng(seed), time.process_time()
        trace = loop(crowd, step, max_steps, rng)
        runs.append(time.process_time() - clock)
    return float(np.median(runs)) / max(len(trace.loss), 1), trace


def _in_room(side: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """A point of the L-shaped room [m], shape (2,)."""
    while True:
        point = rng.uniform(0.0, side, 2)
        if point.min() < side / 2:
            return point
