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
from tasks.capture.files.documents import json_floats, plain_text
from tasks.capture.labels import normalized
from tasks.capture.roomplan.elements import LARGEST_M, RoomElement
from tasks.capture.rooms.alignment import rotation_to_z
from tasks.geometry.transforms import is_rigid, nearest_rigid

Array = NDArray[np.float64]

REMOVED = "remove"
"""Label of what is no object: what the scan has of things that are not there."""

LEVEL_RADIANS = 1e-6
"""What stands as straight as this is level; the file's own rounding is finer."""

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


def objects_of(document: dict[str, Any], name: str) -> list[AnnotatedObject]:
    """Objects of the annotation, in its order; parts of an object are not told apart.

    Raises:
        InputError: it is no annotation, or two objects have one name.
    """
    listed = document.get("objects")
    if not isinstance(listed, list) or not listed:
        raise InputError(name, "objects", "must be a list of objects", "is it the annotation of a scan of MultiScan?")
    if len(listed) > BUDGET.nodes:
        raise InputError(name, "objects", f"lists more than {BUDGET.nodes}", "is it the right file?")
    objects = [_object(entry, name, f"objects[{index}]") for index, entry in enumerate(listed)]
    seen: set[str] = set()
    for entry in objects:
        if entry.source_id in seen and not (entry.is_removed and entry.number is None):
            raise InputError(name, entry.field, f"{entry.source_id[:40]!r} names two objects", "give every object its own name")
        seen.add(entry.source_id)
    return objects


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


def _object(entry: Any, name: str, field: str) -> AnnotatedObject:
    if not isinstance(entry, dict):
        raise InputError(name, field, "must be an object", "is it the right file?")
    word = entry.get("label")
    if not isinstance(word, str) or not plain_text(word):
        raise InputError(name, f"{field}.label", "must be a text", "is it the right file?")
    word = plain_text(word)
    match = _NUMBERED.fullmatch(word)
    label = match[1] if match else word
    box = entry.get("obb")
    if box is not None and not isinstance(box, dict):
        raise InputError(name, f"{field}.obb", "must be a box", _AGAIN)
    stated = None if box is None else box.get("up")
    up = None if stated is None else json_floats(stated, name, f"{field}.obb.up", 3)
    if up is not None and abs(float(np.linalg.norm(up)) - 1.0) > 0.01:
        raise InputError(name, f"{field}.obb.up", "is no unit vector", _AGAIN)
    return AnnotatedObject(
        name=word,
        label=label,
        number=_number(entry.get("objectId"), name, f"{field}.objectId"),
        box=None if box is None else _box(box, word, label, name, f"{field}.obb"),
        up=up,
        field=field,
    )


def _number(value: Any, name: str, field: str) -> int | None:
    """`objectId`, which the description calls a text and shows as a number."""
    if isinstance(value, str) and re.fullmatch(r"\d{1,9}", value, re.ASCII):
        return int(value)
    if value is not None and (not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**31):
        raise InputError(name, field, "must be a number from 0", _AGAIN)
    return value


def _box(box: dict[str, Any], word: str, label: str, name: str, field: str) -> RoomElement:
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
