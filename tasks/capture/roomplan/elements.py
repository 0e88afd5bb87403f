"""Elements of a captured room: where they are, how large, and what."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import json_floats, plain_text
from tasks.geometry.transforms import Y_UP_TO_Z_UP, is_rigid, nearest_rigid

Array = NDArray[np.float64]

LARGEST_M = 200.0
"""Larger than any room, and than any building that is scanned by hand."""

_AGAIN = "export the room again"


@dataclasses.dataclass(frozen=True)
class RoomElement:
    """An element. pose: Its own frame (x along its width, y along its height, z its normal or depth) to the +Z-up frame, 4x4 [m].
    size: Width, height and depth [m], shape (3,). corners: Of its outline in its own frame [m], shape (n, 3), none where it is its
    rectangle. parent: Identifier of the wall that it is in. field: Where it stands in the file."""

    identifier: str
    category: str
    pose: Array
    size: Array
    corners: Array
    parent: str
    field: str


def elements_of(value: Any, name: str, kind: str) -> tuple[list[RoomElement], list[str]]:
    """Elements of a list of the file, of which there may be none, and a note for each that is wrong and left out.

    Raises:
        InputError: it is not a list.
    """
    if value is None:
        return [], []
    if not isinstance(value, list):
        raise InputError(name, kind, "must be a list", "is it the right file?")
    elements: list[RoomElement] = []
    notes: list[str] = []
    for index, entry in enumerate(value):
        try:
            elements.append(_element(entry, name, f"{kind}[{index}]"))
        except InputError as error:
            notes.append(f"{error.file}: {error.field}: {error.problem}: left out")
    return elements, notes


def _element(entry: Any, name: str, field: str) -> RoomElement:
    if not isinstance(entry, dict):
        raise InputError(name, field, "must be an object", "is it the right file?")
    size = json_floats(entry.get("dimensions"), name, f"{field}.dimensions", 3)
    if (size < 0.0).any() or (size > LARGEST_M).any():
        raise InputError(name, f"{field}.dimensions", f"must be 0 to {LARGEST_M:g} m", _AGAIN)
    pose = json_floats(entry.get("transform"), name, f"{field}.transform", 16).reshape(4, 4).T  # columns come one after another
    if not is_rigid(pose, 0.01):
        raise InputError(name, f"{field}.transform", "is no rotation and translation", _AGAIN)
    corners = entry.get("polygonCorners") or []
    if not isinstance(corners, list) or len(corners) > 10_000:
        raise InputError(name, f"{field}.polygonCorners", "must be a list of corners", _AGAIN)
    outline = [json_floats(corner, name, f"{field}.polygonCorners[{at}]", 3) for at, corner in enumerate(corners)]
    return RoomElement(
        identifier=_text(entry.get("identifier")),
        category=_category(entry.get("category")),
        pose=Y_UP_TO_Z_UP @ nearest_rigid(pose),
        size=size,
        corners=np.array(outline, dtype=np.float64).reshape(-1, 3),
        parent=_text(entry.get("parentIdentifier")),
        field=field,
    )


def _category(value: Any) -> str:
    """`{"chair": {}}`, as Swift encodes it, or a plain word; an element without one is an object."""
    return _text(next(iter(value), "") if isinstance(value, dict) else value) or "object"


def _text(value: Any) -> str:
    return plain_text(value) if isinstance(value, str) else ""
