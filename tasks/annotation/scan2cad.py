"""Alignments of Scan2CAD as answers: CAD models found among the candidates of the objects that they are aligned to.

A model's frame is ShapeNet's, +Y up. Assets are the same model turned to +Z up, in metres, its origin at the bottom center; what that did
to it follows from the model's box, which Scan2CAD states, and from the asset's.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from tasks.annotation.batch import MAX_NUMBER, QUATERNION_TOLERANCE
from tasks.batches import BatchSchema
from tasks.geometry.boxes import oriented_iou
from tasks.geometry.transforms import (
    Y_UP_TO_Z_UP,
    Z_UP_TO_Y_UP,
    inverse,
    matrix,
    nearest_rigid,
    pose_from_quaternion_wxyz,
    quaternion_wxyz,
    translation,
    yaw_of,
    yaw_pose,
)

Array = NDArray[np.float64]

SCAN2CAD_SCHEMA_FILE = Path(__file__).with_name("scan2cad.schema.json")
"""What is read of a file of Scan2CAD."""

SCHEMA = BatchSchema(SCAN2CAD_SCHEMA_FILE)

LEAST_OVERLAP = 0.1
"""Of an aligned model's box and an instance's, intersection over union: less is another object, or one that the scan's labels lack."""


@dataclasses.dataclass(frozen=True)
class Aligned:
    """Answers as a JSON value of `batch.schema.json`, and what could not be taken for one, a line each."""

    document: dict[str, Any]
    left_out: tuple[str, ...]


def read_scan2cad(
    document: Any, name: str, batch_id: str, annotator: str, answered_at: datetime, scenes: Sequence[Scene], instances: Sequence[Instance],
    candidates: Sequence[Candidate], assets: Sequence[Asset],
) -> Aligned:  # fmt: skip
    """The alignments in a JSON value of Scan2CAD for scans that the lake has; `name` is what errors call it.

    An instance that several models are aligned to gets the one whose box covers it best.

    Raises:
        InputError: the document is not Scan2CAD's, or holds a transform that is none. Names the JSON path.
    """
    SCHEMA.check(document, name)
    known = {asset.asset_id: asset for asset in assets}
    by_scan: dict[str, list[Scene]] = {}
    for scene in sorted(scenes, key=lambda row: row.scene_id):
        by_scan.setdefault(scene.scan, []).append(scene)
    left_out: list[str] = []
    answers: dict[tuple[str, str], tuple[float, str, dict[str, Any]]] = {}
    for index, scan in enumerate(document):
        where = f"[{index}]"
        if scan["id_scan"] not in by_scan:
            left_out.append(f"{where}: scan {scan['id_scan']} is not in the lake")
            continue
        to_scan = inverse(_rigid(scan["trs"], name, f"{where}.trs"))
        for scene in by_scan[scan["id_scan"]]:
            objects = [row for row in instances if row.scene_id == scene.scene_id and not row.is_structure]
            frame = matrix(scene.alignment) @ to_scan
            for place, model in _models(scan, where):
                answer = _answer(model, name, place, frame, objects, candidates, known)
                called = f"{place}: {model['catid_cad']}/{model['id_cad']}"
                if isinstance(answer, str):
                    left_out.append(f"{called}: {answer}")
                    continue
                share, row = answer
                key = (scene.scene_id, row["instance_id"])
                if key in answers:
                    worse = answers[key][1] if share > answers[key][0] else called
                    left_out.append(f"{worse}: another model is aligned to {' '.join(key)}, too, and covers it no worse")
                if key not in answers or share > answers[key][0]:
                    stated = {
                        "scene_id": scene.scene_id,
                        "annotator": annotator,
                        "answered_at": answered_at.isoformat(),
                        "tool": "Scan2CAD",
                    }
                    answers[key] = (share, called, stated | row)
    return Aligned({"batch_id": batch_id, "annotations": [answers[key][2] for key in sorted(answers)]}, tuple(left_out))


