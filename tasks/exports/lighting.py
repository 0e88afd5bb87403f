"""Lamps under the ceiling and a camera that looks into the room: what a viewer needs before it can show an exported scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Shell
from tasks.exports.bodies import Body, Replica
from tasks.geometry.transforms import transform_points
from tasks.shell import floor_ring, interior_footprints

Array = NDArray[np.float64]

LAMP_SPACING_M = 2.5
"""How far apart lamps hang [m]: one in a bathroom, six in a living room."""

BELOW_CEILING_M = 0.3
"""How far below the ceiling lamps and the camera are [m]."""

EYE_M = 1.6
"""Height of the camera above the floor [m], where the room is high enough."""

CLEARANCE_M = 0.3
"""How far the camera keeps from walls and from the boxes of objects [m]."""

FIELD_OF_VIEW_DEGREES = 75.0
"""Of the camera, from left to right, in pictures of 16 to 9."""

SMALLEST_CELL = 0.25
"""A cell of the grid of lamps that lies in the room with less than this share of it gets none."""


def lamps(room: Shell) -> Array:
    """Positions of lamps in the world frame [m], shape (n, 3), n at least 1, all above the floor polygon and beside inner walls.

    Raises:
        InputError: the floor polygon has no area or crosses itself, or an interior wall has no size.
    """
    import shapely

    floor = _open_floor(room)
    low, high = np.array(floor.bounds).reshape(2, 2)
    counts = np.maximum(np.round((high - low) / LAMP_SPACING_M), 1).astype(int)
    edges = [np.linspace(low[axis], high[axis], counts[axis] + 1) for axis in range(2)]
    places = []
    for x, x_end in zip(edges[0], edges[0][1:], strict=False):
        for y, y_end in zip(edges[1], edges[1][1:], strict=False):
            cell = floor.intersection(shapely.box(x, y, x_end, y_end))
            if cell.area >= SMALLEST_CELL * (x_end - x) * (y_end - y):
                places.append(_inside(cell))
    if not places:
        places = [_inside(floor)]
    height = room.height_m - min(BELOW_CEILING_M, 0.5 * room.height_m)
    return np.column_stack([np.array(places), np.full(len(places), height)])


def viewpoint(replica: Replica) -> Array:
    """Camera to world [m], 4x4, for a camera that looks along its own -Z with +Y up (as those of USD and MuJoCo).

    It stands at eye height over the floor polygon, outside of every object's box where there is such a place, as far as possible from the
    middle of the room, at which it looks down.

    Raises:
        InputError: as for `lamps`.
    """
    import shapely

    floor = _open_floor(replica.room)
    middle = _inside(floor)
    height = min(EYE_M, replica.room.height_m - min(BELOW_CEILING_M, 0.5 * replica.room.height_m))
    inner = floor.buffer(-CLEARANCE_M)
    low, high = np.array(floor.bounds).reshape(2, 2)
    grid = np.stack(np.meshgrid(*(np.linspace(low[axis], high[axis], 25) for axis in range(2)), indexing="ij"), axis=-1).reshape(-1, 2)
    seen = shapely.linestrings(np.stack([grid, np.tile(middle, (len(grid), 1))], axis=1))
    fits = shapely.contains_xy(inner, grid[:, 0], grid[:, 1]) & shapely.within(seen, floor)
    fits &= _is_free(np.column_stack([grid, np.full(len(grid), height)]), replica.bodies)
    distance = np.where(fits, np.linalg.norm(grid - middle, axis=1), -1.0)
    eye = grid[int(distance.argmax())] if distance.max() > 0.0 else middle - np.array([1e-3, 0.0])
    return _looking(np.array([*eye, height]), np.array([*middle, 0.25 * height]))


def _open_floor(room: Shell) -> Any:
    """The floor without what walls inside the room stand on; the whole of it where nothing else is left."""
    import shapely

    floor = shapely.Polygon(floor_ring(room))
    left = floor.difference(shapely.unary_union([shapely.Polygon(corners) for corners in interior_footprints(room)]))
    return left if left.area > SMALLEST_CELL * floor.area else floor


def _inside(area: Any) -> Array:
    """The centroid of an area where it lies in it, else the point farthest from its edge, to a centimeter [m], shape (2,)."""
    import shapely

    solid = area.buffer(0.0)  # an intersection may hold lines beside areas
    center = solid.centroid
    place = center if solid.contains(center) else shapely.Point(shapely.maximum_inscribed_circle(solid, 0.01).coords[0])
    return np.array([place.x, place.y])


def _is_free(points: Array, bodies: Sequence[Body]) -> NDArray[np.bool_]:
    """Which points in the world frame, shape (n, 3), lie outside the boxes of all bodies, grown by the clearance."""
    free = np.ones(len(points), dtype=bool)
    for body in bodies:
        local = transform_points(points, np.linalg.inv(body.pose))
        low, high = body.shape.bounds
        free &= ~((local >= low - CLEARANCE_M) & (local <= high + CLEARANCE_M)).all(axis=1)
    return free


def _looking(eye: Array, target: Array) -> Array:
    """Pose of a camera at `eye` that looks at `target`, both shape (3,) [m], its horizon level."""
    back = eye - target
    back = back / np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, eye
    return pose
