"""The triangles that a navmesh is baked from: floor, walls and placed furniture, glTF frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Shell
from tasks.geometry.transforms import Z_UP_TO_Y_UP, transform_points
from tasks.navigation.navmesh import Settings
from tasks.shell import floor_ring, room_shell

if TYPE_CHECKING:
    from tasks.geometry.meshes import Surface

Array = NDArray[np.float64]

_UNDER_M = 1e-3
"""The floor is thinner than one voxel by this [m], so that its top is in the lowest layer."""


def scene_triangles(room: Shell, furniture: Sequence[Surface], settings: Settings) -> tuple[Array, NDArray[np.int64]]:
    """Floor, outer and interior walls and furniture as one triangle soup.

    The floor's top is z = 0, and it is nearly one voxel thick. Layers of voxels are counted from the lowest triangle: so
    the navmesh lies 1 mm above the floor, and what blocks the agent is what is higher than `agent_max_climb`. With a
    floor of no thickness layers would begin at the floor, and furniture up to two voxels high (0.4 m) would be climbed.

    Args:
        room: Its floor polygon and walls.
        furniture: Placed surfaces in the world frame [m].
        settings: Their `cell_height` sets the floor's thickness.

    Returns:
        Vertices in the glTF frame [m], shape (n, 3), and faces, outward counter-clockwise, shape (m, 3).

    Raises:
        InputError: the floor polygon has no area or crosses itself, or an interior wall has no size.
    """
    import shapely

    pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.Polygon(floor_ring(room))))
    floor = shapely.get_coordinates(shapely.orient_polygons(pieces)).reshape(-1, 4, 2)[:, :3].reshape(-1, 2)
    upward = np.arange(len(floor)).reshape(-1, 3)
    depth = settings.cell_height - _UNDER_M
    vertices = [np.column_stack([floor, np.full(len(floor), z)]) for z in (0.0, -depth)]
    faces: list[NDArray[np.int64]] = [upward, upward[:, ::-1]]
    for name, wall in room_shell(room):
        if name != "floor":
            vertices.append(np.asarray(wall.vertices, dtype=np.float64))
            faces.append(np.asarray(wall.faces, dtype=np.int64))
    for surface in furniture:
        vertices.append(_above(surface.vertices, -depth))
        faces.append(np.asarray(surface.faces, dtype=np.int64))
    offsets = np.cumsum([0, *(len(part) for part in vertices)])[:-1]
    joined = np.concatenate([face + offset for face, offset in zip(faces, offsets, strict=True)])
    return transform_points(np.concatenate(vertices), Z_UP_TO_Y_UP), joined


def _above(vertices: Array, lowest: float) -> Array:
    """Vertices no lower than the floor's underside: what reaches below it would shift the layers of voxels."""
    raised = np.array(vertices, dtype=np.float64)
    raised[:, 2] = np.maximum(raised[:, 2], lowest)
    return raised
