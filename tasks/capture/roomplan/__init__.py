"""Apple RoomPlan: the JSON of a captured room or structure, with walls, doors, windows, openings and boxes of furniture.

Written from the public description of `CapturedRoom`. There is no mesh and there are no frames: surfaces are the stated rectangles and
boxes. The USDZ that lies beside it shows the same boxes and is not read.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.documents import license_of, name_of, read_json
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.roomplan.elements import RoomElement, elements_of
from tasks.capture.roomplan.surfaces import ElementPart, assembled, box_part, floor_part, floor_within, panel_part, wall_parts
from tasks.capture.scan import Scan, ScanFormat, license_path, own_file
from tasks.geometry.transforms import Y_UP_TO_Z_UP

_NAMED = re.compile(r"(captured|roomplan).*\.json", re.IGNORECASE)

NO_SURFACE = "no mesh and no frames in the scan: objects are boxes, walls rectangles; no views, no masks"


def read_roomplan(scan: Scan) -> Reading:
    """Walls without their openings, floor, doors, windows, and the box of each object, turned to +Z up.

    Raises:
        InputError: the file is no captured room, or has no wall.
    """
    folder = scan.folder
    path = own_file(scan, _document(scan).name)
    name = name_of(path, folder)
    document = read_json(path, name)
    listed: dict[str, list[RoomElement]] = {}
    notes = [NO_SURFACE]
    for kind in ("walls", "doors", "windows", "openings", "floors", "objects"):
        listed[kind], more = elements_of(document.get(kind), name, kind)
        notes += more
    if sum(map(len, listed.values())) > BUDGET.nodes:
        raise InputError(name, "content", f"lists more than {BUDGET.nodes} elements", "is it the right file?")
    if not listed["walls"]:
        raise InputError(name, "walls", "there are none", "is it the JSON of a CapturedRoom? Scan the room's walls, too")
    holes = [*listed["doors"], *listed["windows"], *listed["openings"]]
    parts = wall_parts(listed["walls"], holes, name)
    labels = ["wall"] * len(parts)
    origins = [wall.field for wall in listed["walls"]]
    floors = [floor_part(floor) for floor in listed["floors"]]
    if not floors:
        floors = [floor_within(listed["walls"])]
        notes.append("no floor in the scan: taken to lie within the walls")
    for kind, made in (("floor", floors), ("door", [*map(panel_part, listed["doors"])]), ("window", [*map(panel_part, listed["windows"])])):
        parts += made
        labels += [kind] * len(made)
        origins += [element.field for element in listed[f"{kind}s"]] or ["walls"] * len(made)
    parts += [box_part(element) for element in listed["objects"]]
    labels += [element.category for element in listed["objects"]]
    origins += [element.field for element in listed["objects"]]
    named = enumerate(zip(parts, labels, origins, strict=True))
    elements = [ElementPart(f"{label} {k}", label, field, f"{path.name}: {field}.category", part) for k, (part, label, field) in named]
    whole = assembled(elements, name, "walls", "scan the room again")
    return Reading(
        surface=whole.surface,
        parts=whole.parts,
        groups=whole.groups,
        room_type=_room_type(document.get("sections")),
        license=license_of(license_path(folder, scan.premises)),
        is_dense=False,
        degradations=(*notes, *whole.notes),
        from_file=Y_UP_TO_Z_UP,
    )


def _room_type(sections: Any) -> str:
    """`livingRoom` is a living room; of several sections none is the room's."""
    labels = {str(entry.get("label")) for entry in sections if isinstance(entry, dict)} if isinstance(sections, list) else set()
    label = labels.pop() if len(labels) == 1 else ""
    if not re.fullmatch(r"[A-Za-z]{1,40}", label) or label == "unidentified":
        return ""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", label).lower()


def _documents(folder: Path) -> Sequence[Path]:
    """JSON files that are those of a captured room by their names, or by a USDZ of the same name beside them."""
    files = sorted(path for path in folder.iterdir() if not path.name.startswith(".") and not path.is_dir())
    models = {path.stem for path in files if path.suffix.lower() == ".usdz"}
    documents = (path for path in files if path.suffix.lower() == ".json")
    return [path for path in documents if _NAMED.fullmatch(path.name) or path.stem in models]


def _document(scan: Scan) -> Path:
    """The JSON of a scan, which is the scan itself where several rooms or other meshes lie side by side."""
    documents = _documents(scan.folder) if scan.path.is_dir() else [scan.path]
    if len(documents) != 1:
        problem = f"holds {len(documents)} captured rooms, one is expected"
        raise InputError(scan.folder.name, "folder", problem, "give every room its own folder")
    return documents[0]


def _files(scan: Scan, premises: Premises) -> list[Path]:
    documents = _documents(scan.folder) if scan.path.is_dir() else [scan.path]
    return [path for path in documents if path.is_file() and premises.admits(path)]


ROOMPLAN = ScanFormat(
    name="roomplan",
    dataset="roomplan",
    expected="CapturedRoom.json, or a .json beside a .usdz of the same name",
    recognize=lambda folder: folder.name if len(_documents(folder)) == 1 else None,
    is_recorded=lambda folder: bool(_documents(folder)),
    files=_files,
    read=read_roomplan,
    signs=("*.usdz", "*.json"),
    is_modelled=True,
    within=lambda folder: [(path, path.stem) for path in _documents(folder)],
)
