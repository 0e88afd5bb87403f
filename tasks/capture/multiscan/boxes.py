"""A scan of MultiScan without its mesh: floor, walls and ceiling in the middle of their boxes, and the box of everything else."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.labels import normalized
from tasks.capture.multiscan.annotation import AnnotatedObject
from tasks.capture.roomplan.elements import RoomElement
from tasks.capture.roomplan.floors import floor_within
from tasks.capture.roomplan.surfaces import Assembly, ElementPart, assembled, box_part, ceiling_part, floor_part, sheets_of, wall_parts

LEAVES = ("door", "window", "gate")
"""Last words of what walls have holes for."""

_QUARTERS = {0: (1, 2, 0), 1: (2, 0, 1), 2: (0, 1, 2)}
"""Axes of a box as x, y and z, right-handed, so that a given one is z."""


def box_surfaces(objects: Sequence[AnnotatedObject], turn: NDArray[np.float64], name: str, file: str) -> tuple[Assembly, list[str]]:
    """Surfaces of all objects that have a box, in their order, and notes on the rest. turn: The file's frame to the +Z-up frame, 4x4.
    name, file: What errors and labels call the annotation.

    Raises:
        InputError: no box has an area, they are larger than a scan, or a door lies in too many walls.
    """
    kept = [(entry, _turned(entry.box, turn)) for entry in objects if entry.box is not None]
    notes = [f"{file}: {entry.field} ({entry.name}): has no box, left out" for entry in objects if entry.box is None]
    walls = [_standing(box) for entry, box in kept if _kind(entry) == "wall"]
    holes = [_standing(box) for entry, box in kept if _kind(entry) in LEAVES]
    sheets, _ = sheets_of(walls, name)
    cut_walls, wall_notes = wall_parts(walls, sheets, holes, name)
    cut = iter(cut_walls)
    notes += wall_notes
    elements = []
    for entry, box in kept:
        match _kind(entry):
            case "wall":
                part = next(cut)
            case "floor":
                part = floor_part(_flat(box, int(np.argmin(box.size))))
            case "ceiling":
                part = ceiling_part(_flat(box, int(np.argmin(box.size))))
            case _:
                part = box_part(box)
        elements.append(ElementPart(entry.source_id, entry.label, f"{file}: {entry.field}", f"{file}: {entry.field}.label", part))
    if walls and not any(_kind(entry) == "floor" for entry, _ in kept):
        elements.append(ElementPart("floor", "floor", f"{file}: objects", f"{file}: objects", floor_within(walls, sheets)))
        notes.append("no floor in the scan: taken to lie within the walls")
    return assembled(elements, name, "objects", "give the scan its mesh, or an annotation with boxes"), notes


def _kind(entry: AnnotatedObject) -> str:
    """The last word of a label: a sliding door is a door, and a wall cabinet a cabinet."""
    return normalized(entry.label).rpartition(" ")[2]


def _turned(box: RoomElement, turn: NDArray[np.float64]) -> RoomElement:
    return dataclasses.replace(box, pose=turn @ box.pose)


def _flat(box: RoomElement, axis: int) -> RoomElement:
    """The rectangle in the middle of a box, across one of its axes: the scan of a flat thing is as thick as its noise."""
    order = list(_QUARTERS[axis])
    pose = box.pose.copy()
    pose[:3, :3] = box.pose[:3, order]
    return dataclasses.replace(box, pose=pose, size=np.array([*box.size[order[:2]], 0.0]))


def _standing(box: RoomElement) -> RoomElement:
    """The same of what stands, across the thinner of its level axes: a short piece of wall may be thicker than high."""
    level = np.argsort(np.abs(box.pose[2, :3]), kind="stable")[:2]
    return _flat(box, int(min(level, key=lambda axis: (box.size[axis], axis))))
