"""Rows of the micro-scenes stage: what stands on, in or leans on each large object of a scene."""

from __future__ import annotations

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record

CARRYING = ("on", "inside", "leans")
"""How a small object can belong to a large one, or to a small one that does."""


@record("micro_scenes", key=("scene_id", "instance_id"), stage="micro_scenes")
class MicroScene:
    """A large object that carries something; the supplementary's unit of synthesis (section B.2).

    Its frame: right-handed, +Z up, metres; origin at the middle of the bottom of the object's box, +X the object's front.
    """

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("The large object", pattern=INSTANCE_PATTERN)
    room_id: str = column("Physical room of the scene, the unit of train/test splits", pattern=SCENE_PATTERN)
    room_index: int | None = column("Room of the scene that it stands in; missing where nobody knows", minimum=0)
    room_type: str = column("Kind of that room, else of the whole scene; 'unknown' when neither stated nor inferred")
    category: str = column("Category among those of the table of categories, merged from the lake's own word")
    word: str = column("The lake's own category of the object")
    asset_id: str = column("Asset that stands for it", pattern=r"[0-9a-f]{64}")
    frame_pose: tuple[float, ...] = column("Its frame to the world frame, turned about +Z alone, 4x4 row by row", unit="m", length=16)
    box_size: tuple[float, ...] = column("Extents of its box along the axes of its frame", unit="m", length=3, minimum=0)
    object_count: int = column("Small objects that belong to it, through others too", minimum=1)


@record("micro_scene_objects", key=("scene_id", "instance_id"), stage="micro_scenes")
class MicroSceneObject:
    """A small object of a micro-scene, in the frame of the large one."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    large_id: str = column("The large object that it belongs to", pattern=INSTANCE_PATTERN)
    instance_id: str = column("The small object", pattern=INSTANCE_PATTERN)
    category: str = column("Category among those of the table of categories; 'object' where the table knows no word for it")
    word: str = column("The lake's own category of the object")
    asset_id: str = column("Asset that stands for it", pattern=r"[0-9a-f]{64}")
    parent_id: str = column("What carries it: the large object, or another small one of it", pattern=INSTANCE_PATTERN)
    relation: str = column("How the parent carries it; 'inside' is a compartment or container", values=CARRYING)
    depth: int = column("Objects from the large one down to it: 1 is carried by the large one itself", minimum=1)
    box_center: tuple[float, ...] = column("Middle of its box in the frame of the large object", unit="m", length=3)
    box_size: tuple[float, ...] = column(
        "Extents of its upright box along the axes of the frame turned by its yaw", unit="m", length=3, minimum=0
    )
    yaw_radians: float = column(
        "Turn of its front about +Z from the front of the large object", unit="rad", minimum=-3.1416, maximum=3.1416
    )
    tilt_radians: float = column("Angle between its upright axis and +Z", unit="rad", minimum=0)
