"""How far it is from any place on a floor to the nearest thing, as a planner asks it ten thousand times a decision."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.kernels import Kernels, compile_kernels

if TYPE_CHECKING:
    from tasks.robot.floor_map import Floor

Array = NDArray[np.float64]

CELL_M = 0.02
"""Between the nodes at which distances are exact [m]."""

SLACK_M = 0.001
"""What is taken off between the nodes [m]: from 5 cm on, the mean of four exact distances is too large by less."""

POINT_M = 0.2
"""Points are in the way with so much around them [m]: what is near to a mapped line passes for mapped, and the feet of a chair reach
farther than what the lidar's plane meets of it."""

FAR_M = 1.5
"""Distances are told up to this [m]: a planner cares for no more."""


@dataclasses.dataclass(frozen=True)
class Clearances:
    """Distances to the nearest thing on a floor, never too large by more than rounding.

    nodes: At nodes [m], 0 in obstacles and off the floor, at most `FAR_M`, shape (columns, rows). origin: Of the first node, world frame
    [m], shape (2,). points: Points that are in the way, too, world frame, shape (n, 2).
    """

    nodes: Array
    origin: Array
    points: Array

    @classmethod
    def of(cls, floor: Floor) -> Clearances:
        """Distances to what a cart runs into, the edge of the floor included."""
        low, high = (np.array(ends) for ends in (floor.polygon.bounds[:2], floor.polygon.bounds[2:]))
        empty = cls.around(floor.edges, low, high)
        columns, rows = np.indices(empty.nodes.shape)
        places = empty.origin + CELL_M * np.column_stack([columns.ravel(), rows.ravel()])
        inside = floor.covers(places).reshape(empty.nodes.shape)
        return dataclasses.replace(empty, nodes=np.where(inside, empty.nodes, 0.0))

    @classmethod
    def around(cls, segments: ArrayLike, low: ArrayLike, high: ArrayLike) -> Clearances:
        """Distances to segments, x and y of both ends, world frame [m], shape (n, 4), between two corners of a box, shape (2,) each."""
        origin = np.asarray(low, dtype=np.float64) - CELL_M
        shape = np.ceil((np.asarray(high, dtype=np.float64) - origin) / CELL_M).astype(int) + 2
        nodes = np.full(shape, FAR_M)
        _kernels()["_spread"](nodes, origin, np.ascontiguousarray(segments, dtype=np.float64).reshape(-1, 4))
        return cls(nodes, origin, np.zeros((0, 2)))

    def with_points(self, points: ArrayLike) -> Clearances:
        """The same with these points in the way, world frame [m], shape (n, 2), in place of others."""
        return dataclasses.replace(self, points=np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 2))

    def flattened(self) -> Clearances:
        """The same with its points drawn into the nodes: for who asks for all of them."""
        if not len(self.points):
            return self
        away = np.full(self.nodes.shape, FAR_M)
        _kernels()["_spread"](away, self.origin, np.hstack([self.points, self.points]))
        nodes = np.where(away < FAR_M, np.minimum(self.nodes, np.maximum(away - POINT_M, 0.0)), self.nodes)
        return Clearances(nodes, self.origin, np.zeros((0, 2)))

    def distances(self, places: ArrayLike) -> Array:
        """Distance from each place, world frame [m], shape (n, 2), to the nearest thing [m], shape (n,); 0 off the floor."""
        asked = np.ascontiguousarray(places, dtype=np.float64).reshape(-1, 2)
        distances: Array = _kernels()["_all_clear"](self.nodes, self.origin, self.points, asked)
        return distances

    def least_along(self, start: ArrayLike, end: ArrayLike) -> float:
        """Least distance on the straight way between two places, shape (2,) each, by a node's width [m]."""
        first, last = (np.asarray(place, dtype=np.float64) for place in (start, end))
        count = max(int(np.ceil(np.hypot(*(last - first)) / CELL_M)), 1)
        return float(self.distances(first + np.linspace(0.0, 1.0, count + 1)[:, None] * (last - first)).min())


def compiled() -> Kernels:
    """What other kernels ask distances with: `clear_at(nodes, origin, points, x, y)`."""
    return {"clear_at": _kernels()["clear_at"]}


@cache
def _kernels() -> Kernels:
    return compile_kernels(_spread, clear_at, _all_clear)


def _spread(nodes: Array, origin: Array, segments: Array) -> None:
    """Lower the nodes around each segment to its distance."""
    columns, rows = nodes.shape
    for i in range(len(segments)):
        ax, ay, bx, by = segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3]
        dx, dy = bx - ax, by - ay
        length = dx * dx + dy * dy
        left = max(int(np.floor((min(ax, bx) - FAR_M - origin[0]) / CELL_M)), 0)
        right = min(int(np.ceil((max(ax, bx) + FAR_M - origin[0]) / CELL_M)) + 1, columns)
        below = max(int(np.floor((min(ay, by) - FAR_M - origin[1]) / CELL_M)), 0)
        above = min(int(np.ceil((max(ay, by) + FAR_M - origin[1]) / CELL_M)) + 1, rows)
        for column in range(left, right):
            px = origin[0] + column * CELL_M - ax
            for row in range(below, above):
                py = origin[1] + row * CELL_M - ay
                share = 0.0
                if length > 0.0:
                    share = min(max((px * dx + py * dy) / length, 0.0), 1.0)
                qx, qy = px - share * dx, py - share * dy
                squared = qx * qx + qy * qy
                if squared < nodes[column, row] * nodes[column, row]:
                    nodes[column, row] = np.sqrt(squared)


def clear_at(nodes: Array, origin: Array, points: Array, x: float, y: float) -> Any:
    """Distance from a place to the nearest thing [m]: between nodes a little less than the mean of the four around it."""
    across, along = (x - origin[0]) / CELL_M, (y - origin[1]) / CELL_M
    column, row = int(np.floor(across)), int(np.floor(along))
    if column < 0 or row < 0 or column + 1 >= nodes.shape[0] or row + 1 >= nodes.shape[1]:
        return 0.0
    s, t = across - column, along - row
    near = (1.0 - s) * ((1.0 - t) * nodes[column, row] + t * nodes[column, row + 1])
    far = s * ((1.0 - t) * nodes[column + 1, row] + t * nodes[column + 1, row + 1])
    clear = max(near + far - SLACK_M, 0.0)
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        if dx * dx + dy * dy < (clear + POINT_M) * (clear + POINT_M):
            clear = max(np.sqrt(dx * dx + dy * dy) - POINT_M, 0.0)
    return clear


def _all_clear(nodes: Array, origin: Array, points: Array, places: Array) -> Array:
    distances = np.empty(len(places))
    for k in range(len(places)):
        distances[k] = clear_at(nodes, origin, points, places[k, 0], places[k, 1])
    return distances
