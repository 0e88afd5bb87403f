"""The document of an annotation batch that was created: what is asked of whom, and where the files beside it lie.

`work.schema.json` describes it. Files are named by content, relative to the folder of the document, with forward slashes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from schemas.annotation import Assignment, WorkBatch
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Shell
from schemas.selection import Selection
from tasks.geometry.transforms import matrix, quaternion_wxyz, yaw_of

WORK_SCHEMA_FILE = Path(__file__).with_name("work.schema.json")
"""The published JSON Schema of the document."""

DOCUMENT, ANSWERS = "work.json", "answers.json"
"""What is asked; and what is handed back, which names a file for each annotator."""

STEPS = (
    "Choose the candidate that looks most like the scanned object: its category first, then its shape and size, then its color.",
    "Align it: position, height, rotation and scale, so that it lies on the scanned points, stands on what carries it, is in nothing else "
    "and in the room.",
    "Rank the next best: the 2nd to the 5th of the remaining nine. Objects that look alike get one and the same asset.",
    "Answer null where no candidate fits.",
)
"""The guidelines, as they are handed out."""


def work_document(
    batch: WorkBatch,
    assignments: Sequence[Assignment],
    instances: Sequence[Instance],
    captions: Sequence[Caption],
    candidates: Sequence[Candidate],
    selections: Sequence[Selection],
    shells: Sequence[Shell],
    assets: Sequence[Asset],
) -> dict[str, Any]:
    """The document of a batch, as JSON values. Of instances and all else the rows of the scenes that it is about."""
    objects = {(row.scene_id, row.instance_id): row for row in instances}
    sentences = {(row.scene_id, row.instance_id): row.sentence for row in captions}
    known = {row.asset_id: row for row in assets}
    slots: dict[tuple[str, str], list[Candidate]] = defaultdict(list)
    for candidate in sorted(candidates, key=lambda row: row.slot):
        if candidate.asset_id in known and candidate.outcome == "filled":
            slots[candidate.scene_id, candidate.instance_id].append(candidate)
    aligned = {(row.scene_id, row.instance_id, row.slot): row for row in selections}
    by_object: dict[tuple[str, str], list[Assignment]] = defaultdict(list)
    by_annotator: dict[str, list[Assignment]] = defaultdict(list)
    for row in sorted(assignments, key=lambda row: (row.annotator, row.place)):
        by_object[row.scene_id, row.instance_id].append(row)
        by_annotator[row.annotator].append(row)
    scenes = {scene for scene, _ in by_object}
    return {
        "$schema": WORK_SCHEMA_FILE.name,
        "batch_id": batch.batch_id,
        "pick": batch.pick,
        "overlap": batch.overlap,
        "guidelines": list(STEPS),
        "scenes": [
            {"scene_id": row.scene_id, "floor_polygon": [list(corner) for corner in row.floor_polygon], "height_m": row.height_m}
            for row in sorted(shells, key=lambda row: row.scene_id)
            if row.scene_id in scenes
        ],
        "objects": [_object(objects[key], sentences.get(key), by_object[key], slots[key], aligned, known) for key in sorted(by_object)],
        "annotators": [
            {
                "annotator": name,
                "answers": answers_file(place),
                "objects": [{"scene_id": row.scene_id, "instance_id": row.instance_id} for row in by_annotator[name]],
            }
            for place, name in enumerate(sorted(by_annotator), 1)
        ],
    }


def answers_file(place: int) -> str:
    """The file for the answers of an annotator, by their place among the batch's; names may hold what paths may not."""
    return f"answers/{place:03d}.json"


def asset_file(asset_id: str) -> str:
    """The GLB of an asset."""
    return f"assets/{asset_id}.glb"


def thumbnail_file(asset_id: str) -> str:
    """The picture of an asset."""
    return f"thumbnails/{asset_id}.jpg"


def crop_file(blob: str) -> str:
    """What the scan has of an object: its points, its faces, its best view."""
    return f"scans/{blob}"


def crops(instance: Instance) -> list[str]:
    """Blobs of what the scan has of an object."""
    return [blob for blob in (instance.points_blob, instance.mesh_blob, instance.view_blob) if blob is not None]


def _object(
    instance: Instance,
    sentence: str | None,
    assignments: Sequence[Assignment],
    candidates: Sequence[Candidate],
    aligned: dict[tuple[str, str, int], Selection],
    assets: dict[str, Asset],
) -> dict[str, Any]:
    """An object of the document."""
    box = matrix(instance.box_pose)
    first = assignments[0]
    return {
        "scene_id": instance.scene_id,
        "instance_id": instance.instance_id,
        "category": instance.category,
        "caption": sentence,
        "box": {
            "center": [float(v) for v in box[:3, 3]],
            "yaw_degrees": float(yaw_of(box) * 57.29577951308232),
            "size": list(instance.box_size),
        },
        "points": crop_file(instance.points_blob),
        "mesh": None if instance.mesh_blob is None else crop_file(instance.mesh_blob),
        "view": None if instance.view_blob is None else crop_file(instance.view_blob),
        "doubt": first.doubt,
        "reasons": list(first.reasons),
        "candidates": [
            _candidate(row.slot, assets[row.asset_id], aligned.get((row.scene_id, row.instance_id, row.slot)))
            for row in candidates
            if row.asset_id is not None
        ],
    }


def _candidate(slot: int, asset: Asset, selection: Selection | None) -> dict[str, Any]:
    """A candidate of an object, as selection ranked and aligned it."""
    transform = None
    if selection is not None:
        pose = matrix(selection.pose)
        transform = {
            "position": [float(v) for v in pose[:3, 3]],
            "rotation_wxyz": list(quaternion_wxyz(pose)),
            "scale": list(selection.scale),
        }
    return {
        "slot": slot,
        "asset_id": asset.asset_id,
        "name": asset.name,
        "category": asset.category,
        "provider": asset.provider,
        "license": asset.license,
        "extents": list(asset.extents),
        "glb": asset_file(asset.asset_id),
        "thumbnail": thumbnail_file(asset.asset_id),
        "rank": None if selection is None else selection.rank,
        "score": None if selection is None else selection.score,
        "transform": transform,
    }
