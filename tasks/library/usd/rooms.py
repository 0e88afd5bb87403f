"""Prims of a captured room, as RoomPlan names them: `Room/Parametric_grp/Arch_grp/Wall_0_grp/Wall0`."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

SURFACES = ("Wall", "Door", "Window", "Opening", "Floor", "Ceiling")

OBJECTS = (
    "Bathtub", "Bed", "Chair", "Dishwasher", "Fireplace", "Oven", "Refrigerator", "Sink", "Sofa", "Stairs", "Storage", "Stove", "Table",
    "Television", "Toilet", "WasherDryer",
)  # fmt: skip
"""Categories of `CapturedRoom.Object`."""

_NAMED = re.compile(rf"({'|'.join((*SURFACES, *OBJECTS))})(?:_?\d+|_[0-9A-Fa-f-]{{8,40}}|_[0-9A-Fa-f_]{{36}})", re.IGNORECASE)

_BY_NAME = {category.lower(): category for category in (*SURFACES, *OBJECTS)}

PARAMETRIC, MESH = "Parametric_grp", "Mesh_grp"
"""Groups of the boxes and of the scanned surfaces; an export may have both."""

MAX_ELEMENTS = 10_000
"""Elements of a file: a structure of a hundred rooms has fewer."""


@dataclasses.dataclass(frozen=True)
class RoomPrim:
    """An element of a captured room. path: its prim. name: of the prim. category: in RoomPlan's spelling, '' for a prim without any.

    remark: a contradiction between name and `customData`, '' without any.
    """

    path: str
    name: str
    category: str
    remark: str = ""


def room_prim(drawn: Any) -> RoomPrim:
    """The element that a drawn prim belongs to: the nearest prim above it, or itself, with a category; otherwise itself."""
    prim = drawn
    while prim and not prim.IsPseudoRoot():
        name = prim.GetName()
        match = _NAMED.fullmatch(name)
        by_name = _BY_NAME[match[1].lower()] if match else ""
        # A mesh lies in an Xform of its name, which has the data.
        holder = prim.GetParent() if match and prim.GetParent().GetName() == name else prim
        stated = prim.GetCustomDataByKey("Category") or holder.GetCustomDataByKey("Category")
        by_data = _BY_NAME.get(stated.lower(), stated[:40]) if isinstance(stated, str) and re.fullmatch(r"[A-Za-z]{1,40}", stated) else ""
        if by_name or by_data:
            differs = bool(by_name and by_data) and by_name != by_data
            remark = f"{name}: customData calls it {by_data}, which counts" if differs else ""
            return RoomPrim(str(prim.GetPath()), name, by_data or by_name, remark)
        prim = prim.GetParent()
    return RoomPrim(str(drawn.GetPath()), drawn.GetName(), "")


def is_room(elements: list[RoomPrim]) -> bool:
    """True if the prims of a file are those of a captured room, with walls.

    Other files have names such as `Wall_001`, too. All prims of a room have a category, or most do and RoomPlan's groups are there.
    """
    if len(elements) > MAX_ELEMENTS or not any(element.category == "Wall" for element in elements):
        return False
    named = [element for element in elements if element.category]
    has_groups = any({PARAMETRIC, MESH} & set(element.path.split("/")) for element in named)
    return len(named) == len(elements) or (has_groups and 2 * len(named) >= len(elements))
