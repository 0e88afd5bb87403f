"""Apple RoomPlan: the JSON of a captured room or structure, with walls, doors, windows, openings and boxes of furniture.

Written from the public description of `CapturedRoom`. There is no mesh and there are no frames: surfaces are the stated rectangles and
boxes. The USDZ that lies beside it shows the same boxes and is not read.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

from schemas.errors import InputError
from tasks.capture.files.documents import license_of, name_of, read_json
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.roomplan.room import ElementMeshes, room_reading
from tasks.capture.roomplan.structure import structure_of
from tasks.capture.scan import Scan, ScanFormat, license_path, own_file

_NAMED = re.compile(r"(captured|roomplan).*\.json", re.IGNORECASE)


def read_roomplan(scan: Scan) -> Reading:
    """Walls without their openings, floor, doors, windows, and the box of each object, turned to +Z up.

    Raises:
        InputError: the file is no captured room, or has no wall.
    """
    folder = scan.folder
    path = own_file(scan, _document(scan).name)
    name = name_of(path, folder)
    structure = structure_of(read_json(path, name), name)
    reading = room_reading(structure.listed, ElementMeshes({}, {}), name, f"{path.name}:", structure.notes)
    license = license_of(license_path(folder, scan.premises))
    return dataclasses.replace(reading, license=license, room_type=structure.room_type)


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
