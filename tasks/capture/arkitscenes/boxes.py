"""Instances from labelled boxes: what of a mesh lies in each."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.annotated_rows import label_text
from tasks.capture.files.documents import json_floats, read_json
from tasks.capture.reading import Group, groups_of
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import vertex_normals

Array = NDArray[np.float64]

SIDE_M = 0.03
"""What lies in a box so near to a side of it [m] and looks into it is floor or wall that the box touches: things look out of theirs."""

EDGE_M = 0.005
"""What lies beyond a side by less [m] is on it: boxes are drawn tightly, and the mesh is noisy."""

INWARD = 0.7
"""Cosine of the angle between a normal and the way into the box from which on it looks into it."""

_AGAIN = "copy the annotation again"


@dataclasses.dataclass(frozen=True)
class LabelledBox:
    """A box in the scan frame. axes: Unit vectors along its sides, row by row, shape (3, 3). size: Along them [m], shape (3,)."""

    source_id: str
    label: str
    center: Array
    axes: Array
    size: Array


def box_groups(path: Path, name: str, surface: Surface) -> tuple[tuple[Group, ...], list[str]]:
    """An instance for each box of an annotation, in its order, and what was odd. Where boxes overlap, vertices are the smaller one's.

    Raises:
        InputError: the file is no such annotation.
    """
    listed, notes = _boxes(read_json(path, name), name)
    boxes = [box for _, box in listed]
    normals = vertex_normals(surface.vertices, surface.faces)
    owner = np.full(len(surface.vertices), -1, dtype=np.int64)
    for index in sorted(range(len(boxes)), key=lambda i: (-float(np.prod(boxes[i].size)), -i)):  # the smallest writes last
        owner[_inside(boxes[index], surface.vertices, normals)] = index
    named: list[tuple[str, str, NDArray[np.int64]]] = []
    origins: list[str] = []
    kept = np.full(len(boxes) + 1, -1, dtype=np.int64)
    for index, (place, box) in enumerate(listed):
        own = np.flatnonzero(owner == index)
        if not len(own):
            notes.append(f"box {box.source_id} ({box.label}): holds nothing of the mesh, left out")
            continue
        kept[index] = len(named)
        named.append((box.source_id, box.label, own))
        origins.append(f"{Path(name).name}: data[{place}].label")
    groups = groups_of(named, kept[owner], surface)
    return tuple(dataclasses.replace(group, origin=origin) for group, origin in zip(groups, origins, strict=True)), notes


def _inside(box: LabelledBox, points: Array, normals: Array) -> NDArray[np.bool_]:
    """Which points are of what a box is around, shape (n,)."""
    local, facing = (points - box.center) @ box.axes.T, normals @ box.axes.T
    depth = 0.5 * box.size - np.abs(local)  # below the nearer side of each pair
    looks_in = (depth < SIDE_M) & (-np.sign(local) * facing > INWARD)
    return np.asarray((depth >= -EDGE_M).all(axis=1) & ~looks_in.any(axis=1))


def _boxes(document: dict[str, Any], name: str) -> tuple[list[tuple[int, LabelledBox]], list[str]]:
    """Boxes of the annotation with their places in its list, and a note for each value that is wrong."""
    data = document.get("data")
    if not isinstance(data, list):
        raise InputError(name, "data", "must be a list of boxes", "is it the right file?")
    boxes: list[tuple[int, LabelledBox]] = []
    notes: list[str] = []
    seen: set[str] = set()
    for index, entry in enumerate(data):
        field = f"data[{index}]"
        try:
            box = _box(entry, index, name, field)
        except InputError as error:
            notes.append(f"{error.file}: {error.field}: {error.problem}: left out")
            continue
        if box.source_id in seen:
            renamed = f"{box.source_id}.{index}"
            notes.append(f"{name}: {field}.uid: {box.source_id[:40]!r} names two boxes: this one is called {renamed[:60]!r}")
            box = dataclasses.replace(box, source_id=renamed)
        if not label_text(entry.get("label"))[1]:
            notes.append(f"{name}: {field}.label: is missing, or not a text: the box is unlabeled")
        seen.add(box.source_id)
        boxes.append((index, box))
    return boxes, notes


def _box(entry: Any, index: int, name: str, field: str) -> LabelledBox:
    segments = entry.get("segments") if isinstance(entry, dict) else None
    box = segments.get("obbAligned", segments.get("obb")) if isinstance(segments, dict) else None
    if not isinstance(box, dict):
        raise InputError(name, field, "must have segments.obbAligned", _AGAIN)
    uid = label_text(entry.get("uid"))[0] or str(index)
    center, size = (json_floats(box.get(key), name, f"{field}.segments.obbAligned.{key}", 3) for key in ("centroid", "axesLengths"))
    axes = json_floats(box.get("normalizedAxes"), name, f"{field}.segments.obbAligned.normalizedAxes", 9).reshape(3, 3)
    if np.abs(axes @ axes.T - np.eye(3)).max() > 0.01:
        raise InputError(name, f"{field}.segments.obbAligned.normalizedAxes", "are not three unit vectors at right angles", _AGAIN)
    if (size <= 0.0).any():
        raise InputError(name, f"{field}.segments.obbAligned.axesLengths", "must be above 0", _AGAIN)
    return LabelledBox(uid, label_text(entry.get("label"))[0], center, axes, size)
