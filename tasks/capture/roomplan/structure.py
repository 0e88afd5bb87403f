"""Elements of a `CapturedRoom`, or of a `CapturedStructure` with the rooms that it was merged from."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.wording import counted
from tasks.capture.files.documents import plain_text
from tasks.capture.roomplan.elements import RoomElement, elements_of

SURFACES = ("walls", "doors", "windows", "openings", "floors")
KINDS = (*SURFACES, "objects")

_COMMON = frozenset({"identifier", "category", "dimensions", "transform", "story"})
_FILLING = _COMMON | {"polygonCorners", "parentIdentifier"}
_READ = {
    "walls": _COMMON | {"polygonCorners", "curve"}, "floors": _COMMON | {"polygonCorners"}, "objects": _COMMON,
    "doors": _FILLING, "windows": _FILLING, "openings": _FILLING,
}  # fmt: skip
"""Fields of elements that are used, by their list."""

MIN_RECTANGLE_SHARE = 0.98
"""Share of its rectangle that the outline of a rectangular door has at least."""

_HEAD = frozenset({*KINDS, "sections", "rooms", "identifier", "version"})
"""Fields of a document or room that are used, or that name it."""

MAX_FIELDS_NAMED = 12
"""Unused fields that a line names."""


@dataclasses.dataclass(frozen=True)
class Structure:
    """Content of a document. listed: elements by their list. room_type: '' if sections state none or several."""

    listed: Mapping[str, list[RoomElement]]
    room_type: str
    notes: tuple[str, ...]


def structure_of(document: dict[str, Any], name: str) -> Structure:
    """The elements of a room or structure. A list that the structure lacks is that of its rooms.

    Raises:
        InputError: a list has the wrong type, the elements are more than the budget, or there are no walls.
    """
    notes: list[str] = []
    rooms = _rooms(document, name)
    values: dict[str, list[tuple[str, Any]]] = {}
    for kind in KINDS:
        merged = document.get(kind)
        if merged is not None and not isinstance(merged, list):
            raise InputError(name, kind, "must be a list", "is it the right file?")
        own = [(f"rooms[{k}].{kind}", room.get(kind)) for k, room in enumerate(rooms)]
        count = sum(len(value) for _, value in own if isinstance(value, list))
        if not merged and count:
            values[kind] = own
            notes.append(f"{name}: {kind}: the structure lists none, its rooms list {count}: those are used")
        else:
            values[kind] = [(kind, merged)]
            # Merging joins walls that two rooms share. Objects are never shared.
            if kind == "objects" and count > len(merged or ()):
                notes.append(f"{name}: objects: the structure lists {len(merged or ())}, its rooms {count}: the structure is used")
    if sum(len(value) for lists in values.values() for _, value in lists if isinstance(value, list)) > BUDGET.nodes:
        raise InputError(name, "content", f"lists more than {BUDGET.nodes} elements", "is it the right file?")
    listed: dict[str, list[RoomElement]] = {kind: [] for kind in KINDS}
    wrong: list[str] = []
    for kind, lists in values.items():
        for field, value in lists:
            elements, more = elements_of(value, name, field)
            listed[kind] += elements
            wrong += more
    if not listed["walls"]:
        first = next((note for note in wrong if note.startswith(f"{name}: walls[")), "")
        problem = f"none is usable ({first.removeprefix(f'{name}: ')})" if first else "there are none"
        raise InputError(name, "walls", problem, "is it the JSON of a CapturedRoom? Scan the room's walls, too")
    sections = [entry for part in (document, *rooms) for entry in _entries(part.get("sections"))]
    room_type, more = _room_type(sections, name)
    return Structure(
        listed,
        room_type,
        (*notes, *wrong, *more, *_unused(document, rooms, values, name), *_open_doors(values, name), *_bent(listed, name)),
    )


def _rooms(document: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """The rooms of a structure.

    Raises:
        InputError: it is not a list of objects.
    """
    value = document.get("rooms")
    if value is None:
        return []
    if not isinstance(value, list) or not all(isinstance(room, dict) for room in value):
        raise InputError(name, "rooms", "must be a list of objects", "is it the right file?")
    return value


def _entries(value: Any) -> Iterator[dict[str, Any]]:
    """Objects of a list; nothing of anything else."""
    return (entry for entry in (value if isinstance(value, list) else ()) if isinstance(entry, dict))


def _room_type(sections: list[dict[str, Any]], name: str) -> tuple[str, list[str]]:
    """The kind of room: `livingRoom` is a living room. Several kinds are noted, and none is the scene's."""
    labels = {str(entry.get("label")) for entry in sections}
    words = sorted(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", label).lower() for label in labels if re.fullmatch(r"[A-Za-z]{1,40}", label))
    words = [word for word in words if word != "unidentified"]
    if len(words) > 1:
        return "", [f"{name}: sections: name several kinds of rooms ({', '.join(words[:MAX_FIELDS_NAMED])}): none is the scene's"]
    return (words[0] if words else ""), []


def _unused(document: Mapping[str, Any], rooms: list[dict[str, Any]], values: Mapping[str, list[tuple[str, Any]]], name: str) -> list[str]:
    """A line with the fields that the file states and that are not used."""
    fields = set[str]()
    for prefix, part in (("", document), *(("rooms.", room) for room in rooms)):
        stories = [wall.get("story") for wall in _entries(part.get("walls"))]
        is_restated = part.get("story") in stories
        read = _HEAD | {"story"} if is_restated else _HEAD
        fields.update(f"{prefix}{key}" for key, value in part.items() if key not in read and value not in (None, [], {}, ""))
    for kind, lists in values.items():
        read = _READ[kind]
        for entry in (entry for _, value in lists for entry in _entries(value)):
            fields.update(f"{kind}.{key}" for key, value in entry.items() if key not in read and value not in (None, [], {}, ""))
    if not fields:
        return []
    named = [plain_text(field)[:60] for field in sorted(fields)]
    more = f" and {counted(len(named) - MAX_FIELDS_NAMED, 'more field')}" if len(named) > MAX_FIELDS_NAMED else ""
    return [f"{name}: not used: {', '.join(named[:MAX_FIELDS_NAMED])}{more}"]


def _bent(listed: Mapping[str, list[RoomElement]], name: str) -> list[str]:
    """A line for each list with doors, windows or openings whose outline is not a rectangle."""
    notes = []
    for kind in ("doors", "windows", "openings"):
        fields = [element.field for element in listed[kind] if not _is_rectangle(element)]
        more = f" and {counted(len(fields) - 1, 'more outline')}" if len(fields) > 1 else ""
        notes += [f"{name}: {fields[0]}.polygonCorners{more}: not a rectangle: its rectangle is taken"] if fields else []
    return notes


def _is_rectangle(element: RoomElement) -> bool:
    """True if an element has no outline, or one that fills its rectangle."""
    if len(element.corners) < 3:
        return True
    x, y = element.corners[:, 0], element.corners[:, 1]
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    return area >= MIN_RECTANGLE_SHARE * float(np.ptp(x) * np.ptp(y))


def _open_doors(values: Mapping[str, list[tuple[str, Any]]], name: str) -> list[str]:
    """A line if doors are stated to be open: their panels are shown shut."""
    categories = [entry.get("category") for _, value in values["doors"] for entry in _entries(value)]
    doors = [category.get("door") for category in categories if isinstance(category, dict)]
    count = sum(isinstance(door, dict) and door.get("isOpen") is True for door in doors)
    return [f"{name}: doors: {counted(count, 'open door')}, shown shut"] if count else []
