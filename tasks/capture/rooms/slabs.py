"""Straight walls inside a room: boxes on the floor, from above a center line with a thickness."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from shapely import Polygon

Array = NDArray[np.float64]

NARROW_M = 0.3
"""Gaps up to this are noise: nothing passes through them. Ends as near to another wall reach it."""

MAX_THICKNESS_M = 0.36
"""A load-bearing wall of one and a half bricks with plaster."""


@dataclasses.dataclass(frozen=True)
class Slab:
    """A wall between two ends of its center line, shape (2,) each, world frame; all [m]."""

    start: Array
    end: Array
    thickness: float
    height: float

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def row(self) -> tuple[float, ...]:
        """x0, y0, x1, y1, thickness, height [m]."""
        return (*map(float, (*self.start, *self.end)), self.thickness, self.height)

    @property
    def faces(self) -> tuple[tuple[float, ...], ...]:
        """The two long sides as segments x0, y0, x1, y1 [m] with the room on their left."""
        along = (self.end - self.start) / self.length
        side = np.array([-along[1], along[0]]) * self.thickness / 2
        left, right = (self.start + side, self.end + side), (self.end - side, self.start - side)
        return tuple(tuple(map(float, (*a, *b))) for a, b in (left, right))

    def polygon(self, grown: float = 0.0) -> Polygon:
        """The slab seen from above, grown to all sides [m]."""
        import shapely

        along = (self.end - self.start) / self.length
        side, ahead = np.array([-along[1], along[0]]) * (self.thickness / 2 + grown), along * grown
        a, b = self.start - ahead, self.end + ahead
        return shapely.Polygon([a - side, b - side, b + side, a + side])


def joined(slabs: list[Slab], floor: Polygon, beside: Sequence[Slab] = ()) -> list[Slab]:
    """Slabs clipped to the floor, with ends that nearly reach another wall drawn out to it. beside: walls that stay as they are."""
    import shapely

    drawn, standing = [], [*slabs, *beside]
    for index, slab in enumerate(slabs):
        along = (slab.end - slab.start) / slab.length
        lines = [part for part in shapely.get_parts(shapely.LineString([slab.start, slab.end]).intersection(floor)) if part.length > 0]
        if not lines:
            continue
        ends = shapely.get_coordinates(max(lines, key=lambda part: part.length))
        ends = ends[np.argsort(ends @ along)][[0, -1]]
        borders = [floor.exterior, *(shapely.LineString([o.start, o.end]) for k, o in enumerate(standing) if k != index)]
        for side, sign in ((0, -1.0), (1, 1.0)):
            # from a little inside, for ends that touch already; as far as nobody passes, from the other wall's face on
            reach = NARROW_M + MAX_THICKNESS_M / 2
            ray = shapely.LineString([ends[side] - sign * 0.05 * along, ends[side] + sign * reach * along])
            for other, slack in zip(borders, [0.0, *(o.thickness / 2 for k, o in enumerate(standing) if k != index)], strict=True):
                hits = shapely.get_coordinates(ray.intersection(other))
                away = (hits - ends[side]) @ along * sign
                if (away < NARROW_M + slack).any() and len(hits):
                    ends[side] = hits[int(np.argmin(np.where(away < NARROW_M + slack, away, np.inf)))]
                    break
        if np.linalg.norm(ends[1] - ends[0]) >= 0.3:
            drawn.append(dataclasses.replace(slab, start=ends[0], end=ends[1]))
    return drawn
