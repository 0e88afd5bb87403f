"""The floor plan of a scan: cells where there is floor or something on it, and polygons around them."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud
from tasks.capture.labels import FLOOR, WALL

if TYPE_CHECKING:
    from shapely import Geometry, Polygon

Array = NDArray[np.float64]

CELL_M = 0.05
"""Cell of the floor plan: two to three vertices of a usual scan mesh wide, a tenth of the narrowest passage."""

_UPRIGHT = 0.5
"""Vertical part of the normal of a wall that bounds the floor: less than that of a slope of 60 degrees."""

_BRIDGE_CELLS = 3
"""Parts of the plan are grown by as many cells to see which are one: rooms with a wall of up to 30 cm between them."""


@dataclasses.dataclass
class FloorCells:
    """Cells of the floor plan: `inside` where there is floor or something on it, `floor` where the floor itself is seen, `seen`
    where anything but walls is."""

    origin: Array
    inside: NDArray[np.bool_]
    floor: NDArray[np.bool_]
    seen: NDArray[np.bool_]
    left_out_m2: float = 0.0

    @staticmethod
    def of(cloud: Cloud, kinds: NDArray[np.int64], height: float) -> FloorCells:
        """Cells that points fall into, closed over gaps and holes, the largest connected piece of them."""
        from scipy import ndimage

        z = cloud.points[:, 2]
        is_floor = kinds == FLOOR
        is_object = (kinds == 0) & (cloud.instance >= 0) & (z > -0.05) & (z < height)
        if not is_object.any() and not is_floor.any():
            is_object = (kinds != WALL) & (z < height)
        used = is_floor | is_object
        base = cloud.points[used, :2] if used.any() else cloud.points[:, :2]
        low, high = np.percentile(base, [0.05, 99.95], axis=0)
        origin = low - 6 * CELL_M
        shape = np.ceil((high - low) / CELL_M).astype(int) + 12
        is_upright = np.abs(cloud.normals[:, 2]) < _UPRIGHT  # floor runs on below a slanted wall
        is_wall = (kinds == WALL) & (z < height) & is_upright
        floor, objects, walls = (_raster(cloud.points[where, :2], origin, shape) for where in (is_floor, is_object, is_wall))
        # Floor is seen once in a cell, but a single point of an object may be a stray one.
        raw = (floor >= 1) | (objects >= 2)
        ball = ndimage.generate_binary_structure(2, 1)
        # What walls and floor enclose is inside, seen or not: behind the front of a wardrobe nobody has looked.
        barrier = raw | (walls >= 2)
        closed = ndimage.binary_closing(np.pad(barrier, 6), ball, iterations=5)[6:-6, 6:-6]
        filled = ndimage.binary_fill_holes(closed) & (raw | ~barrier)
        opened = ndimage.binary_opening(filled, ball, iterations=2)
        if not opened.any():
            return FloorCells(origin, np.zeros_like(raw), floor >= 1, raw)
        joined, _ = ndimage.label(ndimage.binary_dilation(opened, ball, iterations=_BRIDGE_CELLS))
        sizes = np.bincount(joined[opened])
        main = int(np.argmax(sizes))
        inside = opened & (joined == main)
        return FloorCells(origin, inside, floor >= 1, raw, float((opened & ~inside).sum()) * CELL_M**2)

    def outline(self) -> Polygon | None:
        """Union of the cells inside, None when there are none. Gaps between rooms are closed, a little wider than whole cells: parts
        that are just one plan would else touch in a line."""
        import shapely

        if self.inside.sum() * CELL_M**2 < 0.2:
            return None
        boxes = []
        for column in range(self.inside.shape[0]):
            steps = np.diff(np.pad(self.inside[column].astype(np.int8), 1))
            x = self.origin[0] + column * CELL_M
            ys = self.origin[1] + np.column_stack([np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)]) * CELL_M
            boxes += [shapely.box(x, low, x + CELL_M, high) for low, high in ys]
        return largest(closed(shapely.union_all(boxes), (_BRIDGE_CELLS + 0.1) * CELL_M))

    def without(self, shape: Geometry) -> FloorCells:
        """The plan without the cells whose middles lie in a shape."""
        import shapely

        if shape.is_empty:
            return self
        xs, ys = (self.origin[axis] + (np.arange(self.inside.shape[axis]) + 0.5) * CELL_M for axis in (0, 1))
        x, y = np.meshgrid(xs, ys, indexing="ij")
        rest = ~shapely.contains_xy(shape, x, y)
        return dataclasses.replace(self, inside=self.inside & rest, floor=self.floor & rest, seen=self.seen & rest)

    def share_of_floor(self, shape: Polygon) -> float:
        """Share of a polygon in whose cells the floor itself is seen."""
        return float(min(1.0, self.floor.sum() * CELL_M**2 / max(shape.area, 1e-9)))

    def filled_share(self, xs: Array, ys: Array, is_seen: bool = False) -> Array:
        """Share of each rectangle between consecutive lines that is inside, shape (len(xs) - 1, len(ys) - 1). is_seen: in whose cells
        anything at all was seen."""
        inside = self.seen if is_seen else self.inside
        total = np.zeros((inside.shape[0] + 1, inside.shape[1] + 1))
        total[1:, 1:] = inside.cumsum(axis=0).cumsum(axis=1)
        i = np.clip(np.round((xs - self.origin[0]) / CELL_M).astype(int), 0, self.inside.shape[0])
        j = np.clip(np.round((ys - self.origin[1]) / CELL_M).astype(int), 0, self.inside.shape[1])
        counts = total[np.ix_(i[1:], j[1:])] - total[np.ix_(i[:-1], j[1:])] - total[np.ix_(i[1:], j[:-1])] + total[np.ix_(i[:-1], j[:-1])]
        return counts / np.maximum(np.outer(np.diff(i), np.diff(j)), 1)

    def is_floor(self, points: Array) -> NDArray[np.bool_]:
        """Whether the floor was seen at places, shape (n, 2)."""
        return self._at(points, self.floor)

    def is_seen(self, points: Array) -> NDArray[np.bool_]:
        """Whether anything but walls was seen at places, shape (n, 2)."""
        return self._at(points, self.seen)

    def _at(self, points: Array, cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
        place = np.floor((points - self.origin) / CELL_M).astype(np.int64)
        known = ((place >= 0) & (place < cells.shape)).all(axis=1)
        there = np.zeros(len(points), dtype=bool)
        there[known] = cells[place[known, 0], place[known, 1]]
        return there


_SEEN_SHARE = 0.25
"""Of the side of a rectangle, along which walls must be seen that face it."""

_OWN_WALL_SHARE, _ON_SIDE_M = 0.5, 0.1
"""Of the side of a rectangle, along which a wall on that side, this near [m], shows that the rectangle is floor."""

_MIN_OTHER_M = 0.3
"""Of the opposite side, along which a wall there shows that a rectangle may lie behind it [m]."""

_BIN_M = 0.1
"""Parts of a side in which the nearest wall is looked for."""


def enclosed(cloud: Cloud, is_wall: NDArray[np.bool_], xs: Array, ys: Array, lines: Sequence[Array]) -> NDArray[np.bool_]:
    """Which rectangles between consecutive lines lie indoors by their walls, whatever hides their floor, shape (len(xs) - 1, len(ys) - 1).

    Scans see walls from indoors: looking from such a rectangle along the axes, the nearest wall turns its face to it rather than its
    back in three directions at least, and in the fourth there is the line of a wall. lines: of walls across x and y [m].
    """
    inside = np.ones((len(xs) - 1, len(ys) - 1), dtype=np.bool_)
    faced = np.zeros(inside.shape, dtype=np.int64)
    for axis, across in ((0, xs), (1, ys)):
        upright = is_wall & (np.abs(cloud.normals[:, axis]) > 0.7)
        at, along = cloud.points[upright, axis], cloud.points[upright, 1 - axis]
        front = np.sign(cloud.normals[upright, axis])
        for direction in (-1.0, 1.0):
            for k, (low, high) in enumerate(itertools.pairwise(across)):
                middle = 0.5 * (low + high)
                away = direction * (at - middle)
                ahead = np.flatnonzero(away > 0.0)
                ahead = ahead[np.argsort(-away[ahead], kind="stable")]  # the nearest comes last, and stays
                bins = np.floor((along[ahead] - along.min(initial=0.0)) / _BIN_M).astype(np.int64)
                nearest = np.zeros(int(bins.max(initial=-1)) + 1)
                nearest[bins] = -direction * front[ahead]
                middles = along.min(initial=0.0) + (np.arange(len(nearest)) + 0.5) * _BIN_M
                is_bounded = (direction * (lines[axis] - middle) > 0.0).any()
                for m, (start, end) in enumerate(itertools.pairwise((ys, xs)[axis])):
                    here = nearest[(middles > start) & (middles < end)]
                    cells = max((end - start) / _BIN_M, 1.0)
                    place = (k, m) if axis == 0 else (m, k)
                    faced[place] += (here > 0).sum() >= max(_SEEN_SHARE * cells, float((here < 0).sum()))
                    inside[place] &= bool(is_bounded)
    return np.asarray(inside & (faced >= 3))


def walled(cloud: Cloud, is_wall: NDArray[np.bool_], xs: Array, ys: Array) -> NDArray[np.bool_]:
    """Rectangles between consecutive lines that have on one side a wall that faces them, and opposite of it no wall, shape
    (len(xs) - 1, len(ys) - 1).

    Args:
        cloud: points of the scan.
        is_wall: which of these points are wall, shape (n,).
        xs: positions of lines across x, sorted [m].
        ys: positions of lines across y, sorted [m].
    """
    is_walled = np.zeros((len(xs) - 1, len(ys) - 1), dtype=np.bool_)
    for axis, across, beside in ((0, xs, ys), (1, ys, xs)):
        upright = is_wall & (np.abs(cloud.normals[:, axis]) > 0.7)
        at, along, normal = cloud.points[upright, axis], cloud.points[upright, 1 - axis], cloud.normals[upright, axis]
        # Lengths depend on one line and the strip along it, so every line looks at the points once.
        lengths = []
        for side in across:
            is_near = np.abs(at - side) < _ON_SIDE_M
            places, facing = along[is_near], normal[is_near]
            lengths.append([_lengths(of_side, beside) for of_side in (places, places[facing > 0.0], places[facing < 0.0])])
        least = _OWN_WALL_SHARE * np.diff(beside)
        for k, ((near, near_front, _), (far, _, far_front)) in enumerate(itertools.pairwise(lengths)):
            row = ((near_front >= least) & (far < _MIN_OTHER_M)) | ((far_front >= least) & (near < _MIN_OTHER_M))
            is_walled[(k, slice(None)) if axis == 0 else (slice(None), k)] |= row
    return is_walled


def _lengths(places: Array, lines: Array) -> Array:
    """Lengths along which points lie between consecutive lines [m], shape (k - 1,).

    Args:
        places: places of the points along an axis [m], shape (n,).
        lines: positions of the lines on that axis, sorted [m], shape (k,).
    """
    after = np.searchsorted(lines, places)
    is_between = (after > 0) & (after < len(lines)) & (places < lines[np.minimum(after, len(lines) - 1)])
    bins = np.floor(places[is_between] / _BIN_M).astype(np.int64)
    low = int(bins.min()) if len(bins) else 0
    span = int(np.ptp(bins)) + 1 if len(bins) else 1
    pairs = np.unique((after[is_between] - 1) * span + bins - low)
    return _BIN_M * np.bincount(pairs // span, minlength=len(lines) - 1).astype(np.float64)


def closed(shape: Any, reach: float) -> Any:
    """A shape without gaps narrower than twice `reach` [m]; without parts narrower than that where it is negative."""
    return shape.buffer(reach, join_style="mitre").buffer(-reach, join_style="mitre")


def largest(shape: Any) -> Polygon | None:
    """The largest polygon of a shape, without holes."""
    import shapely

    parts = [part for part in getattr(shape, "geoms", [shape]) if part.geom_type == "Polygon" and part.area > 0]
    return shapely.Polygon(max(parts, key=lambda part: part.area).exterior) if parts else None


def _raster(points: Array, origin: Array, shape: NDArray[np.int64]) -> NDArray[np.int64]:
    cells = np.floor((points - origin) / CELL_M).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < shape)).all(axis=1)]
    return np.bincount(cells[:, 0] * shape[1] + cells[:, 1], minlength=int(np.prod(shape))).reshape(shape)
