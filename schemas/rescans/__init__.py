"""Rows of the rescans stage: how a scan lies in an earlier one of its room, and what changed between them."""

from __future__ import annotations

from typing import Literal, get_args

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record

Change = Literal["unchanged", "moved", "added", "removed", "unnamed", "not_seen"]

CHANGES: tuple[Change, ...] = get_args(Change)
"""What can have become of an object between two scans."""


@record("rescans", key=("scene_id", "reference_scene_id"), stage="rescans", grain="rescan")
class Rescan:
    """A scan, held against an earlier one of the same room."""

    scene_id: str = column("Scene of the later scan", pattern=SCENE_PATTERN)
    reference_scene_id: str = column("Scene of the earlier scan", pattern=SCENE_PATTERN)
    room_id: str = column("Physical room of both, as their format tells it by their names", pattern=SCENE_PATTERN)
    outcome: str = column("Whether the one could be laid onto the other; refused: it fits nowhere", values=("registered", "refused"))
    problem: str | None = column("Why it was refused")
    pose: tuple[float, ...] | None = column(
        "World frame of the later scan to that of the earlier, a turn about +Z and a shift in plan, 4x4 row by row; missing when refused",
        unit="m",
        length=16,
    )
    wall_share: float = column(
        "Share of the standing surfaces that are no object's within 10 cm of the other scan's, of the scan of which more fits",
        minimum=0,
        maximum=1,
    )
    object_share: float | None = column("The same of the surfaces of objects; missing where one scan has none", minimum=0, maximum=1)
    conflict_share: float = column("Share of the walls of one that stand on what the other saw as bare floor", minimum=0, maximum=1)


@record("rescan_objects", key=("scene_id", "reference_scene_id", "number"), stage="rescans", grain="rescan")
class RescanObject:
    """What became of one object between two scans of a room."""

    scene_id: str = column("Scene of the later scan", pattern=SCENE_PATTERN)
    reference_scene_id: str = column("Scene of the earlier scan", pattern=SCENE_PATTERN)
    number: int = column("Number among the objects of both: those of the earlier scan first, then those that were added", minimum=0)
    change: str = column(
        "What became of it; unnamed: only one scan names it, and the other shows a surface in its place; not_seen: only one scan has it, "
        "and the other never saw its place",
        values=CHANGES,
    )
    instance_id: str | None = column("Instance in the later scan; missing when it has none", pattern=INSTANCE_PATTERN)
    reference_instance_id: str | None = column("Instance in the earlier scan; missing when it has none", pattern=INSTANCE_PATTERN)
    category: str = column("Category in the later scan, else in the earlier")
    shift: tuple[float, ...] | None = column(
        "How its middle moved, in the world frame of the earlier scan; missing when one scan does not have it", unit="m", length=3
    )
    distance_m: float | None = column("Length of the shift", unit="m", minimum=0)
    turn_radians: float | None = column(
        "How it turned about +Z, the smallest turn that its shape allows; missing when one scan does not have it",
        unit="rad",
        minimum=-3.1416,
        maximum=3.1416,
    )
    seen_share: float | None = column("Share of its place that the scan without it saw; missing when both have it", minimum=0, maximum=1)
