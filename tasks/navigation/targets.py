"""Objects to navigate to, and the points that they are seen from."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.navigation.configuration import NavigationConfig
from tasks.navigation.protocol import PathFinder

if TYPE_CHECKING:
    import shapely

Array = NDArray[np.float64]

_MARCH_M = 0.05
"""View points are looked for in steps of this away from the object [m]: a fifth of the agent's own step."""

_SKIN_M = 0.05
"""Directions are taken on a rounded outline this far out [m], so that corners of the object get some too."""

_SAME_M = 0.1
"""View points nearer than this are one [m]: half the success distance."""


@dataclasses.dataclass(frozen=True)
class NavigationTarget:
    """An object and where it is seen from.

    view_points: World frame [m], shape (n, 2). yaws: Heading towards the object [rad], shape (n,). islands: Island of each, shape (n,).
    """

    instance_id: str
    category: str
    view_points: Array
    yaws: Array
    islands: NDArray[np.int64]


def view_points(outline: shapely.Geometry, finder: PathFinder, config: NavigationConfig, walls: Sequence[shapely.Geometry] = ()) -> Array:
    """For directions all around an object the navigable point nearest to it, at most `view_reach_m` away, no wall between; (n, 2).

    Args:
        outline: Convex hull of the object seen from above, world frame [m].
        finder: Knows where the agent can be.
        config: Reach and spacing.
        walls: What stands between rooms, world frame [m]: nothing is seen through it.
    """
    import shapely

    solid = outline if outline.geom_type == "Polygon" else shapely.buffer(outline, 1e-3, quad_segs=2)
    skin = shapely.buffer(solid, _SKIN_M, quad_segs=4).exterior
    count = max(config.view_directions, math.ceil(skin.length / config.view_spacing_m))
    around = shapely.line_interpolate_point(skin, np.arange(count) / count, normalized=True)
    lines = shapely.get_coordinates(shapely.shortest_line(solid, around)).reshape(-1, 2, 2)
    edge, outward = lines[:, 0], lines[:, 1] - lines[:, 0]
    outward /= np.hypot(outward[:, 0], outward[:, 1])[:, None]
    steps = np.arange(math.floor(config.view_reach_m / _MARCH_M) + 1) * _MARCH_M
    tried = edge[:, None] + steps[None, :, None] * outward[:, None]
    good = finder.is_navigable(tried.reshape(-1, 2)).reshape(tried.shape[:2])
    views = tried[np.arange(count), good.argmax(axis=1)][good.any(axis=1)]
    if not len(views):
        center = shapely.get_coordinates(solid.centroid)
        nearest = finder.snap(center)
        views = nearest[shapely.distance(solid, shapely.points(nearest)) <= config.view_reach_m]
    if walls and len(views):
        # what stands in a wall, as a door does, is seen from both sides: only wall beyond the object hides it
        hiding = shapely.difference(shapely.union_all(walls), shapely.buffer(solid, _SKIN_M))
        views = views[~shapely.intersects(shapely.shortest_line(shapely.points(views), solid), hiding)]
    kept: list[Array] = []
    for point in views:
        if all(np.hypot(*(point - other)) >= _SAME_M for other in kept):
            kept.append(point)
    return np.array(kept).reshape(-1, 2)


def target_of(
    instance_id: str, category: str, outline: shapely.Geometry, finder: PathFinder, config: NavigationConfig,
    walls: Sequence[shapely.Geometry] = (),
) -> NavigationTarget | str:  # fmt: skip
    """An object as a target, or the reason why nobody can get near it.

    Args:
        instance_id: Instance that the object stands for.
        category: Its category.
        outline: Convex hull of the object seen from above, world frame [m].
        finder: Knows where the agent can be.
        config: Reach and spacing of view points.
        walls: What stands between rooms, world frame [m].
    """
    import shapely

    points = view_points(outline, finder, config, walls)
    if not len(points):
        nearest = shapely.points(finder.snap(shapely.get_coordinates(outline.centroid)))
        away = float(shapely.distance(outline, nearest)[0])
        if away <= config.view_reach_m:
            return "a wall stands between it and the free floor near it"
        return f"the free floor near it is {away:.2f} m away, view points reach {config.view_reach_m:g} m"
    center = shapely.get_coordinates(outline.centroid)[0]
    ahead = center - points
    yaws = np.where(np.hypot(*ahead.T) > 1e-6, np.arctan2(ahead[:, 1], ahead[:, 0]), 0.0)
    return NavigationTarget(instance_id, category, points, yaws, finder.island_of(points))
