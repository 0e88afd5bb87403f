"""The room's boundary: what lies outside of the floor polygon, and the shortest way back in."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from shapely import Geometry

Array = NDArray[np.float64]


def outside_share(outline: Array, ring: Array) -> float:
    """Share of a convex outline in plan, shape (k, 2) [m], that lies outside of the floor polygon, shape (n, 2)."""
    import shapely

    shape = shapely.Polygon(outline)
    return float(shape.difference(shapely.Polygon(ring)).area / max(shape.area, 1e-12))


def way_in(outline: Array, ring: Array) -> tuple[float, float] | None:
    """The shortest shift (dx, dy) [m] that brings a convex outline, shape (k, 2), wholly into the floor polygon, shape
    (n, 2); zero when it lies inside, None when it fits nowhere."""
    import shapely

    center, free = outline.mean(axis=0), centers_inside(outline, ring)
    if free.is_empty:
        return None
    here = shapely.Point(center)
    if free.covers(here):
        return 0.0, 0.0
    there = shapely.shortest_line(here, free).coords[-1]
    return float(there[0] - center[0]), float(there[1] - center[1])


def centers_inside(outline: Array, ring: Array) -> Geometry:
    """Where the mean corner of a convex outline, shape (k, 2) [m], may be moved so that it lies wholly within the floor polygon,
    shape (n, 2): a geometry in plan, empty where it fits nowhere.

    The places that an outline may not take are the Minkowski sums of the polygon's edges and the mirrored outline.
    """
    import shapely

    mirrored = outline.mean(axis=0) - outline
    after = np.roll(ring, -1, axis=0)
    blocked = [shapely.MultiPoint(np.concatenate([a + mirrored, b + mirrored])).convex_hull for a, b in zip(ring, after, strict=True)]
    return shapely.Polygon(ring).difference(shapely.union_all(blocked).buffer(-1e-9))
