"""Collision loss, and Algorithm 1 of the MetaScenes supplementary (CVPR 2025), which lowers it move by move."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.optimization.search.descent import compiled_descent

Array = NDArray[np.float64]

OUTCOMES = ("start", "kept", "reverted", "left_room", "left_support")
"""What became of a move, by code, as `optimization_steps` names it."""

MOVES: NDArray[np.int64] = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
"""The four moves, in steps along x and y."""


@dataclasses.dataclass(frozen=True)
class Crowd:
    """Boxes that may stand in each other's way, and what limits their moves. n objects, in a fixed order.

    low, high: corners of the axis-aligned boxes in the world frame [m], shape (n, 3). counted: pairs that count in the
    loss, shape (n, n), symmetric. movable: shape (n,). carries: object j moves along with object i, shape (n, n), with
    i itself. outlines: convex counter-clockwise rings in plan [m], shape (n, k, 2), and how many corners each has.
    room: triangles that make up the floor, counter-clockwise [m], shape (t, 3, 2); none: no room is known. carrier:
    index of the object that each stands on, -1 for none, shape (n,). shifts: where each may stand on it, in steps from
    its place, shape (n, 2 reach + 1, 2 reach + 1).
    """

    low: Array
    high: Array
    counted: NDArray[np.bool_]
    movable: NDArray[np.bool_]
    carries: NDArray[np.bool_]
    outlines: Array
    corners: NDArray[np.int64]
    room: Array
    carrier: NDArray[np.int64]
    shifts: NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Trace:
    """Every step of the algorithm, from 1: the object that was moved, the move in steps (m, 2), the loss after it [m3],
    the smallest loss so far [m3], and the outcome's code, shape (m,) each. moved: steps that every object was moved in
    the end, shape (n, 2). start: loss before the first step [m3]. exhausted: no single move lowers the loss."""

    objects: NDArray[np.int64]
    moves: NDArray[np.int64]
    loss: Array
    smallest: Array
    outcome: NDArray[np.int64]
    moved: NDArray[np.int64]
    start: float
    exhausted: bool

    @property
    def final(self) -> float:
        """Loss in the end [m3]."""
        return float(self.smallest[-1]) if len(self.smallest) else self.start


def descend(crowd: Crowd, step: float, max_steps: int, rng: np.random.Generator) -> Trace:
    """Algorithm 1: random moves of single objects by `step` [m], each kept when it lowers the loss.

    An object and one of four directions are drawn. The object, with all it carries, is moved. The move is undone when it
    takes more of an outline out of the room than was out before, or a carried object off its carrier; else the loss is
    taken, and the move undone unless the loss falls below the smallest so far. It ends at a loss of zero, after
    `max_steps`, or once every move of every movable object was tried since the last one kept: then none can lower it,
    and the steps that are left would change nothing.
    """
    movable = np.flatnonzero(crowd.movable)
    if not len(movable) or max_steps <= 0:
        movable, max_steps = np.zeros(1, dtype=np.int64), 0
    objects = movable[rng.integers(0, len(movable), max_steps)].astype(np.int64)
    directions = rng.integers(0, 4, max_steps).astype(np.int64)
    loss, smallest = np.empty(max_steps), np.empty(max_steps)
    outcome, moved = np.empty(max_steps, dtype=np.int64), np.zeros((len(crowd.low), 2), dtype=np.int64)
    apart, apart_first = listed(~crowd.counted)
    carried, carried_first = listed(crowd.carries)
    done, start, exhausted = compiled_descent()(
        crowd.low, crowd.high, apart, apart_first, int(crowd.movable.sum()), carried, carried_first, crowd.outlines, crowd.corners,
        crowd.room, room_borders(crowd.room), crowd.carrier, crowd.shifts, MOVES, float(step), objects, directions, loss, smallest,
        outcome, moved,
    )  # fmt: skip
    count = int(done)
    return Trace(
        objects=objects[:count],
        moves=MOVES[directions[:count]],
        loss=loss[:count],
        smallest=smallest[:count],
        outcome=outcome[:count],
        moved=moved,
        start=float(start),
        exhausted=bool(exhausted),
    )


def listed(chosen: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The chosen columns of every row, shape (n, n), one row after the other, and where each row begins, shape (n + 1,)."""
    row, column = np.divmod(np.flatnonzero(chosen), max(len(chosen), 1))
    return column, np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(chosen)))]).astype(np.int64)


def plan_ring(points: Array, most: int = 32) -> Array:
    """Convex hull in plan of points, shape (n, 2), as a counter-clockwise ring, shape (k, 2), 3 <= k <= `most`.

    More corners than `most` are thinned to the extreme ones in that many directions, which cuts a circle by half a
    percent. Points on a line give their box.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        ring = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    if len(ring) > most:
        angles = 2 * np.pi * np.arange(most) / most
        extreme = np.unique(np.argmax(ring @ np.array([np.cos(angles), np.sin(angles)]), axis=0))
        ring = ring[extreme]
    return np.asarray(ring)


def stacked(rings: Sequence[Array]) -> tuple[Array, NDArray[np.int64]]:
    """Rings as one array, shape (n, k, 2), padded with their first corner, and how many corners each has, shape (n,)."""
    most = max((len(r) for r in rings), default=3)
    padded = [np.vstack([r, np.repeat(r[:1], most - len(r), axis=0)]) for r in rings]
    return np.array(padded).reshape(len(rings), most, 2), np.array([len(r) for r in rings], dtype=np.int64)


def room_triangles(ring: Array, walls: Sequence[Array] = ()) -> Array:
    """A simple polygon, shape (n, 2), less the walls in it, shape (4, 2) each, as counter-clockwise triangles, shape (t, 3, 2)."""
    import shapely

    free = shapely.Polygon(ring)
    if walls:
        free = free.difference(shapely.union_all([shapely.Polygon(corners) for corners in walls]))
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(free))
    triangles = np.array([shapely.get_coordinates(p)[:3] for p in parts]).reshape(-1, 3, 2)
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    clockwise = first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0]
    triangles[clockwise] = triangles[clockwise, ::-1]
    return triangles


def room_borders(room: Array) -> Array:
    """What bounds a room of triangles, shape (t, 3, 2): the sides that belong to one of them alone, shape (e, 2, 2)."""
    borders: dict[frozenset[tuple[float, float]], tuple[tuple[float, float], tuple[float, float]]] = {}
    for triangle in room.tolist():
        for e in range(3):
            start, other = tuple(triangle[e]), tuple(triangle[(e + 1) % 3])
            if borders.pop(frozenset((start, other)), None) is None:
                borders[frozenset((start, other))] = start, other
    return np.array(list(borders.values()), dtype=np.float64).reshape(-1, 2, 2)