def _models(scan: Mapping[str, Any], where: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The aligned models of a scan, with their JSON paths."""
    for index, model in enumerate(scan["aligned_models"]):
        yield f"{where}.aligned_models[{index}]", model


def _answer(
    model: Mapping[str, Any], name: str, where: str, frame: Array, objects: Sequence[Instance], candidates: Sequence[Candidate],
    assets: Mapping[str, Asset],
) -> tuple[float, dict[str, Any]] | str:  # fmt: skip
    """How well a model's box covers an instance's and the answer for it; or why there is none."""
    half, center = _numbers(model["bbox"], name, f"{where}.bbox"), _numbers(model["center"], name, f"{where}.center")
    scale = _numbers(model["trs"]["scale"], name, f"{where}.trs.scale")
    for field, values in (("bbox", half), ("trs.scale", scale)):
        if (values <= 1.0 / MAX_NUMBER).any():
            raise InputError(name, f"{where}.{field}", "must be three numbers above 0", "mend the file")
    pose = nearest_rigid(frame @ _rigid(model["trs"] | {"scale": [1, 1, 1]}, name, f"{where}.trs")) @ Z_UP_TO_Y_UP
    bottom = (Y_UP_TO_Z_UP[:3, :3] @ (center - [0.0, half[1], 0.0])) * scale[[0, 2, 1]]
    pose = pose @ translation(bottom)
    size = 2.0 * half[[0, 2, 1]] * scale[[0, 2, 1]]
    upright = yaw_pose(yaw_of(pose), pose[:3, 3]) @ translation([0.0, 0.0, size[2] / 2])
    shares = [(oriented_iou(upright, size, row.box_pose, row.box_size), row.instance_id, row.scene_id) for row in objects]
    share, instance_id, scene_id = max(shares, default=(0.0, "", ""))
    if share < LEAST_OVERLAP:
        return "no instance lies where it is aligned"
    own = [row for row in candidates if (row.scene_id, row.instance_id) == (scene_id, instance_id) and row.asset_id in assets]
    asset = next(
        (assets[row.asset_id] for row in own if row.asset_id is not None and _is_model(assets[row.asset_id], model["id_cad"])), None
    )
    if asset is None:
        return f"no candidate of {scene_id} {instance_id} is that model"
    return share, {
        "instance_id": instance_id,
        "choice": asset.asset_id,
        "transform": {
            "position": [float(v) for v in pose[:3, 3]],
            "rotation_wxyz": [float(v) for v in quaternion_wxyz(pose)],
            "scale": [float(v) for v in size / np.maximum(np.array(asset.extents), 1e-9)],
        },
    }


def _is_model(asset: Asset, id_cad: str) -> bool:
    """Whether an asset was read from a file, or lies in a folder, of a model's name."""
    return id_cad == asset.name or id_cad in (PurePosixPath(asset.name).stem, *PurePosixPath(asset.source).parts)


def _rigid(trs: Mapping[str, Any], name: str, where: str) -> Array:
    """Rotation and translation of a transform, 4x4; its scale must be 1.

    Raises:
        InputError: it is no rotation, scales, or goes too far.
    """
    quaternion, place = _numbers(trs["rotation"], name, f"{where}.rotation"), _numbers(trs["translation"], name, f"{where}.translation")
    length = math.hypot(*quaternion)
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise InputError(name, f"{where}.rotation", f"has length {length:.4g}", "give a unit quaternion w, x, y, z")
    if np.abs(_numbers(trs["scale"], name, f"{where}.scale") - 1.0).max() > QUATERNION_TOLERANCE:
        raise InputError(name, f"{where}.scale", "scales the scan", "give metres")
    return pose_from_quaternion_wxyz(quaternion.tolist(), place)


def _numbers(values: Sequence[float], name: str, where: str) -> Array:
    """JSON's numbers as floats, none of them so large that digits would be lost.

    Raises:
        InputError: one is.
    """
    if any(abs(value) > MAX_NUMBER for value in values):
        raise InputError(name, where, "holds too large a number", "give metres or factors")
    return np.array([float(value) for value in values])
