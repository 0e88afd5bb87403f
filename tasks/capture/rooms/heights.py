"""Heights of rooms whose scans end below any ceiling."""

from __future__ import annotations

import dataclasses

import numpy as np

from tasks.capture.rooms.room import NO_ROOM, RoomShape

MIN_SCANNED_M = 1.0
"""What is lower is a table or a shelf with its surroundings, not a room whose upper half was not scanned."""

MIN_ROOM_M = 2.1
"""Building codes ask for more in rooms that people live in; lower walls were not seen up to the ceiling."""

ASSUMED_M = 2.5
"""Most dwellings have 2.4 to 2.6 m."""


def with_plausible_height(shape: RoomShape, is_stated: bool) -> tuple[RoomShape, list[str]]:
    """A room without a seen ceiling, as high as rooms are, and a line that states it.

    Args:
        shape: the room; returned as it is if its walls are high enough.
        is_stated: true if the walls were drawn or stated, not scanned: their height is meant.
    """
    if shape.height_source == "ceiling":
        return shape, []
    if NO_ROOM in shape.notes:
        return shape, [f"no ceiling seen: height taken from the {shape.height_source}"]
    if is_stated and shape.height_source == "walls":
        return shape, []  # drawn and captured rooms state their walls and no ceiling
    # Slanted walls end at the scanned height: with another one they would be steeper.
    if is_stated or shape.slopes or not MIN_SCANNED_M <= shape.height < MIN_ROOM_M:
        return shape, [f"no ceiling seen: height taken from the {shape.height_source}"]
    walls = shape.interior_walls.copy()
    # Walls that reach as high as the scan go on above it; half-height ones end where they were seen to end.
    reach = walls[:, 5] > shape.height - 0.1
    walls[reach, 5] = ASSUMED_M
    line = f"no ceiling seen and the scan ends {shape.height:.2f} m above the floor: a height of {ASSUMED_M:.2f} m is assumed"
    return dataclasses.replace(shape, interior_walls=np.asarray(walls), height=ASSUMED_M, height_source="assumed"), [line]
