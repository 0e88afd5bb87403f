"""Rooms of a scene as rows: their floors, what stands in them, and what kind they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Instance, Room, Shell
from tasks.capture.rooms.room import inferred_room_type
from tasks.capture.rooms.separation import Seen, corners_of, separated
from tasks.geometry.transforms import matrix

SEVERAL = "dwelling"
"""What several rooms are together where nobody says more."""

NEAR_M = 0.5
"""Doors and windows lie in walls, not in rooms: what is farther from a room than a thick wall with its reveal is outside."""


def parted(
    shell: Shell, instances: Sequence[Instance], stated: str, is_seen: Seen | None = None
) -> tuple[Shell, list[Room], list[Instance]]:
    """A scene's rooms, and its shell and instances with what follows from them.

    stated: kind that the scan states, empty for none: that of the room where there is one, else that of the whole; each of several
    rooms is what stands in it. is_seen: where anything but walls was seen, of places shape (m, 2) [m], if that is known.
    """
    floors = [corners_of(room) for room in separated(np.array(shell.floor_polygon), shell.interior_walls, is_seen).rooms]
    placed = [dataclasses.replace(row, room_index=room_of_instance(row, floors)) for row in instances]
    is_one = len(floors) == 1
    rooms = []
    for index, floor in enumerate(floors):
        # structure tells nothing of which room it is in
        categories = [row.category for row in placed if is_one or row.room_index == index]
        rooms.append(
            Room(
                scene_id=shell.scene_id,
                room_index=index,
                room_type=(stated if is_one else "") or inferred_room_type(categories),
                floor_polygon=tuple((float(x), float(y)) for x, y in floor),
                floor_area_m2=ring_area(floor),
            )
        )
    return dataclasses.replace(shell, room_type=stated or (rooms[0].room_type if is_one else SEVERAL)), rooms, placed


def room_of_instance(row: Instance, floors: Sequence[NDArray[np.float64]]) -> int | None:
    """Index of the floor, corners shape (n, 2) [m], that the center of an instance's box is on, else of the nearest within `NEAR_M`;
    None for structure and for what is outside of all."""
    import shapely

    if row.is_structure:
        return None
    center = shapely.Point(matrix(row.box_pose)[:2, 3])
    away = [float(shapely.Polygon(floor).distance(center)) for floor in floors]
    nearest = int(np.argmin(away))
    return nearest if away[nearest] <= NEAR_M else None


def ring_area(ring: NDArray[np.float64]) -> float:
    """Area of a ring of corners, shape (n, 2) [m2]."""
    x, y = ring.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
