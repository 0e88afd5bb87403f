"""Objects of a scan of MultiScan as its annotation lists them: names, labels, oriented boxes, and which way is up."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.annotated_rows import label_text, whole_number
from tasks.capture.files.documents import json_floats
from tasks.capture.labels import normalized
from tasks.capture.roomplan.elements import LARGEST_M, RoomElement
from tasks.capture.rooms.alignment import rotation_to_z
from tasks.geometry.transforms import is_rigid, nearest_rigid

Array = NDArray[np.float64]

REMOVED = "remove"
"""Label of what is no object: what the scan has of things that are not there."""

LEVEL_RADIANS = 1e-6
"""What stands as straight as this is level; the file's own rounding is finer."""

MAX_OBJECT_NUMBER = 2**31
"""Numbers of objects stay below this: faces of a mesh name them with 32 bits."""

_NUMBERED = re.compile(r"(.+?)\.\d{1,9}", re.ASCII | re.DOTALL)

_AGAIN = "copy the annotation again"


@dataclasses.dataclass(frozen=True)
class AnnotatedObject:
    """An object of the annotation.

    name: As written, as in `chair.1`. label: Without its number. number: By which the faces of a mesh name it, None where the file has
    none. box: Its frame (x and y along its width and height where it stands, z its depth) and size, in the file's own frame, None where
    the file has none. field: Where it stands in the file.
    """

    name: str
    label: str
    number: int | None
    box: RoomElement | None
    up: Array | None
    field: str

    @property
    def source_id(self) -> str:
        """Its number where it has one, which alone is unique; else its name."""
        return self.name if self.number is None else str(self.number)

    @property
    def is_removed(self) -> bool:
        """Whether it is no object; see `REMOVED`."""
        return normalized(self.label) == REMOVED


def objects_of(document: dict[str, Any], name: str) -> tuple[list[AnnotatedObject], list[str]]:
    """Objects of the annotation, in its order, and a note for each value that is wrong; parts are not told apart.

    An object with the name of an earlier one is left out. A box that is wrong is left out, its object is not.

    Raises:
        InputError: it is not an annotation.
    """
    listed = document.get("objects")
    if not isinstance(listed, list) or not listed:
        raise InputError(name, "objects", "must be a list of objects", "is it the annotation of a scan of MultiScan?")
    if len(listed) > BUDGET.nodes:
        raise InputError(name, "objects", f"lists more than {BUDGET.nodes}", "is it the right file?")
    objects: list[AnnotatedObject] = []
    notes: list[str] = []
    seen: set[str] = set()
    for index, row in enumerate(listed):
        field = f"objects[{index}]"
        if not isinstance(row, dict):
            notes.append(f"{name}: {field}: is not an object: left out")
            continue
        entry = _object(row, name, field, index, notes)
        if entry.source_id in seen and not (entry.is_removed and entry.number is None):
            notes.append(f"{name}: {field}: {entry.source_id[:40]!r} names two objects: left out")
            continue
        seen.add(entry.source_id)
        objects.append(entry)
    return objects, notes


def upright(objects: Sequence[AnnotatedObject]) -> tuple[Array, list[str]]:
    """The turn of the file's frame, 4x4, that has up point along +Z as most objects say; none, and a note, where they do not agree."""
    pose = np.eye(4)
    ups = [entry.up for entry in objects if entry.up is not None]
    if not ups:
        return pose, ["no object says what is up: +Z is"]
    up = np.median(ups, axis=0)  # of what lies on its side, up points sideways
    length = float(np.linalg.norm(up))
    if length < 0.9:
        return pose, ["objects do not agree on what is up: +Z is"]
    if np.linalg.norm(up[:2]) > LEVEL_RADIANS * length or up[2] < 0.0:
        pose[:3, :3] = rotation_to_z(up)
    return pose, []


def _object(entry: dict[str, Any], name: str, field: str, index: int, notes: list[str]) -> AnnotatedObject:
    word, is_label = label_text(entry.get("label"))
    if not is_label or not word:
        notes.append(f"{name}: {field}.label: is missing, or not a text: the object is unlabeled")
    match = _NUMBERED.fullmatch(word)
    label = match[1] if match else word
    word = word or f"unlabeled.{index}"
    number = whole_number(entry.get("objectId"))
    number = number if number is None or number < MAX_OBJECT_NUMBER else None
    if number is None and entry.get("objectId") is not None:
        notes.append(f"{name}: {field}.objectId: must be a number from 0: left out")
    obb = entry.get("obb")
    box, up = None, None
    try:
        box = None if obb is None else _box(obb, word, label, name, f"{field}.obb")
        up = None if obb is None else _up(obb, name, f"{field}.obb.up")
    except InputError as error:
        notes.append(f"{error.file}: {error.field}: {error.problem}: left out")
    return AnnotatedObject(word, label, number, box, up, field)


def _up(box: dict[str, Any], name: str, field: str) -> Array | None:
    """The direction that a box calls up, shape (3,); None where it states none."""
    if box.get("up") is None:
        return None
    up = json_floats(box["up"], name, field, 3)
    if abs(float(np.linalg.norm(up)) - 1.0) > 0.01:
        raise InputError(name, field, "is not a unit vector", _AGAIN)
    return up


def _box(box: Any, word: str, label: str, name: str, field: str) -> RoomElement:
    if not isinstance(box, dict):
        raise InputError(name, field, "must be a box", _AGAIN)
    center, size = (json_floats(box.get(key), name, f"{field}.{key}", 3) for key in ("centroid", "axesLengths"))
    if (size < 0.0).any() or (size > LARGEST_M).any():
        raise InputError(name, f"{field}.axesLengths", f"must be 0 to {LARGEST_M:g} m", _AGAIN)
    pose = np.eye(4)
    pose[:3, :3] = json_floats(box.get("normalizedAxes"), name, f"{field}.normalizedAxes", 9).reshape(3, 3).T  # axes are columns
    pose[:3, 3] = center
    if np.linalg.det(pose[:3, :3]) < 0.0:
        pose[:3, 2] *= -1.0  # a box is the same mirrored
    if not is_rigid(pose, 0.01):
        raise InputError(name, f"{field}.normalizedAxes", "are no three unit vectors at right angles", _AGAIN)
    return RoomElement(word, label, nearest_rigid(pose), size, np.zeros((0, 3)), "", field)
