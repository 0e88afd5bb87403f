"""Rescans: scans of one room laid onto each other, and what was moved, added and removed between them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from schemas.capture import Instance, Scene
from schemas.rescans import Rescan, RescanObject
from tasks.geometry.transforms import flat
from tasks.rescans.configuration import RescansConfig
from tasks.rescans.matching import MatchedObject, matched, placed
from tasks.rescans.registration import Registration, registration
from tasks.rescans.surfaces import RoomScan, scanned_room
from tasks.stage import Context, Outcome, Stage

__all__ = ["STAGE", "RescansConfig", "run"]


def run(
    *, rescanned_rooms: Sequence[str], scenes: Sequence[Scene], instances: Sequence[Instance], context: Context, config: RescansConfig
) -> Outcome:
    """Rows of `rescans` and `rescan_objects`: the first of some scans of a room, which is `context.scene_id`, held against each other one.

    rescanned_rooms: Their scenes. scenes, instances: Rows of all of them.

    Raises:
        InputError: a mesh or a cloud cannot be read.
    """
    rows, inside = {row.scene_id: row for row in scenes}, defaultdict(list)
    for row in instances:
        inside[row.scene_id].append(row)
    later, *earlier = (scanned_room(rows[name], inside[name], context.blobs, context.rng("surface", name)) for name in rescanned_rooms)
    rescans, objects, notes = [], [], []
    for reference in earlier:
        fit = registration(later, reference, config.registration)
        rescans.append(_row(rows[later.scene_id], reference, fit))
        if fit.problem:
            notes.append(f"{later.scene_id} does not fit onto {reference.scene_id}, which has its room id: {fit.problem}")
            continue
        changes = matched(placed(later, fit.pose), reference, config.matching)
        objects += [_object_row(later, reference, number, each) for number, each in enumerate(changes)]
    return Outcome(rescans=rescans, rescan_objects=objects, degradations=notes)


def _row(scene: Scene, reference: RoomScan, fit: Registration) -> Rescan:
    return Rescan(
        scene_id=scene.scene_id,
        reference_scene_id=reference.scene_id,
        room_id=scene.room_id,
        outcome="refused" if fit.problem else "registered",
        problem=fit.problem or None,
        pose=None if fit.problem else flat(fit.pose),
        wall_share=fit.wall_share,
        object_share=fit.object_share,
        conflict_share=fit.conflict_share,
    )


def _object_row(later: RoomScan, reference: RoomScan, number: int, matching: MatchedObject) -> RescanObject:
    motion, known = matching.motion, matching.later or matching.reference
    assert known is not None
    return RescanObject(
        scene_id=later.scene_id,
        reference_scene_id=reference.scene_id,
        number=number,
        change=matching.change,
        instance_id=matching.later.instance_id if matching.later is not None else None,
        reference_instance_id=matching.reference.instance_id if matching.reference is not None else None,
        category=known.category,
        shift=None if motion is None else tuple(float(value) for value in motion.shift),
        distance_m=None if motion is None else motion.distance_m,
        turn_radians=None if motion is None else motion.turn_radians,
        seen_share=matching.seen_share,
    )


STAGE = Stage(
    name="rescans",
    reads=("scenes", "instances"),
    writes=("rescans", "rescan_objects"),
    config=RescansConfig,
    run=run,
    grain="rescan",
    outside=("rescanned_rooms",),
)
"""What changed between scans of one room."""
