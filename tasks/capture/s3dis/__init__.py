"""S3DIS: rooms as points in text, with the points of each object in a file of its own.

Written from the public description of the data set.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file
from tasks.capture.bare_mesh import NO_FRAMES
from tasks.capture.bare_mesh.upright import Stated
from tasks.capture.files.documents import license_of, name_of
from tasks.capture.point_cloud.points import NO_OBJECT, LabelledPoints, Points, check_count
from tasks.capture.point_cloud.rows import read_rows
from tasks.capture.point_cloud.scene import cloud_reading
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan, ScanFormat, files_named, license_path

OBJECTS = "Annotations"
"""The folder of the objects' files."""

WIDTH = 6
"""x, y, z, red, green and blue."""

_OBJECT = re.compile(r"(?P<label>.+)_\d+")
_AREA = re.compile(r"(?i)area_?\d+\w*")


def read_s3dis(scan: Scan) -> Reading:
    """The surface of a room's points, and an instance for each of its objects.

    Raises:
        InputError: the room's file or all of its objects are broken, or the points are too many.
    """
    folder = scan.path
    tables: list[NDArray[np.float64]] = []
    named: list[tuple[str, str]] = []
    notes: list[str] = []
    for path in _object_files(folder, scan.premises):
        match = _OBJECT.fullmatch(path.stem)
        try:
            values = _rows(path, name_of(path, folder), notes)
        except InputError as error:  # a broken object costs itself
            notes.append(f"{error}: left out")
            continue
        check_count(len(values) + sum(map(len, tables)), folder.name)
        tables.append(values)
        named.append((path.stem, match["label"] if match else path.stem))
    if not tables:
        raise InputError(folder.name, OBJECTS, f"has no object that can be read ({'; '.join(notes)[:200]})", "copy the room again")
    owner = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    values = np.concatenate(tables)
    is_used = _owned_once(values, owner)
    if not is_used.all():
        notes.append(f"{folder.name}: {int((~is_used).sum())} points are in several objects: the smallest object has them")
        values, owner = values[is_used], owner[is_used]
    room = _room_file(folder)
    if room.is_file() and scan.premises.admits(room):
        rest = _unlabelled(_rows(room, name_of(room, folder), notes), values)
        values, owner = np.concatenate([values, rest]), np.append(owner, np.full(len(rest), NO_OBJECT))
        if len(rest):
            notes.append(f"{name_of(room, folder)}: {len(rest)} points are of no object")
    colors = np.clip(np.nan_to_num(values[:, 3:]), 0, 255).astype(np.uint8)
    points = Points(values[:, :3], colors, objects=LabelledPoints(owner.astype(np.int64), tuple(named)), unit_m=1.0, notes=tuple(notes))
    stated = Stated(1.0, "z", "its data set")
    license = license_of(license_path(folder, scan.premises))
    return cloud_reading(points, stated, folder.name, license, (NO_FRAMES,))


def _rows(path: Path, name: str, notes: list[str]) -> NDArray[np.float64]:
    """Rows of a file of points, shape (n, 6)."""
    try:
        with open_file(path, name, BUDGET.scene_bytes) as file:
            table = read_rows(file, name, WIDTH)
    except OSError as error:
        raise InputError(name, "file", f"cannot be read ({error.strerror or error})", "check its permissions") from error
    notes += table.notes
    return table.values


def _unlabelled(room: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of a room that no object has, by their millimeters."""
    return room[~np.isin(_keys(room), _keys(values))]


def _owned_once(values: NDArray[np.float64], owner: NDArray[np.int64]) -> NDArray[np.bool_]:
    """False for rows that a smaller object has as well, by their millimeters, shape (n,)."""
    place = np.unique(_keys(values), return_inverse=True)[1]
    order = np.lexsort((owner, np.bincount(owner)[owner], place))
    is_first = np.diff(place[order], prepend=-1) != 0
    smallest = owner[order][is_first]
    return np.asarray((owner == smallest[place]) | ~np.isfinite(values[:, :3]).all(axis=1))


def _keys(rows: NDArray[np.float64]) -> NDArray[np.void]:
    with np.errstate(invalid="ignore"):
        cells = np.rint(np.clip(np.nan_to_num(rows[:, :3]), -1e9, 1e9) * 1000).astype(np.int64)
    return np.ascontiguousarray(cells).view(np.dtype((np.void, 24)))[:, 0]


def _object_files(folder: Path, premises: Premises) -> list[Path]:
    return [path for path in files_named(folder / OBJECTS, (".txt",)) if premises.admits(path)]


def _room_file(folder: Path) -> Path:
    return folder / f"{folder.name}.txt"


def _recognize(folder: Path) -> str | None:
    """Name of the room, with its area's: each area has an `office_1`."""
    objects = folder / OBJECTS
    if not objects.is_dir() or not any(_OBJECT.fullmatch(path.stem) for path in files_named(objects, (".txt",))):
        return None
    return f"{folder.parent.name}_{folder.name}" if _AREA.fullmatch(folder.parent.name) else folder.name


def _files(scan: Scan, premises: Premises) -> list[Path]:
    room = _room_file(scan.path)
    return [*_object_files(scan.path, premises), *([room] if room.is_file() and premises.admits(room) else [])]


S3DIS = ScanFormat(
    name="s3dis",
    dataset="s3dis",
    expected="<room>.txt and Annotations/<label>_<number>.txt",
    recognize=_recognize,
    is_recorded=lambda folder: _recognize(folder) is not None,
    files=_files,
    read=read_s3dis,
    signs=("Annotations/*_*.txt", "*.txt"),
)
