"""Rooms as occupancy grids: which cells of the floor are free, which are occupied, and which are not known."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError

if TYPE_CHECKING:
    import shapely

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""Values of cells, as `nav_msgs/OccupancyGrid` has them."""

ROUNDING_M = 1e-5
"""What reaches into a cell by less than this [m] only touches its border: outlines are joined on a grid of a tenth of it."""

_AT_ONCE = 100_000
"""Squares that are held against a shape at once: some 20 MB."""


MOST_CELLS = 4_000_000
"""A hall of 100 m at 5 cm; a map of so many is made in half a minute."""


@dataclasses.dataclass(frozen=True)
class Raster:
    """Square cells on the floor, world frame. origin: The lower left corner of the first cell [m]. rows go up (+Y), columns right (+X)."""

    origin: tuple[float, float]
    resolution_m: float
    rows: int
    columns: int

    @classmethod
    def around(cls, bounds: tuple[float, float, float, float], resolution_m: float, margin: int) -> Raster:
        """Cells whose corners are multiples of the resolution, over a box (least x and y, greatest x and y) [m] and `margin` cells more
        on each side.

        Raises:
            InputError: they are more than `MOST_CELLS`.
        """
        count = np.prod([(high - low) / resolution_m + 2.0 * margin + 1.0 for low, high in zip(bounds[:2], bounds[2:], strict=True)])
        if not count <= MOST_CELLS:
            problem = f"a map of {count:.3g} cells is larger than {MOST_CELLS:,}"
            raise InputError("exports.nav2", "resolution_m", problem, "set a coarser one, or look whether the room has a stray corner")
        low = [int(np.floor(value / resolution_m)) - margin for value in bounds[:2]]
        high = [int(np.ceil(value / resolution_m)) + margin for value in bounds[2:]]
        x, y = (round(index * resolution_m, 9) for index in low)  # what the file says, and readers begin with
        return cls((x, y), resolution_m, high[1] - low[1], high[0] - low[0])

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least x and y, greatest x and y [m]."""
        (x, y), size = self.origin, self.resolution_m
        return x, y, x + self.columns * size, y + self.rows * size

    def squares(self, shape: shapely.Geometry, inset_m: float) -> Iterator[tuple[NDArray[np.int64], NDArray[np.object_]]]:
        """Cells that the bounding box of a shape meets, some rows at a time: rows and columns, shape (n, 2), and their squares, smaller by
        `inset_m` on every side, shape (n,)."""
        import shapely

        if shape.is_empty:
            return
        (x, y), size = self.origin, self.resolution_m
        low_x, low_y, high_x, high_y = shape.bounds
        columns = np.arange(max(0, int((low_x - x) / size) - 1), min(self.columns, int((high_x - x) / size) + 2))
        every = np.arange(max(0, int((low_y - y) / size) - 1), min(self.rows, int((high_y - y) / size) + 2))
        for rows in np.array_split(every, 1 + len(every) * len(columns) // _AT_ONCE):
            cells = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.int64)
            left, bottom = x + cells[:, 1] * size, y + cells[:, 0] * size
            yield cells, shapely.box(left + inset_m, bottom + inset_m, left + size - inset_m, bottom + size - inset_m)

    def touched(self, shapes: Iterable[shapely.Geometry]) -> NDArray[np.bool_]:
        """Cells that any of the shapes reaches into, however little of them it covers, shape (rows, columns)."""
        import shapely

        cells = np.zeros((self.rows, self.columns), dtype=np.bool_)
        for shape in shapes:
            for piece in shapely.get_parts(shape):
                shapely.prepare(piece)
                for places, squares in self.squares(piece, ROUNDING_M):
                    rows, columns = places[shapely.intersects(piece, squares)].T
                    cells[rows, columns] = True
        return cells

    def covered(self, shape: shapely.Geometry) -> NDArray[np.bool_]:
        """Cells that lie within a shape as a whole, but for a rounding, shape (rows, columns)."""
        import shapely

        cells = np.zeros((self.rows, self.columns), dtype=np.bool_)
        shapely.prepare(shape)
        for places, squares in self.squares(shape, ROUNDING_M):
            rows, columns = places[shapely.covers(shape, squares)].T
            cells[rows, columns] = True
        return cells


def occupancy(raster: Raster, floor: shapely.Geometry, slab: shapely.Geometry, obstacles: Iterable[shapely.Geometry]) -> NDArray[np.int8]:
    """What is known of every cell, shape (rows, columns), the lowest row first: free, occupied or unknown.

    Occupied is what an obstacle reaches into, however little. Free is what is left of the slab and joined to the room by cells that
    are free, too: the floor, and doorways in the walls. A cell of the room that lies beside the slab in part is occupied: nothing
    carries a robot there. All else is unknown.

    Args:
        raster: The cells.
        floor: The floor polygon, world frame [m].
        slab: What carries a robot, the ground below the walls included, world frame [m].
        obstacles: What stands on it, walls included, seen from above, world frame [m].
    """
    from scipy.ndimage import label

    blocked, room, ground = raster.touched(obstacles), raster.touched([floor]), raster.covered(slab)
    regions, _ = label(ground & ~blocked)  # cells that share an edge
    inside = np.unique(regions[room & ground & ~blocked])
    cells = np.full((raster.rows, raster.columns), UNKNOWN, dtype=np.int8)
    cells[np.isin(regions, inside[inside > 0])] = FREE
    cells[blocked | (room & ~ground)] = OCCUPIED
    return cells
