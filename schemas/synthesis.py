"""Rows of scenes that a model drew: from what, on what, and what it drew before anything was moved."""

from __future__ import annotations

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record
from schemas.training import HASH


@record("syntheses", key=("scene_id",), stage="capture")
class Synthesis:
    """How a scene came to be that no scan shows: a model drew what is on a large object."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    model_id: str = column("Model that drew it", pattern=HASH)
    model_kind: str = column("Architecture of the model")
    instance_id: str = column("The large object", pattern=INSTANCE_PATTERN)
    category: str = column("Its category, of the table of categories of micro-scenes")
    box_size: tuple[float, ...] = column("Extents that were asked for: depth, width, height", unit="m", length=3, minimum=0)
    frame_pose: tuple[float, ...] = column(
        "Frame of the large object to the world frame as drawn, turned about +Z alone, 4x4 row by row", unit="m", length=16
    )
    room_type: str = column("Kind of room that was asked for; 'unknown' where none was")
    seed: int = column("Seed that was asked for")
    number: int = column("Number of the layout among those of its request; with the seed it decides on all that was drawn", minimum=0)
    based_on: str | None = column("Scene whose large object was furnished anew; missing for a room of its own", pattern=SCENE_PATTERN)
    based_on_instance: str | None = column("The large object in that scene", pattern=INSTANCE_PATTERN)
    object_count: int = column("Objects that were drawn", minimum=0)
    colliding_count: int = column("Of these, boxes that go deeper than 5 mm into another drawn one as drawn", minimum=0)
    off_support_count: int = column(
        "Of these, boxes that reach over the edge of the large one, or have nothing within 1 cm below them, as drawn", minimum=0
    )
    stable_share: float | None = column(
        "Share of the drawn objects that MuJoCo left within 1 cm and 5 degrees of where they were drawn, before anything was put right; "
        "missing where none was drawn",
        minimum=0,
        maximum=1,
    )
    seconds: float = column("Time to draw it and to make rows of it", unit="s", minimum=0, volatile=True)


@record("synthesis_objects", key=("scene_id", "instance_id"), stage="capture")
class SynthesisObject:
    """A small object as a model drew it, in the frame of the large one: +Z up, origin at the middle of the bottom, +X its front."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("The small object", pattern=INSTANCE_PATTERN)
    category: str = column("Category that was drawn, of the table of categories of micro-scenes")
    box_center: tuple[float, ...] = column("Middle of its box", unit="m", length=3)
    box_size: tuple[float, ...] = column("Extents of its box along its own axes", unit="m", length=3, minimum=0)
    yaw_radians: float = column(
        "Turn of its front about +Z from the front of the large object", unit="rad", minimum=-3.1416, maximum=3.1416
    )
    is_colliding: bool = column("Its box goes deeper than 5 mm into another drawn one")
    is_off_support: bool = column("Its box reaches over the edge of the large one, or has nothing within 1 cm below it")
    is_stable: bool | None = column(
        "MuJoCo left it within 1 cm and 5 degrees of where it was drawn; missing where it could not be simulated"
    )
