"""Heights of rooms whose scans end below any ceiling."""

from __future__ import annotations

import dataclasses

import numpy as np

from tasks.capture.rooms.room import RoomShape

MIN_SCANNED_M, MIN_FLOOR_M2 = 1.0, 4.0
"""What is lower [m] and has a smaller floor [m2] is a table with its surroundings, not the lower half of a room."""

MIN_ROOM_M = 2.1
"""Building codes ask for more in rooms that people live in; lower walls were not seen up to the ceiling."""

ASSUMED_M = 2.5
"""Most dwellings have 2.4 to 2.6 m."""

OVER_WALLS_M = 0.1
"""What was scanned higher over the walls than this [m] shows that these were not seen up to the ceiling: depth noise is less."""


def with_plausible_height(shape: RoomShape, is_stated: bool) -> tuple[RoomShape, list[str]]:
    """A room without a seen ceiling, as high as rooms are, and a line that states it.

    Args:
        shape: the room; returned as it is if its walls are high enough.
        is_stated: true if the walls were drawn or stated, not scanned: their height is meant.
    """
    if shape.height_source == "ceiling":
        return shape, []
    if not shape.is_room:
        return shape, []
    if is_stated and shape.height_source == "walls":
        return shape, []  # drawn and captured rooms state their walls and no ceiling
    # Slanted walls end at the scanned height: with another one they would be steeper.
    is_whole = shape.height >= MIN_ROOM_M and shape.top <= shape.height + OVER_WALLS_M
    is_thing = shape.height < MIN_SCANNED_M and shape.area < MIN_FLOOR_M2
    if is_stated or shape.slopes or is_whole or is_thing:
        return shape, [f"no ceiling seen: height taken from the {shape.height_source}"]
    height = max(ASSUMED_M, shape.height, shape.top)
    walls = shape.interior_walls.copy()
    # Walls that reach as high as the scan go on above it; half-height ones end where they were seen to end.
    reach = walls[:, 5] > shape.height - 0.1
    walls[reach, 5] = height
    line = f"no ceiling seen and walls end {shape.height:.2f} m above the floor: a height of {height:.2f} m is assumed"
    return dataclasses.replace(shape, interior_walls=np.asarray(walls), height=height, height_source="assumed"), [line]
